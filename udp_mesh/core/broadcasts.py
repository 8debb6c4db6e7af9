"""Datagrams without acknowledgement: broadcasts, one per carrier or one per fixed neighbour, and words to strangers."""

from __future__ import annotations

from collections.abc import Callable

from udp_mesh.core import wire
from udp_mesh.core.carriers import MAX_BROADCAST_WAIT_S, Path
from udp_mesh.core.datagram import Datagram
from udp_mesh.core.state import NodeState


def _nothing(_carrier: int, _room_bytes: int) -> bytes:
    return b""


class Broadcasts:
    """This node's broadcasts, which have a series of numbers of their own."""

    def __init__(self, state: NodeState) -> None:
        self._state = state
        self.next_number = 0

    def data(self, frames: bytes, *, priority: int, now: float) -> list[Datagram]:
        """Return a message's one datagram for all."""
        return self._datagrams(frames, _nothing, priority, is_control=False, now=now)

    def control(self, frames: bytes, further: Callable[[int, int], bytes] = _nothing, *, now: float) -> list[Datagram]:
        """Return beacons, probes and the like, for carriers of known rate only a part of what those carry.

        ``further``: told a carrier's number and the room there in bytes, returns frames for that carrier alone.
        """
        return self._datagrams(frames, further, 0, is_control=True, now=now)

    def _datagrams(
        self,
        frames: bytes,
        further: Callable[[int, int], bytes],
        priority: int,
        *,
        is_control: bool,
        now: float,
    ) -> list[Datagram]:
        state = self._state
        header = wire.encode_header(
            epoch=state.epoch, destination_tag=0, packet_number=self.next_number, flags=wire.FLAG_UNNUMBERED
        )
        self.next_number += 1
        out: list[Datagram] = []
        for index, carrier in state.carriers.items():
            paths = state.broadcast_paths(carrier)
            if not paths:
                continue
            if carrier.busy_until_s > now + MAX_BROADCAST_WAIT_S:
                state.counters["broadcasts_too_late"] += 1
                continue
            if is_control and not carrier.takes_control(now=now):
                continue
            data = header + frames
            data += further(index, state.packet_bytes(paths[0]) - len(data))
            size_bytes = len(paths) * len(data)
            if is_control:
                carrier.on_control(size_bytes, now=now)
            carrier.on_sent(size_bytes, now=now)
            out += [Datagram(path, data, 0, priority) for path in paths]
        return out

    def stray(self, path: Path, tag: int, frames: bytes) -> Datagram:
        """Return a unicast to somebody with whom there is no session; it is never acknowledged."""
        header = wire.encode_header(
            epoch=self._state.epoch, destination_tag=tag, packet_number=wire.MAX_NUMBER, flags=wire.FLAG_UNNUMBERED
        )
        return Datagram(path, header + frames)
