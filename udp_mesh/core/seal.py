"""The team's key: authenticated encryption of every datagram, and what is believed of one that opens (docs/wire.md).

Theory of operation.
* A datagram's header travels in the clear and is authenticated; its frames are encrypted (ChaCha20-Poly1305, RFC 8439).
* Each start of a node encrypts with a key of its own, derived from the team's key and its epoch (HMAC-SHA-256 as a
  pseudo-random function). The nonce counts that start's datagrams over all its carriers: none is used twice.
* A number is taken once (:mod:`udp_mesh.core.replay`). There is a window for each carrier that the sender uses (its
  series), because a slow one lags behind a fast one by any number of datagrams.
* That alone would let a recording of an earlier day speak to a node that was restarted. So an epoch is believed only
  after one of its datagrams has named this node's tag, which is drawn at each start: until then it gets an introduction
  as answer and changes nothing. What was sealed before that datagram is never taken.
* Of several keys the first seals and all open, so that a team changes its key node by node without an interruption.

Only a node that has a key imports this module: it needs the package ``cryptography``.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305

from udp_mesh.core import wire, wire_seal
from udp_mesh.core.keys import epoch_key, key_id
from udp_mesh.core.packets import BadDatagram
from udp_mesh.core.replay import ReplayWindow
from udp_mesh.core.wire_seal import SealHeader

_LAST_SERIES = 255
_MAX_EPOCHS = 2048
_MAX_CLOSED = 65_536


class Opened(NamedTuple):
    """A datagram as its sender built it; ``is_believed``: its sender is known to run now."""

    data: bytes
    is_believed: bool


class _Sender:
    """An epoch that is believed: its ciphers by key, its windows by series."""

    __slots__ = ("ciphers", "first", "windows")

    def __init__(self, first: int) -> None:
        self.first = first  # number of the datagram that made it believed
        self.ciphers: dict[bytes, ChaCha20Poly1305] = {}
        self.windows: dict[int, ReplayWindow] = {}

    def is_new(self, header: SealHeader) -> bool:
        window = self.windows.get(header.series)
        return header.number >= self.first and (window is None or window.is_new(header.number))

    def take(self, header: SealHeader) -> None:
        window = self.windows.get(header.series)
        if window is None:
            window = self.windows[header.series] = ReplayWindow()
        window.take(header.number)


class Seal:
    """One node's keys, its own numbers and what it has seen of others."""

    def __init__(self, keys: Sequence[bytes], *, epoch: int) -> None:
        """``keys``: at least one, each of 32 bytes; the first seals."""
        self._epoch = epoch
        self._series: dict[int, int] = {}
        self._next_number = 0
        self._senders: dict[int, _Sender] = {}
        self._closed: dict[int, None] = {}  # believed once, forgotten for others: nothing of them is taken any more
        self._last: SealHeader | None = None
        self.use(keys)

    def use(self, keys: Sequence[bytes]) -> None:
        """Change the keys; numbers and windows go on."""
        self._ids = {key: key_id(key) for key in keys}
        self._own_id = key_id(keys[0])
        self._own = ChaCha20Poly1305(epoch_key(keys[0], self._epoch))
        for sender in self._senders.values():
            sender.ciphers = {key: cipher for key, cipher in sender.ciphers.items() if key in self._ids}

    def seal(self, datagrams: bytes, segment_bytes: int, *, carrier: int) -> bytes:
        """Seal what leaves by one carrier: datagrams of one length (the last may be shorter), one after the other.

        Each becomes ``wire.SEAL_BYTES`` longer.
        """
        series = self._series.setdefault(carrier, min(len(self._series), _LAST_SERIES))
        sealed: list[bytes] = []
        for number, at in enumerate(range(0, len(datagrams), segment_bytes), self._next_number):
            frames_at = at + wire.HEADER_BYTES
            clear = wire_seal.encode_clear(datagrams[at:frames_at], key_id=self._own_id, series=series, number=number)
            frames = datagrams[frames_at : at + segment_bytes]
            sealed += (clear, self._own.encrypt(wire_seal.nonce(number), frames, clear))
        self._next_number += len(sealed) // 2
        return b"".join(sealed)

    def open(self, header: SealHeader, datagram: memoryview) -> Opened | BadDatagram:
        """Return what a datagram was before it was sealed, or why it cannot be taken. Never raises."""
        sender = self._senders.get(header.epoch)
        if header.epoch in self._closed or (sender is not None and not sender.is_new(header)):
            return BadDatagram.REPLAYED
        keys = [key for key, ident in self._ids.items() if ident == header.key_id]
        frames = _decrypt(datagram, header, keys, sender)
        if frames is None:
            return BadDatagram.FORGED if keys else BadDatagram.UNKNOWN_KEY
        if sender is not None:
            sender.take(header)
            if len(self._senders) > _MAX_EPOCHS // 2:  # who is heard is not the first to be forgotten
                self._senders[header.epoch] = self._senders.pop(header.epoch)
        self._last = header
        return Opened(wire_seal.plain_header(datagram) + frames, sender is not None)

    def believe(self, epoch: int) -> None:
        """Note that the datagram opened last, which has this epoch, names this node's tag."""
        header = self._last
        if epoch in self._senders or header is None or header.epoch != epoch:
            return
        if len(self._senders) >= _MAX_EPOCHS:
            oldest = next(iter(self._senders))
            del self._senders[oldest]
            self._closed[oldest] = None
            if len(self._closed) > _MAX_CLOSED:
                del self._closed[next(iter(self._closed))]
        sender = self._senders[epoch] = _Sender(header.number)
        sender.take(header)


def _decrypt(datagram: memoryview, header: SealHeader, keys: list[bytes], sender: _Sender | None) -> bytes | None:
    clear, sealed = wire_seal.authenticated(datagram), datagram[wire_seal.CLEAR_BYTES :]
    for key in keys:
        cipher = None if sender is None else sender.ciphers.get(key)
        if cipher is None:
            cipher = ChaCha20Poly1305(epoch_key(key, header.epoch))
        try:
            frames = cipher.decrypt(wire_seal.nonce(header.number), sealed, clear)
        except InvalidTag:
            continue
        if sender is not None:
            sender.ciphers[key] = cipher
        return frames
    return None
