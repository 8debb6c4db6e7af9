"""Messages that are longer than a datagram: cut into parts, and put together again as far as they arrived.

A *sliced* type is cut at one of its arrays: each part is a whole message with a slice of that array, behind the place
of its first element and the whole array's length. Missing slices leave a gap that the receiver sees; the rest is
useful. Every other type is cut through its encoded bytes, and of those all parts are needed.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

import msgspec

from rose.core.types import AnyMessage, Message, decode_message, decode_plain, encode_message, info_of, known_type
from rose.core.wire import PARTS_MAX
from rose.errors import RoseError, TypeMismatchError

_SLICE = struct.Struct("!II")  # place of the slice's first element, elements of the whole array
SLICE_BYTES = _SLICE.size
#: A sliced array longer than this is refused: one forged number must not make a receiver allocate gigabytes.
ELEMENTS_MAX = 1 << 20


@dataclass(frozen=True, slots=True)
class Cut:
    """An encoded message, ready to be sent part by part."""

    payloads: tuple[bytes, ...]
    is_sliced: bool


@dataclass(frozen=True, slots=True)
class Assembled:
    """A message as far as it arrived. ``missing``: ranges [first, end) of its sliced array that hold no data."""

    message: Message
    completeness: float
    missing: tuple[tuple[int, int], ...] = ()


def cut(message: Message, *, part_bytes: int) -> Cut:
    """Encode a message and cut it into parts of at most ``part_bytes`` (at least 64).

    Raises:
        RoseError: It is longer than 4096 parts, or one element of its sliced array is longer than a part.
    """
    whole = encode_message(message)
    sliced = info_of(type(message)).sliced
    if len(whole) <= part_bytes - (SLICE_BYTES if sliced else 0):
        return Cut((_slice_head(message, sliced) + whole,), sliced is not None)
    payloads = (
        _slices(message, sliced, part_bytes)
        if sliced
        else [whole[at : at + part_bytes] for at in range(0, len(whole), part_bytes)]
    )
    if len(payloads) > PARTS_MAX:
        raise RoseError(f"the message has {len(whole)} bytes, {len(payloads)} parts; at most {PARTS_MAX} can be sent")
    return Cut(tuple(payloads), sliced is not None)


def assemble(parts: Sequence[bytes | None], cls: type[Message], identity: bytes, *, is_sliced: bool) -> Assembled:
    """Put a message together from its parts in order; None stands for those that did not arrive.

    Args:
        parts: Payloads.
        cls: What it is; :class:`AnyMessage` for whatever its header says.
        identity: The header's ``type_id``.
        is_sliced: Whether each part holds a slice.

    Raises:
        TypeMismatchError: The parts do not make such a message, or too few arrived to say anything.
    """
    if cls is AnyMessage:
        info = known_type(identity)
        if info is None:
            return _assemble_plain(parts, identity, is_sliced=is_sliced)
        cls = info.cls
    if not is_sliced:
        return Assembled(decode_message(_joined(parts), cls), 1.0)
    slices = sorted((_read_slice(cls, part) for part in parts if part is not None), key=lambda read: read.first)
    if not slices:
        raise TypeMismatchError("nothing of it arrived")
    return _merge(cls, slices)


def _joined(parts: Sequence[bytes | None]) -> bytes:
    if None in parts:
        raise TypeMismatchError("not all of it arrived")
    return b"".join(part for part in parts if part is not None)


def _assemble_plain(parts: Sequence[bytes | None], identity: bytes, *, is_sliced: bool) -> Assembled:
    """Slices of an unknown type stay apart, for nobody knows which of its fields was cut."""
    if not is_sliced:
        return Assembled(AnyMessage(decode_plain(_joined(parts)), identity), 1.0)
    slices = [decode_plain(part[SLICE_BYTES:]) for part in parts if part is not None]
    value = slices[0] if len(parts) == 1 and slices else slices
    return Assembled(AnyMessage(value, identity), len(slices) / len(parts))


@dataclass(frozen=True, slots=True)
class _Slice:
    first: int
    total: int
    message: Message


def _slice_head(message: Message, sliced: str | None) -> bytes:
    return _SLICE.pack(0, len(getattr(message, sliced))) if sliced else b""


def _slices(message: Message, sliced: str, part_bytes: int) -> list[bytes]:
    """Cut so that every part fits: by the mean size first, halving what turns out too long."""
    elements = getattr(message, sliced)
    total = len(elements)
    room = part_bytes - SLICE_BYTES
    empty = len(encode_message(_with(message, sliced, elements[:0]))) + 4
    if empty >= room or not total:
        raise RoseError(f"without its '{sliced}' the message has {empty} bytes already; {room} fit into a datagram")
    size = max(1, int(total * (room - empty) / (len(encode_message(message)) - empty + 1)))
    payloads, first = [], 0
    while first < total:
        count = min(size, total - first)
        body = encode_message(_with(message, sliced, elements[first : first + count]))
        while len(body) > room:
            if count == 1:
                raise RoseError(f"element {first} of '{sliced}' is longer than a datagram ({len(body)} bytes)")
            count = max(1, count * 3 // 4)
            body = encode_message(_with(message, sliced, elements[first : first + count]))
        payloads.append(_SLICE.pack(first, total) + body)
        first += count
    return payloads


def _read_slice(cls: type[Message], payload: bytes) -> _Slice:
    if len(payload) < SLICE_BYTES:
        raise TypeMismatchError("a slice is cut short")
    first, total = _SLICE.unpack_from(payload)
    message = decode_message(payload[SLICE_BYTES:], cls)
    if total > ELEMENTS_MAX or first + len(_elements(message)) > total:
        raise TypeMismatchError("a slice lies outside its array")
    return _Slice(first, total, message)


def _merge(cls: type[Message], slices: list[_Slice]) -> Assembled:
    """Slices in the order of their place become one message; gaps are filled with the array's own nothing."""
    total = slices[0].total
    filler = _filler(slices)
    elements: list[object] = []
    missing: list[tuple[int, int]] = []
    for part in slices:
        if part.total != total or part.first < len(elements):
            raise TypeMismatchError("slices of different messages")
        if part.first > len(elements):
            missing.append((len(elements), part.first))
            elements += [filler] * (part.first - len(elements))
        elements += _elements(part.message)
    if len(elements) < total:
        missing.append((len(elements), total))
        elements += [filler] * (total - len(elements))
    lost = sum(end - first for first, end in missing)
    sliced = info_of(cls).sliced
    assert sliced is not None
    kind = type(getattr(slices[0].message, sliced))
    message = _with(slices[0].message, sliced, kind(elements))
    return Assembled(message, 1.0 - lost / total if total else 1.0, tuple(missing))


def _filler(slices: Sequence[_Slice]) -> object:
    """What stands where nothing arrived: NaN among floats, else None; :attr:`Assembled.missing` tells for sure."""
    for part in slices:
        for element in _elements(part.message)[:1]:
            return float("nan") if isinstance(element, float) else None
    return None


def _elements(message: Message) -> list[object]:
    sliced = info_of(type(message)).sliced
    if sliced is None:
        raise TypeMismatchError(f"{info_of(type(message)).name} is not sliced here, but was by its sender")
    return list(getattr(message, sliced))


def _with(message: Message, field: str, value: object) -> Message:
    return msgspec.structs.replace(message, **{field: value})
