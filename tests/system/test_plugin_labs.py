"""The pytest plugin, as a project that uses it meets it: each test here runs a pytest of its own."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest_plugins = ["pytester"]

HEAD = """
import pytest
from netlab.lab.builder import ScenarioBuilder
from netlab.lab.facade import Lab

TWO = {"name": "two", "duration": "1s", "nodes": {"a": {}, "b": {}}, "links": [{"between": ["a", "b"]}]}

def names(lab):
    return [lab.exec(node, "hostname").stdout.strip() for node in lab.scenario.nodes]
"""


@pytest.fixture(autouse=True)
def _own_options(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("PYTEST_ADDOPTS", raising=False)
    monkeypatch.delenv("CI", raising=False)  # pytest then prints its summary at another length
    monkeypatch.delenv("PYTEST_XDIST_WORKER", raising=False)


def _run(pytester: pytest.Pytester, tests: str, *options: str) -> pytest.RunResult:
    pytester.makepyfile(test_labs=HEAD + tests)
    return pytester.runpytest_subprocess("-p", "no:cacheprovider", "-W", "error", "-rA", *options)


def _captures(pytester: pytest.Pytester) -> list[str]:
    return sorted(str(path.relative_to(pytester.path)) for path in pytester.path.rglob("*.mcap"))


def test_a_scenario_comes_from_a_file_a_mapping_a_builder_or_the_marker(pytester: pytest.Pytester) -> None:
    (pytester.path / "two.yaml").write_text(
        "name: two\nduration: 1s\nnodes: {f: {}, g: {}}\nlinks: [{between: [f, g]}]\n"
    )
    tests = """
@pytest.mark.scenario("two.yaml", seed=5, overrides=["name=other"])
def test_marker(lab):
    assert isinstance(lab, Lab) and names(lab) == ["f", "g"]
    assert lab.status()["seed"] == 5 and lab.name.startswith("other-")

def test_all(make_lab):
    labs = [make_lab(TWO), make_lab(ScenarioBuilder("two", duration="1s").node("u").node("v"))]
    assert [names(lab) for lab in labs] == [["a", "b"], ["u", "v"]]
    assert len({lab.name for lab in labs}) == 2
"""
    _run(pytester, tests).assert_outcomes(passed=2)
    assert _captures(pytester) == []  # nobody needs the captures of tests that pass


def test_the_captures_of_a_failed_test_are_kept_and_named(pytester: pytest.Pytester) -> None:
    tests = """
@pytest.mark.parametrize("side", ["le/ft"])
def test_wrong(make_lab, side):
    make_lab(TWO)
    assert make_lab(TWO).name == side

def test_right(make_lab):
    make_lab(TWO)
"""
    result = _run(pytester, tests)
    result.assert_outcomes(passed=1, failed=1)
    names = ["captures/test_labs.py_test_wrong_le_ft.mcap", "captures/test_labs.py_test_wrong_le_ft2.mcap"]
    assert _captures(pytester) == names
    for name in names:
        path = pytester.path / name
        assert path.read_bytes().startswith(b"\x89MCAP")
        assert path.read_bytes().endswith(b"\x89MCAP0\r\n")  # finished, not torn off
        result.stdout.fnmatch_lines([f"*kept as {path}; look into it with: netlab inspect {path}"])


def test_workers_run_labs_side_by_side(pytester: pytest.Pytester, tmp_path: Path) -> None:
    tests = f"""
import pathlib, time
MEETING = pathlib.Path({str(tmp_path)!r})

@pytest.mark.parametrize("me, other", [("one", "two"), ("two", "one")])
def test_meets_the_other(make_lab, me, other):
    lab = make_lab(TWO)
    (MEETING / me).write_text(lab.name)
    deadline = time.monotonic() + 20
    while not (MEETING / other).exists():  # both labs are up at the same time, or this never ends well
        assert time.monotonic() < deadline
    lab.outage("a", "b", active=True)
    assert (MEETING / other).read_text() != lab.name
    assert names(lab) == ["a", "b"]
"""
    _run(pytester, tests, "-n", "2").assert_outcomes(passed=2)


def test_an_error_is_one_clear_message(pytester: pytest.Pytester) -> None:
    tests = """
BAD = {"name": "two", "duration": "1", "nodez": 3, "nodes": {"a": {"processes": [{"argv": ["/no/such"]}]}}}

@pytest.mark.scenario(BAD)
def test_marker(lab): pass

def test_factory(make_lab):
    make_lab(BAD)

@pytest.mark.scenario({**TWO, "nodes": {"a": {"processes": [{"argv": ["/no/such"]}]}, "b": {}}})
def test_process(lab): pass

def test_no_marker(lab): pass

@pytest.mark.scenario(TWO, sede=3)
def test_misspelt(lab): pass
"""
    result = _run(pytester, tests, "--lab-captures", "kept")
    result.assert_outcomes(failed=1, errors=4)
    assert _captures(pytester) == ["kept/test_labs.py_test_process.mcap"]  # of the only lab that came that far
    text = result.stdout.str()
    assert text.count("write a duration like 20ms (units: us, ms, s)\n") == 2
    assert text.count("nodez: unknown key 'nodez'; did you mean 'nodes'?\n") == 2
    assert "a: process 'such' cannot start: /no/such: No such file or directory; argv: /no/such" in text
    assert "the `lab` fixture needs @pytest.mark.scenario(FILE or mapping); or use `make_lab`" in text
    assert "@pytest.mark.scenario does not know sede; it takes engine, overrides, packets, seed" in text
    assert "facade.py" not in text  # none of the lab's insides
    assert "pytest_plugin.py" not in text


def test_labs_end_with_the_test_whatever_it_did_to_them(pytester: pytest.Pytester) -> None:
    tests = """
import os, signal
seen = []

def test_breaks_its_lab(make_lab):
    lab = make_lab(TWO)
    seen.append(lab.supervisor_pid)
    os.kill(lab.supervisor_pid, signal.SIGKILL)

def test_leaves_it_running(make_lab):
    seen.append(make_lab(TWO).supervisor_pid)

def test_nothing_is_left():
    for pid in seen:
        with pytest.raises(ProcessLookupError):
            os.kill(pid, 0)
"""
    _run(pytester, tests).assert_outcomes(passed=3)
