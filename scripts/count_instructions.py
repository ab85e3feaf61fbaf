#!/usr/bin/env python3
"""Counts the instructions of a small fixed bake and compares them with the accepted count.

    scripts/count_instructions.py [BUILD]             fails where the bake, or a part of it, takes over 5 % more than accepted
    scripts/count_instructions.py [BUILD] --accept    accepts what is counted now

BUILD is the folder of a release build, build/release if left out. Instructions are counted by valgrind, so neither the machine's
speed nor its load matters. They do depend on the compiler: scripts/instructions.json has the accepted counts of each, and
one that is not there is told and not compared. valgrind knows no AVX-512: 8 lanes are counted where the machine has AVX2, else 4.
"""

import argparse
import json
import os
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile

SOURCE = pathlib.Path(__file__).resolve().parents[1]
ACCEPTED = SOURCE / "scripts/instructions.json"
TOLERANCE = 0.05
SMALLEST_PART = 0.02  # of the whole, to be judged by itself

GROOM = ["--style", "curly", "--strands", "128", "--vertices", "24", "--seed", "1"]
# Every method, every pass, both ways to hold lengths, and a cache as people write it. No animation: assimp is not ours to count.
SCENE = """
[bake]
frames = "1-24"
fps = 24
substeps = 4

[groom]
files = ["groom.hair"]

[[region]]
name = "method 1"
strands = {range = "0-63"}
damping = 0.1
local = {stiffness = 0.5, iterations = 3, method = 1}
global = {stiffness = {1 = 0.3, 12 = 0.1}, range = 0.4}

[[region]]
name = "method 2"
strands = {range = "64-95"}
local = {stiffness = 0.5, iterations = 3, method = 2}
lengths = {iterations = 2}

[[region]]
name = "method 4"
strands = {range = "96-107"}
local = {stiffness = 0.5, iterations = 3, method = 4}

[[region]]
name = "rod"
strands = {range = "120-127"}
method = "rod"

[[region]]
name = "method 3"
local = {stiffness = 0.5, iterations = 3, method = 3}

[[collider]]
sphere = {center = [0, 0, 0], radius = 0.1}

[wind]
velocity = [2, 0, 1]
gust = 0.5

[cache]
precision = 1e-5
compression = "deflate:1"
"""


def symbols(archive):
    """The object file that defines each function of an archive, by its linker name."""
    lines = subprocess.run(["nm", "-A", "--defined-only", archive], capture_output=True, text=True, check=True).stdout
    found = {}
    for line in lines.splitlines():
        place, kind, name = line.rsplit(maxsplit=2)
        if kind in "tTwWuV":
            found.setdefault(name, place.split(":")[1].removesuffix(".o"))
    return found


class Parts:
    """Says which part of the program a function belongs to."""

    def __init__(self, build):
        self.sim = symbols(build / "sim/libstrandbake_sim.a")
        self.formats = symbols(build / "formats/libstrandbake_formats.a")

    def of(self, library, function):
        if library.startswith("ld-linux"):
            return "loading libraries"
        if library.startswith("libdeflate"):
            return "encoding"
        if library.startswith("libhdf5"):
            return "HDF5"
        if library != "strandbake":
            return "other libraries"
        function = re.sub(r"'\d+$", "", function)  # a cycle's number
        if re.match("_?H5", function):
            return "HDF5"
        if function in self.sim:
            return "solver"
        if self.formats.get(function, "").startswith(("cache_", "commit_")):
            return "encoding"
        return "scene and groom" if function in self.formats else "command line"


def self_costs(path):
    """Instructions of each function itself, {(library, function): count}, from the output of callgrind."""
    names = {"ob": {}, "fn": {}}
    library = function = ""
    costs = {}
    is_call = False
    for line in path.read_text().splitlines():
        entry = re.match(r"c?(ob|fn)=\((\d+)\)(?: (.*))?$", line)
        if entry:
            kind, number, name = entry.groups()
            if name is not None:
                names[kind][number] = name
            if line.startswith("ob="):
                library = pathlib.Path(names["ob"][number]).name
            elif line.startswith("fn="):
                function = names["fn"][number]
        elif line.startswith("calls="):
            is_call = True  # what the next line counts belongs to the function that is called
        elif re.match(r"[\d+*-]", line):
            if not is_call:
                costs[library, function] = costs.get((library, function), 0) + int(line.split()[1])
            is_call = False
        elif line.startswith("totals:") and int(line.split()[1]) != sum(costs.values()):
            sys.exit("count_instructions.py: the output of callgrind is not understood")
    return costs


