"""What scripts and shells rely on: --json and its schemas, completion, the manual page."""

import functools
import gzip
import json
import os
import pathlib
import pty
import re
import select
import shutil
import subprocess
import time

import jsonschema
import pytest
from conftest import GOOD, INPUT, PROGRAM, SOURCE, USAGE, strict_schema, validated

SCHEMAS = sorted(path.stem for path in (SOURCE / "docs/schemas").glob("*.json"))


def subcommands(shot, *command):
    """Names of the commands below one, as its help lists them."""
    out = shot.run(*command, "--help").out
    return re.findall(r"^  ([a-z0-9]+) ", out.split("Subcommands:\n")[1], re.M) if "Subcommands:" in out else []


def leaves(shot):
    """Every command that runs something, as a list of words."""
    return [[verb, name] for verb in subcommands(shot) for name in subcommands(shot, verb)] + \
        [[verb] for verb in subcommands(shot) if not subcommands(shot, verb)]


# Schemas


def test_every_verb_speaks_json_and_has_a_schema(shot):
    assert sorted(subcommands(shot)) == SCHEMAS
    for command in leaves(shot):
        assert "--json" in shot.run(*command, "--help").out, command


@pytest.mark.parametrize("verb", SCHEMAS)
def test_a_schema_is_valid_and_the_program_has_it(shot, verb):
    text = (SOURCE / f"docs/schemas/{verb}.json").read_text()
    assert shot.run("docs", "--schema", verb).out == text
    schema = json.loads(text)
    jsonschema.Draft202012Validator.check_schema(schema)
    assert re.fullmatch(rf"urn:strandbake:{verb}:[1-9]\d*", schema["$id"])

    def look(node):
        """Every field is described, and no required one is misspelt."""
        for field in node.get("properties", {}).values():
            assert field["description"].endswith((".", "]"))
        assert set(node.get("required", [])) <= set(node.get("properties", {}))
        for part in node.values():
            for inner in part if isinstance(part, list) else part.values() if isinstance(part, dict) else ():
                if isinstance(inner, dict):
                    look(inner)
        if isinstance(node.get("items"), dict):
            look(node["items"])

    look(schema)


def test_a_strict_schema_refuses_what_it_does_not_know():
    info = {"type": "object", "properties": {"a": {"type": "integer"}}, "required": ["a"]}
    jsonschema.validate({"a": 1, "b": 2}, info)
    for wrong in ({"a": 1, "b": 2}, {}, {"a": "1"}):
        with pytest.raises(jsonschema.ValidationError):
            jsonschema.validate(wrong, strict_schema(info))


REGIONS = '''[[region]]
name = "still"
strands = {range = "0"}
simulate = false
[[region]]
name = "hair"
[cache]
velocity = true
'''


def test_what_the_program_prints_is_what_its_schemas_say(shot):
    """Shot.run() holds all JSON of all tests against the schemas; here it is looked at, too."""
    shot.bake("--set", "forces.gravity=[3, -9, 0]", scene=shot.scene(REGIONS), out="golden.h5")
    events = validated("bake", shot.run("bake", "scene.toml", "-o", "out.h5", "--json").out)
    assert [event["event"] for event in events] == ["start"] + 4 * ["frame"] + ["done"]

    check = validated("check", shot.run("check", "scene.toml", "--json").out)[0]
    assert check["good"] and check["faults"] == [] and (check["plan"]["strands"], check["plan"]["vertices"]) == (5, 30)
    still, hair = check["plan"]["regions"]
    assert (still["strands"], still["simulated"], still["passes"]) == (1, False, [])
    assert {p["pass"]: p["runs"] for p in hair["passes"]} == {"wind": False, "global shape": True, "rod": False,
                                                              "local shape": True, "edge lengths": True}
    assert check["plan"]["substeps"] == {"least": 4, "most": 4, "total": 12}
    assert check["plan"]["disk_bytes"] == 4 * 2 * 12 * 30
    words = shot.run("check", "scene.toml").out
    assert all(p["how"] in words for p in hair["passes"]) and check["plan"]["solver"] in words

    info = validated("info", shot.run("info", "out.h5", "--json").out)[0]
    assert info["strands"] == 5
    found = shot.run("compare", "golden.h5", "out.h5", "--json")
    assert not validated("compare", found.out)[0]["good"]

    text = shot.run("digest", "out.h5", "-o", "out.digest", "--json")
    digest = validated("digest", text.out)[0]
    assert digest["output"] == "out.digest" and len(digest["frames"]) == 4
    assert all(frame["exact"] in (shot / "out.digest").read_text() for frame in digest["frames"])
    printed = validated("digest", shot.run("digest", "out.h5", "--json").out)[0]
    assert {**printed, "output": "out.digest"} == digest
    assert not validated("compare", shot.run("compare", "golden.h5", "out.digest", "--json").out)[0]["good"]

    drawn = validated("preview", shot.run("preview", "out.h5", "-o", "out.png", "--count", "2", "--json").out)[0]
    assert drawn["output"] == "out.png" and drawn["frames"] == [1, 4]
    page = validated("view", shot.run("view", "out.h5", "-o", "out.html", "--every", "2", "--json").out)[0]
    assert (page["output"], page["strands"], page["all_strands"], page["frames"]) == ("out.html", 5, 5, [1, 3])
    assert page["bytes"] == (shot / "out.html").stat().st_size
    made = validated("groom", shot.run("groom", "--from", "a.hair", "-o", "b.hair", "--json").out)[0]
    assert made == {"schema": "urn:strandbake:groom:1", "output": "b.hair", "strands": 5, "vertices": 30, "warnings": []}


