"""Typed messages: how a Python class and the bytes on the wire belong together.

A type is a ``msgspec.Struct`` whose fields go as one MessagePack array, in the order of their definition. Its name and
version travel in every header. A newer version may only add fields at the end, with defaults: whoever knows less
ignores what it does not know, whoever knows more takes the defaults. So both directions keep working while a team is
updated robot by robot.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, TypeVar

import msgspec

from rose.errors import TypeMismatchError

_Type = TypeVar("_Type", bound="type[Message]")
_encoder = msgspec.msgpack.Encoder()


class Message(msgspec.Struct, array_like=True, frozen=True):
    """Base of all messages; give subclasses ``array_like=True, frozen=True`` too, and :func:`message` as decorator."""


@dataclass(frozen=True, slots=True)
class TypeInfo:
    """What the wire knows of a type. ``sliced``: name of the array that may be cut between datagrams, or None."""

    name: str
    version: int
    type_id: bytes
    sliced: str | None
    cls: type[Message]


_by_class: dict[type[Message], TypeInfo] = {}
_by_id: dict[bytes, TypeInfo] = {}


class AnyMessage(Message, array_like=True, frozen=True):
    """What stands for a message whose type this process does not know: its fields as plain values."""

    value: object
    type_id: bytes = b""


def type_id(name: str) -> bytes:
    """Return the four bytes that stand for a type's name in headers."""
    return hashlib.sha256(name.encode()).digest()[:4]


def message(name: str, *, version: int = 1, sliced: str | None = None) -> Any:
    """Register a class as the message type ``name``, such as ``@rose.message("laser_scan", sliced="ranges_m")``.

    Args:
        name: The same in every language and on every robot.
        version: 0..255; one more each time fields were added at the end.
        sliced: An array field: what is too long for one datagram is cut there, and each datagram is useful on its own.
            Without it, a message that is too long arrives whole or not at all.

    Raises:
        ValueError: Another class has that name, or ``sliced`` is none of its fields.
    """

    def register(cls: _Type) -> _Type:
        info = TypeInfo(name, version, type_id(name), sliced, cls)
        other = _by_id.get(info.type_id)
        if other is not None and (other.cls.__module__, other.cls.__qualname__) != (cls.__module__, cls.__qualname__):
            raise ValueError(f"message type '{name}': its name stands for {other.cls.__qualname__} ('{other.name}')")
        if sliced is not None and sliced not in cls.__struct_fields__:
            raise ValueError(f"message type '{name}': there is no field '{sliced}' to slice")
        if not 0 <= version <= 255:
            raise ValueError(f"message type '{name}': version {version} is impossible; it is 0 to 255")
        _by_class[cls] = _by_id[info.type_id] = info
        return cls

    return register


def info_of(cls: type[Message]) -> TypeInfo:
    """Return what was registered for a class.

    Raises:
        TypeMismatchError: Nothing was.
    """
    try:
        return _by_class[cls]
    except KeyError:
        raise TypeMismatchError(
            f"{cls.__qualname__} is no message type; decorate it with @rose.message(NAME)"
        ) from None


def known_type(identity: bytes) -> TypeInfo | None:
    """Return the registered type of a header's ``type_id``, if this process knows it."""
    return _by_id.get(identity)


def known_names() -> Iterable[str]:
    """Return the names of all registered types."""
    return sorted(info.name for info in _by_id.values())


def encode_message(value: Message) -> bytes:
    """Return the message as MessagePack."""
    return _encoder.encode(value)


def decode_message(payload: bytes | memoryview, cls: type[Message]) -> Message:
    """Return the message that ``payload`` holds.

    Raises:
        TypeMismatchError: It holds something else.
    """
    try:
        return _decoder(cls).decode(payload)
    except (msgspec.DecodeError, msgspec.ValidationError, UnicodeDecodeError, RecursionError) as error:
        raise TypeMismatchError(f"no {info_of(cls).name}: {error}") from None


def decode_plain(payload: bytes | memoryview) -> object:
    """Return the plain values in ``payload``, for people who do not have its type.

    Raises:
        TypeMismatchError: It is not MessagePack.
    """
    try:
        return _plain_decoder.decode(payload)
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError) as error:
        raise TypeMismatchError(f"not MessagePack: {error}") from None


def decode_any(payload: bytes | memoryview, identity: bytes) -> Message:
    """Return a message as its own type if this process knows it, else its plain values.

    Raises:
        TypeMismatchError: It is neither.
    """
    info = known_type(identity)
    return decode_message(payload, info.cls) if info else AnyMessage(decode_plain(payload), identity)


_plain_decoder: msgspec.msgpack.Decoder[object] = msgspec.msgpack.Decoder()
_decoders: dict[type[Message], msgspec.msgpack.Decoder[Message]] = {}


def _decoder(cls: type[Message]) -> msgspec.msgpack.Decoder[Message]:
    decoder = _decoders.get(cls)
    if decoder is None:
        decoder = _decoders[cls] = msgspec.msgpack.Decoder(cls)
    return decoder
