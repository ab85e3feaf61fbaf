#!/usr/bin/env python3
"""Bakes the first frames of every scene of scenes/ and compares them, to the bit, with the digests of scenes/golden/.

    scripts/golden.py [BUILD]             fails where a position has changed
    scripts/golden.py [BUILD] --accept    writes what is baked now as the new digests; the commit says why

BUILD is the folder of a release build, build/release if left out. A scene whose files are not here is told and left out:
STRANDBAKE_ASSETS names their folder, ../shared/assets beside the project if left out.
"""

import argparse
import os
import pathlib
import re
import subprocess
import sys
import tempfile
import time

SOURCE = pathlib.Path(__file__).resolve().parents[1]
GOLDEN = SOURCE / "scenes/golden"
# So many frames of each that all take some 15 seconds on two cores.
FRAMES = {"curls": "1-24", "demo": "1-30", "mohawk_fbx": "1-12", "ponytail_robot": "1-12", "ponytail_walk": "1-12"}


def run(program: pathlib.Path, *arguments: str | os.PathLike, cwd: str) -> tuple[int, str]:
    """Exit code of a run, and what it said."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("STRANDBAKE_")}
    done = subprocess.run([program, *arguments], cwd=cwd, env=environment, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
                          text=True, check=False)
    return done.returncode, done.stdout.strip()


def judge(program: pathlib.Path, scene: pathlib.Path, assets: pathlib.Path, folder: str, accept: bool) -> bool:
    """Bakes a scene and compares or accepts it; tells how that went, and returns whether it went well."""
    search = pathlib.Path(folder)
    if groom := re.search(r"^#   strandbake (groom .*)$", scene.read_text(), re.MULTILINE):  # as the scene says how to make it
        run(program, *groom[1].split(), cwd=folder)
    elif assets.is_dir():
        search = assets
    else:
        print(f"{scene.stem}: left out: {assets} is not here")
        return True
    start = time.monotonic()
    digest = GOLDEN / f"{scene.stem}.digest"
    code, text = run(program, "bake", scene, "--search", search, "--frames", FRAMES[scene.stem], "-o", "scene.h5", "--quiet",
                     "--force", cwd=folder)
    if code == 0 and accept:
        GOLDEN.mkdir(exist_ok=True)
        code, text = run(program, "digest", "scene.h5", "-o", digest, "--force", cwd=folder)
    elif code == 0:
        code, text = run(program, "compare", digest, "scene.h5", cwd=folder)
    how = "failed" if code else "accepted" if accept else "the same"
    print(f"{scene.stem}: {how}, frames {FRAMES[scene.stem]}, {time.monotonic() - start:.1f} s")
    if code:
        print(text)
    return code == 0


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("build", nargs="?", type=pathlib.Path, default=SOURCE / "build/release", metavar="BUILD")
    parser.add_argument("--accept", action="store_true")
    options = parser.parse_args()
    program = (options.build / "cli/strandbake").resolve()
    assets = pathlib.Path(os.environ.get("STRANDBAKE_ASSETS") or SOURCE.parent / "shared/assets").resolve()
    scenes = sorted((SOURCE / "scenes").glob("*.toml"))
    if unknown := [scene.name for scene in scenes if scene.stem not in FRAMES]:
        sys.exit(f"golden.py: FRAMES does not say how many frames of {', '.join(unknown)} to bake")
    with tempfile.TemporaryDirectory() as folder:
        results = [judge(program, scene, assets, folder, options.accept) for scene in scenes]
    if not all(results):
        print("if that is meant to be: scripts/golden.py --accept, and say why in the commit")
    return 0 if all(results) else 1


if __name__ == "__main__":
    sys.exit(main())
