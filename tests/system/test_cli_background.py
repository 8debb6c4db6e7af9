"""Labs in the background as a user meets them: up, ls, exec, shell, logs, link, down."""

from __future__ import annotations

import os
import select
import signal
import struct
import termios
import time
from collections.abc import Callable, Iterator
from fcntl import ioctl
from pathlib import Path
from pty import fork as fork_on_terminal
from typing import Any

import pytest

from netlab.lab.control import ControlClient

PAIR = Path(__file__).parents[1] / "data" / "cli" / "pair.yaml"
TALKER = "nodes.a.processes=[udp_mesh, {argv: [sh, -c, 'echo line one; echo line two >&2'], name: talker}]"
LIMIT_S = 10.0

#: Round trips of refused connections, in seconds: needs nobody at the other end.
ROUND_TRIP = """
import socket, time
for attempt in range(6):  # the first one also resolves the address
    s = socket.socket(); s.settimeout(5); t = time.monotonic()
    try: s.connect(("b", 9))
    except ConnectionRefusedError: print(time.monotonic() - t)
    except TimeoutError: print("lost")
"""


@pytest.fixture(scope="module")
def lab(new_netlab: Callable[[], Any]) -> Iterator[Any]:
    """The command, with one lab that is up."""
    netlab = new_netlab()
    done = netlab("up", PAIR, "--set", TALKER)
    assert done.returncode == 0, done.stderr
    assert netlab.labs() == [done.stdout.strip()]
    yield netlab
    done = netlab("down")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "")
    assert netlab.labs() == []
    assert netlab.processes() == {}


def _until(holds: Callable[[], object]) -> None:
    deadline = time.monotonic() + LIMIT_S
    while not holds():
        assert time.monotonic() < deadline


def _states(netlab: Any) -> dict[str, str]:
    (name,) = netlab.labs()
    connection = ControlClient(netlab.runtime / name / "control")
    rows = connection.request({"do": "status"})["links"]
    connection.close()
    return {f"{row['from']}{row['to']}": row["state"] for row in rows}


def test_ls_shows_what_runs(lab: Any) -> None:
    done = lab("ls")
    assert done.returncode == 0
    assert done.stdout == f"{lab.labs()[0]}  ready  engine=air  nodes: a b\n"


def test_exec_passes_input_output_and_exit_code(lab: Any) -> None:
    done = lab("exec", "a", "--", "sh", "-c", "cat; hostname >&2; exit 7", stdin="in\n")
    assert (done.returncode, done.stdout, done.stderr) == (7, "in\n", "a\n")


def test_exec_reports_a_signal_as_shells_do(lab: Any) -> None:
    assert lab("exec", "a", "sh", "-c", "kill -9 $$").returncode == 128 + signal.SIGKILL


def test_exec_takes_options_of_the_command_as_they_are(lab: Any) -> None:
    assert lab("exec", "a", "--", "echo", "--lab", "-h").stdout == "--lab -h\n"


def test_exec_works_from_a_directory_that_nodes_do_not_see(lab: Any, tmp_path: Path) -> None:
    assert lab("exec", "a", "pwd", cwd=tmp_path).stdout == "/\n"


