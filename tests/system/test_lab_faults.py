"""What breaks in a lab is said, shows in the exit code and is never a traceback: disk, processes, helpers, rights."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from netlab.capture.reader import Capture
from netlab.capture.records import Kind
from netlab.pytest_plugin import MakeLab

PAIR = Path(__file__).parents[1] / "data" / "cli" / "pair.yaml"

#: Runs the rest of its arguments with a small disk at the first one; copies the capture off it before it goes.
SMALL_DISK = """
import os, shutil, subprocess, sys
from netlab.kernel import syscalls
disk, kept, *argv = sys.argv[1:]
uid, gid = os.geteuid(), os.getegid()
if uid:
    syscalls.unshare(syscalls.CLONE_NEWUSER | syscalls.CLONE_NEWNS)
    for name, text in (("setgroups", "deny"), ("uid_map", f"0 {uid} 1"), ("gid_map", f"0 {gid} 1")):
        open(f"/proc/self/{name}", "w").write(text)
else:
    syscalls.unshare(syscalls.CLONE_NEWNS)
syscalls.mount("none", "/", None, syscalls.MS_REC | syscalls.MS_PRIVATE)
syscalls.mount("tmpfs", disk, "tmpfs", 0, "size=160k")
code = subprocess.call(argv)
shutil.copy(f"{disk}/run.mcap", kept)
sys.exit(code)
"""

#: Runs the rest of its arguments as an ordinary user who may not create user namespaces. Works for root and others.
NO_USER_NAMESPACES = """
import os, sys
from netlab.kernel import syscalls
uid, gid = os.geteuid(), os.getegid()
syscalls.unshare(syscalls.CLONE_NEWUSER)
for name, text in (("setgroups", "deny"), ("uid_map", f"1000 {uid} 1"), ("gid_map", f"1000 {gid} 1")):
    open(f"/proc/self/{name}", "w").write(text)
