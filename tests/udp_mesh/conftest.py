"""Two or more cores, a fake network and virtual time: what every test of the protocol plays with.

``make_net`` is a fixture that hands out the class :class:`Net`, so that tests need no import from a neighbouring file.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable
from dataclasses import dataclass, replace
from random import Random
from typing import Any

import pytest

from tests.udp_mesh.bridge_places import places_class
from tests.udp_mesh.radio_net import radio_class
from tests.virtual_calls import VirtualCalls
from udp_mesh.core import events, wire
from udp_mesh.core.mesh import Datagram, MeshCore, Path, PeerStatus, new_epoch
from udp_mesh.core.settings import Settings

HEADERS_BYTES = 42  # Ethernet, IPv4, UDP


@dataclass(slots=True)
class Link:
    """One direction between two nodes: loss before the queue, then a rate-limited FIFO, then the delay."""

    delay_s: float = 0.01
    loss_ratio: float = 0.0
    duplicate_ratio: float = 0.0
    jitter_s: float = 0.0
    rate_bps: float = 0.0
    limit_packets: int = 1000
    is_cut: bool = False
    free_at_s: float = 0.0
    delivered_bytes: int = 0
    dropped: int = 0


class OwnClock(MeshCore):
    """A core that lives by a clock of its own: at network time t it is told ``offset_s + rate * t``."""

    def __init__(self, offset_s: float, rate: float, settings: Settings, *, epoch: int, rng: Random, now: float):
        self.offset_s, self.rate = offset_s, rate
        super().__init__(settings, epoch=epoch, rng=rng, now=self._own(now))

    def _own(self, now: float) -> float:
        return self.offset_s + self.rate * now

    def receive_datagram(self, data: bytes | memoryview, path: Path, *, now: float) -> None:
        super().receive_datagram(data, path, now=self._own(now))

    def receive_burst(self, data: bytes | memoryview, segment_bytes: int, path: Path, *, now: float) -> None:
        super().receive_burst(data, segment_bytes, path, now=self._own(now))

    def datagrams_to_send(self, *, now: float) -> list[Datagram]:
        return super().datagrams_to_send(now=self._own(now))

    def handle_timer(self, *, now: float) -> None:
        super().handle_timer(now=self._own(now))

    def next_timer(self) -> float:
        due_s = super().next_timer()
        if (self.offset_s, self.rate) == (0.0, 1.0):
            return due_s
        # A little late, so that rounding never asks for a time at which the core finds nothing to do.
        return (due_s - self.offset_s) / self.rate + 1e-6

    def peers(self, *, now: float) -> list[PeerStatus]:
        return super().peers(now=self._own(now))

    def reconfigure(self, settings: Settings, *, now: float) -> None:
        super().reconfigure(settings, now=self._own(now))

    def publish(self, topic: str, payload: bytes | memoryview, *, now: float, **options: Any) -> int:
        return super().publish(topic, payload, now=self._own(now), **options)


class Net(VirtualCalls):
    """Named cores on one carrier. Everything happens in the order of virtual time; the seed decides all chances."""

    def __init__(self, *, seed: int = 1, **default_link: float) -> None:
        super().__init__(now=100.0)
        self.rng = Random(seed)
        self.cores: dict[str, MeshCore] = {}
        self.events: dict[str, list[events.Event]] = {}
        self.sent: dict[str, list[tuple[float, Datagram]]] = {}
        self.links: dict[tuple[str, str], Link] = {}
        self.default_link = default_link
        self.keep_datagrams = False
        self._in_air: list[tuple[float, int, str, bytes, Path]] = []

    def add(self, name: str, *, clock: tuple[float, float] = (0.0, 1.0), **settings: object) -> MeshCore:
        """Start a node, or start it again with a new epoch and nothing remembered.

        ``clock``: seconds by which its clock is ahead at network time 0, and how many of its seconds pass in one.
        """
        core = OwnClock(
            *clock,
            Settings(name=name, **settings),  # type: ignore[arg-type]
            epoch=new_epoch(self.rng),
            rng=Random(self.rng.random()),
            now=self.now,
        )
        core.add_carrier(0)
        for other in self.cores:
            if other != name:
                self.links.setdefault((name, other), Link(**self.default_link))  # type: ignore[arg-type]
                self.links.setdefault((other, name), Link(**self.default_link))  # type: ignore[arg-type]
        self.cores[name] = core
        self.events.setdefault(name, [])
        self.sent.setdefault(name, [])
        return core

    def link(self, a: str, b: str, **changes: object) -> None:
        """Change both directions between two nodes."""
        for pair in ((a, b), (b, a)):
            self.one_way(*pair, **changes)

    def one_way(self, sender: str, receiver: str, **changes: object) -> None:
        """Change one direction."""
        for key, value in changes.items():
            setattr(self.links[sender, receiver], key, value)

    def run(self, duration_s: float, *, until: Callable[[], bool] | None = None) -> bool:
        """Let time pass; with ``until``, stop when it holds and say whether it did."""
        end_s = self.now + duration_s
        self._settle()
        while until is None or not until():
            next_s = self._next_s()
            if next_s > end_s:
                self.now = end_s
                return False
            self.now = max(self.now, next_s)
            self._step()
        return True

    def _next_s(self) -> float:
        times = [core.next_timer() for core in self.cores.values()]
        times += [heap[0][0] for heap in (self._in_air, self._calls) if heap]
        return max(min(times), self.now)

    def _step(self) -> None:
        touched: set[str] = set()
        if self._call_due():
            touched.update(self.cores)
        while self._in_air and self._in_air[0][0] <= self.now:
            name, data, segment_bytes, path = self._next_arrival()
            if name in self.cores:
                self.cores[name].receive_burst(data, segment_bytes, path, now=self.now)
                touched.add(name)
        for name, core in self.cores.items():
            if core.next_timer() <= self.now:
                core.handle_timer(now=self.now)
                touched.add(name)
        self._settle(touched)

    def _next_arrival(self) -> tuple[str, bytes, int, Path]:
        """Return what arrives next; from one sender together and of one length, it is one burst, as with UDP_GRO."""
        at_s, _order, name, data, path = heapq.heappop(self._in_air)
        burst, size = [data], len(data)
        while self._in_air and len(burst[-1]) == size:
            next_s, _order, receiver, following, sender = self._in_air[0]
            if (next_s, receiver, sender) != (at_s, name, path) or len(following) > size:
                break
            burst.append(following)
            heapq.heappop(self._in_air)
        return name, b"".join(burst), size, path

    def _settle(self, names: set[str] | None = None) -> None:
        for name in sorted(self.cores if names is None else names):
            core = self.cores.get(name)
            if core is None:
                continue
            while datagrams := core.datagrams_to_send(now=self.now):
                for burst in datagrams:
                    for data in burst.segments():
                        self._send(name, Datagram(burst.path, data))
            while (event := core.next_event()) is not None:
                self.events[name].append(event)

    def _send(self, sender: str, datagram: Datagram) -> None:
        if self.keep_datagrams:
            self.sent[sender].append((self.now, datagram))
        for receiver in self.cores:
            if receiver != sender and datagram.path.address in ("", receiver):
                self._transmit(self.links[sender, receiver], sender, receiver, datagram.data)

    def _transmit(self, link: Link, sender: str, receiver: str, data: bytes) -> None:
        if link.is_cut or self.rng.random() < link.loss_ratio:
            return
        arrives_s = self.now
        if link.rate_bps:
            serialisation_s = 8 * (len(data) + HEADERS_BYTES) / link.rate_bps
            if link.free_at_s - self.now > link.limit_packets * 8 * 1442 / link.rate_bps:
                link.dropped += 1
                return
            link.free_at_s = max(link.free_at_s, self.now) + serialisation_s
            arrives_s = link.free_at_s
        link.delivered_bytes += len(data)
        for _ in range(2 if self.rng.random() < link.duplicate_ratio else 1):
            self._order += 1
            at_s = arrives_s + link.delay_s + self.rng.random() * link.jitter_s
            heapq.heappush(self._in_air, (at_s, self._order, receiver, data, Path(0, sender)))

    def stop(self, name: str) -> None:
        """Kill a node; what it sent stays in the air."""
        del self.cores[name]

    def publish(
        self, sender: str, topic: str, payload: bytes, to: str, *, is_tracked: bool = False, **policy: object
    ) -> int:
        """Publish with the topic's configured policy, changed by the given values."""
        core = self.cores[sender]
        chosen = replace(core.settings.policy(topic), **policy)  # type: ignore[arg-type]
        return core.publish(topic, payload, to=to, policy=chosen, is_tracked=is_tracked, now=self.now)

    def of(self, name: str, kind: type) -> list[events.Event]:
        """Return a node's events of one kind."""
        return [event for event in self.events[name] if isinstance(event, kind)]

    def delivered(self, name: str, topic: str | None = None) -> list[events.MessageDelivered]:
        """Return what reached a node's applications."""
        return [
            event
            for event in self.events[name]
            if isinstance(event, events.MessageDelivered) and topic in (None, event.topic)
        ]

    def meet(self, timeout_s: float = 3.0) -> None:
        """Run until every node has every other online."""
        count = len(self.cores) - 1

        def complete() -> bool:
            return all(sum(p.online for p in c.peers(now=self.now)) == count for c in self.cores.values())

        assert self.run(timeout_s, until=complete), "nodes did not discover each other"

    def packets(self, name: str) -> list[tuple[float, wire.Dissection]]:
        """Return what a node sent, decoded, with times; needs ``keep_datagrams``."""
        decoded = [(at, wire.dissect(datagram.data)) for at, datagram in self.sent[name]]
        return [(at, packet) for at, packet in decoded if packet is not None]


@pytest.fixture(scope="session")
def make_net() -> type[Net]:
    """The class, for tests that build their own network."""
    return Net


@pytest.fixture(scope="session")
def places() -> type[Net]:
    """The class of networks with several carriers, for tests of bridges."""
    return places_class(Net)


@pytest.fixture(scope="session")
def radio() -> type[Net]:
    """The class of networks whose nodes share a radio channel."""
    return radio_class(Net)
