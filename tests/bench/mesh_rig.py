"""Two cores of udp_mesh over the lab's own medium, in virtual time and one process: a minute of mission in seconds.

The medium is that of the ``air`` engine (netem's order: loss, then the queue, then rate and delay). Nodes and the
medium may be stalled: what reaches them meanwhile waits, as it does in a socket whose process does not run. That socket
may be small: what it has no room for is lost.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from random import Random

from netlab.medium.impairments import PERFECT, Impairment
from netlab.medium.pair import DROPPED, Outcome, Pair
from netlab.medium.verdicts import Verdict
from tests.virtual_calls import VirtualCalls
from udp_mesh.core.events import Event, MessageDelivered
from udp_mesh.core.mesh import MeshCore, Path, new_epoch
from udp_mesh.core.outbox import Refused
from udp_mesh.core.settings import Settings, TopicPolicy

FRAME_HEADERS = bytes(42)  # Ethernet, IPv4, UDP
HOST_DELAY_S = 20e-6  # between a frame's arrival and its reader's turn

Stalls = tuple[tuple[float, float], ...]  # (begin, end), seconds from the start


@dataclass
class Node:
    """One core, what it is told late, and what it said."""

    core: MeshCore
    name: str
    stalls: Stalls = ()
    waiting: list[bytes] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)

    def stalled_until(self, now: float) -> float:
        """Return when it runs again; ``now`` or before if it runs."""
        return max((end for begin, end in self.stalls if begin <= now < end), default=now)


class Rig(VirtualCalls):
    """Nodes ``a`` and ``b`` and the wire between them; time begins at 0."""

    def __init__(
        self,
        *,
        seed: int,
        stalls: dict[str, Stalls] | None = None,
        socket_bytes: float = float("inf"),
        **settings: object,
    ) -> None:
        rng = Random(seed)
        super().__init__(0.0)
        self.rng = rng
        self.verdicts: dict[Verdict, int] = {}
        self.frames = 0
        self.frame_bytes = 0
        self.queued: list[tuple[float, Verdict]] = []
        self.socket_bytes = socket_bytes
        self.socket_drops = 0
        self._medium_stalls = (stalls or {}).get("medium", ())
        self.nodes = {}
        for name in "ab":
            core = MeshCore(
                Settings(name=name, **settings),  # type: ignore[arg-type]
                epoch=new_epoch(rng),
                rng=Random(rng.random()),
                now=0.0,
            )
            core.add_carrier(0)
            self.nodes[name] = Node(core, name, (stalls or {}).get(name, ()))
        self.pairs = {"a": Pair(1, PERFECT, seed * 2 + 1), "b": Pair(0, PERFECT, seed * 2 + 2)}

    def shape(self, impairment: Impairment, *, sender: str | None = None) -> None:
        """Give one or both directions this impairment."""
        for name in sender or "ab":
            self.pairs[name].configure(impairment)

    def outage(self, *, active: bool) -> None:
        """Lose everything, or end that."""
        for pair in self.pairs.values():
            pair.set_outage(active)

    def meet(self) -> None:
        """Run until both are online."""
        while not all(any(p.online for p in n.core.peers(now=self.now)) for n in self.nodes.values()):
            self.run(0.01)
            assert self.now < 30, "the nodes did not discover each other"
        self.run(0.2)

    def run(self, duration_s: float) -> None:
        """Let time pass."""
        end_s = self.now + duration_s
        for node in self.nodes.values():
            self._settle(node)
        while True:
            timers = {node.name: node.stalled_until(node.core.next_timer()) for node in self.nodes.values()}
            next_s = min([*timers.values(), *(entry[0] for entry in self._calls[:1])])
            if next_s > end_s:
                self.now = end_s
                return
            self.now = max(self.now, next_s)
            if self._call_due():
                continue
            for node in self.nodes.values():
                if timers[node.name] <= self.now:
                    self._turn(node)

    def _turn(self, node: Node) -> None:
        if node.stalled_until(self.now) > self.now:
            return
        for data in node.waiting:
            node.core.receive_datagram(data, Path(0, "ab"[node.name == "a"]), now=self.now)
        node.waiting.clear()
        if node.core.next_timer() <= self.now:
            node.core.handle_timer(now=self.now)
        self._settle(node)

    def _settle(self, node: Node) -> None:
        if node.stalled_until(self.now) > self.now:
            return
        while datagrams := node.core.datagrams_to_send(now=self.now):
            for datagram in datagrams:
                for data in datagram.segments():
                    self._offer(node, data)
        while (event := node.core.next_event()) is not None:
            node.events.append(event)

    def _medium_runs_at(self, when_s: float) -> float:
        return max((end for begin, end in self._medium_stalls if begin <= when_s < end), default=when_s)

    def _offer(self, node: Node, data: bytes) -> None:
        runs_at_s = self._medium_runs_at(self.now)
        if runs_at_s > self.now:
            self.at(runs_at_s, lambda: self._offer(node, data))
            return
        outcomes: list[Outcome] = []
        self.pairs[node.name].offer(FRAME_HEADERS + data, self.now, outcomes)
        other = self.nodes["ab"[node.name == "a"]]
        for due_s, _receiver, frame, verdict in outcomes:
            self.verdicts[verdict] = self.verdicts.get(verdict, 0) + 1
            if verdict is Verdict.QUEUE_FULL:
                self.queued.append((self.now, verdict))
            if due_s != DROPPED:
                payload = frame[len(FRAME_HEADERS) :]
                if node.name == "a":
                    self.frames += 1
                    self.frame_bytes += len(frame)
                self.at(
                    self._medium_runs_at(due_s) + HOST_DELAY_S, lambda payload=payload: self._arrive(other, payload)
                )  # type: ignore[misc]

    def _arrive(self, node: Node, data: bytes) -> None:
        if sum(map(len, node.waiting)) + len(data) > self.socket_bytes:
            self.socket_drops += 1
            return
        node.waiting.append(data)
        self.at(node.stalled_until(self.now), lambda: self._turn(node))

    def publish(self, sender: str, topic: str, size_bytes: int, policy: TopicPolicy) -> int | None:
        """Publish zeros to the other node; None if refused."""
        node = self.nodes[sender]
        try:
            number = node.core.publish(topic, bytes(size_bytes), to="ab"[sender == "a"], policy=policy, now=self.now)
        except Refused:
            return None
        self.at(node.stalled_until(self.now), lambda: self._turn(node))
        return number

    def delivered(self, name: str, topic: str) -> list[MessageDelivered]:
        """Return what reached a node's applications."""
        return [e for e in self.nodes[name].events if isinstance(e, MessageDelivered) and e.topic == topic]


