"""The libc calls: they do what they say, and failures carry the errno and name the call."""

import errno
import os
import select
import signal
import time
from pathlib import Path

import pytest

from netlab.kernel import syscalls


def test_failures_carry_errno_and_the_call() -> None:
    with pytest.raises(OSError, match=r"mount\(.*on /nonexistent/x, type tmpfs") as caught:
        syscalls.mount("tmpfs", "/nonexistent/x", "tmpfs")
    assert caught.value.errno in (errno.ENOENT, errno.EPERM)
    with pytest.raises(OSError, match=r"setns\(fd 999999, CLONE_NEWNET\)") as caught:
        syscalls.setns(999999, syscalls.CLONE_NEWNET)
    assert caught.value.errno == errno.EBADF


def test_unshare_names_its_flags() -> None:
    with pytest.raises(OSError, match="unshare") as caught:
        syscalls.unshare(0x1)  # not a namespace: the kernel answers EINVAL
    assert caught.value.errno == errno.EINVAL


def test_timerfd_absolute_deadline_becomes_readable_and_not_before() -> None:
    fd = syscalls.timerfd_create(time.CLOCK_MONOTONIC)
    try:
        deadline_ns = time.monotonic_ns() + 3_000_000
        syscalls.timerfd_settime(fd, deadline_ns)
        assert select.select([fd], [], [], 0)[0] == []
        assert select.select([fd], [], [], 2)[0] == [fd]
        assert time.monotonic_ns() >= deadline_ns
        assert int.from_bytes(os.read(fd, 8), "little") == 1
    finally:
        os.close(fd)


def test_timerfd_in_the_past_fires_at_once_and_zero_disarms() -> None:
    fd = syscalls.timerfd_create(time.CLOCK_MONOTONIC)
    try:
        syscalls.timerfd_settime(fd, 1)
        assert select.select([fd], [], [], 1)[0] == [fd]
        syscalls.timerfd_settime(fd, 0)
        assert select.select([fd], [], [], 0)[0] == []
        with pytest.raises(OSError, match="timerfd_settime"):
            syscalls.timerfd_settime(fd, -5)
    finally:
        os.close(fd)


def test_process_settings_reach_the_kernel() -> None:
    reader, writer = os.pipe()
    pid = os.fork()
    if pid == 0:
        syscalls.set_name("a-name-longer-than-15")
        syscalls.set_timerslack_ns(1)
        syscalls.set_pdeathsig(signal.SIGKILL)
        syscalls.set_no_new_privs()
        text = Path("/proc/self/comm").read_text() + Path("/proc/self/timerslack_ns").read_text()
        status = Path("/proc/self/status").read_text()
        os.write(writer, (text + status).encode())
        os._exit(0)
    os.close(writer)
    with os.fdopen(reader) as stream:
        lines = stream.read().split("\n")
    assert os.waitpid(pid, 0)[1] == 0
    assert lines[:2] == ["a-name-longer-t", "1"]
    assert "NoNewPrivs:\t1" in lines
