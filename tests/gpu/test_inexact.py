"""How far hair strays from the CPU's in one frame on a device whose divisions and square roots are as wrong as OpenCL lets
them be. No device at hand is, so the program's text is made so."""
import json
import os
import pathlib
import re
import subprocess

import pytest

SAMPLE = os.environ["STRANDBAKE_GPU_SAMPLE"]
PROGRAM = pathlib.Path(os.environ["STRANDBAKE_GPU_PROGRAM"]).read_text()
PASSES_END = PROGRAM.index('#line 1 "gpu/kernels/layout.h"')

# OpenCL 1.2, section 7.4: a quotient may be off by 2.5 units in its last place, a root by 3. What is off by half a unit is
# moved by two more: all up, all down, or each by its own bits.
OFF = {"up": "2", "down": "-2", "either way": "(int)((as_uint(x) * 2654435761u) >> 16) % 5 - 2"}
INEXACT = "static float inexact(float x) { return isnormal(x) ? as_float(as_int(x) + (%s)) : x; }\n"


def with_inexact_math(moved):
    """The program with inexact(a / b) for each division of the passes and inexact(sqrt(a)) for each root."""
    text = re.sub("//.*", "", PROGRAM[:PASSES_END])
    while (slash := text.find(" / ")) >= 0:
        # What is next to the sign without a space, parentheses and all in them included.
        begin, depth = slash, 0
        while depth > 0 or re.match(r"[\w.)]", text[begin - 1]):
            begin -= 1
            depth += {")": 1, "(": -1}.get(text[begin], 0)
        end, depth = slash + 3, 0
        while depth > 0 or re.match(r"[\w.(]", text[end]):
            depth += {"(": 1, ")": -1}.get(text[end], 0)
            end += 1
        text = f"{text[:begin]}inexact({text[begin:slash]}/{text[slash + 3:end]}){text[end:]}"
    root = "#define SQRT(a) sqrt(a)"
    assert root in text
    return INEXACT % moved + text.replace(root, "#define SQRT(a) inexact(sqrt(a))") + PROGRAM[PASSES_END:]


def distances(folder, text):
    """To the CPU's hair after a frame, root mean squares [m]: of every method, each in the mapping that suits few strands;
    and of rods."""
    (folder / "program.cl").write_text(text)
    done = subprocess.run([SAMPLE, folder / "program.cl", "vertices"], capture_output=True, text=True, timeout=300,
                          env={**os.environ, "POCL_EXTRA_BUILD_FLAGS": "-cl-opt-disable"})
    if done.returncode == 3 and "OpenCL" in done.stderr:
        pytest.skip("there is no OpenCL device")
    assert done.returncode in (0, 1), done.stderr
    ran = json.loads(done.stdout)
    return ran["rms_distance"], ran["rod_rms_distance"]


def test_what_is_moved_by_nothing_strays_nowhere(tmp_path):
    text = with_inexact_math("0")
    assert text.count("inexact(") >= 9
    assert distances(tmp_path, text) == (0, 0)


@pytest.mark.parametrize("off", OFF)
def test_an_inexact_device_strays_by_no_more_than_devices_says(tmp_path, off):
    others, rods = distances(tmp_path, with_inexact_math(OFF[off]))
    assert 0 < others < 5e-8
    assert 0 < rods < 3e-6
