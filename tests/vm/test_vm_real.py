"""Commands in the real box, in virtual time. Skipped, loudly, where its kernel is not built."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from box_rig import Run, with_word

from netlab.vm.kernels import Kernel
from netlab.vm.request import Clock

pytestmark = pytest.mark.usefixtures("memory")

#: Real seconds that a box with almost nothing to do may take; measured: 0.7 s on an idle machine.
SLACK_S = 40.0


def test_exit_code_output_and_virtual_sleep(built_kernel: Kernel, memory: Path) -> None:
    run = Run()
    result = run.box("sh", "-c", "echo out; echo err >&2; sleep 1000; exit 7", kernel=built_kernel)
    assert (result.exit_code, run.out.getvalue(), run.err.getvalue()) == (7, b"out\n", b"err\n")
    assert result.guest_s == pytest.approx(1000.0, abs=0.01)
    assert result.wall_s < SLACK_S
    assert list(memory.iterdir()) == []


def test_the_virtual_clock_starts_now(built_kernel: Kernel) -> None:
    run, before_s = Run(), time.time()
    run.box("date", "+%s.%N", kernel=built_kernel)
    assert before_s - 1 < float(run.out.getvalue()) < time.time() + 1


def test_real_time_is_real(built_kernel: Kernel) -> None:
    result = Run().box("sleep", "1", kernel=built_kernel, clock=Clock.REAL)
    assert result.guest_s == pytest.approx(1.0, abs=0.9)
    assert result.wall_s > 1.0


def test_much_output_comes_whole(built_kernel: Kernel) -> None:
    run = Run()
    run.box("sh", "-c", "seq 200000", kernel=built_kernel)
    assert run.out.getvalue() == b"".join(b"%d\n" % i for i in range(1, 200001))


def test_signals_and_missing_commands_end_as_in_a_shell(built_kernel: Kernel) -> None:
    run = Run()
    assert run.box("sh", "-c", "kill -TERM $$", kernel=built_kernel).exit_code == 128 + signal.SIGTERM
    assert run.box("no-such-command", kernel=built_kernel).exit_code == 127
    assert b"no-such-command: No such file" in run.err.getvalue()


def test_only_the_output_folder_outlives_the_box(built_kernel: Kernel, tmp_path: Path) -> None:
    output, beside = tmp_path / "output", tmp_path / "beside"
    for folder in (output, beside):
        folder.mkdir()
        (folder / "old").write_text("old\n")
    run = Run()
    write = f"for f in {output} {beside}; do echo new >$f/old; echo x >$f/new; done"
    script = f"cat {beside}/old; pwd; {write}; cat {beside}/new"
    result = run.box("sh", "-c", script, kernel=built_kernel, cwd=beside, output=output)
    assert (result.exit_code, run.out.getvalue()) == (0, f"old\n{beside}\nx\n".encode()), run.err.getvalue()
    assert ((output / "old").read_text(), (output / "new").read_text()) == ("new\n", "x\n")
    assert (beside / "old").read_text() == "old\n"
    assert not (beside / "new").exists()
    assert (output / "new").stat().st_uid == os.geteuid()


def test_a_fresh_machine_whose_new_namespaces_have_the_loopback_alone(built_kernel: Kernel) -> None:
    run = Run()
    script = "hostname; id -u; ls -A /tmp | wc -l; ls -A /dev/shm | wc -l; unshare -Urn ip -o link | cut -d: -f2"
    run.box("sh", "-c", script, kernel=built_kernel)
    words = run.out.getvalue().split()
    assert (words[:2], words[3:]) == ([b"box", b"0"], [b"0", b"lo"])
    assert int(words[2]) <= 1  # the test's own folder lies below /tmp and stays visible


def test_netem_delays_exactly(built_kernel: Kernel) -> None:
    program = """
import socket, statistics, subprocess, time
subprocess.run(["tc", "qdisc", "add", "dev", "lo", "root", "netem", "delay", "20ms"], check=True)
receiver = socket.socket(type=socket.SOCK_DGRAM)
receiver.bind(("127.0.0.1", 0))
sender = socket.socket(type=socket.SOCK_DGRAM)
for i in range(50):
    sent_s = time.monotonic()
    sender.sendto(b"x", receiver.getsockname())
    receiver.recv(9)
    print(time.monotonic() - sent_s)
"""
    run = Run()
    result = run.box("python3", "-c", program, kernel=built_kernel)
    if b"'tc'" in run.err.getvalue():
        pytest.skip("tc is not installed; to run this test too: sudo apt-get install iproute2")
    delays_s = [float(line) for line in run.out.getvalue().split()]
    assert result.exit_code == 0, run.err.getvalue()
    assert len(delays_s) == 50
    assert delays_s == [pytest.approx(0.020, abs=0.0001)] * 50


def test_a_busy_guest_is_ended_by_the_hosts_clock(built_kernel: Kernel, memory: Path) -> None:
    began_s = time.monotonic()
    result = Run().box("sh", "-c", "while :; do :; done", kernel=built_kernel, timeout_s=6.0)
    assert (result.exit_code, result.timed_out) == (124, True)
    assert time.monotonic() - began_s < SLACK_S
    assert list(memory.iterdir()) == []


CALLER = """
import sys
from pathlib import Path
from netlab.vm.request import BoxRequest, Clock, clean_environment
from netlab.vm.run import run_in_box
from netlab.vm.request import KernelChoice
run_in_box(BoxRequest(("sh", "-c", "sleep 1000 & echo ready; sleep 1000"), Path("/"), clean_environment({}),
    memory_bytes=512 << 20, clock=Clock.REAL, kernel=KernelChoice.UML))
"""


@pytest.mark.parametrize("victim", ["caller", "keeper", "nurse", "kernel"])
def test_nothing_is_left_of_a_real_box_whoever_is_killed(built_kernel: Kernel, memory: Path, victim: str) -> None:
    with subprocess.Popen([sys.executable, "-c", CALLER], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as caller:
        assert caller.stdout is not None
        assert caller.stdout.readline() == b"ready\n"
        chain = {"caller": caller.pid}
        for parent, child in (("caller", "keeper"), ("keeper", "nurse"), ("nurse", "kernel")):
            path = Path(f"/proc/{chain[parent]}/task/{chain[parent]}/children")
            chain[child] = int(path.read_text().split()[0])
        assert len(with_word(str(memory))) > 3
        os.kill(chain[victim], signal.SIGKILL)
        caller.wait(20)
    end_s = time.monotonic() + 10
    while with_word(str(memory)) and time.monotonic() < end_s:
        os.sched_yield()
    assert with_word(str(memory)) == []
