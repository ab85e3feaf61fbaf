"""bench: each benchmark runs and says what it measured in every form. What it measured is no matter for a test."""

import csv
import json
import re
import xml.etree.ElementTree

import pytest
from conftest import DISK, GOOD, USAGE, Shot, assert_one_error

SMALL = ["--quick", "--threads", "1", "--share", "0.002"]

# Columns that say what a row is about, and columns of figures that cannot be zero or below.
BENCHMARKS = {
    "table2": (["model", "method"], ["median_ms", "best_ms", "ns_per_vertex", "floor_ms", "floor_share_percent"]),
    "passes": (["precision", "pass"], ["floor_ns"]),
    "scaling": (["sweep", "method", "strands", "vertices", "regions", "threads", "substeps", "lanes"],
                ["median_ms", "best_ms", "ns_per_vertex", "ratio", "floor_share_percent"]),
    "bake": (["scene", "compression"], ["whole_s", "whole_best_s", "before_frames_ms"]),
    "stability": (["case", "method", "lengths", "precision", "finite"], []),
    "features": (["feature"], ["all_ms", "without_ms", "alone_ms", "bare_ms"]),
}


@pytest.fixture(scope="module", params=BENCHMARKS)
def measured(request, tmp_path_factory):
    """A benchmark's name, the rows of its CSV and the comments before them, its JSON and its SVG."""
    shot = Shot(tmp_path_factory.mktemp("bench"))
    name = request.param
    run = shot.run("bench", name, *SMALL, "--csv", "b.csv", "--json", "--svg", "b.svg")
    assert run.code == GOOD and run.err == "", run.err
    assert shot.files() == ["a.hair", "b.csv", "b.svg"]  # bakes leave nothing behind
    lines = (shot / "b.csv").read_text().splitlines()
    comments = [line for line in lines if line.startswith("# ")]
    rows = list(csv.DictReader(lines[len(comments):], strict=True))
    return name, rows, comments, json.loads(run.out), (shot / "b.svg").read_text()


def test_the_csv_has_its_columns_and_a_figure_in_each(measured):
    name, rows, _, _, _ = measured
    words, figures = BENCHMARKS[name]
    assert rows
    for row in rows:
        assert all(row[word] for word in words)
        assert all(float(row[figure]) > 0 for figure in figures), row
    keys = [tuple(row[word] for word in words) for row in rows]
    assert len(set(keys)) == len(keys)  # no row twice


def test_the_json_says_the_same_as_the_csv(measured):
    name, rows, _, report, _ = measured
    assert report["benchmark"] == name and len(report["rows"]) == len(rows)
    for in_json, in_csv in zip(report["rows"], rows):
        assert list(in_json) == list(in_csv)
        for key, value in in_json.items():
            if isinstance(value, float):
                assert float(in_csv[key]) == pytest.approx(value, rel=1e-5)
            else:
                assert in_csv[key] == ("" if value is None else value)


def test_the_machine_and_the_commit_are_named_everywhere(measured):
    _, _, comments, report, _ = measured
    machine = report["machine"]
    assert list(machine) == ["program", "commit", "processor", "cores", "caches", "memory", "lanes", "compiler", "flags"]
    assert all(machine.values())
    for name, value in machine.items():
        assert f"# {name}: {value}" in comments


def test_the_probes_found_a_machine(measured):
    name, _, _, report, _ = measured
    assert bool(report["probes"]) == (name in ("table2", "passes", "scaling"))
    for probe in report["probes"]:
        assert probe["triad_bytes_per_s"] > 0
        assert all(point["bytes_per_s"] > 0 for point in probe["update"])
        assert all(rate > 0 for precision in ("float", "double") for rate in probe[precision].values())


def test_the_plot_is_well_formed_and_has_its_words(measured):
    _, _, _, report, svg = measured
    root = xml.etree.ElementTree.fromstring(svg)
    assert root.tag == "{http://www.w3.org/2000/svg}svg"
    words = [element.text for element in root.iter("{http://www.w3.org/2000/svg}text")]
    assert len(words) > 10 and all(words)
    assert not re.search(r"(?<![a-z])(nan|inf)(?![a-z])", svg)
    for row in report["rows"]:
        for key in ("feature", "pass"):
            assert key not in row or row[key] in words


def test_the_text_is_a_table_with_a_line_for_each_row_and_names_the_machine(shot):
    run = shot.run("bench", "passes", *SMALL, "--csv", "b.csv")
    assert run.code == GOOD
    comments = [line[2:] for line in (shot / "b.csv").read_text().splitlines() if line.startswith("# ")]
    rows = [line for line in (shot / "b.csv").read_text().splitlines() if not line.startswith("# ")]
    head, table = run.out.split("\n\n")[:2]
    assert head.splitlines() == comments and len(table.splitlines()) == len(rows)


@pytest.mark.parametrize("measured", ["table2"], indirect=True)
def test_table2_has_the_figures_of_the_paper(measured):
    found = {(row["model"], row["method"]): row["hd7970_ms"] for row in measured[3]["rows"]}
    assert found == {("model1", 1): 4.59, ("model1", 2): 1.22, ("model1", 3): 0.78, ("model1", 4): None, ("model1", "rod"): None,
                     ("model2", 1): 5.32, ("model2", 2): 1.24, ("model2", 3): 0.80, ("model2", 4): None, ("model2", "rod"): None,
                     ("model3", 1): 62.38, ("model3", 2): 3.21, ("model3", 3): 2.11, ("model3", 4): None, ("model3", "rod"): None}


@pytest.mark.parametrize("measured", ["stability"], indirect=True)
def test_stability_tells_of_every_shot_and_method_what_does_not_hold(measured):
    rows = measured[3]["rows"]
    assert {(row["method"], row["lengths"], row["precision"]) for row in rows} == {
        *((method, "direct", "float") for method in (1, 2, 3, 4)), ("rod", "rod", "float")}
    assert len(rows) == 5 * len({row["case"] for row in rows}) and all(row["finite"] == "yes" for row in rows)
    for row in rows:
        assert row["reach"] < 1.001 and row["largest_stretch_percent"] < 1
        stops = row["growth"] is not None
        assert ("no rest" in row["mark"]) == (stops and row["unrest"] > 5e-4)
        assert (row["steps_to_rest"] is not None) == (stops and "no rest" not in row["mark"])
    assert any(row["steps_to_rest"] for row in rows)


@pytest.mark.parametrize("arguments", [
    [], ["table3"], ["table2", "passes"], ["table2", "--threads", "0"], ["table2", "--share", "0"], ["table2", "--share", "2"],
    ["bake", "--folder", "none"]])
def test_a_command_line_without_sense_ends_with_2(shot, arguments):
    run = shot.run("bench", *arguments)
    assert run.code == USAGE and run.out == "" and run.err != ""


@pytest.mark.parametrize("option", ["--csv", "--svg"])
def test_an_existing_file_stays_without_force(shot, option):
    (shot / "old").write_text("old")
    assert_one_error(shot.run("bench", "table2", *SMALL, option, "old"), DISK, "old", "--force")
    assert (shot / "old").read_text() == "old"


def test_a_folder_that_is_not_there_is_said_before_anything_is_measured(shot):
    assert_one_error(shot.run("bench", "table2", *SMALL, "--csv", "none/b.csv"), DISK, "none/b.csv", "none")
