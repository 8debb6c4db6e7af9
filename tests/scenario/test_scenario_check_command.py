"""`netlab check`: exit codes, every problem on a line, the schema."""

import json
from pathlib import Path

import pytest

from netlab.cli import main


def run(*arguments: str) -> int:
    with pytest.raises(SystemExit) as caught:
        main(["check", *arguments])
    return int(caught.value.code or 0)


@pytest.fixture
def pair(tmp_path: Path) -> Path:
    path = tmp_path / "pair.yaml"
    path.write_text("duration: 5s\nnodes: {a: , b: }\nlinks:\n  - {between: [a, b], delay: 2ms}\n")
    return path


def test_a_sound_file_is_summed_up(pair: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(str(pair)) == 0
    assert capsys.readouterr().out == f"{pair}: ok: 2 nodes, 1 wire, 5s\n"


def test_every_problem_is_one_line_on_stderr_and_the_exit_code_is_2(
    pair: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pair.write_text(pair.read_text().replace("2ms", "2").replace("[a, b]", "[a, z]"))
    assert run(str(pair), "--set", "duration=1") == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    lines = printed.err.splitlines()
    assert len(lines) == 3
    assert lines[0].startswith("--set duration=1: duration: 1 has no unit")
    assert all(line.startswith(f"{pair}:4: links[0].") for line in lines[1:])


def test_the_schema_is_json_and_needs_no_file(capsys: pytest.CaptureFixture[str]) -> None:
    assert run("--schema") == 0
    schema = json.loads(capsys.readouterr().out)
    assert schema["required"] == ["duration"]
    assert {"from", "to", "between", "1-h"}.isdisjoint(schema["properties"])
    assert {"1-h", "1-k"} <= schema["$defs"]["GilbertElliott"]["properties"].keys()


def test_no_file_is_a_usage_error(capsys: pytest.CaptureFixture[str]) -> None:
    assert run() == 2
    assert "name a scenario file" in capsys.readouterr().err