def count(build, lanes):
    """Runs the bake under callgrind; the costs of each function."""
    program = (build / "cli/strandbake").resolve()
    output = build / "instructions"
    shutil.rmtree(output, ignore_errors=True)
    output.mkdir()
    # Neither the length of a path nor the caller's settings shall count.
    environment = {"PATH": os.environ["PATH"], "LC_ALL": "C", "OMP_NUM_THREADS": "1"}
    with tempfile.TemporaryDirectory() as folder:
        where = pathlib.Path(folder)
        (where / "scene.toml").write_text(SCENE)
        (where / "strandbake").symlink_to(program)
        subprocess.run([program, "groom", *GROOM, "-o", "groom.hair"], cwd=where, check=True, stdout=subprocess.DEVNULL)
        run = subprocess.run(
            ["valgrind", "--tool=callgrind", "--demangle=no", f"--callgrind-out-file={output.resolve()}/callgrind.out",
             "./strandbake", "bake", "scene.toml", "--quiet", "--threads", "1", "--lanes", str(lanes)],
            cwd=where, env=environment, capture_output=True, text=True, check=False)
        if run.returncode != 0:
            sys.exit(f"count_instructions.py: the bake under valgrind failed:\n{run.stderr}")
    return self_costs(output / "callgrind.out")


def compiler_of(build):
    """The compiler that built, as CMake has it."""
    (found,) = build.glob("CMakeFiles/*/CMakeCXXCompiler.cmake")
    text = found.read_text()
    name, version = (re.search(rf'set\(CMAKE_CXX_COMPILER_{key} "([^"]*)"\)', text)[1] for key in ("ID", "VERSION"))
    return f"{name} {version}"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("build", nargs="?", type=pathlib.Path, default=SOURCE / "build/release", metavar="BUILD")
    parser.add_argument("--accept", action="store_true")
    options = parser.parse_args()

    if "CMAKE_BUILD_TYPE:STRING=Release\n" not in (options.build / "CMakeCache.txt").read_text():
        sys.exit(f"count_instructions.py: {options.build} is no release build")
    lanes = 8 if " avx2 " in pathlib.Path("/proc/cpuinfo").read_text() else 4
    setting = f"{compiler_of(options.build)}, {os.uname().machine}, {lanes} lanes"
    costs = count(options.build, lanes)
    parts = Parts(options.build)
    now = {"all": sum(costs.values())}
    for (library, function), instructions in costs.items():
        part = parts.of(library, function)
        now[part] = now.get(part, 0) + instructions
    now = dict(sorted(now.items(), key=lambda item: -item[1]))

    every = json.loads(ACCEPTED.read_text()) if ACCEPTED.exists() else {}
    accepted = every.get(setting)
    more, less = [], []
    print(f"{setting}: instructions in thousands" + (", change" if accepted else ""))
    for part in list(now) + [part for part in accepted or {} if part not in now]:
        instructions = now.get(part, 0)
        change = ""
        if accepted:
            before = accepted.get(part, 0)
            ratio = instructions / before - 1 if before else float(instructions > 0)
            change = f"{ratio:+10.2%}"
            if max(before, instructions) >= SMALLEST_PART * now["all"] and abs(ratio) > TOLERANCE:
                (more if ratio > 0 else less).append(part)
        print(f"  {part:20}{instructions / 1000:10.0f}{change}")

    if options.accept:
        every[setting] = now
        ACCEPTED.write_text(json.dumps(every, indent=1, sort_keys=False) + "\n")
        print(f"accepted in {ACCEPTED.relative_to(SOURCE)}")
        return 0
    accept = " ".join(["scripts/count_instructions.py", *sys.argv[1:], "--accept"])
    if accepted is None:
        print(f"not compared: no count is accepted for this compiler; {accept}")
    if less:
        print(f"over 5 % less: {', '.join(less)}; let it stay so: {accept}")
    if more:
        print(f"over 5 % more: {', '.join(more)}; the functions that take most:")
        within = [(cost, parts.of(*where), *where) for where, cost in costs.items() if more == ["all"] or parts.of(*where) in more]
        for instructions, part, library, function in sorted(within, reverse=True)[:12]:
            name = subprocess.run(["c++filt", function], capture_output=True, text=True, check=True).stdout.strip()
            print(f"  {instructions / 1000:10.0f}  {part}: {name[:80]} ({library})")
        print(f"make them fewer, or say in the commit why they have to be and run {accept}")
    return 1 if more else 0


if __name__ == "__main__":
    sys.exit(main())
