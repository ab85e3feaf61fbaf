"""The command `strandcache`. Exit codes are Strandbake's: 2 usage, 3 input, 5 disk."""

from __future__ import annotations

import argparse
import sys
import zipfile
from collections.abc import Sequence
from pathlib import Path

from . import Cache, CacheError, __version__, bl_info, to_usd

_USAGE, _INPUT, _DISK = 2, 3, 5


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="strandcache", description="Takes Strandbake's caches into other programs.")
    parser.add_argument("--version", action="version", version=__version__)
    verbs = parser.add_subparsers(dest="verb", required=True)

    usd = verbs.add_parser("to-usd", help="write USD: BasisCurves with a sample for each frame")
    usd.add_argument("cache", type=Path, metavar="CACHE")
    usd.add_argument("output", type=Path, metavar="OUTPUT", help=".usdc, .usda or .usd")
    usd.add_argument("--frames", type=_frames, metavar="FIRST-LAST", help="only these frames of the scene")
    usd.add_argument(
        "--width", type=float, default=1e-4, metavar="METRES", help="diameter of the strands (%(default)s)"
    )
    usd.add_argument("--by-region", action="store_true", help="curves of their own for each region")
    usd.add_argument(
        "--frames-per-clip", type=int, metavar="N", help="for long shots: points in value clips of N frames"
    )

    abc = verbs.add_parser("to-abc", help="write Alembic; needs Blender's Python package: pip install bpy")
    abc.add_argument("cache", type=Path, metavar="CACHE")
    abc.add_argument("output", type=Path, metavar="OUTPUT", help=".abc")
    abc.add_argument("--radius", type=float, default=5e-5, metavar="METRES", help="of the strands (%(default)s)")

    addon = verbs.add_parser("blender-addon", help="write the add-on that Blender installs")
    addon.add_argument("output", type=Path, metavar="OUTPUT", help=".zip")
    addon.add_argument(
        "--wheel",
        type=Path,
        action="append",
        default=[],
        help="a wheel to bring along for Blenders that lack it, as h5py; Blender 4.2 or newer; may be repeated",
    )

    for verb in (usd, abc, addon):
        verb.add_argument("--force", action="store_true", help="replace OUTPUT")
    return parser


def _frames(text: str) -> range:
    first, _, last = text.partition("-")
    try:
        return range(int(first), int(last or first) + 1)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text}: wants FIRST-LAST, as 1-120") from None


def _write_addon(target: Path, wheels: Sequence[Path]) -> None:
    """The package itself, with the manifest that Blender 4.2 and newer look for."""
    listed = ", ".join(f'"./wheels/{wheel.name}"' for wheel in wheels)
    manifest = f"""schema_version = "1.0.0"
id = "strandcache"
version = "{__version__}"
name = "{bl_info["name"]}"
tagline = "{bl_info["description"]}"
maintainer = "Strandbake"
type = "add-on"
blender_version_min = "4.2.0"
license = ["SPDX:MIT"]
wheels = [{listed}]

[permissions]
files = "Reads caches"
"""
    package = Path(__file__).parent
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in sorted(package.glob("*.py")):
            archive.write(file, f"strandcache/{file.name}")
        archive.writestr("strandcache/blender_manifest.toml", manifest)
        for wheel in wheels:
            archive.write(wheel, f"strandcache/wheels/{wheel.name}")


def _run(arguments: argparse.Namespace) -> None:
    target: Path = arguments.output
    if target.exists() and not arguments.force:
        raise FileExistsError(f"{target}: is there already; --force replaces it")
    if arguments.verb == "blender-addon":
        _write_addon(target, arguments.wheel)
    elif arguments.verb == "to-abc":
        from . import blender

        blender.to_alembic(arguments.cache, target, radius=arguments.radius)
    else:
        with Cache(arguments.cache) as cache:
            to_usd(
                cache,
                target,
                frames=arguments.frames,
                width=arguments.width,
                by_region=arguments.by_region,
                frames_per_clip=arguments.frames_per_clip,
            )


def main(words: Sequence[str] | None = None) -> int:
    arguments = _parser().parse_args(words)
    try:
        _run(arguments)
    except CacheError as error:
        return _say(error, _INPUT)
    except (ValueError, ImportError) as error:
        return _say(error, _USAGE)
    except OSError as error:
        return _say(error, _DISK)
    return 0


def _say(error: Exception, code: int) -> int:
    print(f"strandcache: error: {error}", file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
