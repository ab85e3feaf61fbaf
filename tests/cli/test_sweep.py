"""The variants of a look in docs/PIPELINE.md."""

import os
import pathlib
import re
import subprocess

import pytest
from conftest import PROGRAM, SOURCE


def test_the_sweep_of_the_pipeline_page_runs(shot):
    page = (SOURCE / "docs/PIPELINE.md").read_text()
    code = re.search(r"## Sweeps.*?```sh\n(.*?)```", page, re.S)[1]
    shot.scene(name="shot.toml")
    path = f"{pathlib.Path(PROGRAM).parent}:{os.environ['PATH']}"
    done = subprocess.run(["bash", "-e", "-c", code], cwd=shot.folder, env={**os.environ, "PATH": path}, capture_output=True,
                          text=True, timeout=300, check=False)
    assert done.returncode == 0 and done.stderr == "", done.stderr
    looks = ["dry", "wet", "heavy", "stiff"]
    assert all((shot / f"{look}.png").exists() for look in looks)
    assert len({(shot / f"{look}.h5").read_bytes() for look in looks}) == 4


def test_the_sweep_of_the_demo_draws_a_sheet(shot):
    image = pytest.importorskip("PIL.Image")
    subprocess.run(["/usr/bin/python3", SOURCE / "scripts/sweep.py", "--program", PROGRAM, "-o", shot / "sweep.png", "--strands", "40",
                    "--frames", "2", "3", "--width", "64"], timeout=300, check=True)
    with image.open(shot / "sweep.png") as sheet:
        assert sheet.width == 4 * 64 and sheet.height >= 2 * 64
        columns = {sheet.crop((64 * c, sheet.height // 2, 64 * c + 64, sheet.height)).tobytes() for c in range(4)}
    assert len(columns) == 4
