"""Before t = 0, the kernels at both ends learn each other's link addresses, where requests for them may get lost.

An ARP request or its answer is one frame that nobody acknowledges; where it is lost, the kernel asks again a second
later, and until then everything to that neighbour waits. A team that has been switched on for a while has that behind
it. A datagram to a port where nobody listens is answered by the other kernel (ICMP port unreachable, RFC 1122,
3.2.2.1), which has to know our address for that: when the answer is here, both know.
"""

from __future__ import annotations

import contextlib
import random
import select
import socket
import time
from collections.abc import Callable, Iterable
from functools import partial

_DISCARD_PORT = 9  # RFC 863
SPREAD_S = 0.25  # so that the requests of a team on one channel do not meet
_REPEAT_S = 0.2
_GIVES_UP_S = 5.0  # somebody may listen there, or answer nobody


def resolve(addresses: Iterable[str], rng: random.Random, *, spread_s: float, deadline_s: float) -> None:
    """Send datagrams to each IPv4 address until its kernel answers, at most until ``deadline_s`` or for 5 s.

    Blocks. ``deadline_s`` is monotonic; what is sent first is sent after up to ``spread_s``. Addresses that nothing
    leads to are left alone.
    """
    time.sleep(min(rng.uniform(0.0, spread_s), max(0.0, deadline_s - time.monotonic())))
    deadline_s = min(deadline_s, time.monotonic() + _GIVES_UP_S)
    with contextlib.ExitStack() as scope:
        waiting = [sock for address in addresses if (sock := _towards(address, scope)) is not None]
        while waiting and time.monotonic() < deadline_s:
            waiting = [sock for sock in waiting if not _refused(partial(sock.send, b""))]
            again_s = min(time.monotonic() + _REPEAT_S, deadline_s)
            while waiting and (left_s := again_s - time.monotonic()) > 0:
                told = select.select(waiting, [], [], left_s)[0]
                waiting = [sock for sock in waiting if sock not in told or not _refused(partial(sock.recv, 1))]


def _towards(address: str, scope: contextlib.ExitStack) -> socket.socket | None:
    sock = scope.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
    sock.setblocking(False)
    try:
        sock.connect((address, _DISCARD_PORT))
    except OSError:
        return None
    return sock


def _refused(call: Callable[[], object]) -> bool:
    """Whether the other kernel's answer shows; other troubles, such as no neighbour yet, pass."""
    try:
        call()
    except ConnectionRefusedError:
        return True
    except OSError:
        pass
    return False
