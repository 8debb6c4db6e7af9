"""Network namespaces held by descriptor, never by a name in /run/netns."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from netlab.kernel.syscalls import CLONE_NEWNET, setns, unshare

# Duplicate address detection and router solicitations are frames that no scenario asked for. The multicast reports of
# a new interface come at random in their interval, otherwise up to seconds into the scenario, where each would draw a
# loss.
_QUIET_IPV6 = {
    "accept_dad": b"0",
    "router_solicitations": b"0",
    "mldv1_unsolicited_report_interval": b"1",  # ms
    "mldv2_unsolicited_report_interval": b"1",
}


def open_current() -> int:
    """Return a descriptor of the calling thread's network namespace."""
    return os.open("/proc/thread-self/ns/net", os.O_RDONLY | os.O_CLOEXEC)


@contextlib.contextmanager
def returning() -> Iterator[int]:
    """Bring the calling thread back into its network namespace at the end; yields that namespace's descriptor."""
    origin = open_current()
    try:
        yield origin
    finally:
        setns(origin, CLONE_NEWNET)
        os.close(origin)


def enter_new() -> int:
    """Move the calling thread into a new network namespace, quiet on IPv6, and return its descriptor.

    Raises:
        OSError: Not permitted, or a limit in /proc/sys/user is reached.
    """
    unshare(CLONE_NEWNET)
    for name, value in _QUIET_IPV6.items():
        # /proc/sys/net shows the reader's own namespace. Read-only /proc/sys or no IPv6: a little noise or none.
        with contextlib.suppress(OSError):
            _write(f"/proc/sys/net/ipv6/conf/default/{name}", value)
    return open_current()


def has_ipv6() -> bool:
    """Whether the kernel has IPv6; without it IPv6 attributes are refused."""
    return Path("/proc/sys/net/ipv6").is_dir()


def _write(path: str, value: bytes) -> None:
    fd = os.open(path, os.O_WRONLY | os.O_CLOEXEC)
    try:
        os.write(fd, value)
    finally:
        os.close(fd)
