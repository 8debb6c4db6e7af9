"""Nodes of a running lab: names, addresses, isolation from one another and from the host."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from netlab.errors import LabError
from netlab.pytest_plugin import MakeLab

TWO = {
    "name": "two",
    "duration": "1s",
    "nodes": {"a": {}, "b": {}},
    "links": [{"between": ["a", "b"], "delay": "5ms"}],
}


def test_nodes_have_their_own_names_and_reach_each_other_by_name(make_lab: MakeLab) -> None:
    lab = make_lab(TWO)
    assert lab.exec("a", "hostname").stdout == "a\n"
    reply = lab.exec("a", "python3", "-c", "import socket; print(socket.gethostbyname('b'))")
    assert reply.stdout == "10.1.0.2\n"
    script = """
import socket, time
s = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); s.bind(("0.0.0.0", 9)); s.settimeout(5)
t = time.monotonic(); s.sendto(b"x", ("b", 9)); s.recv(9); print(time.monotonic() - t)
"""
    echo = (
        "import socket\ns = socket.socket(socket.AF_INET, socket.SOCK_DGRAM); s.bind(('0.0.0.0', 9)); s.settimeout(9)\n"
    )
    echo += "print('bound', flush=True)\nfor _ in range(6): s.sendto(*s.recvfrom(9))\n"
    server = {**TWO, "nodes": {"a": {}, "b": {"processes": [{"argv": ["python3", "-uc", echo], "name": "echo"}]}}}
    lab = make_lab(server)
    while "bound" not in lab.log("b", "echo"):
        lab.status()
    lab.exec("a", "python3", "-c", script)  # the first one also resolves the address
    least_s = min(float(lab.exec("a", "python3", "-c", script).stdout) for _ in range(5))
    assert 0.010 <= least_s < 0.1


def test_each_node_has_private_directories_and_shared_memory(make_lab: MakeLab, tmp_path: Path) -> None:
    lab = make_lab(TWO)
    lab.exec("a", "sh", "-c", "touch /dev/shm/mark /tmp/mark /run/mark")
    listing = lab.exec("b", "sh", "-c", "ls /dev/shm /tmp /run").stdout
    assert "mark" not in listing
    for directory in ("/dev/shm", "/tmp", "/run"):
        assert not Path(directory, "mark").exists()
    keep = lab.exec("a", "ls", "/dev/shm").stdout
    assert keep == "mark\n"  # and a node keeps its own from one command to the next


def test_nodes_have_their_own_ipc_and_mounts_but_one_set_of_processes(make_lab: MakeLab) -> None:
    lab = make_lab(TWO)
    command = ("sh", "-c", "readlink /proc/self/ns/net /proc/self/ns/ipc /proc/self/ns/mnt /proc/self/ns/uts")
    a, b = lab.exec("a", *command).stdout.split(), lab.exec("b", *command).stdout.split()
    host = [str(Path(f"/proc/self/ns/{kind}").readlink()) for kind in ("net", "ipc", "mnt", "uts")]
    assert all(len({x, y, z}) == 3 for x, y, z in zip(a, b, host, strict=True))
    assert lab.exec("a", "cat", "/proc/1/comm").stdout == "netlab\n"


def test_the_node_sees_its_own_interfaces_everywhere(make_lab: MakeLab) -> None:
    lab = make_lab(TWO)
    assert set(lab.exec("a", "ls", "/sys/class/net").stdout.split()) == {"lo", "eth0"}


def test_a_command_gets_input_environment_and_gives_back_its_exit_code(make_lab: MakeLab) -> None:
    lab = make_lab(TWO)
    done = lab.exec("a", "sh", "-c", 'cat; echo "$X" >&2; exit 7', env={"X": "set"}, text="in")
    assert (done.returncode, done.stdout, done.stderr) == (7, "in", "set\n")
    assert lab.exec("a", "sh", "-c", "kill -9 $$").returncode == -9


def test_a_command_that_does_not_end_is_ended(make_lab: MakeLab) -> None:
    lab = make_lab(TWO)
    with pytest.raises(subprocess.TimeoutExpired):
        lab.exec("a", "sleep", "1234.5", timeout_s=0.3)
    while (
        "1234.5"
        in lab.exec("a", "sh", "-c", "cat /proc/[0-9]*/cmdline 2>/dev/null | grep -a -o 1234[.]5 | head -1").stdout
    ):
        pass


def test_unknown_nodes_and_programs_are_named(make_lab: MakeLab) -> None:
    lab = make_lab(TWO)
    with pytest.raises(LabError, match="no node 'c'; nodes are a, b"):
        lab.exec("c", "true")
    with pytest.raises(LabError, match="no-such-program: No such file"):
        lab.exec("a", "no-such-program")


def test_a_process_that_cannot_start_stops_the_lab_with_all_that_is_known(make_lab: MakeLab) -> None:
    broken = {**TWO, "nodes": {"a": {"processes": [{"argv": ["/no/such"], "name": "brain"}]}, "b": {}}}
    with pytest.raises(LabError, match=r"a: process 'brain' cannot start: /no/such: No such file.*argv: /no/such"):
        make_lab(broken)


def test_a_process_that_dies_before_it_is_ready_is_shown_with_its_last_words(make_lab: MakeLab) -> None:
    argv = ["sh", "-c", "echo cannot open /dev/lidar >&2; exit 3"]
    broken = {**TWO, "nodes": {"a": {"processes": [{"argv": argv, "name": "brain", "ready": "fd"}]}, "b": {}}}
    with pytest.raises(LabError, match=r"(?s)a: process 'brain' ended with exit code 3; .*cannot open /dev/lidar"):
        make_lab(broken)


def test_a_process_may_be_restarted_by_the_lab(make_lab: MakeLab) -> None:
    argv = ["sh", "-c", "echo here; exec sleep 1000"]
    lab = make_lab({**TWO, "nodes": {"a": {"processes": [{"argv": argv, "name": "brain"}]}, "b": {}}})
    first = next(p["pid"] for p in lab.status()["processes"])
    lab.kill("a", "brain")
    assert lab.status()["processes"][0]["exit_status"] == -9
    lab.restart("a", "brain")
    row = lab.status()["processes"][0]
    assert row["state"] == "ready"
    assert row["pid"] != first


def test_two_labs_do_not_see_each_other(make_lab: MakeLab) -> None:
    one, two = make_lab(TWO), make_lab(TWO)
    one.outage("a", "b", active=True)
    assert [row["state"] for row in one.status()["links"]] == ["outage", "outage"]
    assert [row["state"] for row in two.status()["links"]] == ["up", "up"]
    assert one.name != two.name
