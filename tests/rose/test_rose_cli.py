"""The command as a person uses it, with mistakes too; no traceback, the right exit code."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

KEY = "cd" * 32


def rose(*words: str, **more: object) -> subprocess.CompletedProcess[str]:
    argv = [sys.executable, "-m", "rose", *words]
    done = subprocess.run(argv, capture_output=True, text=True, timeout=60, check=False, **more)  # type: ignore[call-overload]
    assert "Traceback" not in done.stderr
    return done


def own_host() -> str:
    return f"127.79.{os.getpid() % 250}.{os.getpid() // 250 % 250 + 1}"


@pytest.fixture(scope="module")
def laser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A running host with a laser; its file."""
    file = tmp_path_factory.mktemp("rose") / "host.yaml"
    file.write_text(
        f'host: {own_host()}\nkeys: ["{KEY}"]\nservices:\n'
        '  - {name: laser, id: 0.1, run: "rose.examples.laser:Laser", settings: {rate_hz: 20, beams: 8}}\n'
    )
    read_fd, write_fd = os.pipe()
    argv = [sys.executable, "-m", "rose", "run", str(file), "--ready-fd", str(write_fd)]
    process = subprocess.Popen(argv, pass_fds=(write_fd,), stderr=subprocess.DEVNULL)
    os.close(write_fd)
    try:
        assert os.read(read_fd, 16) == b"ready\n"
        yield file
    finally:
        os.close(read_fd)
        process.terminate()
        assert process.wait(30) == 0


def test_list(laser: Path) -> None:
    done = rose("list", "--config", str(laser), "--json")
    assert done.returncode == 0, done.stderr
    (host,) = [json.loads(line) for line in done.stdout.splitlines() if json.loads(line)["host"] == own_host()]
    assert [(s["sid"], s["name"], s["state"]) for s in host["services"]] == [(f"{own_host()}/0.1", "laser", "running")]


def test_echo(laser: Path) -> None:
    done = rose("echo", f"{own_host()}/0.1", "--count", "2", "--json", env=os.environ | {"ROSE_CONFIG": str(laser)})
    assert done.returncode == 0, done.stderr
    first, second = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(first["message"]["ranges_m"]) == 8
    assert second["sequence"] == first["sequence"] + 1


def test_call(laser: Path) -> None:
    words = ("call", f"{own_host()}/0.1", "example/set_rate")
    done = rose(*words, '{"rate_hz": 30}', "--config", str(laser))
    assert (done.returncode, done.stdout) == (0, "done\n")
    done = rose(*words, "[-1.0]", "--config", str(laser))
    assert done.returncode == 1
    assert "refuses: a rate of -1 Hz is impossible; it is above 0 and up to 100" in done.stderr
    done = rose(*words, '{"hz": 1}', "--config", str(laser))
    assert done.returncode == 1
    assert "there is no field hz; its fields are rate_hz" in done.stderr
    done = rose("call", f"{own_host()}/0.1", "example/fly", "--config", str(laser))
    assert "type 'example/fly' is not known; known are example/laser_scan" in done.stderr
    assert done.returncode == 1


def test_without_the_key_there_is_no_answer(laser: Path) -> None:
    done = rose("call", f"{own_host()}/0.1", "example/set_rate", "[1.0]", "--host", "127.0.0.1", "--timeout", "0.3")
    assert done.returncode == 1
    assert "did not answer within 0.3 s" in done.stderr


def test_check_prints_addresses_or_every_mistake(laser: Path, tmp_path: Path) -> None:
    done = rose("config", "check", str(laser))
    assert done.returncode == 0
    assert "port 4097" in done.stdout
    wrong = tmp_path / "wrong.xml"
    wrong.write_text('<rose host="here">\n  <service id="0.0" run="x:Y"/>\n</rose>\n')
    done = rose("config", "check", str(wrong))
    assert done.returncode == 2
    assert done.stderr.splitlines() == [
        f"{wrong}:1: host: 'here' is no IP address",
        f"{wrong}:2: services[0].id: 0.0 is the Service Manager's own; take another",
    ]


@pytest.mark.parametrize(
    ("words", "status", "told"),
    [
        (("echo", "10.0.0.1"), 1, "write HOST/ROBOT.SERVICE"),
        (("echo", "10.0.0.1/0.1", "--host", "robot1"), 2, "--host robot1 is no IP address"),
        (("run", "nowhere.yaml"), 2, "nowhere.yaml: cannot be read"),
        (("fly",), 2, "No such command"),
        (("echo", "127.0.0.1/0.1", "--host", "127.0.0.1", "--types", "no_such"), 1, "--types no_such"),
    ],
)
def test_mistakes(words: tuple[str, ...], status: int, told: str) -> None:
    done = rose(*words)
    assert done.returncode == status
    assert told in done.stderr


def test_key_is_a_key() -> None:
    assert len(bytes.fromhex(rose("key").stdout.strip())) == 32
