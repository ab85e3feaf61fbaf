"""Packages of a finished build: they are unpacked somewhere else, and what is in them is used."""

import gzip
import os
import pathlib
import re
import shutil
import subprocess

import pytest

BUILD = pathlib.Path(os.environ["STRANDBAKE_PROGRAM"]).resolve().parents[1]
SOURCE = pathlib.Path(os.environ["STRANDBAKE_SOURCE"]).resolve()
ENVIRONMENT = {k: v for k, v in os.environ.items() if not k.startswith(("STRANDBAKE_", "CMAKE_", "PYTHON"))}


def run(*command, cwd=None, **settings):
    done = subprocess.run([os.fspath(word) for word in command], cwd=cwd, env={**ENVIRONMENT, **settings}, capture_output=True,
                          text=True, timeout=600, check=False)
    assert done.returncode == 0, f"{command}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def need_debian():
    if shutil.which("dpkg-shlibdeps") is None:
        pytest.skip("needs dpkg-dev")


@pytest.fixture(scope="module")
def packages(tmp_path_factory):
    folder = tmp_path_factory.mktemp("packages")
    run("cpack", "-B", folder, "--config", BUILD / "CPackConfig.cmake", cwd=BUILD)
    return folder


@pytest.fixture(scope="module")
def tarball(packages, tmp_path_factory):
    """The tarball, unpacked where it was not made for."""
    (file,) = packages.glob("*.tar.gz")
    folder = tmp_path_factory.mktemp("some where else")
    run("tar", "xzf", file, "-C", folder)
    (prefix,) = folder.iterdir()
    assert re.fullmatch(r"strandbake-\d+\.\d+\.\d+-linux-\w+", prefix.name)
    return prefix


@pytest.fixture(scope="module")
def debian(packages, tmp_path_factory):
    """The files of all Debian packages, as below a root of their own."""
    need_debian()
    root = tmp_path_factory.mktemp("root")
    for file in packages.glob("*.deb"):
        run("dpkg-deb", "-x", file, root)
    return root / "usr"


@pytest.fixture(params=["tarball", "debian"])
def prefix(request):
    return request.getfixturevalue(request.param)


def bake_the_demo(prefix, folder):
    """The first frames of the scene that is installed, whose head is a glTF file, with the program that is installed."""
    program = prefix / "bin/strandbake"
    run(program, "groom", "--style", "wavy", "--strands", "40", "--vertices", "24", "-o", folder / "demo.hair")
    run(program, "bake", prefix / "share/strandbake/scenes/demo.toml", "--search", folder, "--set", "bake.frames=1-3", "-o",
        folder / "demo.h5")
    return folder / "demo.h5"


def bake_the_demo_here(prefix, folder):
    run(BUILD / "cli/strandbake", "bake", prefix / "share/strandbake/scenes/demo.toml", "--search", folder, "--set",
        "bake.frames=1-3", "-o", folder / "here.h5")
    return folder / "here.h5"


def test_an_unpacked_program_bakes_an_installed_scene(prefix, tmp_path):
    cache = bake_the_demo(prefix, tmp_path)
    here = bake_the_demo_here(prefix, tmp_path)
    assert cache.read_bytes() == here.read_bytes()
    assert "complete" in run(prefix / "bin/strandbake", "info", cache, "--json")


def test_the_python_package_comes_along(prefix, tmp_path):
    cache = bake_the_demo(prefix, tmp_path)
    code = "import strandcache as s, sys; cache = s.Cache(sys.argv[1]); print(s.__file__, len(cache), cache.strand_count)"
    out = run("/usr/bin/python3", "-c", code, cache, cwd=tmp_path, PYTHONPATH=str(prefix / "lib/python3/dist-packages"),
              PYTHONDONTWRITEBYTECODE="1")
    assert out == f"{prefix / 'lib/python3/dist-packages/strandcache/__init__.py'} 3 40\n"


