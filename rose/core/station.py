"""One service's end of the protocol: messages in, datagrams out, and the other way round. Pure.

It keeps no connection: whoever publishes does not know who listens; whoever listens knows of a sender what its last
datagrams said. What is not understood is counted by reason and dropped.
"""

from __future__ import annotations

from collections import OrderedDict
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from rose.core.addressing import ServiceId
from rose.core.keys import KeyRing
from rose.core.parts import Cut, cut
from rose.core.reception import Reception, Sample
from rose.core.types import AnyMessage, Message, encode_message, info_of
from rose.core.wire import (
    DATAGRAM_BYTES_MAX,
    HEADER_BYTES,
    NO_FLAGS,
    SEAL_BYTES,
    Fault,
    Flag,
    Header,
    Kind,
    decode,
    encode,
)
from rose.errors import RoseError

if TYPE_CHECKING:
    from rose.core.seal import Opener, Sealer

#: Commands and answers whose parts are waited for at the same time, and the longest of them.
GATHERED_MAX = 64
COMMAND_BYTES_MAX = 256 * 1024


Frames = tuple[tuple[Header, bytes], ...]
"""The parts of one message, each with its header, not sealed yet."""


@dataclass(frozen=True, slots=True)
class Published:
    """Samples of a sender that this station listens to."""

    reception: Reception
    samples: list[Sample]


@dataclass(frozen=True, slots=True)
class Whole:
    """A command, an answer or an announcement with all its parts, not yet decoded."""

    header: Header
    payload: bytes


