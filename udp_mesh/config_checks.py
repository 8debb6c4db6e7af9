"""What single values of a configuration have to be. A check returns the value or raises ValueError."""

from __future__ import annotations

from collections.abc import Callable
from enum import StrEnum
from importlib.util import find_spec

from udp_mesh.core import wire
from udp_mesh.core.keys import MAX_KEYS, parse_key
from udp_mesh.core.settings import BROADCAST_NAME
from udp_mesh.io import compression

Check = Callable[[object], object]


def number(low: float, high: float, *, whole: bool) -> Check:
    """Return a check for a number within bounds, bounds included."""

    def check(value: object) -> object:
        kinds = (int,) if whole else (int, float)
        if isinstance(value, bool) or not isinstance(value, kinds) or not low <= value <= high:
            raise ValueError(f"has to be a {'whole ' if whole else ''}number from {low:g} to {high:g}")
        return value if whole else float(value)

    return check


def boolean(value: object) -> object:
    """Check a switch."""
    if not isinstance(value, bool):
        raise ValueError("has to be true or false")
    return value


def compress(value: object) -> object:
    """Check a switch that needs zstandard."""
    if boolean(value) and not compression.is_available():
        raise ValueError("needs the package zstandard: pip install zstandard; without it, it has to be false")
    return value


def text(value: object) -> object:
    """Check a text."""
    if not isinstance(value, str):
        raise ValueError("has to be a text")
    return value


def name(value: object) -> object:
    """Check a node's name."""
    if not isinstance(value, str) or not 0 < len(value.encode()) <= wire.MAX_NAME_BYTES or not value.isprintable():
        raise ValueError(f"has to be a text of 1..{wire.MAX_NAME_BYTES} printable bytes")
    if value == BROADCAST_NAME:
        raise ValueError(f'cannot be "{BROADCAST_NAME}", which means every node')
    return value


def names(value: object) -> object:
    """Check a list of nodes' names."""
    if not isinstance(value, list):
        raise ValueError('has to be a list of names like ["base", "robot1"]')
    return tuple(name(entry) for entry in value)


def interfaces(value: object) -> object:
    """Check a list of interface names."""
    if not isinstance(value, list) or not all(isinstance(name, str) and 0 < len(name) < 16 for name in value):
        raise ValueError('has to be a list of interface names like ["wlan0"]')
    return tuple(value)


def key(value: object) -> object:
    """Check the team's key or keys; no message repeats them."""
    given: list[object] = value if isinstance(value, list) else [value]
    texts = [text for text in given if isinstance(text, str)]
    if not 0 < len(texts) <= MAX_KEYS or texts != given:
        raise ValueError(f"has to be a key of 64 hexadecimal digits in quotes, or a list of 1..{MAX_KEYS} of them")
    keys = tuple(parse_key(text) for text in texts)
    if find_spec("cryptography") is None:
        raise ValueError("needs the Python package cryptography; install it: pip install 'udp-mesh-lab[secure]'")
    return keys


def one_of(kind: type[StrEnum]) -> Check:
    """Return a check for one of the words of ``kind``."""

    def check(value: object) -> object:
        choices = [member.value for member in kind]
        if value not in choices:
            raise ValueError(f"has to be one of {', '.join(choices)}")
        return kind(str(value))

    return check