@dataclass(frozen=True, slots=True)
class Outcomes:
    """``utilisation``: bulk payload over what the link carries after headers. ``excess_s``: above the base, sorted.

    Telemetry that never arrived counts as infinitely late.
    """

    utilisation: float
    bulk_bps: float
    excess_s: list[float]
    base_s: float
    longest_bulk_gap_s: float
    queue_drops: int
    duplicates: int
    rig: Rig

    def quantile(self, share: float) -> float:
        """Nearest rank above."""
        return self.excess_s[min(int(share * len(self.excess_s)), len(self.excess_s) - 1)]


DATA_BYTES, DATAGRAM_BYTES = 1363, 1400
BULK = TopicPolicy(priority=9)
TELEMETRY = TopicPolicy(priority=1)


def saturate(
    link: Impairment,
    *,
    seed: int = 1,
    duration_s: float = 10.0,
    telemetry_hz: float = 10.0,
    telemetry: TopicPolicy = TELEMETRY,
    telemetry_bytes: int = 200,
    bulk_bytes: int = 200_000,
    stalls: dict[str, Stalls] | None = None,
    socket_bytes: float = float("inf"),
    **settings: object,
) -> Outcomes:
    """Bulk fills the wire from a to b while telemetry goes the same way."""
    rig = Rig(seed=seed, stalls=stalls, socket_bytes=socket_bytes, **settings)
    rig.shape(link)
    rig.meet()
    begin_s, published = rig.now, {}
    core = rig.nodes["a"].core

    def bulk() -> None:
        while core.stats()["queued_bytes"] < 5 * bulk_bytes:
            if rig.publish("a", "bulk", bulk_bytes, BULK) is None:
                return

    def send_telemetry() -> None:
        number = rig.publish("a", "telemetry", telemetry_bytes, telemetry)
        if number is not None:
            published[number] = rig.now

    rig.every(0.02, bulk, until_s=begin_s + duration_s)
    interval_s = 1 / telemetry_hz
    for index in range(int(duration_s * telemetry_hz)):
        rig.at(begin_s + (index + rig.rng.random()) * interval_s, send_telemetry)
    rig.run(duration_s)
    end_s = rig.now
    rate_bps = link.rate_bps or 0.0
    rig.run(2.0)
    first: dict[int, float] = {}
    delivered = rig.delivered("b", "telemetry")
    for event in delivered:
        first.setdefault(event.message_id, event.now)
    base_s = link.delay_s + (8 * (telemetry_bytes + 42 + 22 + 15 + 1 + len("telemetry")) / rate_bps if rate_bps else 0)
    excess = sorted(first.get(number, float("inf")) - at - base_s for number, at in published.items())
    times = [e.now for e in rig.delivered("b", "bulk") if e.now <= end_s]
    bulk_bps = 8 * bulk_bytes * len(times) / duration_s
    gaps = [y - x for x, y in zip([begin_s, *times], [*times, end_s], strict=True)]
    share = DATA_BYTES / (DATAGRAM_BYTES + 42)
    return Outcomes(
        utilisation=bulk_bps / (rate_bps * share) if rate_bps else 0.0,
        bulk_bps=bulk_bps,
        excess_s=excess,
        base_s=base_s,
        longest_bulk_gap_s=max(gaps),
        queue_drops=len(rig.queued),
        duplicates=len(delivered) - len(first),
        rig=rig,
    )
