"""Several meshes, a fake network and virtual time: what every test of the mesh plays with.

``make_mesh_net`` is a fixture that hands out the class :class:`MeshNet`, so that tests need no import from a
neighbouring file.
"""

from __future__ import annotations

import heapq
from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from itertools import pairwise
from random import Random

import pytest

from tests.virtual_calls import VirtualCalls
from wnet.config import MeshConfig
from wnet.core import events
from wnet.core.mesh import Member, Mesh, Outgoing, Reception

MTU = 1700
#: At which a driver sends where it is not told a rate; receivers are told it all the same.
DRIVER_RATE_BPS = 6_000_000


@dataclass(slots=True)
class Path:
    """One direction between two members: loss, then a rate-limited queue, then the delay. A radio's is what one hears
    of the other; its group frames are not repeated by a MAC, nor are its unicast ones here."""

    delay_s: float = 0.002
    loss_ratio: float = 0.0
    rate_bps: float = 0.0
    limit_frames: int = 100
    snr_db: float | None = None
    is_cut: bool = False
    free_at_s: float = 0.0


@dataclass(slots=True)
class Station:
    """A node of the net with what became of it. ``delivered``: (time, frame); ``sent``: (time, outgoing)."""

    name: str
    mac: bytes
    members: list[Member]
    mesh: Mesh
    config: MeshConfig
    delivered: list[tuple[float, bytes]] = field(default_factory=list)
    sent: list[tuple[float, Outgoing]] = field(default_factory=list)
    events: list[events.Event] = field(default_factory=list)
    is_silent: bool = False


def mac_of(number: int, member: int | None = None) -> bytes:
    """The address of a node, or of one of its members."""
    return bytes((2, 0x57, 0 if member is None else 1 + member, 0, number >> 8, number & 0xFF))


