"""Many cores on one radio channel in virtual time: who has discovered whom, and what that costs in airtime.

The channel: frames leave one after the other in the order of asking, each for its airtime (802.11 OFDM at 6 Mbit/s:
16 + 4 + 4 ceil((22 + 8 L) / 24) microseconds, DIFS and the mean backoff before it; a unicast's acknowledgement after
it). Every receiver loses broadcasts on its own; unicasts are repeated by the radio until they arrive.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterable
from random import Random

from udp_mesh.core.mesh import Datagram, MeshCore, Path, new_epoch
from udp_mesh.core.settings import Settings

BITS_PER_SYMBOL = 24  # 6 Mbit/s
DIFS_S = 34e-6
SIFS_S = 16e-6
SLOT_S = 9e-6
MEAN_BACKOFF_SLOTS = 7.5
ACK_BYTES = 14
BELOW_UDP_BYTES = 28 + 8 + 24 + 4  # IPv4 and UDP, LLC, 802.11 header, checksum


def frame_s(size_bytes: int) -> float:
    """Return how long a frame of 802.11 with so many bytes lasts at 6 Mbit/s."""
    return (16 + 4 + 4 * math.ceil((22 + 8 * size_bytes) / BITS_PER_SYMBOL)) * 1e-6


def airtime_s(datagram: Datagram) -> float:
    """Return for how long a datagram keeps the channel from others."""
    access_s = DIFS_S + MEAN_BACKOFF_SLOTS * SLOT_S
    data_s = frame_s(len(datagram.data) + BELOW_UDP_BYTES)
    return access_s + data_s + (SIFS_S + frame_s(ACK_BYTES) if datagram.path.address else 0.0)


class Channel:
    """Cores that all hear each other, without any application's traffic: all airtime is discovery's."""

    def __init__(self, *, seed: int, loss_ratio: float) -> None:
        self.rng = Random(seed)
        self.loss_ratio = loss_ratio
        self.now = 100.0
        self.cores: dict[str, MeshCore] = {}
        self.airtime_s = 0.0
        self.frames = 0
        self._free_at_s = 0.0
        self._timers: dict[str, float] = {}
        self._arrivals: list[tuple[float, int, str, bytes, str]] = []

    def add(self, name: str, **settings: object) -> None:
        """Start a node now."""
        epoch, rng = new_epoch(self.rng), Random(self.rng.random())
        core = MeshCore(Settings(name=name, **settings), epoch=epoch, rng=rng, now=self.now)  # type: ignore[arg-type]
        core.add_carrier(0)
        self.cores[name] = core
        self._turn([name])

    def run(self, until_s: float) -> None:
        """Let time pass."""
        while True:
            arrival_s = self._arrivals[0][0] if self._arrivals else math.inf
            next_s = max(self.now, min(arrival_s, min(self._timers.values())))
            if next_s > until_s:
                self.now = until_s
                return
            self.now = next_s
            touched = {name for name, due_s in self._timers.items() if due_s <= next_s}
            for name in touched:
                self.cores[name].handle_timer(now=next_s)
            while self._arrivals and self._arrivals[0][0] <= next_s:
                _at, _order, name, data, source = heapq.heappop(self._arrivals)
                self.cores[name].receive_datagram(data, Path(0, source), now=next_s)
                touched.add(name)
            self._turn(sorted(touched))

    def _turn(self, names: Iterable[str]) -> None:
        for name in names:
            core = self.cores[name]
            while datagrams := core.datagrams_to_send(now=self.now):
                for datagram in datagrams:
                    self._send(name, datagram)
            while core.next_event() is not None:
                pass
            self._timers[name] = core.next_timer()

    def _send(self, sender: str, datagram: Datagram) -> None:
        self.frames += 1
        self.airtime_s += airtime_s(datagram)
        self._free_at_s = max(self._free_at_s, self.now) + airtime_s(datagram)
        address = datagram.path.address
        for receiver in [address] if address else self.cores:
            if receiver == sender or (not address and self.rng.random() < self.loss_ratio):
                continue
            arrival = (self._free_at_s, self.frames, receiver, datagram.data, sender)
            heapq.heappush(self._arrivals, arrival)

    def knows(self, name: str, other: str) -> bool:
        """Whether a node lists another as online."""
        return self.cores[name].is_online(other)


def join_delays_s(channel: Channel, newcomer: str, *, within_s: float) -> list[float]:
    """Start a node; return after which time each of the others listed it (infinite if not within the time)."""
    others = list(channel.cores)
    began_s = channel.now
    channel.add(newcomer)
    delays = dict.fromkeys(others, math.inf)
    while channel.now < began_s + within_s:
        for other in others:
            if delays[other] == math.inf and channel.knows(other, newcomer):
                delays[other] = channel.now - began_s
        channel.run(min(channel.now + 0.01, began_s + within_s))
    return sorted(delays.values())