def test_manual_completions_documents_and_licence_are_where_they_are_looked_for(prefix):
    assert gzip.decompress((prefix / "share/man/man1/strandbake.1.gz").read_bytes()).startswith(b".TH STRANDBAKE 1")
    assert "complete -F" in (prefix / "share/bash-completion/completions/strandbake").read_text()
    assert "complete -c" in (prefix / "share/fish/vendor_completions.d/strandbake.fish").read_text()
    for folder in ("site-functions", "vendor-completions"):
        assert (prefix / f"share/zsh/{folder}/_strandbake").read_text().startswith("#compdef strandbake")
    documents = prefix / "share/doc/strandbake"
    assert (documents / "copyright").read_text() == (SOURCE / "LICENSE").read_text()
    for link in re.findall(r"\]\((docs/[^)#]+)\)", (documents / "README.md").read_text()):
        assert (documents / link).exists(), link


def test_nothing_in_a_package_knows_where_it_was_built(tarball):
    for file in tarball.rglob("*"):
        if file.is_file():
            data = file.read_bytes()
            assert os.fsencode(BUILD) not in data and os.fsencode(SOURCE) not in data, file


def test_debian_packages_name_what_they_need(packages):
    need_debian()
    found = {}
    for file in packages.glob("*.deb"):
        name, depends = run("dpkg-deb", "-f", file, "Package", "Depends").strip().split("\n")
        found[name.removeprefix("Package: ")] = set(re.findall(r"([a-z0-9.+-]+)(?: \(|,|$)", depends.removeprefix("Depends: ")))
    assert set(found) == {"strandbake", "libstrandbake-dev", "python3-strandcache"}
    assert {"libassimp5", "libc6", "libfmt9", "libgif7", "libstdc++6"} <= found["strandbake"]
    assert "libhdf5-103-1" not in found["strandbake"] and "libgomp1" not in found["strandbake"]  # are parts of the program
    assert found["libstrandbake-dev"] == {"libeigen3-dev", "libgomp1"}
    assert found["python3-strandcache"] == {"python3", "python3-h5py", "python3-numpy"}


# The library


@pytest.fixture(scope="module")
def example(tarball, tmp_path_factory):
    """What the example of the documents prints, built against the tarball; arguments: compiler flags."""
    def built(flags):
        folder = tmp_path_factory.mktemp("example")
        run("cmake", "-S", tarball / "share/doc/strandbake/docs/example", "-B", folder, "-G", "Ninja", "-D",
            f"CMAKE_PREFIX_PATH={tarball}", "-D", f"CMAKE_CXX_FLAGS={flags}")
        run("cmake", "--build", folder)
        return run(folder / "step_groom")
    return built


def test_the_example_steps_a_groom_with_the_installed_library(example):
    out = example("-O1 -Wall -Werror")
    rows = [list(map(float, re.findall(r"-?\d+\.\d+", line))) for line in out.splitlines()]
    assert [line.split(":")[0] for line in out.splitlines()] == ["frame 12", "frame 24", "frame 36", "frame 48"]
    for x, y, z in rows:
        # The strand's root is at (0.049, 1.6, 0.1), 0.15 m long, and the head has turned by less than 0.2.
        assert abs(x - 0.049) < 1e-3 and 1.2 < y < 1.75 and abs(z) < 0.7
    assert rows[0] != rows[1]
    # The same numbers from a compiler that lays out wider vectors, where this machine can run it.
    if "avx2" in pathlib.Path("/proc/cpuinfo").read_text():
        assert example("-O1 -mavx2") == out


def test_every_installed_header_compiles(tarball, tmp_path):
    headers = sorted(path.name for path in (tarball / "include/strandbake/sim").iterdir())
    assert {"solver.h", "groom.h", "params.h"} <= set(headers)
    (tmp_path / "all.cpp").write_text("".join(f"#include <sim/{name}>\n" for name in headers))
    run("c++", "-std=c++20", "-fsyntax-only", "-Wall", "-Wextra", "-Werror", f"-I{tarball / 'include/strandbake'}", "-isystem",
        "/usr/include/eigen3", tmp_path / "all.cpp")


def test_a_version_that_is_too_new_is_refused(tarball, tmp_path):
    (tmp_path / "CMakeLists.txt").write_text(
        "cmake_minimum_required(VERSION 3.25)\nproject(p LANGUAGES CXX)\nfind_package(strandbake 99 REQUIRED)\n")
    done = subprocess.run(["cmake", "-S", tmp_path, "-B", tmp_path / "build", f"-DCMAKE_PREFIX_PATH={tarball}"], env=ENVIRONMENT,
                          capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode != 0 and re.search(r'requested\s+version "99"', done.stderr)
