"""Which frames passed here already. Bounded: two generations, the older one is forgotten when the newer is full."""

from __future__ import annotations

GENERATION = 8192
"""Frames remembered at least: some seconds of 20 Mbit/s."""


class Seen:
    """The last 8192 to 16384 keys."""

    __slots__ = ("_newer", "_older")

    def __init__(self) -> None:
        self._newer: set[bytes] = set()
        self._older: set[bytes] = set()

    def add(self, key: bytes) -> bool:
        """Remember a key; return whether it is new."""
        if key in self._newer or key in self._older:
            return False
        if len(self._newer) >= GENERATION:
            self._older, self._newer = self._newer, set()
        self._newer.add(key)
        return True

    def __len__(self) -> int:
        return len(self._newer) + len(self._older)
