"""Before t = 0, the kernel learns the link addresses of those to whom a node will talk.

An ARP request is a broadcast: on a shared channel it may collide, nobody acknowledges it, and the kernel repeats it a
second later. A team that has been switched on for a while has that behind it.
"""

from __future__ import annotations

import contextlib
import random
import socket
import time
from collections.abc import Iterable
from pathlib import Path

_DISCARD_PORT = 9  # RFC 863
_COMPLETE = 0x2  # ATF_COM, linux/if_arp.h
_SPREAD_S = 0.25  # so that the requests of a team do not meet
_POLL_S = 0.02
_GIVES_UP_S = 3.0  # mcast_solicit (3) times retrans_time (1 s), arp(7)
_ARP_TABLE = Path("/proc/net/arp")


def resolve(addresses: Iterable[str], rng: random.Random, *, deadline_s: float) -> None:
    """Send a datagram to each IPv4 address and wait until its link address is known, at most until ``deadline_s``.

    Blocks. ``deadline_s`` is monotonic. Addresses that nothing leads to are left alone.
    """
    time.sleep(min(rng.uniform(0.0, _SPREAD_S), max(0.0, deadline_s - time.monotonic())))
    waiting = set(addresses)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        while waiting and time.monotonic() < deadline_s:
            for address in waiting:
                with contextlib.suppress(OSError):
                    sock.sendto(b"", (address, _DISCARD_PORT))
            asked_again_s = time.monotonic() + _GIVES_UP_S  # until then the kernel repeats its requests
            while waiting and time.monotonic() < min(asked_again_s, deadline_s):
                time.sleep(_POLL_S)
                waiting -= known(_ARP_TABLE.read_text())


def known(table: str) -> set[str]:
    """The addresses of /proc/net/arp whose link address is known."""
    rows = (line.split() for line in table.splitlines()[1:])
    return {row[0] for row in rows if len(row) > 2 and int(row[2], 16) & _COMPLETE}
