"""The OpenCL program under oclgrind, which sees every access of every work-item: no race, nothing out of bounds, nothing
read that was never written; and that it sees, shown on programs with such a fault put in."""
import concurrent.futures
import json
import os
import pathlib
import re
import subprocess

import pytest

OCLGRIND = pathlib.Path("/usr/lib/oclgrind/liboclgrind-rt-icd.so")
SAMPLE = os.environ["STRANDBAKE_GPU_SAMPLE"]
PROGRAM = pathlib.Path(os.environ["STRANDBAKE_GPU_PROGRAM"]).read_text()
# Stands in it once for each kernel.
FILE = '#line 1 "gpu/kernels/vertex_per_item.cl"'
KERNELS = [(int(m[1]), m[2]) for m in re.finditer(r"#ifdef VERTICES_METHOD_(\d)_(\w+)", PROGRAM)]
COPIES = [m.start() for m in re.finditer(re.escape(FILE), PROGRAM)]
TEXT = PROGRAM[COPIES[0]:COPIES[1]]
TEXT = TEXT[:TEXT.index("#undef METHOD")]

# Local memory and a work-group of so many items; strands are up to 9 vertices long.
RUNS = {"strands": ["strands", "32768", "16"], "local": ["vertices", "32768", "16"], "global": ["vertices", "100", "16"]}

pytestmark = pytest.mark.skipif(not OCLGRIND.exists(), reason="oclgrind is not installed")


def oclgrind(folder, run, text=PROGRAM):
    """What the sample says and what oclgrind has to complain about."""
    folder.mkdir(exist_ok=True)
    (folder / "oclgrind.icd").write_text(f"{OCLGRIND}\n")
    (folder / "program.cl").write_text(text)
    log = folder / "log"
    environment = {
        **os.environ, "OCL_ICD_VENDORS": str(folder), "OCLGRIND_LOG": str(log), "OCLGRIND_DATA_RACES": "1",
        "OCLGRIND_UNIFORM_WRITES": "1", "OCLGRIND_UNINITIALIZED": "1", "OCLGRIND_CHECK_API": "1",
        "OCLGRIND_MAX_ERRORS": "20000",
        "OCLGRIND_BUILD_OPTIONS": "-cl-opt-disable",  # it does not know what optimised programs are made of
    }
    done = subprocess.run([SAMPLE, folder / "program.cl", *RUNS[run]], env=environment, capture_output=True, text=True,
                          timeout=120)
    return done, log.read_text() if log.exists() else ""


@pytest.mark.parametrize("run", RUNS)
def test_no_fault_in_any_kernel(tmp_path, run):
    done, log = oclgrind(tmp_path / run, run)
    assert log == ""
    assert done.returncode == 0, done.stdout + done.stderr
    ran = json.loads(done.stdout)
    assert "Oclgrind" in ran["device"]
    assert ran["strand_blocks"] > 0
    assert (ran["vertex_blocks"] > 0) == (run != "global")
    assert (ran["long_blocks"] > 0) == (run == "global")
    assert ran["strands_in_a_block"] == 2  # so 8 rows of vertices in a group, less than some strands have


def kernel_name(method, memory):
    return f"advance_vertices_{method}_{memory.lower()}"


def compiled_for(method, place):
    """Whether the conditions on METHOD around a place of the text hold."""
    holds = []
    for line in TEXT[:place].splitlines():
        if re.match("#if(def|ndef)? ", line):
            condition = re.fullmatch(r"#if (METHOD [^/]*?)\s*(//.*)?", line)
            text = re.sub(r"defined\(\w+\)", "True", condition[1]) if condition else "True"
            holds.append(eval(text.replace("||", "or").replace("&&", "and"), {"METHOD": method}))
        elif line.startswith("#else"):
            holds[-1] = not holds[-1]
        elif line.startswith("#endif"):
            holds.pop()
    return all(holds)


BARRIER = "SHARED_BARRIER;"
BARRIERS = [m.start() for m in re.finditer(BARRIER, TEXT)]


def without_barrier(place):
    text = PROGRAM
    for copy in COPIES:
        assert text[copy + place:].startswith(BARRIER)
        text = text[:copy + place] + " " * len(BARRIER) + text[copy + place + len(BARRIER):]
    return text


def kernels_with(log, complaint):
    """The kernels that oclgrind complains about. An entry: what, then the lines about who."""
    return {kernel for entry in log.split("\n\n") if complaint in entry for kernel in re.findall(r"Kernel: *(\w+)", entry)}


def test_each_barrier_is_missed_where_it_is_taken_out(tmp_path):
    assert len(KERNELS) == len(COPIES) == 8 and len(BARRIERS) >= 10

    def not_missed(place):
        """The kernels that have the barrier less those where it was missed."""
        having = {kernel_name(*kernel) for kernel in KERNELS if compiled_for(kernel[0], place)}
        assert having
        for run in ("local", "global"):
            _, log = oclgrind(tmp_path / f"{place}_{run}", run, without_barrier(place))
            having -= kernels_with(log, "data race")
        return having

    with concurrent.futures.ThreadPoolExecutor(os.cpu_count()) as pool:
        found = list(pool.map(not_missed, BARRIERS))
    assert {TEXT[:place].count("\n"): kernels for place, kernels in zip(BARRIERS, found) if kernels} == {}


# An index shifted by the length of what it goes through, so that the last of its kind leaves the buffer.
TWIST = "NAME(write_twist)(more, i, twist_between"
SHIFTS = {
    "local memory": ("local", "advance_vertices_4_local", TWIST, TWIST.replace(" i,", " i + capacity,")),
    "scratch memory": ("global", "advance_vertices_4_global", TWIST,
                       TWIST.replace(" i,", " i + get_num_groups(0) * shared_stride / ROW,")),
    "state": ("local", "advance_strands", "turn_with(head, read3(rest, i)));", "turn_with(head, read3(rest, i + n)));"),
    "spheres": ("local", "advance_strands", "[s * kSubstepInts + kSphereBegin];",
                "[s * kSubstepInts + kSphereBegin] + 4 * substep_ints[s * kSubstepInts + kSphereCount];"),
    "positions": ("local", "gather", "target.first + i)", "target.first + i + target.count)"),
}


@pytest.mark.parametrize("what", SHIFTS)
def test_an_index_out_of_bounds_is_seen(tmp_path, what):
    run, kernel, right, wrong = SHIFTS[what]
    names = [kernel_name(*k) for k in KERNELS]
    begin = COPIES[names.index(kernel)] if kernel in names else 0
    assert right in PROGRAM[begin:]
    _, log = oclgrind(tmp_path / "run", run, PROGRAM[:begin] + PROGRAM[begin:].replace(right, wrong, 1))
    assert kernels_with(log, "Invalid") == {kernel}
