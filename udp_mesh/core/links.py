"""What bridges say that they reach, and which way that is (:mod:`udp_mesh.core.bridge`).

Theory of operation. A LINK frame is a hint, no more: who is named in it and is not known gets an introduction by way of
the bridge, and is a peer once it has answered. A peer that is reached over a bridge sends beacons that nobody here
hears; that the bridge still names it stands for them. The link behind the bridge has the least datagram and rate that
the frame tells, and all who are reached over it share it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from udp_mesh.core.carriers import Carrier, Path
from udp_mesh.core.packets import Link
from udp_mesh.core.peer import Peer
from udp_mesh.core.state import NodeState

FIRST_INTERVAL_S = 1.0
RAREST_INTERVAL_S = 60.0
MAX_TOLD = 4096
MOST_GREETINGS = 16  # for one LINK frame; it comes again
MAX_LINKS = 4096
LEAST_MTU_BYTES = 128
MISSED_FRAMES = 3.5


@dataclass(slots=True)
class Told:
    """That a bridge reaches a node: by which way, since when it is known, how often it is said."""

    way: Path
    at_s: float
    interval_s: float

    def is_fresh(self, *, now: float) -> bool:
        """Whether it would have been said again by now if it had ceased to be so."""
        return now - self.at_s <= MISSED_FRAMES * self.interval_s


@dataclass(slots=True)
class _Greeted:
    at_s: float
    interval_s: float


class Links:
    """Ways over bridges, by the tags of those whom they reach."""

    def __init__(self, state: NodeState) -> None:
        self._state = state
        self._numbers: dict[tuple[str, int, int, int], int] = {}
        self._told: dict[
            int, dict[tuple[str, int], Told]
        ] = {}  # by tag, then by bridge and the carrier it was heard on
        self._greeted: dict[int, _Greeted] = {}

    def take(
        self, bridge: Peer, link: Link, path: Path, greet: Callable[[int, Path], None], *, now: float
    ) -> list[tuple[Peer, Told]]:
        """Note a LINK frame; return the peers that it names. ``greet`` is called for whom to introduce ourselves to."""
        if path.via or link.mtu_bytes < LEAST_MTU_BYTES or len(self._numbers) >= MAX_LINKS:
            return []
        way = Path(path.carrier, path.address, self._via(bridge, link))
        interval_s = bridge.beacon_interval_s * max(1, link.rounds)
        known = []
        greetings = 1 if self._state.rate_bps(path) else MOST_GREETINGS  # the other side greets, too
        for tag in link.tags:
            if tag == self._state.tag:
                continue
            told = self._told.setdefault(tag, {})[bridge.name, path.carrier] = Told(way, now, interval_s)
            peer = self._state.peer_of_tag(tag)
            if peer is not None:
                known.append((peer, told))
            if (peer is None or not peer.is_online) and greetings and self._may_greet(tag, now=now):
                greetings -= 1
                greet(tag, way)
        self._forget(now=now)
        return known

    def _via(self, bridge: Peer, link: Link) -> int:
        """Return the number of a link; one whose facts have changed is another link, and what was cut is cut anew."""
        via = self._numbers.setdefault((bridge.name, *link[:3]), len(self._numbers) + 1)
        if via not in self._state.links:
            self._state.links[via] = Carrier(via, link.mtu_bytes, float(link.rate_bps))
        return via

    def _may_greet(self, tag: int, *, now: float) -> bool:
        last = self._greeted.get(tag)
        if last is None:
            self._greeted[tag] = _Greeted(now, FIRST_INTERVAL_S)
        elif now - last.at_s < last.interval_s:
            return False
        else:
            last.at_s, last.interval_s = now, min(2 * last.interval_s, RAREST_INTERVAL_S)
        return True

    def met(self, tag: int) -> None:
        """Forget how often a node was greeted: it has answered."""
        self._greeted.pop(tag, None)

    def _forget(self, *, now: float) -> None:
        if len(self._told) > MAX_TOLD // 2:
            self._told = {
                tag: told for tag, told in self._told.items() if any(t.is_fresh(now=now) for t in told.values())
            }
            self._greeted = {tag: greeted for tag, greeted in self._greeted.items() if tag in self._told}
        while len(self._told) > MAX_TOLD:
            del self._told[next(iter(self._told))]

    def way(self, tag: int, path: Path) -> Told | None:
        """Return by which link a bridged datagram of this sender came on ``path``; None if its bridge never told."""
        for told in self._told.get(tag, {}).values():
            if told.way[:2] == path[:2]:
                return told
        return None

    def is_told_by_lesser(self, tag: int, carrier: int, *, now: float) -> bool:
        """Whether a bridge of a lesser name than this node tells of a node on a carrier."""
        own_name = self._state.settings.name
        told = self._told.get(tag, {}).items()
        return any(name < own_name and on == carrier and t.is_fresh(now=now) for (name, on), t in told)
