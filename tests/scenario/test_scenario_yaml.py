"""YAML reading: lines, duplicate keys, YAML 1.1's surprises, hostile files."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from netlab.errors import ScenarioError
from netlab.scenario import yaml_source
from netlab.scenario.yaml_source import plain_scalar, read_yaml


def problems(text: str) -> list[str]:
    with pytest.raises(ScenarioError) as caught:
        read_yaml(text, name="f.yaml")
    return caught.value.problems


@pytest.mark.parametrize("word", ["on", "off", "yes", "no", "y", "1:30", "2026-01-01", "0x10", "007", "1_000", ".inf"])
def test_yaml_1_1_surprises_stay_text(word: str) -> None:
    assert read_yaml(f"a: {word}\n{word}: b", name="f").data == {"a": word, word: "b"}


def test_plain_scalars_are_typed_and_quoted_ones_are_not() -> None:
    data = read_yaml("a: 5\nb: -1.5\nc: true\nd: ~\ne: '5'\nf: \"true\"\ng:\n1: x", name="f").data
    assert data == {"a": 5, "b": -1.5, "c": True, "d": None, "e": "5", "f": "true", "g": None, "1": "x"}


def test_every_part_knows_its_line() -> None:
    document = read_yaml("a:\n  b:\n    - 1\n    - {c: 2,\n       d: 3}\n", name="f.yaml")
    assert document.where(("a", "b", 1, "c")) == "f.yaml:4: a.b[1].c"
    assert document.where(("a", "b", 1, "d")) == "f.yaml:5: a.b[1].d"
    assert document.where(("a", "b", 1, "missing")) == "f.yaml:4: a.b[1].missing"
    assert document.where(()) == "f.yaml:1"


def test_a_key_given_twice_is_reported_with_both_lines_wherever_it_is() -> None:
    assert problems("a: 1\nb: {c: 1, d: 2, c: 3}\na: 2\n") == [
        "f.yaml:2: b.c: is given twice (first in f.yaml:2); remove one",
        "f.yaml:3: a: is given twice (first in f.yaml:1); remove one",
    ]


def test_anchors_and_merge_keys_work_and_what_is_given_wins() -> None:
    text = "x: &x {a: 1, b: 2}\ny: {<<: *x, b: 3}\nz: {<<: [{a: 9}, *x]}\n"
    assert read_yaml(text, name="f").data == {"x": {"a": 1, "b": 2}, "y": {"a": 1, "b": 3}, "z": {"a": 9, "b": 2}}


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "f.yaml: the file is empty; it needs at least duration: and nodes:"),
        ("# only a comment\n", "f.yaml: the file is empty; it needs at least duration: and nodes:"),
        ("- a\n", "f.yaml:1: a scenario is a block of keys (name:, duration:, nodes:, ...)"),
        ("a: 1\n---\nb: 2\n", "f.yaml:2: a second document begins; a file holds one scenario"),
        ("a: !secret 1\n", "f.yaml:1: a: tags such as !secret mean nothing here; remove it"),
        ("a: &a [*a]\n", "f.yaml:1: a[0]: refers to itself; write it out"),
        ("a: 1\n[b]: 2\n", "f.yaml:2: a key must be a single word"),
    ],
)
def test_files_that_are_no_scenario_are_explained(text: str, expected: str) -> None:
    assert problems(text) == [expected]


def test_syntax_errors_name_the_line_and_tabs() -> None:
    [problem] = problems("a: 1\nb:\n\tc: 2\n")
    assert problem.startswith("f.yaml:3: not YAML: ")
    assert "indent with spaces, not tabs" in problem
    [problem] = problems("a: [1, 2\nb: 3\n")
    assert problem.startswith("f.yaml:2: not YAML: ")


def test_hostile_nesting_and_multiplying_aliases_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(yaml_source, "_MAX_PARTS", 5_000)
    assert problems("a: " + "[" * 100_000) == ["f.yaml:1: nested deeper than 60 levels"]
    bomb = "a0: &a0 [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
        f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 10)}]\n" for i in range(1, 9)
    )
    [problem] = problems(bomb)
    assert "multiply" in problem


@given(st.text(max_size=200))
def test_any_text_is_read_or_refused(text: str) -> None:
    try:
        document = read_yaml(text, name="f")
    except ScenarioError:
        return
    assert isinstance(document.data, dict)


@given(st.text())
def test_any_scalar_has_a_value(text: str) -> None:
    value = plain_scalar(text)
    assert value is None or isinstance(value, (str, int, float))
