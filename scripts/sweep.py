#!/usr/bin/env python3
"""Bakes variants of the demo scene with --set: the same hair as it is, wet, heavy and stiff, as in Figure 6 of the paper. Puts
pictures of them side by side; docs/sweep.png is one.

  scripts/sweep.py -o docs/sweep.png
"""

import argparse
import pathlib
import subprocess
import tempfile

from PIL import Image

SOURCE = pathlib.Path(__file__).resolve().parents[1]

VARIANTS: dict[str, list[str]] = {
    "dry": [],
    "wet": ["forces.gravity=[0, -15, 0]", "region.hair.local.stiffness=0.1", "region.hair.local.iterations=2",
            "region.hair.global.stiffness=0.05", "region.hair.damping=0.15", "region.hair.drag=0.1"],
    "heavy": ["forces.gravity=[0, -30, 0]", "region.hair.local.stiffness=0.3", "region.hair.global.stiffness=0.05",
              "region.hair.drag=0.3"],
    "stiff": ["region.hair.local.stiffness=0.99", "region.hair.local.iterations=10", "region.hair.global.stiffness=0.4",
              "region.hair.global.range=0.9"],
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("-o", "--output", type=pathlib.Path, required=True, help="the picture (PNG)")
    parser.add_argument("--program", type=pathlib.Path, default=SOURCE / "build/release/cli/strandbake")
    parser.add_argument("--style", default="wavy", help="of `strandbake groom`")
    parser.add_argument("--strands", default="12000")
    parser.add_argument("--frames", type=int, nargs="+", default=[44, 104], help="a row of pictures for each")
    parser.add_argument("--width", type=int, default=240, help="of each picture, in pixels")
    options = parser.parse_args()

    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)

        def strandbake(*words: str) -> None:
            subprocess.run([options.program.resolve(), *words], cwd=folder, stdout=subprocess.DEVNULL, check=True)

        strandbake("groom", "--style", options.style, "--strands", options.strands, "--vertices", "24", "--seed", "7", "-o",
                   "demo.hair")
        pictures = {}
        for variant, settings in VARIANTS.items():
            changes = [word for setting in settings for word in ("--set", setting)]
            strandbake("bake", str(SOURCE / "scenes/demo.toml"), "--search", ".", "-o", f"{variant}.h5", "--quiet",
                       "--set", f"bake.frames=1-{max(options.frames)}", *changes)
            for frame in options.frames:
                strandbake("preview", f"{variant}.h5", "-o", "picture.png", "--frames", str(frame), "--force")
                with Image.open(folder / "picture.png") as picture:
                    height = round(picture.height * options.width / picture.width)
                    pictures[variant, frame] = picture.convert("RGB").resize((options.width, height), Image.Resampling.LANCZOS)

    width, height = next(iter(pictures.values())).size
    sheet = Image.new("RGB", (width * len(VARIANTS), height * len(options.frames)))
    for (variant, frame), picture in pictures.items():
        sheet.paste(picture, (width * list(VARIANTS).index(variant), height * options.frames.index(frame)))
    sheet.save(options.output, optimize=True)


if __name__ == "__main__":
    main()
