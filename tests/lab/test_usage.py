"""What a process has cost: read while it lives, told by the kernel at its end, added up over restarts."""

from __future__ import annotations

import os
from pathlib import Path

from netlab.lab.process import Process, ProcessSpec, State
from netlab.lab.usage import Usage, usage_at_end, usage_now

STAT = "7 (a) b) S 1 7 7 0 -1 4194560 10 0 0 0 {user} {system} 9 9 20 0 1 0 5 1 1"
TICKS_PER_S = os.sysconf("SC_CLK_TCK")


def test_a_living_process_is_read_from_proc(tmp_path: Path) -> None:
    (tmp_path / "7").mkdir()
    (tmp_path / "7" / "stat").write_text(STAT.format(user=2 * TICKS_PER_S, system=TICKS_PER_S))
    (tmp_path / "7" / "status").write_text("Name:\ta) b\nVmHWM:\t   2048 kB\nVmRSS:\t 1024 kB\n")
    assert usage_now(7, tmp_path) == Usage(3.0, 2048 * 1024)


def test_this_process_has_cost_something_and_one_that_is_gone_nothing() -> None:
    mine = usage_now(os.getpid())
    assert mine.cpu_s > 0
    assert 1e6 < mine.max_rss_bytes < 1e10
    assert usage_now(1 << 30) == Usage()


def test_the_kernel_tells_the_cost_of_a_child_at_its_end() -> None:
    pid = os.fork()
    if pid == 0:
        ballast = bytearray(30_000_000)
        os._exit(len(ballast) and sum(range(300_000)) * 0)
    used = usage_at_end(os.wait4(pid, 0)[2])
    assert 30e6 < used.max_rss_bytes < 1e9
    assert 0 < used.cpu_s < 10


def test_restarts_add_up() -> None:
    process = Process(ProcessSpec("a", "daemon", ("x",)), state=State.READY, pid=os.getpid())
    process.used_before = Usage(100.0, 1)
    assert process.usage().cpu_s > 100.0
    assert process.usage().max_rss_bytes > 1
    process.state = State.EXITED  # its id may be somebody else's by now
    assert process.usage() == Usage(100.0, 1)
    assert Usage(1.0, 5).then(Usage(2.0, 3)) == Usage(3.0, 5)
