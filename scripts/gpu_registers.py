#!/usr/bin/env python3
"""What compilers for real GPUs make of the kernels, without a GPU: registers and spills of each.

    scripts/gpu_registers.py [BUILD]    BUILD: a build folder, build/release if left out

Wants clang-15 and libclc-15 (Debian), for AMD's RDNA 3 (gfx1100); and ptxas of CUDA for NVIDIA's Hopper (sm_90), which is
left out where it is not installed. Drivers have compilers of their own: counts of theirs will differ somewhat.
"""

import pathlib
import re
import shutil
import subprocess
import sys
import tempfile

BUILD = pathlib.Path(sys.argv[1] if len(sys.argv) > 1 else pathlib.Path(__file__).resolve().parents[1] / "build/release")
SOURCE = BUILD / "gpu/program_source.cpp.cl"
CLC = pathlib.Path("/usr/lib/clc")
# As table2 has it: one region, half of each strand in the range of the global shape, spheres.
PLAN = ["REAL=float", "REAL3=float3", "WIDTH=16", "ITEM_GROUP=64", "VERTEX_GROUP=256", "HAS_GLOBAL_SHAPE", "HAS_LOCAL_SHAPE",
        "HAS_EDGE_LENGTHS", "HAS_SPHERES"]
KERNELS = [("strands", 1, "advance_strands", "LOCAL_METHOD=1"), ("strands", 2, "advance_strands", "LOCAL_METHOD=2"),
           ("strands", 3, "advance_strands", "LOCAL_METHOD=3"),
           *(("vertices", m, f"advance_vertices_{m}_local", f"VERTICES_METHOD_{m}_LOCAL") for m in (2, 3, 4))]


def compile_for(target, library, define, out, *more):
    clang = ["clang-15", "-x", "cl", "-cl-std=CL1.2", "-O3", "-ffp-contract=off", "-Xclang", "-finclude-default-header",
             "-target", target, *more, "-Xclang", "-mlink-bitcode-file", "-Xclang", str(CLC / library), "-S",
             *(f"-D{name}" for name in [*PLAN, define]), str(SOURCE), "-o", str(out)]
    subprocess.run(clang, check=True, stderr=subprocess.DEVNULL)


def amd(kernel, define, folder):
    out = folder / "kernel.s"
    compile_for("amdgcn--amdhsa", "amdgcn--amdhsa.bc", define, out, "-mcpu=gfx1100", "-nogpulib")
    (entry,) = (e for e in re.split(r"\n  - ", out.read_text()) if re.search(rf"\.name: +{kernel}\n", e))
    found = {key: int(value) for key, value in re.findall(r"\.(vgpr_count|sgpr_count|vgpr_spill_count): +(\d+)", entry)}
    return found["vgpr_count"], found["sgpr_count"], found["vgpr_spill_count"]


def nvidia(kernel, define, folder):
    ptxas = shutil.which("ptxas")
    if ptxas is None:
        return "", ""
    out = folder / "kernel.ptx"
    compile_for("nvptx64--nvidiacl", "nvptx64--nvidiacl.bc", define, out)
    told = subprocess.run([ptxas, "-arch=sm_90", "-v", str(out), "-o", "/dev/null"], capture_output=True, text=True, check=True)
    text = told.stderr.split(f"'{kernel}'")[1]
    return int(re.search(r"Used (\d+) registers", text)[1]), int(re.search(r"(\d+) bytes spill stores", text)[1])


def main():
    if shutil.which("clang-15") is None or not CLC.is_dir():
        sys.exit("gpu_registers.py: install clang-15 and libclc-15")
    print("mapping   method  gfx1100: VGPR  SGPR  spilled   sm_90: registers  spilled bytes")
    with tempfile.TemporaryDirectory() as folder:
        for mapping, method, kernel, define in KERNELS:
            vgpr, sgpr, spilled = amd(kernel, define, pathlib.Path(folder))
            registers, stores = nvidia(kernel, define, pathlib.Path(folder))
            print(f"{mapping:10}{method:6}{vgpr:15}{sgpr:6}{spilled:9}{registers:>19}{stores:>15}")


main()
