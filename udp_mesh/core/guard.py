"""Stands between the carriers and the protocol of a node that has a key: seals what leaves, opens what arrives.

Nothing in a datagram that does not open, was seen before, or may be a recording reaches the protocol.
"""

from __future__ import annotations

from collections.abc import Sequence

from udp_mesh.core import wire, wire_seal
from udp_mesh.core.datagram import Datagram
from udp_mesh.core.liveness import Liveness
from udp_mesh.core.packets import BadDatagram
from udp_mesh.core.peer import Path
from udp_mesh.core.receive import Receiver
from udp_mesh.core.seal import Seal
from udp_mesh.core.state import NodeState


class Guard:
    """The key's work for one core; see :mod:`udp_mesh.core.seal` for what is believed, and why."""

    def __init__(self, keys: Sequence[bytes], state: NodeState, receiver: Receiver, liveness: Liveness) -> None:
        self._seal = Seal(keys, epoch=state.epoch)
        self._state = state
        self._receiver = receiver
        self._liveness = liveness

    def use(self, keys: Sequence[bytes]) -> None:
        """Change the keys."""
        self._seal.use(keys)

    def seal(self, datagrams: list[Datagram]) -> list[Datagram]:
        """Return the same datagrams as they leave."""
        return [
            Datagram(
                path,
                self._seal.seal(data, segment_bytes or len(data), carrier=path.carrier),
                segment_bytes and segment_bytes + wire.SEAL_BYTES,
                priority,
            )
            for path, data, segment_bytes, priority in datagrams
        ]

    def burst(self, data: bytes | memoryview, segment_bytes: int, path: Path, *, now: float) -> None:
        """Take sealed datagrams of one length (the last may be shorter) that arrived together."""
        view = memoryview(data)
        plain: list[bytes] = []  # of believed senders, all as long as the first
        for at in range(0, len(view), segment_bytes):
            opened = self._open(view[at : at + segment_bytes], path, now=now)
            if opened is None:
                continue
            if self._state.settings.bridge:  # it may have to be passed on as it is
                self._receiver.datagram(opened, path, sealed=view[at : at + segment_bytes], now=now)
                continue
            if plain and len(opened) > len(plain[0]):
                self._pass(plain, path, now=now)
                plain = []
            plain.append(opened)
            if len(opened) < len(plain[0]):
                self._pass(plain, path, now=now)
                plain = []
        self._pass(plain, path, now=now)

    def _pass(self, plain: list[bytes], path: Path, *, now: float) -> None:
        if plain:
            self._receiver.burst(b"".join(plain), len(plain[0]), path, now=now)

    def _open(self, datagram: memoryview, path: Path, *, now: float) -> bytes | None:
        counters = self._state.counters
        header = wire_seal.decode_clear(datagram)
        if isinstance(header, BadDatagram):
            counters[f"bad_{header.value}"] += 1
            return None
        if header.epoch == self._state.epoch:
            counters["own_datagrams"] += 1  # our broadcasts come back
            return None
        opened = self._seal.open(header, datagram)
        if isinstance(opened, BadDatagram):
            counters[f"bad_{opened.value}"] += 1
            return None
        if opened.is_believed or self._is_proof(header.epoch, opened.data):
            return opened.data
        counters[f"bad_{BadDatagram.UNPROVEN.value}"] += 1
        self._liveness.introduce(header.epoch, path, ask=True, now=now)
        return None

    def _is_proof(self, epoch: int, data: bytes) -> bool:
        """Whether a datagram names this node's tag: then it was made after this node's start, and its sender runs."""
        packet, tag = wire.dissect(data), self._state.tag
        if packet is None:
            return False
        names_us = packet.destination_tag == tag or tag in packet.probes
        if names_us or any(tag in hello.heard for hello in packet.beacons):
            self._seal.believe(epoch)
            return True
        return False