open("/proc/sys/user/max_user_namespaces", "w").write("0")
os.execv(sys.argv[1], sys.argv[1:])  # and with that, every capability is gone
"""


def _wrapped(netlab: Any, script: str, *arguments: object) -> subprocess.CompletedProcess[str]:
    argv = [sys.executable, "-c", script, *map(str, arguments)]
    return subprocess.run(
        argv, cwd=netlab.work, env=netlab.env, capture_output=True, text=True, timeout=60, check=False
    )


def _begin(netlab: Any, *arguments: object) -> subprocess.Popen[str]:
    """Start a run; returns when its scenario is running."""
    run: subprocess.Popen[str] = netlab.start("run", PAIR, *arguments)
    assert run.stderr is not None
    seen = ""
    while " running " not in seen:
        line = run.stderr.readline()
        assert line, seen
        seen += line
    return run


def test_a_full_disk_stops_the_capture_and_not_the_run(netlab: Any) -> None:
    (netlab.work / "disk").mkdir()
    bulk = "traffic=[{from: a, to: b, topic: pose, priority: 1, size: 1kB, rate: 200Hz}]"
    command = netlab.argv("run", PAIR, "--set", bulk, "--set", "duration=2s", "--capture", "disk/run.mcap", "--json")
    done = _wrapped(netlab, SMALL_DISK, "disk", "kept.mcap", *command)
    assert done.returncode == 2, done.stderr
    assert "t=  2.0s finished" in done.stderr  # it went on to its end
    complaint = "disk/run.mcap: No space left on device; nothing more is captured, the run goes on"
    assert complaint in done.stderr.partition("finished")[0]  # said when it happened
    assert complaint in done.stderr.partition("THE LAB BROKE: ")[2]  # and in the end
    assert "Traceback" not in done.stderr
    (stream,) = json.loads(done.stdout)["streams"]
    with Capture.open(netlab.work / "kept.mcap") as capture:
        published = sum(1 for _ in capture.records({Kind.PUBLISHED}))
        assert capture.metadata["name"] == "mini"
        assert sum(capture.counts().values()) > 100
    assert 0 < published < 400
    assert stream["sent"] == published  # figures are of what was captured, and do not pretend more


def test_a_process_that_dies_is_named_with_its_last_words_and_the_rest_is_judged(netlab: Any) -> None:
    brain = "{argv: [sh, -c, 'echo thinking; sleep 0.3; echo lost the lidar >&2; exit 3'], name: brain}"
    done = netlab("run", PAIR, "--set", f"nodes.a.processes=[udp_mesh, {brain}]")
    assert done.returncode == 0, done.stdout
    assert "a: process 'brain' ended with exit code 3; argv: sh -c" in done.stderr
    problems = done.stdout.partition("problems\n")[2].partition("\n\n")[0]
    assert problems.startswith("  a: process 'brain' ended with exit code 3; argv: sh -c")
    assert problems.endswith("thinking\n    lost the lidar")
    assert "met      delivered of pose" in done.stdout


def test_a_daemon_that_is_killed_and_started_again_carries_on(make_lab: MakeLab) -> None:
    lab = make_lab(
        {
            "name": "phoenix",
            "duration": "2s",
            "nodes": {"a": {"processes": ["udp_mesh"]}, "b": {"processes": ["udp_mesh"]}},
            "links": [{"between": ["a", "b"], "delay": "2ms"}],
            "traffic": [{"from": "a", "to": "b", "topic": "pose", "priority": 1, "size": "100B", "rate": "50Hz"}],
            "events": [{"at": "600ms", "kill": {"node": "b", "process": "udp_mesh"}, "restart": "300ms"}],
        }
    )
    result = lab.run()
    assert result.problems == ()  # it was asked for
    assert result.exit_code == 0
    sink = next(row for row in lab.status()["processes"] if (row["node"], row["process"]) == ("b", "traffic-sink"))
    assert (sink["exit_status"], sink["restarts"]) == (0, 0)
    row = result.stream("pose")
    received = [entry.seq for entry in result.trace.delivered[0]]
    assert row["sent"] == 100
    assert row["delivered"] == len(set(received))
    assert row["duplicates"] == len(received) - len(set(received))
    assert max(received) >= 98  # it flows again to the end
    assert set(range(28)) <= set(received)  # and everything before the kill was there
    assert 0.3 <= row["longest_gap_s"] < 1.4


def test_a_recorder_that_is_killed_voids_the_verdict_but_not_the_run(netlab: Any) -> None:
    run = _begin(netlab, "--set", "duration=2s", "--capture", "run.mcap")
    os.kill(netlab.process("netlab.capture.recorder"), signal.SIGKILL)
    out, err = run.communicate(timeout=30)
    assert run.returncode == 2
    assert "t=  2.0s finished" in err
    assert "40/40" in err  # the traffic did not notice
    assert "the recorder ended early" in err
    assert "THE LAB BROKE: figures and expectations cover only what was captured" in out
    assert "Traceback" not in out + err
    inspected = netlab("inspect", "run.mcap")
    assert inspected.returncode == 0
    assert "note: " in inspected.stderr


def test_an_air_process_that_is_killed_ends_the_run_at_once(netlab: Any) -> None:
    started = time.monotonic()
    run = _begin(netlab, "--set", "duration=60s", "--set", "events=[{at: 30s, link: {between: [a, b], loss: 1%}}]")
    os.kill(netlab.process("netlab.engines.air_process"), signal.SIGKILL)
    out, err = run.communicate(timeout=30)
    assert time.monotonic() - started < 30
    assert run.returncode == 2
    assert "the air process ended; no frame is carried any more" in err
    assert "the air process ended; no frame is carried any more" in out.partition("THE LAB BROKE: ")[2]
    assert "Traceback" not in out + err


def test_a_fork_server_that_is_killed_ends_the_run_at_once(netlab: Any) -> None:
    run = _begin(netlab, "--set", "duration=60s")
    os.kill(netlab.process("netlab.lab.spawner"), signal.SIGKILL)
    out, err = run.communicate(timeout=30)
    assert run.returncode == 2
    assert "the lab's fork server ended" in out.partition("THE LAB BROKE: ")[2]
    assert "Traceback" not in out + err


def test_a_supervisor_that_is_killed_is_one_message(netlab: Any) -> None:
    run = _begin(netlab, "--set", "duration=60s")
    os.kill(netlab.process("netlab.lab.supervisor"), signal.SIGKILL)
    out, err = run.communicate(timeout=30)
    assert (run.returncode, out) == (2, "")
    assert "the lab" in err.splitlines()[-1]
    assert "Traceback" not in err


def test_what_breaks_in_a_background_lab_shows_in_the_list(netlab: Any) -> None:
    netlab("up", PAIR)
    os.kill(netlab.process("netlab.engines.air_process"), signal.SIGKILL)
    deadline = time.monotonic() + 10
    while "! the air process ended" not in (listed := netlab("ls").stdout):
        assert time.monotonic() < deadline, listed
    done = netlab("link", "a", "b", "loss=5%")
    assert done.returncode == 2
    assert "air" in done.stderr
    assert "Traceback" not in done.stderr
    assert netlab("down").returncode == 0


def test_a_truncated_capture_is_read_up_to_its_last_whole_chunk(netlab: Any) -> None:
    assert netlab("run", PAIR, "--capture", "run.mcap").returncode == 0
    whole, torn = (netlab.work / "run.mcap").read_bytes(), netlab.work / "torn.mcap"
    counts = []
    for keep in (0.9, 0.5):
        torn.write_bytes(whole[: int(len(whole) * keep)])
        done = netlab("inspect", torn, "--json")
        assert done.returncode == 0, done.stderr
        answer = json.loads(done.stdout)
        assert answer["metadata"]["name"] == "mini"
        assert any("torn.mcap" in note for note in answer["notes"])
        counts.append(sum(answer["messages"].values()))
    assert counts[0] >= counts[1] > 0
    done = netlab("inspect", torn)
    assert done.returncode == 0
    assert done.stderr.startswith("note: ")
    assert "mini" in done.stdout
    assert netlab("export", torn).returncode == 0
    assert (netlab.work / "torn.pcapng").exists()


@pytest.mark.parametrize("command", ["run", "up"])
def test_where_user_namespaces_are_forbidden_the_way_out_is_told(netlab: Any, command: str) -> None:
    done = _wrapped(netlab, NO_USER_NAMESPACES, *netlab.argv(command, PAIR))
    if "PermissionError" in done.stderr and "unshare" in done.stderr:
        pytest.skip("user namespaces are forbidden here already; there is none to forbid them in")
    assert (done.returncode, done.stdout) == (2, "")
    assert "an ordinary user may not create a user namespace" in done.stderr
    assert "sudo sysctl -w user.max_user_namespaces=" in done.stderr
    assert "Or run the same command as root (sudo)." in done.stderr
    assert "Traceback" not in done.stderr