class MeshNet(VirtualCalls):
    """Nodes by name. Everything happens in the order of virtual time; the seed decides all chances."""

    def __init__(self, *, seed: int = 1, **config: object) -> None:
        super().__init__(now=100.0)
        self.seed = seed
        self.rng = Random(seed)
        self.default_config = config
        self.stations: dict[str, Station] = {}
        self.paths: dict[tuple[tuple[str, int], tuple[str, int]], Path] = {}
        self._from: dict[tuple[str, int], list[tuple[tuple[str, int], Path]]] = {}
        self._due: dict[str, float] = {}
        self._wires: dict[str, int] = {}
        self._in_air: list[tuple[float, int, str, int, bytes, Reception | None]] = []

    # -- building ----------------------------------------------------------------------------------------------------

    def add(
        self,
        name: str,
        *,
        wires: int = 0,
        radios: int = 1,
        mtu: int = MTU,
        rates_bps: tuple[int, ...] = (),
        number: int | None = None,
        **config: object,
    ) -> Station:
        """Start a node with so many members, radios first; or start it again with nothing remembered."""
        old = self.stations.get(name)
        number = number or (int.from_bytes(old.mac[4:], "big") if old else len(self.stations) + 1)
        members = [Member(mac_of(number, i), True, mtu, rates_bps) for i in range(radios)]
        members += [Member(mac_of(number, radios + i), False, mtu) for i in range(wires)]
        if old is not None:
            members = old.members
        settings = MeshConfig(**{**self.default_config, **config})  # type: ignore[arg-type]
        mesh = Mesh(
            settings,
            mac_of(number),
            members,
            epoch=self.rng.getrandbits(32),
            rng=Random(self.rng.random()),
            now=self.now,
        )
        station = Station(name, mac_of(number), members, mesh, settings)
        if old is not None:
            station.delivered, station.sent, station.events = old.delivered, old.sent, old.events
        self.stations[name] = station
        return station

    def wire(self, a: str, b: str, **path: object) -> None:
        """Join two nodes by a wire of their own; each has been given enough wires."""
        ends = []
        for name in (a, b):
            station = self.stations[name]
            radios = sum(member.is_radio for member in station.members)
            ends.append((name, radios + self._wires.get(name, 0)))
            self._wires[name] = self._wires.get(name, 0) + 1
        self.join(ends[0], ends[1], **path)

    def join(self, a: tuple[str, int], b: tuple[str, int], **path: object) -> None:
        """Let two members hear each other."""
        for sender, receiver in ((a, b), (b, a)):
            self.paths[sender, receiver] = Path(**path)  # type: ignore[arg-type]
            self._from.setdefault(sender, []).append((receiver, self.paths[sender, receiver]))

    def radio(self, a: str, b: str, **path: object) -> None:
        """Let the first radios of two nodes hear each other."""
        self.join((a, 0), (b, 0), **path)

    def between(self, a: str, b: str) -> list[Path]:
        """All paths between two nodes, in both directions."""
        return [path for (x, y), path in self.paths.items() if {x[0], y[0]} == {a, b}]

    def change(self, a: str, b: str, **changes: object) -> None:
        """Change all paths between two nodes."""
        for path in self.between(a, b):
            for key, value in changes.items():
                setattr(path, key, value)

    def one_way(self, a: str, b: str, **changes: object) -> None:
        """Change all paths from one node to another."""
        for (x, y), path in self.paths.items():
            if (x[0], y[0]) == (a, b):
                for key, value in changes.items():
                    setattr(path, key, value)

    def line(self, names: Iterable[str], **path: object) -> None:
        """Nodes in a row, each with wires to the next."""
        row = list(names)
        for i, name in enumerate(row):
            self.add(name, radios=0, wires=2 - (i in (0, len(row) - 1)))
        for a, b in pairwise(row):
            self.wire(a, b, **path)

    # -- time --------------------------------------------------------------------------------------------------------

    def run(self, duration_s: float, *, until: Callable[[], bool] | None = None) -> bool:
        """Let time pass; with ``until``, stop when it holds and say whether it did."""
        end_s = self.now + duration_s
        self._settle(self.stations)
        steps = 0
        while until is None or not until():
            next_s = self._next_s()
            if next_s > end_s:
                self.now = end_s
                return False
            steps = 0 if next_s > self.now else steps + 1
            assert steps < 1000, f"time stands still at {self.now}: somebody asks for a time that is not ahead"
            self.now = max(self.now, next_s)
            self._step()
        return True

    def _next_s(self) -> float:
        times = [due for name, due in self._due.items() if not self.stations[name].is_silent]
        times += [heap[0][0] for heap in (self._in_air, self._calls) if heap]
        return max(min(times), self.now)

    def _step(self) -> None:
        touched: set[str] = set()
        self._call_due()
        while self._in_air and self._in_air[0][0] <= self.now:
            _at, _order, name, member, frame, reception = heapq.heappop(self._in_air)
            station = self.stations.get(name)
            if station is not None and not station.is_silent:
                station.mesh.receive(member, frame, now=self.now, reception=reception)
                touched.add(name)
        for name, due in list(self._due.items()):
            station = self.stations[name]
            if due <= self.now and not station.is_silent:
                station.mesh.handle_timer(now=self.now)
                touched.add(name)
        self._settle(touched)

    def _settle(self, names: Iterable[str]) -> None:
        for name in sorted(names):
            station = self.stations.get(name)
            if station is None or station.is_silent:
                continue
            for outgoing in station.mesh.frames_to_send(now=self.now):
                station.sent.append((self.now, outgoing))
                self._carry(name, outgoing)
            station.delivered += [(self.now, frame) for frame in station.mesh.take_delivered()]
            while (event := station.mesh.next_event()) is not None:
                station.events.append(event)
            self._due[name] = station.mesh.next_timer() or float("inf")

    def _carry(self, name: str, outgoing: Outgoing) -> None:
        for receiver, path in self._from.get((name, outgoing.member), ()):
            if path.is_cut or not self._is_for(receiver, outgoing.frame):
                continue
            if path.loss_ratio and self.rng.random() < path.loss_ratio:
                continue
            leaves_s = self.now
            if path.rate_bps:
                airtime_s = 8 * len(outgoing.frame) / path.rate_bps
                if path.free_at_s - self.now > path.limit_frames * airtime_s:
                    continue
                path.free_at_s = leaves_s = max(path.free_at_s, self.now) + airtime_s
            reception = None
            if path.snr_db is not None:
                reception = Reception(-95.0 + path.snr_db, -95.0, outgoing.rate_bps or DRIVER_RATE_BPS)
            self._order += 1
            arrival = (leaves_s + path.delay_s, self._order, *receiver, outgoing.frame, reception)
            heapq.heappush(self._in_air, arrival)

    def _is_for(self, receiver: tuple[str, int], frame: bytes) -> bool:
        name, member = receiver
        return bool(frame[0] & 1) or frame[:6] == self.stations[name].members[member].mac

    def inject(self, name: str, member: int, frame: bytes) -> None:
        """Let a node receive a frame from nowhere."""
        self.stations[name].mesh.receive(member, frame, now=self.now)
        self._settle([name])

    # -- traffic -----------------------------------------------------------------------------------------------------

    def send(self, source: str, destination: str | bytes, payload: bytes = b"", *, dscp: int = 0) -> bytes:
        """Hand a node an IPv4 frame, to a node or to an address; return it."""
        target = destination if isinstance(destination, bytes) else self.stations[destination].mac
        ip = bytes((0x45, dscp << 2)) + bytes(18)
        frame = target + self.stations[source].mac + b"\x08\x00" + ip + payload
        self.stations[source].mesh.originate(frame, now=self.now)
        self._settle([source])
        return frame

    def got(self, name: str) -> list[bytes]:
        """Payloads of the IPv4 frames that a node's mesh interface was given (queries of the mesh itself left out)."""
        return [frame[34:] for _at, frame in self.stations[name].delivered if is_data(frame)]

    def times(self, name: str) -> list[float]:
        """When they came."""
        return [at for at, frame in self.stations[name].delivered if is_data(frame)]

    def counts(self, name: str) -> Counter[str]:
        """A node's counters."""
        return Counter(self.stations[name].mesh.counts)

    def told(self, name: str, kind: type) -> list[events.Event]:
        """A node's events of one kind."""
        return [event for event in self.stations[name].events if isinstance(event, kind)]

    def all_known(self) -> bool:
        """Whether every node has a route to every other."""
        for station in self.stations.values():
            reachable = {route.destination for route in station.mesh.snapshot(now=self.now).routes}
            if len(reachable) != len(self.stations) - 1:
                return False
        return True


def is_data(frame: bytes) -> bool:
    """Whether a frame is a test's, not a query of the mesh."""
    return frame[12:15] == b"\x08\x00\x45"


@pytest.fixture
def make_mesh_net() -> type[MeshNet]:
    """The class of fake networks of meshes."""
    return MeshNet
