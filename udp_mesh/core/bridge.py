"""A node that joins its carriers: passes on what nodes that cannot hear each other send to one another.

Theory of operation.
* What is passed on are datagrams, as they are but for a mark. Sessions, acknowledgements, epochs, priorities and the
  key stay between the two ends, so whatever they promise each other holds, and a bridge that is restarted loses
  nothing that is not sent again. Where to, the datagram's destination tag says.
* A bridge tells the nodes on each carrier whom it hears on the others (LINK frames in its beacons); what they make of
  it, :mod:`udp_mesh.core.links` says. It passes on only what comes from a node that it hears itself, to a node that it
  hears itself on another carrier, and nothing that another bridge has passed on: so nothing can go in circles.
* Broadcasts that carry messages go to the other carriers once, by the bridge with the least name of those that tell
  there of the same sender. Beacons and probes stay where they are.
* For a carrier of known rate there is a queue of its own (:mod:`udp_mesh.core.bridge_queue`). It takes turns with this
  node's own messages, by priority. Elsewhere datagrams leave at once.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import count

from udp_mesh.core.bridge_queue import BridgeQueue
from udp_mesh.core.carriers import Path
from udp_mesh.core.datagram import CONTROL_PRIORITY, Datagram
from udp_mesh.core.links import Links
from udp_mesh.core.packets import Dissection, Link
from udp_mesh.core.paths import STALE_AT_LEAST_S, STALE_BEACONS
from udp_mesh.core.peer import Peer
from udp_mesh.core.search import PROBE_BYTES
from udp_mesh.core.state import NodeState
from udp_mesh.core.wire_links import LINK_HEAD, TAG, encode_link, mark_bridged

LEAST_PRIORITY = 255
REMEMBERED_BROADCASTS = 256
_MAX_TAGS = 255


class Bridge:
    """What this node passes on, while ``Settings.bridge``."""

    def __init__(self, state: NodeState, links: Links) -> None:
        self._state = state
        self._links = links
        self._queues: dict[int, BridgeQueue] = {}
        self._at_once: list[Datagram] = []
        self._passed: dict[tuple[int, int], None] = {}  # epoch and number of broadcasts
        self._numbers: dict[int, int] = {}  # of carriers, short, for LINK frames
        self._next_number = count()
        self._turn: dict[tuple[int, int], int] = {}
        self._own_turn: dict[int, bool] = {}

    # -- what is passed on

    def unicast(self, data: bytes | memoryview, packet: Dissection, sender: Peer, path: Path, *, now: float) -> bool:
        """Pass on a datagram for somebody else; whether it was meant to be."""
        state = self._state
        target = state.peer_of_tag(packet.destination_tag)
        if not state.settings.bridge or packet.is_bridged or path.via or target is None or target is sender:
            return False
        if target.path.via or target.path.carrier == path.carrier:
            return False
        if not target.is_online:
            state.counters["bridge_offline"] += 1
        else:
            self._pass(data, target.path, packet, now=now)
        return True

    def broadcast(self, data: bytes | memoryview, packet: Dissection, sender: Peer, path: Path, *, now: float) -> None:
        """Pass on a broadcast with messages to every other carrier where its sender is not heard, once."""
        state = self._state
        if not state.settings.bridge or packet.is_bridged or path.via or not packet.fragments:
            return
        key = packet.epoch, packet.packet_number
        if key in self._passed:
            return
        self._passed[key] = None
        if len(self._passed) > REMEMBERED_BROADCASTS:
            del self._passed[next(iter(self._passed))]
        for index in state.carriers:
            is_wanted = any(peer.path.carrier == index for peer in self._others(path.carrier))
            if not is_wanted or _is_heard(sender, index, now=now):
                continue
            if not self._links.is_told_by_lesser(sender.session.tag, index, now=now):
                for way in state.broadcast_paths(state.carriers[index]):
                    self._pass(data, way, packet, now=now)

    def _others(self, carrier: int) -> list[Peer]:
        """Return the peers that this node hears itself and that are reached on another carrier than this one."""
        peers = self._state.peers.values()
        return [p for p in peers if p.is_online and not p.path.via and p.path.carrier != carrier]

    def _pass(self, data: bytes | memoryview, path: Path, packet: Dissection, *, now: float) -> None:
        state = self._state
        carrier = state.carriers.get(path.carrier)
        if carrier is None or len(data) > carrier.mtu_bytes:
            state.counters["bridge_too_large"] += 1
            return
        state.counters["bridge_passed"] += 1
        datagram = Datagram(path, mark_bridged(data), 0, _priority(packet))
        if not carrier.rate_bps:
            self._at_once.append(datagram)
            return
        queue = self._queues.setdefault(path.carrier, BridgeQueue(carrier.rate_bps))
        state.counters["bridge_dropped"] += queue.push(datagram, now=now)

    # -- when it leaves

    def datagrams(self, own_priority: Callable[[int], int | None], *, now: float) -> list[Datagram]:
        """Return what leaves now; ``own_priority``: told a carrier, of what this node itself would send there now."""
        out, self._at_once = self._at_once, []
        for index, queue in self._queues.items():
            self._state.counters["bridge_dropped"] += queue.forget_stale(now=now)
            carrier = self._state.carriers.get(index)
            if carrier is None or carrier.busy_until_s > now or queue.head_priority is None:
                continue
            own = own_priority(index)
            is_own_turn = self._own_turn.get(index, False)
            if own is not None and (own < queue.head_priority or (own == queue.head_priority and is_own_turn)):
                self._own_turn[index] = False
                continue
            self._own_turn[index] = True
            datagram = queue.pop()
            carrier.on_sent(len(datagram.data), now=now)
            out.append(datagram)
        return out

    def next_timer(self, *, now: float) -> float | None:
        """Return when something may leave."""
        if self._at_once:
            return now
        carriers, queues = self._state.carriers, self._queues
        times = [carriers[i].busy_until_s for i, q in queues.items() if i in carriers and q.head_priority is not None]
        return min(times, default=None)

    # -- what it tells

    def reaches(self, tag: int, path: Path) -> bool:
        """Whether a node that is behind this path is told of the node with this tag."""
        target = self._state.peer_of_tag(tag)
        return target is not None and target in self._others(path.carrier)

    def link_frames(self, carrier: int, room_bytes: int, *, now: float) -> bytes:
        """Return frames for one carrier that say who is on the others; where rates are known, little at a time."""
        by_carrier: dict[int, list[int]] = {}
        for peer in self._others(carrier):
            if not _is_heard(peer, carrier, now=now):
                by_carrier.setdefault(peer.path.carrier, []).append(peer.session.tag)
        least_bytes = len(by_carrier) * (LINK_HEAD.size + TAG.size)
        if self._state.carriers[carrier].rate_bps:
            room_bytes = min(room_bytes, max(PROBE_BYTES // 2, least_bytes))
        if not by_carrier or room_bytes < least_bytes:
            return b""
        limit = min(_MAX_TAGS, (room_bytes // len(by_carrier) - LINK_HEAD.size) // TAG.size)
        return b"".join(self._link_frame(carrier, index, tags, limit) for index, tags in by_carrier.items())

    def _link_frame(self, told: int, index: int, tags: list[int], limit: int) -> bytes:
        start = self._turn.get((told, index), 0) % len(tags)
        chosen = (tags[start:] + tags[:start])[:limit]
        self._turn[told, index] = start + len(chosen)
        carrier = self._state.carriers[index]
        number = self._numbers.get(index)
        if number is None:
            number = self._numbers[index] = next(self._next_number) % 256
        rounds = -(-len(tags) // limit)
        return encode_link(Link(number, carrier.mtu_bytes, int(carrier.rate_bps), rounds, tuple(chosen)))


def _is_heard(peer: Peer, carrier: int, *, now: float) -> bool:
    stale_s = max(STALE_AT_LEAST_S, STALE_BEACONS * peer.beacon_interval_s)
    return peer.paths.heard_on(carrier, since_s=now - stale_s)


def _priority(packet: Dissection) -> int:
    if packet.fragments:
        return min(fragment.priority for fragment in packet.fragments)
    return CONTROL_PRIORITY if packet.acks else LEAST_PRIORITY