def test_faults_and_warnings_are_told_as_json(shot):
    run = shot.run("check", shot.scene("[wind]\nspeed = 3\n"), "--json")
    (fault,) = validated("check", run.out)[0]["faults"]
    assert run.code == INPUT and fault["place"] == "scene.toml:7:1" and "speed" in fault["message"]
    assert fault["place"] in run.err
    # The last strand has no length.
    (shot / "odd.obj").write_text("v 0 0 0\nv 0 1 0\nv 1 0 0\nl 1 2\nl 3 3\n")
    run = shot.run("groom", "--from", "odd.obj", "-o", "odd.hair", "--json")
    (warning,) = validated("groom", run.out)[0]["warnings"]
    assert run.code == GOOD and run.err == "" and "strand 1" in warning
    assert shot.run("groom", "--from", "odd.obj", "-o", "plain.hair").err == f"strandbake: warning: {warning}\n"


def test_the_reference_as_json_is_the_page(shot):
    reference = validated("docs", shot.run("docs", "--json").out)[0]
    page = (SOURCE / "docs/SCENE.md").read_text()
    assert [table["name"] for table in reference["tables"]] == re.findall(r"^## `\[+(\w+)\]+`$", page, re.M)
    rows = [p for table in reference["tables"] for p in table["parameters"]]
    assert [p["key"] for p in rows] == re.findall(r"^\| `([^`]+)` \|", page, re.M)
    damping = next(p for p in rows if p["key"] == "damping")
    assert (damping["type"], damping["default"], damping["range"], damping["keyed"]) == ("number", "0.1", "from 0 to 1", True)


def test_docs_prints_one_thing_at_a_time(shot):
    for arguments in (["--json", "--example"], ["--man", "--schema", "info"], ["--completion", "tcsh"], ["--schema", "fly"]):
        run = shot.run("docs", *arguments)
        assert run.code == USAGE and run.out == ""


# The manual page


def test_the_manual_page_names_every_verb_and_option(shot):
    page = shot.run("docs", "--man")
    assert page.code == GOOD and page.err == ""
    plain = page.out.replace("\\-", "-")
    for command in leaves(shot):
        assert command[-1] in plain
        for name in re.findall(r"(--[a-z-]+)", shot.run(*command, "--help").out.split("Options:")[1]):
            assert name in plain, (command, name)
    assert "130 interrupted" in plain and "STRANDBAKE_LANES" in plain


@pytest.mark.parametrize("reader", [["mandoc", "-T", "lint", "-W", "warning"], ["groff", "-man", "-Tutf8", "-ww", "-z"]])
def test_the_manual_page_is_good_roff(shot, reader):
    if shutil.which(reader[0]) is None:
        pytest.skip(f"needs {reader[0]}")
    (shot / "strandbake.1").write_text(shot.run("docs", "--man").out)
    read = subprocess.run([*reader, "strandbake.1"], cwd=shot.folder, capture_output=True, text=True, timeout=60, check=False)
    # A date would change the bytes of each build.
    found = [line for line in (read.stdout + read.stderr).splitlines() if "missing date" not in line]
    assert found == [] and (read.returncode == 0) == (read.stdout == "")


# Completion. What each shell offers at the end of a line.

BASH = '''
source completion.bash
COMP_WORDS=("$@")
COMP_CWORD=$((${#COMP_WORDS[@]} - 1))
_strandbake
printf '%s\\n' "${COMPREPLY[@]}"
'''


def offered_by_bash(shot, *words):
    run = subprocess.run(["bash", "--norc", "-u", "-c", BASH, "bash", "strandbake", *words], cwd=shot.folder, capture_output=True,
                         text=True, timeout=60, check=True)
    assert run.stderr == ""
    return run.stdout.split("\n")[:-1]


def offered_by_fish(shot, *words):
    line = " ".join(("strandbake", *(word.replace("[", "\\[") for word in words)))
    command = f"source completion.fish; complete -C {json.dumps(line)}"
    run = subprocess.run(["fish", "--no-config", "-c", command], cwd=shot.folder, capture_output=True, text=True, timeout=60,
                         env={**os.environ, "HOME": str(shot.folder)}, check=True)
    assert run.stderr == ""
    return [offer.split("\t")[0] for offer in run.stdout.splitlines()]


