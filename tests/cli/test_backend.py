"""The solver on OpenCL devices, from the command line: the bytes of the CPU, and what happens where a device is missing,
too small or fails."""

import json
import os
import platform
import re
import shutil
import signal
import subprocess

import numpy as np
import pytest
from conftest import DEVICE, GOOD, PROGRAM, SOURCE, USAGE, assert_one_error, read

# A region for each method and one of rods, and most of what a scene can have.
SCENE = '''[bake]
frames = "1-4"
substeps = 2

[groom]
files = ["hair.hair"]

[[region]]
name = "exact"
strands = {range = "0-19"}

[[region]]
name = "scanned"
strands = {range = "20-39"}
local = {method = 4}

[[region]]
name = "rods"
strands = {range = "40-49"}
method = "rod"

[[region]]
name = "turned"
local = {method = 3}
global = {stiffness = 0.2, range = 0.5}

[[collider]]
sphere = {center = [0, 0, 0], radius = 0.1}

[wind]
velocity = [2, 0, 1]
gust = 0.5
'''


@pytest.fixture(scope="module")
def library_folder(tmp_path_factory):
    return tmp_path_factory.mktemp("library")


@pytest.fixture
def scene(shot):
    assert shot.run("groom", "--style", "curly", "--strands", "60", "--vertices", "12", "-o", "hair.hair").code == GOOD
    (shot / "scene.toml").write_text(SCENE)
    return shot


@pytest.fixture
def device(shot):
    """A shot on a machine that has a device which gives the bytes of the CPU."""
    listed = shot.run("devices", "--json")
    if listed.code != GOOD:
        pytest.skip("there is no OpenCL device")
    devices = json.loads(listed.out)["devices"]
    if not devices[0]["exact_float"]:
        pytest.skip("the first OpenCL device does not divide exactly")
    return devices[0]


def bake(shot, *options, **settings):
    return shot.run("bake", "scene.toml", "--force", "--quiet", *options, **settings)


def test_devices_are_listed(shot, device):
    listed = shot.run("devices")
    assert listed.code == GOOD
    assert f"device 0: {device['name']}\n" in listed.out
    assert "the bytes of the CPU" in listed.out


def test_a_device_writes_the_cache_of_the_cpu(scene, device):
    assert bake(scene, "--backend", "openmp", "-o", "cpu.h5").code == GOOD
    # The second mapping in batches that take turns in the device's memory.
    for options in (["--mapping", "vertices"], ["--mapping", "strands", "--device-memory", "40KB"]):
        result = bake(scene, "--backend", "opencl", *options, "-o", "device.h5")
        assert result.code == GOOD, result.err
        assert (scene / "device.h5").read_bytes() == (scene / "cpu.h5").read_bytes()
    # auto takes a GPU or the CPU; the cache is the same.
    assert bake(scene, "-o", "auto.h5").code == GOOD
    assert (scene / "auto.h5").read_bytes() == (scene / "cpu.h5").read_bytes()


# Every method in every mapping that has it.
METHODS = [(1, "strands"), (2, "strands"), (2, "vertices"), (3, "strands"), (3, "vertices"), (4, "vertices"), ("rod", "strands")]
ASSETS = os.environ.get("STRANDBAKE_ASSETS")


@pytest.mark.parametrize("path", sorted((SOURCE / "scenes").glob("*.toml")), ids=lambda path: path.stem)
def test_the_scenes_of_the_project_are_the_same_on_a_device(shot, device, path):
    if not shot.groom_of(path, strands=400) and not ASSETS:
        pytest.skip("STRANDBAKE_ASSETS names no folder with real grooms and animation")
    settings = ["--search", shot.folder, "--search", ASSETS or shot.folder, "--frames", "1-2", "--set", "bake.preroll=1"]
    regions = re.findall(r'^name = "([^"]+)"', path.read_text(), re.MULTILINE)
    for method, mapping in METHODS:
        which = 'method="rod"' if method == "rod" else f'local.method={method}'
        options = [*settings, *(f'--set=region."{name}".{key}' for name in regions for key in ('method="shape"', which))]
        for backend, more in (("openmp", []), ("opencl", ["--mapping", mapping])):
            result = shot.run("bake", path, "--force", "--quiet", "--backend", backend, *more, *options, "-o", f"{backend}.h5")
            assert result.code == GOOD, result.err
        assert (shot / "opencl.h5").read_bytes() == (shot / "openmp.h5").read_bytes(), (method, mapping)