@pytest.mark.parametrize("signum", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_command_in_a_node_ends_with_the_exec_that_started_it(lab: Any, signum: int) -> None:
    mark = f"{4000 + signum}.5"
    command = lab.start("exec", "a", "--", "sh", "-c", f"echo here; sleep {mark}; true")
    assert command.stdout.readline() == "here\n"
    _until(lambda: any(text.startswith(f"sleep {mark}") for text in lab.processes().values()))
    command.send_signal(signum)
    _out, err = command.communicate(timeout=LIMIT_S)
    assert "Traceback" not in err
    assert command.returncode == (130 if signum == signal.SIGINT else -signum)
    _until(lambda: not any(mark in text for text in lab.processes().values()))


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["exec", "a", "--", "no-such-program"], "a: no-such-program: No such file or directory"),
        (["exec", "zz", "true"], "there is no node 'zz'; nodes are a, b"),
        (["exec", "--lab", "nope", "a", "true"], "no lab is called 'nope'; running: mini-"),
        (["exec", "a"], "Missing argument 'ARGV...'"),
        (["shell", "zz"], "there is no node 'zz'; nodes are a, b"),
        (["logs", "zz"], "no output of zz; processes: a/udp_mesh, a/talker, b/udp_mesh"),
        (["logs", "a", "zz"], "no output of a/zz; processes: a/udp_mesh, a/talker, b/udp_mesh"),
        (["link", "a", "zz", "down"], "there is no node 'zz'; nodes are a, b"),
        (["link", "a", "a", "down"], "no link joins 'a' and 'a'; 'a' is linked to b"),
        (["link", "a", "b", "loss"], "loss: has no value"),
        (["link", "a", "b", "delay=5"], "delay: 5 has no unit; write a duration like 20ms"),
        (["link", "a", "b", "loss=200%"], "'200%' is impossible"),
        (["link", "a", "b", "speed=3mbit"], "unknown key 'speed'; known keys are delay, jitter,"),
        (["link", "a", "b", ","], "nothing changes; add a word such as loss: 20%"),
    ],
)
def test_a_request_that_cannot_be_met_says_why(lab: Any, arguments: list[str], text: str) -> None:
    done = lab(*arguments)
    assert (done.returncode, done.stdout) == (2, "")
    assert text in done.stderr
    assert "Traceback" not in done.stderr
    assert "between, from, to" not in done.stderr


def test_logs_prints_one_process_or_all(lab: Any) -> None:
    assert lab("logs", "a", "talker").stdout == "line one\nline two\n"
    everything = lab("logs", "a").stdout
    assert "==> talker <==\nline one\n" in everything
    assert "==> udp_mesh <==\n" in everything


def test_link_down_pulls_the_cable_and_up_plugs_it(lab: Any) -> None:
    def carrier() -> str:
        return str(lab("exec", "a", "cat", "/sys/class/net/eth0/carrier").stdout.strip())

    assert carrier() == "1"
    assert lab("link", "a", "b", "down").returncode == 0
    assert _states(lab) == {"ab": "no_carrier", "ba": "no_carrier"}
    _until(lambda: carrier() == "0")
    assert lab("link", "a", "b", "up").returncode == 0
    _until(lambda: carrier() == "1")


def test_link_one_way_cuts_silently_and_up_heals_whatever_was_cut(lab: Any) -> None:
    lab("link", "a", "b", "down", "--one-way")
    assert _states(lab) == {"ab": "outage", "ba": "up"}
    lab("link", "a", "b", "up", "--one-way")
    assert _states(lab) == {"ab": "up", "ba": "up"}
    lab("link", "b", "a", "down", "--one-way")
    lab("link", "a", "b", "up")
    assert _states(lab) == {"ab": "up", "ba": "up"}


def test_link_changes_take_effect_per_direction(lab: Any) -> None:
    def round_trip_s() -> float:
        words = lab("exec", "a", "--", "python3", "-c", ROUND_TRIP).stdout.split()
        return min(float(word) for word in words if word != "lost")

    assert lab("link", "a", "b", "delay=40ms").returncode == 0
    assert 0.080 <= round_trip_s() < 0.140
    assert lab("link", "b", "a", "delay=2ms, loss={gemodel: {p: 0.1%, r: 90%}}", "--one-way").returncode == 0
    assert 0.042 <= round_trip_s() < 0.075
    lab("link", "a", "b", "delay=2ms,loss=0%")


def test_shell_runs_a_script_from_standard_input(lab: Any) -> None:
    lab.env["SHELL"] = "/bin/sh"
    done = lab("shell", "b", stdin="hostname\nexit 4\n")
    assert (done.returncode, done.stdout) == (4, "b\n")