# Completion of zsh runs only where somebody types. Here compadd, which gets the offers, tells them.
ZSH = '''
PS1=READY; unset zle_bracketed_paste; stty -echo
fpath=($PWD/zsh $fpath); autoload -Uz compinit; compinit -D -u
zstyle ':completion:*' verbose no
tell() {
  compadd() { local -a found; builtin compadd -O found "$@"; print -rl -- "OFFER:"${^found}; builtin compadd "$@"; }
  compstate[insert]= compstate[list]=
  _main_complete
  print END
}
zle -C tell complete-word tell; bindkey '^T' tell; bindkey '^U' kill-whole-line
'''


class Zsh:
    """A zsh that thinks that somebody types."""

    def __init__(self, folder):
        (folder / "zsh").mkdir()
        shutil.copy(folder / "completion.zsh", folder / "zsh/_strandbake")
        (folder / "rc").write_text(ZSH)
        self.process, self.terminal = pty.fork()
        if self.process == 0:
            os.chdir(folder)
            os.execvpe("zsh", ["zsh", "-f", "-i"], {**os.environ, "TERM": "dumb", "HOME": str(folder)})
        self.typed(b"source rc\n", "READY")

    def typed(self, keys, answer):
        """What it shows from these keys to the answer."""
        os.write(self.terminal, keys)
        seen, end = b"", time.monotonic() + 60
        while answer.encode() not in seen and time.monotonic() < end:
            if select.select([self.terminal], [], [], 1)[0]:
                seen += os.read(self.terminal, 65536)
        text = seen.decode(errors="replace").replace("\r", "")
        assert answer in text, text
        return text

    def offered(self, *words):
        line = " ".join(("strandbake", *words)).encode()
        return re.findall(r"OFFER:(\S+)", self.typed(b"\x15" + line + b"\x14", "END"))

    def close(self):
        os.close(self.terminal)
        os.waitpid(self.process, 0)


@pytest.fixture(params=["bash", "zsh", "fish"])
def offered(request, shot):
    shell = request.param
    if shutil.which(shell) is None:
        pytest.skip(f"needs {shell}")
    script = shot.run("docs", "--completion", shell)
    assert script.code == GOOD and script.err == ""
    (shot / f"completion.{shell}").write_text(script.out)
    (shot / "shots").mkdir()
    zsh = Zsh(shot.folder) if shell == "zsh" else None
    ask = {"bash": functools.partial(offered_by_bash, shot), "fish": functools.partial(offered_by_fish, shot)}
    yield lambda *words: set(zsh.offered(*words) if zsh else ask[shell](*words))
    if zsh:
        zsh.close()


def test_a_shell_completes_verbs_options_and_values(offered, shot):
    assert set(subcommands(shot)) <= offered("")
    assert offered("ba") == {"bake"}
    assert {"table2", "bake", "error"} <= offered("bench", "")
    assert {"a.hair", "shots"} <= {name.rstrip("/") for name in offered("info", "")}
    assert {"--frames", "--threads", "--set", "--json"} <= offered("bake", "--")
    assert "--tolerance" not in offered("bake", "--")
    assert {"--csv", "--share"} <= offered("bench", "bake", "--")
    assert offered("bake", "scene.toml", "--backend", "") == {"auto", "openmp", "opencl"}
    assert offered("groom", "--style", "cu") == {"curly"}
    assert {name.rstrip("/") for name in offered("check", "--search", "")} == {"shots"} | ({"zsh"} if (shot / "zsh").exists() else set())
    assert offered("bake", "--set", "bake.qu") == {"bake.quality="}
    assert "region[0].local.stiffness=" in offered("bake", "--set", "region")
    assert offered("docs", "--schema", "di") == {"digest"}


def test_bash_completes_behind_an_equals_sign(shot):
    (shot / "completion.bash").write_text(shot.run("docs", "--completion", "bash").out)
    # As bash parts the words.
    assert offered_by_bash(shot, "bake", "--backend", "=", "openm") == ["openmp"]
    assert offered_by_bash(shot, "bake", "--backend", "=") == ["auto", "openmp", "opencl"]
    (shot / "with blank.h5").write_text("")
    assert offered_by_bash(shot, "info", "with") == ["with blank.h5"]


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_completion_is_good_syntax(shot, shell):
    if shutil.which(shell) is None:
        pytest.skip(f"needs {shell}")
    (shot / "completion").write_text(shot.run("docs", "--completion", shell).out)
    read = subprocess.run([shell, "-n", "completion"], cwd=shot.folder, capture_output=True, text=True, timeout=60, check=False)
    assert read.returncode == 0 and read.stderr == ""


def test_the_build_made_the_page_and_the_completions(shot):
    folder = pathlib.Path(PROGRAM).parent / "generated"
    assert gzip.decompress((folder / "strandbake.1.gz").read_bytes()).decode() == shot.run("docs", "--man").out
    for name, shell in (("strandbake.bash", "bash"), ("_strandbake", "zsh"), ("strandbake.fish", "fish")):
        assert (folder / name).read_text() == shot.run("docs", "--completion", shell).out