def test_frames_that_are_not_written_are_simulated_on_the_device_too(scene, device):
    assert bake(scene, "--backend", "openmp", "--frames", "3-4", "-o", "cpu.h5").code == GOOD
    assert bake(scene, "--backend", "opencl", "--mapping", "vertices", "--frames", "3-4", "-o", "device.h5").code == GOOD
    assert (scene / "device.h5").read_bytes() == (scene / "cpu.h5").read_bytes()


@pytest.mark.parametrize("begun, ended", [("opencl", "openmp"), ("openmp", "opencl"), ("opencl", "opencl")])
def test_a_bake_that_was_stopped_goes_on_elsewhere(scene, device, begun, ended):
    frames = ["--set", "bake.frames=1-150"]
    assert bake(scene, "--backend", "openmp", *frames, "-o", "whole.h5").code == GOOD
    # With batches that take turns in the device's memory, too.
    begun_there = ["--device-memory", "40KB"] if (begun, ended) == ("opencl", "openmp") else []
    process = scene.start("bake", "scene.toml", "-o", "out.h5", "--json", "--backend", begun, *begun_there, *frames,
                          stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    for line in process.stdout:
        if json.loads(line).get("frame") == 5:
            break
    process.send_signal(signal.SIGINT)
    process.communicate(timeout=100)
    if process.returncode == GOOD:
        pytest.skip("the bake is too fast to be interrupted")
    run = scene.run("bake", "scene.toml", "-o", "out.h5", "--resume", "--json", "--backend", ended, *frames)
    assert run.code == GOOD, run.err
    start = next(event for event in map(json.loads, run.out.splitlines()) if event["event"] == "start")
    assert start["simulated_from"] == start["kept_frames"] >= 5
    assert (scene / "out.h5").read_bytes() == (scene / "whole.h5").read_bytes()


def test_the_plan_names_the_device(scene, device):
    for verb in (["check", "scene.toml"], ["bake", "scene.toml", "--dry-run"]):
        plan = scene.run(*verb, "--backend", "opencl")
        assert plan.code == GOOD
        assert f"opencl on {device['name']}" in plan.out
        assert plan.out.count("a strand per work-item") == 2 and plan.out.count("a vertex per work-item") == 2


def test_the_summary_tells_what_ran_on_the_device(scene, device):
    run = lambda *options: scene.run("bake", "scene.toml", "--force", "--backend", "opencl", "--mapping", "vertices", *options)
    assert "work-item" not in scene.run("bake", "scene.toml", "--backend", "openmp").out
    told = run().out
    # 20 strands with method 1, 10 rods, 20 with method 4, 10 with method 3.
    assert re.search(r"kernels took [\d.]+ s; blocks of 16 strands, 3 with a strand per work-item, 3 with a vertex per "
                     r"work-item in [\d.]+ KiB of local memory\n", told), told
    work = [json.loads(line) for line in run("--json", "--device-memory", "40KB").out.splitlines()][-1]["device"]
    assert work["kernel_seconds"] > 0
    assert (work["strand_blocks"], work["vertex_blocks"], work["long_blocks"]) == (3, 3, 0)
    assert work["streamed"] and work["batches"] > 1
    assert f"; {work['batches']} batches took turns in its memory\n" in run("--device-memory", "40KB").out


def test_devices_that_do_not_exist(scene, device):
    assert_one_error(bake(scene, "--backend", "opencl", "--device", "99", "-o", "x.h5"), DEVICE, "no device 99",
            "strandbake devices")
    for option in (["--device", "0"], ["--mapping", "strands"], ["--device-memory", "1GB"]):
        for verb in (["bake", "scene.toml"], ["check", "scene.toml"]):
            assert_one_error(scene.run(*verb, *option), USAGE, option[0], "--backend opencl")
    assert bake(scene, "--backend", "cuda").code == USAGE
    assert bake(scene, "--backend", "opencl", "--device", "-1").code == USAGE
    assert not (scene / "x.h5").exists() and not (scene / "x.h5.part").exists()


def test_without_any_device(scene, device, library_folder):
    nothing = {"OCL_ICD_VENDORS": str(library_folder / "nothing")}
    assert_one_error(bake(scene, "--backend", "opencl", "-o", "x.h5", env=nothing), DEVICE, "lists no device",
            "--backend openmp")
    assert_one_error(scene.run("devices", env=nothing), DEVICE, "lists no device")
    assert bake(scene, "-o", "auto.h5", env=nothing).code == GOOD


def test_without_any_opencl(scene, library_folder):
    folder = library_folder / "broken"
    folder.mkdir(exist_ok=True)
    (folder / "libOpenCL.so.1").write_text("this is no library\n")
    broken = {"LD_LIBRARY_PATH": str(folder)}
    assert_one_error(bake(scene, "--backend", "opencl", "-o", "x.h5", env=broken), DEVICE, "no OpenCL library",
            "--backend openmp")
    assert_one_error(scene.run("devices", env=broken), DEVICE, "no OpenCL library")
    for backend in ("auto", "openmp"):
        assert bake(scene, "--backend", backend, "-o", f"{backend}.h5", env=broken).code == GOOD


def test_opencl_is_not_loaded_unless_asked_for(scene):
    maps = subprocess.run(["ldd", PROGRAM], capture_output=True, text=True, check=False)
    assert "OpenCL" not in maps.stdout
    loaded = bake(scene, "--backend", "openmp", "-o", "x.h5", env={"LD_DEBUG": "libs"})
    assert loaded.code == GOOD and "libOpenCL" not in loaded.err


def test_built_programs_are_kept_and_damage_to_them_is_mended(scene, device, library_folder):
    cache = library_folder / "programs"
    settings = {"XDG_CACHE_HOME": str(cache)}
    run = lambda: bake(scene, "--backend", "opencl", "--mapping", "vertices", "-o", "x.h5", env=settings)
    assert run().code == GOOD
    first = (scene / "x.h5").read_bytes()
    (program,) = (cache / "strandbake/opencl").iterdir()
    whole = program.read_bytes()
    for damaged in (whole[: len(whole) // 2], b"", whole[:-1] + bytes([whole[-1] ^ 1])):
        program.write_bytes(damaged)
        assert run().code == GOOD
        assert (scene / "x.h5").read_bytes() == first
        assert program.read_bytes()[:64] == whole[:64] or len(program.read_bytes()) > len(damaged)
    assert [p.name for p in (cache / "strandbake/opencl").iterdir()] == [program.name]


# Stands in for libOpenCL.so.1 and hands every call on, but for what the environment asks it to refuse or to say otherwise.
STAND_IN = r'''
#include <dlfcn.h>
#include <fcntl.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#define EACH(F) F(clGetPlatformIDs) F(clGetPlatformInfo) F(clGetDeviceIDs) F(clCreateContext) \
  F(clReleaseContext) F(clCreateCommandQueue) F(clReleaseCommandQueue) F(clReleaseMemObject) \
  F(clCreateProgramWithSource) F(clCreateProgramWithBinary) F(clBuildProgram) F(clGetProgramInfo) \
  F(clGetProgramBuildInfo) F(clReleaseProgram) F(clCreateKernel) F(clReleaseKernel) F(clSetKernelArg) \
  F(clEnqueueReadBuffer) F(clEnqueueWriteBuffer) F(clEnqueueMapBuffer) F(clEnqueueUnmapMemObject) F(clWaitForEvents) F(clGetEventProfilingInfo) F(clReleaseEvent) \
  F(clFlush) F(clFinish)
#define F(name) static void* real_##name; __attribute__((naked)) void name(void) { __asm__("jmp *%0" ::"m"(real_##name)); }
EACH(F)
#undef F
static int (*real_run)(void*, void*, unsigned, void*, void*, void*, unsigned, void*, void*);
static void* (*real_create_buffer)(void*, unsigned long, size_t, void*, int*);
static int (*real_device_info)(void*, unsigned, size_t, void*, size_t*);
static long kernels_left, largest_buffer;
int clEnqueueNDRangeKernel(void* a, void* b, unsigned c, void* d, void* e, void* f, unsigned g, void* h, void* i) {
  return kernels_left-- > 0 ? real_run(a, b, c, d, e, f, g, h, i) : -5; /* CL_OUT_OF_RESOURCES */
}
void* clCreateBuffer(void* context, unsigned long flags, size_t size, void* host, int* status) {
  if (size <= (size_t)largest_buffer) return real_create_buffer(context, flags, size, host, status);
  *status = -4; /* CL_MEM_OBJECT_ALLOCATION_FAILURE */
  return NULL;
}
int clGetDeviceInfo(void* device, unsigned what, size_t size, void* value, size_t* size_of) {
  int status = real_device_info(device, what, size, value, size_of);
  if (what == 0x1000 && getenv("AS_GPU")) *(unsigned long*)value = 4; /* CL_DEVICE_TYPE, CL_DEVICE_TYPE_GPU */
  if (what == 0x1035 && getenv("AS_GPU")) *(unsigned*)value = 0; /* CL_DEVICE_HOST_UNIFIED_MEMORY */
  if (what == 0x101B && getenv("INEXACT")) *(unsigned long*)value &= ~(1UL << 7); /* CL_DEVICE_SINGLE_FP_CONFIG */
  return status;
}
/* With LD_PRELOAD: the node of a graphics driver. */
int stat(const char* path, struct stat* found) {
  return fstatat(AT_FDCWD, strcmp(path, "/dev/nvidiactl") ? path : "/dev/null", found, 0);
}
static long setting(const char* name) { return getenv(name) ? atol(getenv(name)) : 1L << 62; }
__attribute__((constructor)) static void find(void) {
  void* library = dlopen(getenv("REAL_OPENCL"), RTLD_NOW);
#define F(name) real_##name = dlsym(library, #name);
  EACH(F)
#undef F
  *(void**)&real_run = dlsym(library, "clEnqueueNDRangeKernel");
  *(void**)&real_create_buffer = dlsym(library, "clCreateBuffer");
  *(void**)&real_device_info = dlsym(library, "clGetDeviceInfo");
  kernels_left = setting("KERNELS_LEFT");
  largest_buffer = setting("LARGEST_BUFFER");
}
'''


def real_opencl():
    listed = subprocess.run(["/sbin/ldconfig", "-p"], capture_output=True, text=True, check=True).stdout
    return next((line.split("=>")[1].strip() for line in listed.splitlines() if "libOpenCL.so.1 " in line), None)


@pytest.fixture(scope="module")
def stand_in(library_folder):
    """The environment of a program that gets the stand-in, with what that shall do."""
    if platform.machine() != "x86_64":
        pytest.skip("the stand-in for OpenCL is written for x86-64")
    if shutil.which("cc") is None:
        pytest.skip("there is no C compiler to make a stand-in for OpenCL with")
    folder = library_folder / "stand_in"
    folder.mkdir()
    source = folder / "stand_in.c"
    source.write_text(STAND_IN)
    subprocess.run(["cc", "-shared", "-fPIC", "-O1", "-Wl,-soname,libOpenCL.so.1", "-o", folder / "libOpenCL.so.1", source, "-ldl"],
                   check=True)
    return lambda **settings: {"LD_LIBRARY_PATH": str(folder), "REAL_OPENCL": real_opencl(),
                               **{name: str(value) for name, value in settings.items()}}


def test_a_device_that_fails_leaves_the_frames_before(scene, device, stand_in):
    assert bake(scene, "--backend", "openmp", "-o", "cpu.h5").code == GOOD
    expected = read(scene / "cpu.h5")["frames/position"]
    seen = set()
    for kernels in (0, 3, 5, 7, 9, 10):
        result = bake(scene, "--backend", "opencl", "--mapping", "vertices", "-o", "x.h5", env=stand_in(KERNELS_LEFT=kernels))
        assert_one_error(result, DEVICE, "CL_OUT_OF_RESOURCES", "x.h5.part holds")
        assert not (scene / "x.h5").exists()
        left = read(scene / "x.h5.part")["frames/position"]
        np.testing.assert_array_equal(left, expected[: len(left)])
        seen.add(len(left))
    assert len(seen) > 1


def test_a_device_with_too_little_memory_takes_batches_or_says_so(scene, device, stand_in):
    run = lambda name, bytes: bake(scene, "--backend", "opencl", "--mapping", "vertices", "-o", name,
                                   env=stand_in(LARGEST_BUFFER=bytes))
    assert bake(scene, "--backend", "openmp", "-o", "cpu.h5").code == GOOD
    assert run("batches.h5", 40000).code == GOOD
    assert (scene / "batches.h5").read_bytes() == (scene / "cpu.h5").read_bytes()
    # Too little for one block of strands, for the positions of a frame, for anything.
    for bytes in (60 * 12 * 12, 60 * 12 * 12 - 1, 0):
        assert_one_error(run("x.h5", bytes), DEVICE, "CL_MEM_OBJECT_ALLOCATION_FAILURE")
        assert not (scene / "x.h5").exists()


# Long enough that auto looks for a GPU, and quickly done: hair rides.
LONG_SCENE = '''[bake]
frames = "1-300"
substeps = 1000

[groom]
files = ["hair.hair"]

[[region]]
name = "all"
simulate = false
'''


@pytest.fixture
def on_gpu(scene, device, stand_in):
    """A long bake, `auto`, on a machine whose device passes for a GPU."""
    (scene / "scene.toml").write_text(LONG_SCENE)

    def run(*options, **settings):
        environment = stand_in(AS_GPU=1, **settings)
        # It has to be there before the first look for a device node.
        environment["LD_PRELOAD"] = environment["LD_LIBRARY_PATH"] + "/libOpenCL.so.1"
        environment["ASAN_OPTIONS"] = os.environ.get("ASAN_OPTIONS", "") + ":verify_asan_link_order=0"
        return scene.run("bake", "scene.toml", "--frames", "300-300", "--force", "-o", "x.h5", *options, env=environment)

    return run


def test_auto_takes_a_gpu_for_a_long_bake(on_gpu, device):
    baked = on_gpu()
    assert baked.code == GOOD, baked.err
    assert f"solved by opencl on {device['name']}" in baked.out


def test_a_device_that_does_not_divide_exactly_is_told_and_left_to_those_who_ask(scene, on_gpu, stand_in):
    baked = on_gpu(INEXACT=1)
    assert baked.code == GOOD and "opencl" not in baked.out
    inexact = stand_in(AS_GPU=1, INEXACT=1)
    assert "not exact: after a frame 5e-7 m from the CPU's hair" in scene.run("devices", env=inexact).out
    baked = scene.run("bake", "scene.toml", "--frames", "1-2", "--force", "--backend", "opencl", env=inexact)
    assert baked.code == GOOD and "are not exact, so bytes differ from the CPU's" in baked.out


def test_auto_falls_back_to_the_cpu_and_says_so(on_gpu):
    baked = on_gpu("--quiet", LARGEST_BUFFER=0)
    assert baked.code == GOOD and baked.out == ""
    assert re.fullmatch("strandbake: warning: .*CL_MEM_OBJECT_ALLOCATION_FAILURE; the CPU bakes\n", baked.err)
    baked = on_gpu("--json", LARGEST_BUFFER=0)
    assert baked.code == GOOD and baked.err == ""
    warning, start, *_, done = map(json.loads, baked.out.splitlines())
    assert warning["event"] == "warning" and warning["message"].endswith("CL_MEM_OBJECT_ALLOCATION_FAILURE; the CPU bakes")
    assert start["solver"].startswith("openmp") and "device" not in done