class Terminal:
    """A command on a terminal of its own, typed at and read from."""

    def __init__(self, netlab: Any, *arguments: str, rows: int, columns: int) -> None:
        self.pid, self.fd = fork_on_terminal()
        if self.pid == 0:
            ioctl(0, termios.TIOCSWINSZ, struct.pack("4H", rows, columns, 0, 0))
            os.chdir(netlab.work)
            argv = netlab.argv(*arguments)
            os.execve(argv[0], argv, {**netlab.env, "SHELL": "/bin/sh", "TERM": "dumb"})
        self.seen = ""

    def read_until(self, text: str) -> str:
        deadline = time.monotonic() + LIMIT_S
        while text not in self.seen:
            left = deadline - time.monotonic()
            assert left > 0, self.seen
            assert select.select([self.fd], [], [], left)[0], self.seen
            try:
                self.seen += os.read(self.fd, 65536).decode()
            except OSError:
                pytest.fail(f"it ended without {text!r}: {self.seen}")
        before, _, self.seen = self.seen.partition(text)
        return before

    def type(self, text: str) -> None:
        os.write(self.fd, text.encode())

    def resize(self, rows: int, columns: int) -> None:
        ioctl(self.fd, termios.TIOCSWINSZ, struct.pack("4H", rows, columns, 0, 0))

    def end(self) -> int:
        """Exit code; the rest of the output is thrown away."""
        while select.select([self.fd], [], [], LIMIT_S)[0]:
            try:
                if not os.read(self.fd, 65536):
                    break
            except OSError:
                break
        os.close(self.fd)
        return os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])


def test_shell_on_a_terminal_has_prompt_size_job_control_and_exit_code(lab: Any) -> None:
    terminal = Terminal(lab, "shell", "a", rows=33, columns=101)
    terminal.read_until("# ")
    terminal.type("stty size; hostname\r")
    terminal.read_until("33 101\r\na\r\n")
    terminal.resize(20, 60)
    terminal.type("while [ \"$(stty size)\" != '20 60' ]; do :; done; echo resi''zed\r")
    terminal.read_until("resized")
    terminal.type("sleep 1000\r")
    terminal.read_until("sleep 1000")
    _until(lambda: any(text.startswith("sleep 1000") for text in lab.processes().values()))
    terminal.type("\x03")  # Ctrl-C ends the sleep, not the shell
    terminal.read_until("# ")
    terminal.type("exit 5\r")
    assert terminal.end() == 5


def test_exec_on_a_terminal_loses_no_output(lab: Any) -> None:
    terminal = Terminal(
        lab, "exec", "a", "--", "sh", "-c", "test -t 0 && seq 1 5000; echo the end", rows=24, columns=80
    )
    output = terminal.read_until("the end")
    assert output.split() == [str(number) for number in range(1, 5001)]
    assert terminal.end() == 0


def test_two_labs_are_told_apart(netlab: Any) -> None:
    first = netlab("up", PAIR, "--set", "name=one").stdout.strip()
    second = netlab("up", PAIR, "--set", "name=two", "--capture", "two.mcap").stdout.strip()
    listed = netlab("ls").stdout.splitlines()
    assert [line.split()[:2] for line in listed] == [[first, "ready"], [second, "ready"]]
    done = netlab("exec", "a", "true")
    assert done.returncode == 2
    assert done.stderr == f"more than one lab is running; choose one with --lab: {first}, {second}\n"
    assert netlab("exec", "--lab", "two", "a", "--", "cat", "/proc/1/comm").stdout == "netlab\n"
    assert netlab("link", "--lab", first, "a", "b", "down").returncode == 0
    assert netlab("exec", "--lab", "two", "b", "cat", "/sys/class/net/eth0/carrier").stdout == "1\n"
    assert netlab("down").returncode == 2
    assert netlab("down", first).returncode == 0
    assert netlab.labs() == [second]
    assert netlab("down", "--lab", "two").returncode == 0
    done = netlab("ls")
    assert (done.returncode, done.stdout, done.stderr) == (0, "", "no lab is running\n")
    assert "name: mini" in netlab("inspect", "two.mcap", "--json").stdout  # the scenario's text is in the capture


def test_a_lab_that_is_killed_leaves_no_trace_in_the_list(netlab: Any) -> None:
    netlab("up", PAIR)
    os.kill(netlab.process("netlab.lab.supervisor"), signal.SIGKILL)
    _until(lambda: not netlab.processes())
    assert netlab("ls").stderr == "no lab is running\n"
    assert netlab.labs() == []


def test_up_says_which_process_kept_the_lab_from_starting(netlab: Any) -> None:
    broken = "nodes.a.processes=[{argv: [sh, -c, 'echo no lidar; exit 3'], name: brain, ready: fd}]"
    done = netlab("up", PAIR, "--set", broken, "--set", "traffic=[]", "--set", "expect=[]")
    assert (done.returncode, done.stdout) == (2, "")
    assert "a: process 'brain' ended with exit code 3; argv: sh -c" in done.stderr
    assert "no lidar" in done.stderr
    assert netlab.labs() == []