class Station:
    """See the module's text. ``faults`` counts what was dropped, by reason, beside the counters of each reception."""

    def __init__(
        self,
        sid: ServiceId,
        *,
        epoch_ns: int,
        keys: KeyRing | None = None,
        datagram_bytes: int = DATAGRAM_BYTES_MAX,
        fresh_s: float = 60.0,
    ) -> None:
        """Start a service's end.

        Args:
            sid: Its id.
            epoch_ns: Now, in ns since 1970; higher than at its last start.
            keys: Its group keys and those of whom it hears; None for none.
            datagram_bytes: The longest datagram to send, at least 256.
            fresh_s: See :class:`rose.core.seal.Opener`.

        Raises:
            RoseError: There are keys, but not the package ``cryptography``.
        """
        self.sid = sid
        self.faults: dict[Fault, int] = {}
        self._epoch_ns = epoch_ns
        self._part_bytes = datagram_bytes - HEADER_BYTES - SEAL_BYTES
        self._sequences = dict.fromkeys(Kind, -1)
        self._receptions: dict[ServiceId, Reception] = {}
        self._gathered: OrderedDict[tuple[ServiceId, int, Kind, int], list[bytes | None]] = OrderedDict()
        self._sealer: Sealer | None = None
        self._opener: Opener | None = None
        if keys:
            self._sealer, self._opener = _seal(sid, epoch_ns, keys, fresh_s)

    @property
    def is_sealed(self) -> bool:
        """Whether this service has a key of its own."""
        return self._sealer is not None

    # -- sending --------------------------------------------------------------------------------------------------

    def publish(self, message: Message, *, wall_ns: int, kind: Kind = Kind.PUBLICATION) -> list[bytes]:
        """Return the datagrams of a publication (or announcement), for the own group.

        Raises:
            RoseError: It is too long; TypeMismatchError: its class is not registered.
        """
        pieces = cut(message, part_bytes=self._part_bytes)
        return self.datagrams(self._frames(kind, self._next(kind), message, pieces, wall_ns, NO_FLAGS))

    def command(self, message: Message, to: ServiceId, *, wall_ns: int) -> tuple[int, Frames]:
        """Return a command's number and its frames, for the unicast address of ``to``."""
        number = self._next(Kind.COMMAND)
        payload = to.packed + encode_message(message)
        return number, self._whole(Kind.COMMAND, number, message, payload, wall_ns, NO_FLAGS)

    def answer(self, command: Header, message: Message, *, wall_ns: int, is_refusal: bool = False) -> Frames:
        """Return the frames of the answer to a command, for the unicast address of its sender."""
        payload = command.sender.packed + command.epoch_ns.to_bytes(8, "big") + encode_message(message)
        flags = Flag.REFUSED if is_refusal else NO_FLAGS
        return self._whole(Kind.ANSWER, command.sequence, message, payload, wall_ns, flags)

    def datagrams(self, frames: Frames) -> list[bytes]:
        """Return frames as datagrams, sealed anew each time: a repeated one must not look like a replay."""
        return [self._seal(header, payload) for header, payload in frames]

    # -- receiving ------------------------------------------------------------------------------------------------

    def subscribe(self, sender: ServiceId, cls: type[Message], *, partial_after_s: float = 0.1) -> Reception:
        """Listen to a sender. A second call for the same one starts anew."""
        if cls is not AnyMessage:
            info_of(cls)  # refuses what is no message type
        reception = self._receptions[sender] = Reception(sender, cls, partial_after_s=partial_after_s)
        return reception

    def unsubscribe(self, sender: ServiceId) -> None:
        """Listen to it no longer."""
        self._receptions.pop(sender, None)

    def receive(self, datagram: bytes, *, now: float, wall_ns: int) -> Published | Whole | None:
        """Take a datagram from any socket of the service. Never raises on bytes.

        Args:
            datagram: All of it.
            now: Monotonic seconds.
            wall_ns: Nanoseconds since 1970 by this host's clock.
        """
        header = decode(datagram)
        if isinstance(header, Fault):
            self._count(header)
            return None
        reception = self._receptions.get(header.sender)
        if header.kind is Kind.PUBLICATION and reception is None:
            self._count(Fault.NOT_FOR_US)
            return None
        payload = self._open(header, datagram, wall_ns)
        if isinstance(payload, Fault):
            self._count(payload)
            return None
        if header.kind is Kind.PUBLICATION and reception is not None:
            if reception.cls is not AnyMessage and header.type_id != info_of(reception.cls).type_id:
                self._count(Fault.OTHER_TYPE)
                return None
            return Published(reception, reception.receive(header, payload, now=now, wall_ns=wall_ns))
        whole = self._gather(header, payload)
        return None if whole is None else self._for_us(header, whole)

    def due(self, *, now: float, wall_ns: int) -> list[Published]:
        """Return the samples whose missing parts are no longer waited for."""
        found = [Published(r, r.due(now=now, wall_ns=wall_ns)) for r in self._receptions.values()]
        return [published for published in found if published.samples]

    def next_due(self) -> float | None:
        """When :meth:`due` next has something; None while nothing waits."""
        times = (reception.next_due() for reception in self._receptions.values())
        return min((at for at in times if at is not None), default=None)

    # -- inside ---------------------------------------------------------------------------------------------------

    def _next(self, kind: Kind) -> int:
        self._sequences[kind] += 1
        return self._sequences[kind]

    def _whole(self, kind: Kind, number: int, message: Message, payload: bytes, wall_ns: int, flags: Flag) -> Frames:
        if len(payload) > COMMAND_BYTES_MAX:
            raise RoseError(f"a command or answer of {len(payload)} bytes; at most {COMMAND_BYTES_MAX} can be sent")
        size = self._part_bytes
        parts = tuple(payload[at : at + size] for at in range(0, len(payload), size))
        return self._frames(kind, number, message, Cut(parts, is_sliced=False), wall_ns, flags)

    def _frames(self, kind: Kind, number: int, message: Message, pieces: Cut, wall_ns: int, flags: Flag) -> Frames:
        info = info_of(type(message))
        flags |= (Flag.SLICED if pieces.is_sliced else NO_FLAGS) | (Flag.SEALED if self._sealer else NO_FLAGS)
        key_id = self._sealer.key_id if self._sealer else 0
        first = Header(
            kind=kind,
            sender=self.sid,
            epoch_ns=self._epoch_ns,
            sequence=number,
            published_ns=wall_ns,
            type_id=info.type_id,
            type_version=info.version,
            flags=flags,
            key_id=key_id,
            parts=len(pieces.payloads),
        )
        return tuple((replace(first, part=part), payload) for part, payload in enumerate(pieces.payloads))

    def _seal(self, header: Header, payload: bytes) -> bytes:
        encoded = encode(header)
        return self._sealer.seal(encoded, payload) if self._sealer else encoded + payload

    def _open(self, header: Header, datagram: bytes, wall_ns: int) -> bytes | Fault:
        is_sealed = bool(header.flags & Flag.SEALED)
        if self._opener is None:
            return Fault.UNKNOWN_KEY if is_sealed else datagram[HEADER_BYTES:]
        if not is_sealed:
            # A service with a key takes orders from nobody without one; it may still listen to an open sensor.
            is_order = header.kind in (Kind.COMMAND, Kind.ANSWER) and self._sealer is not None
            return Fault.UNSEALED if is_order or self._opener.expects(header.sender) else datagram[HEADER_BYTES:]
        return self._opener.open(header, datagram, wall_ns=wall_ns)

    def _gather(self, header: Header, payload: bytes) -> bytes | None:
        """Return a command's or answer's payload once all its parts are here."""
        if header.parts == 1:
            return payload
        if header.parts * 64 > COMMAND_BYTES_MAX or header.flags & Flag.SLICED:
            self._count(Fault.MALFORMED)
            return None
        key = (header.sender, header.epoch_ns, header.kind, header.sequence)
        parts = self._gathered.setdefault(key, [None] * header.parts)
        if len(parts) != header.parts:
            self._count(Fault.MALFORMED)
            return None
        parts[header.part] = payload
        if len(self._gathered) > GATHERED_MAX:
            self._gathered.popitem(last=False)
        if None in parts:
            return None
        self._gathered.pop(key, None)
        return b"".join(part for part in parts if part is not None)

    def _for_us(self, header: Header, payload: bytes) -> Whole | None:
        """Commands and answers name whom they are for: ports may be shared, and groups reach many."""
        if header.kind is Kind.ANNOUNCEMENT:
            return Whole(header, payload)
        own = self.sid.packed + (self._epoch_ns.to_bytes(8, "big") if header.kind is Kind.ANSWER else b"")
        if payload[: len(own)] != own:
            self._count(Fault.NOT_FOR_US)
            return None
        return Whole(header, payload[len(own) :])

    def _count(self, fault: Fault) -> None:
        self.faults[fault] = self.faults.get(fault, 0) + 1


def _seal(sid: ServiceId, epoch_ns: int, keys: KeyRing, fresh_s: float) -> tuple[Sealer | None, Opener]:
    try:
        from rose.core.seal import Opener, Sealer
    except ImportError:
        raise RoseError("keys need the package cryptography: pip install 'udp-mesh-lab[secure]'") from None
    own = keys.of(sid)
    return Sealer(sid, epoch_ns, own) if own else None, Opener(keys, fresh_s=fresh_s)
