"""What a person gets wrong on the command line: one message, exit code 2, nothing started. No namespaces needed."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import pytest

from netlab.cli import COMMANDS, main

DATA = Path(__file__).parents[1] / "data" / "cli"
PAIR, MISTAKES = DATA / "pair.yaml", DATA / "mistakes.yaml"


@dataclass(frozen=True, slots=True)
class Done:
    returncode: int
    stdout: str
    stderr: str


@pytest.fixture
def labs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where labs would be; the command runs in an empty directory of its own."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("NETLAB_RUNTIME_DIR", str(tmp_path / "labs"))
    monkeypatch.setattr("netlab.lab.registry._LONGEST_ROOT", 200)  # no socket is ever made here
    (tmp_path / "labs").mkdir(mode=0o700)
    return tmp_path / "labs"


@pytest.fixture
def netlab(labs: Path, capsys: pytest.CaptureFixture[str]) -> Callable[..., Done]:
    """The command's own entry point, in this process."""

    def run(*arguments: object) -> Done:
        with pytest.raises(SystemExit) as stop:
            main([str(argument) for argument in arguments])
        out, err = capsys.readouterr()
        return Done(int(stop.value.code or 0), out, err)

    return run


def test_every_mistake_is_named_with_its_line_and_nothing_starts(netlab: Callable[..., Done], labs: Path) -> None:
    for command in ("run", "up", "check", "lab"):
        done = netlab(command, MISTAKES)
        assert (done.returncode, done.stdout) == (2, ""), command
        lines = done.stderr.splitlines()
        assert [line.partition(": ")[0] for line in lines] == [f"{MISTAKES}:{line}" for line in (3, 4, 8, 8)]
        assert "write a duration like 20ms" in lines[0]
        assert "did you mean 'nodes'" in lines[1]
        assert not list(labs.iterdir())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["run"], ["Missing argument 'FILE'"]),
        (["frobnicate"], ["No such command 'frobnicate'"]),
        (["run", PAIR, "--bogus"], ["No such option", "--bogus"]),
        (["run", "missing.yaml"], ["missing.yaml", "No such file or directory"]),
        (["run", "."], ["Is a directory"]),
        (["run", "latin.yaml"], ["latin.yaml: is not a text file in UTF-8"]),
        (["up", "latin.yaml"], ["latin.yaml: is not a text file in UTF-8"]),
        (["run", PAIR, "--set", "duration"], ["--set duration", "key.path=value"]),
        (["run", PAIR, "--set", "links.0.delay=5"], ["links.0.delay", "20ms"]),
        (["run", PAIR, "--seed", "x"], ["'x' is not a valid integer"]),
        (["run", PAIR, "--capture", "/dev/null/run.mcap"], ["/dev/null/run.mcap", "cannot be made"]),
        (["up", PAIR, "--capture", "/dev/null/run.mcap"], ["/dev/null/run.mcap", "cannot be made"]),
        (["run", PAIR, "--clock", "virtual"], ["the host's clock cannot be virtual; add --in vm"]),
        (["run", PAIR, "--report", "/dev/null/out"], ["/dev/null/out/capture.mcap", "cannot be made"]),
        (["report", PAIR], ["is not an MCAP file"]),
        (["lab"], ["topologies/default.yaml", "No such file"]),
        (["inspect", "missing.mcap"], ["missing.mcap: No such file"]),
        (["inspect", PAIR], ["is not an MCAP file"]),
        (["export", PAIR], ["is not an MCAP file"]),
        (["ls", "--nope"], ["--nope"]),
        (["exec", "a", "--", "true"], ["no lab is running; start one with: netlab up FILE"]),
        (["down"], ["no lab is running"]),
    ],
)
def test_a_mistake_is_one_message_and_exit_code_2(
    netlab: Callable[..., Done], labs: Path, arguments: list[object], words: list[str]
) -> None:
    Path("latin.yaml").write_bytes("name: h\u00f6hle\n".encode("latin-1"))
    done = netlab(*arguments)
    assert done.returncode == 2
    assert done.stdout == ""
    assert all(word in done.stderr for word in words), done.stderr
    assert "Traceback" not in done.stderr
    assert len(done.stderr.splitlines()) <= 4
    assert not list(labs.iterdir())


def test_help_is_quick_because_it_imports_next_to_nothing() -> None:
    script = (
        "import sys\nfrom netlab.cli import main\n"
        "try: main(['--help'])\nexcept SystemExit as stop: print(stop.code, *sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    code, *modules = done.stdout.splitlines()[-1].split()
    assert code == "0"
    assert not {"pydantic", "rich", "pyroute2", "mcap", "yaml", "asyncio", "google.protobuf"} & set(modules)
    for command in (
        "lab",
        "run",
        "up",
        "down",
        "ls",
        "exec",
        "shell",
        "link",
        "logs",
        "check",
        "inspect",
        "report",
        "doctor",
    ):
        assert f"  {command} " in done.stdout


def test_check_and_doctor_tell_by_their_exit_code(netlab: Callable[..., Done]) -> None:
    done = netlab("check", PAIR)
    assert (done.returncode, done.stderr) == (0, "")
    assert "ok: 2 nodes, 1 wire, 1 stream, 1 expectation, 1s" in done.stdout
    done = netlab("doctor", "--json")
    assert done.returncode == (0 if json.loads(done.stdout)["can_run"] else 1)


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help(netlab: Callable[..., Done], command: str) -> None:
    done = netlab(command, "--help")
    assert done.returncode == 0
    assert f"Usage: netlab {command}" in done.stdout
