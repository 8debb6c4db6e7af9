"""`netlab vm`: what it hands to the box, and with which exit code it ends."""

from __future__ import annotations

from pathlib import Path

import pytest
from box_rig import ANSWER, PREAMBLE
from click.testing import CliRunner, Result

from netlab.cli import vm as command
from netlab.vm import cache
from netlab.vm.request import BoxRequest, BoxResult, Clock, KernelChoice


class Recorded:
    """Stands where the box would, and remembers what it was asked."""

    def __init__(self, result: BoxResult) -> None:
        self.requests: list[BoxRequest] = []
        self._result = result

    def __call__(self, request: BoxRequest) -> BoxResult:
        self.requests.append(request)
        return self._result


@pytest.fixture
def recorded(monkeypatch: pytest.MonkeyPatch) -> Recorded:
    box = Recorded(BoxResult(5, "a kernel", 0.5, 1.0, 30.0, ("memory lies elsewhere",)))
    monkeypatch.setattr(command, "run_in_box", box)
    return box


def call(*words: str) -> Result:
    return CliRunner().invoke(command.vm, words)


def test_the_commands_exit_code_and_words_pass_through(recorded: Recorded) -> None:
    result = call("--clock", "virtual", "--memory", "1G", "--timeout", "9", "--", "build", "--flag", "--", "x")
    assert result.exit_code == 5
    (request,) = recorded.requests
    assert request.argv == ("build", "--flag", "--", "x")  # a command that is named like a subcommand
    assert (request.clock, request.kernel) == (Clock.VIRTUAL, KernelChoice.AUTO)
    assert (request.memory_bytes, request.timeout_s, request.cwd) == (1 << 30, 9.0, Path.cwd())
    assert "memory lies elsewhere" in result.stderr
    assert "30.0 s by the clock inside" not in result.stderr
    assert "30.0 s by the clock inside" in call("-v", "--", "true").stderr


def test_more_of_the_environment_on_request(recorded: Recorded, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOKEN", "t")
    call("--", "true")
    call("--env", "TOKEN", "--env", "A=b=c", "--", "true")
    without, with_both = (request.env for request in recorded.requests)
    assert "TOKEN" not in without
    assert (with_both["TOKEN"], with_both["A"]) == ("t", "b=c")
    assert call("--env", "UNSET_NAME", "--", "true").exit_code == 2


def test_the_time_limit_is_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "run_in_box", Recorded(BoxResult(124, "k", 0.5, 3.0, None)))
    result = call("--timeout", "3", "--", "sleep", "9")
    assert result.exit_code == 124
    assert "time limit of 3 s on the host's clock" in result.stderr


@pytest.mark.parametrize("words", [(), ("--",), ("--memory", "2", "--", "x"), ("--timeout", "0", "--", "x"), ("frob",)])
def test_wrong_usage_ends_with_2(recorded: Recorded, words: tuple[str, ...]) -> None:
    result = call(*words)
    assert result.exit_code == 2
    assert recorded.requests == []


def test_virtual_time_without_a_kernel_ends_with_2(store: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main("--clock", "virtual", "--", "true") == 2
    assert "netlab vm build" in capsys.readouterr().err


def main(*words: str) -> int:
    """As a person calls it: messages instead of tracebacks."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("sys.argv", ["netlab", *words])
        with pytest.raises(SystemExit) as ended:
            command.main()
    assert isinstance(ended.value.code, int)
    return ended.value.code


def install(tmp_path: Path) -> cache.BuiltKernel:
    kernel, config = tmp_path / "linux", tmp_path / ".config"
    kernel.write_text(PREAMBLE + ANSWER)
    config.touch()
    return cache.install(kernel, config, "6.1-1")


@pytest.mark.usefixtures("memory")
def test_a_whole_run(store: Path, tmp_path: Path) -> None:
    install(tmp_path)
    result = call("--clock", "virtual", "--memory", "128M", "--", "true")
    assert (result.exit_code, result.stdout, result.stderr) == (7, "to stdout\n", "to stderr\n")


def test_status_and_build_know_the_cache(store: Path, tmp_path: Path) -> None:
    missing = call("status")
    assert missing.exit_code == 1
    assert "netlab vm build" in missing.stdout
    built = install(tmp_path)
    there = call("status")
    assert there.exit_code == 0
    assert built.key in there.stdout
    again = call("build")
    assert again.exit_code == 0
    assert "already built" in again.stdout
    assert call("export", str(tmp_path / "k.tgz")).exit_code == 0
    assert (tmp_path / "k.tgz").stat().st_size > 0
