"""The team's key: every frame of a member is encrypted and authenticated (docs/wnet.md, "The seal").

Theory of operation.
* What follows the outer Ethernet header is encrypted (ChaCha20-Poly1305, RFC 8439); addresses, EtherType and the seal's
  own header are authenticated. Each hop opens and seals anew.
* Each start of a node seals with a key of its own, derived from the team's key and its epoch (HMAC-SHA-256); the nonce
  counts that start's frames: none is used twice.
* A counter is taken once from each member of a sender (sliding window). A recording of a sender's earlier start opens,
  but changes nothing but the table of who was heard: a link is used only once the neighbour's HELLO has named this
  node's present epoch, and acknowledged a probe.
"""

from __future__ import annotations

import hmac
import struct
from collections import OrderedDict
from collections.abc import Sequence
from typing import TYPE_CHECKING

from udp_mesh.core.replay import ReplayWindow
from wnet.core import wire
from wnet.core.events import Drop

if TYPE_CHECKING:
    from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305

_HEADER = struct.Struct("!BBHIIH")  # kind, key id, counter (48 bits), epoch, bytes after this (Ethernet pads)
_NONCE = struct.Struct("!IQ")
TAG_BYTES = 16
SEAL_BYTES = _HEADER.size + TAG_BYTES
_ADDRESSES_BYTES = wire.ETHERNET_BYTES
_MAX_SENDERS = 512


def key_id(key: bytes) -> int:
    """Return the byte that says which key sealed a frame; it gives nothing of the key away."""
    return hmac.digest(key, b"wnet 1 key id", "sha256")[0]


def epoch_key(key: bytes, epoch: int, node: bytes) -> bytes:
    """Return the 32 bytes with which one start of a member's node seals."""
    return hmac.digest(key, b"wnet 1 epoch" + epoch.to_bytes(4, "big") + node, "sha256")


class Seal:
    """One node's keys, its own counter and what it has seen of others."""

    def __init__(self, keys: Sequence[bytes], *, epoch: int) -> None:
        """``keys``: at least one, each of 32 bytes; the first seals, all open.

        Raises:
            ModuleNotFoundError: The package ``cryptography`` is missing.
        """
        from cryptography.exceptions import InvalidTag
        from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305

        self._cipher, self._invalid = ChaCha20Poly1305, InvalidTag
        self._keys = {key: key_id(key) for key in keys}
        self._sealing = keys[0]
        self._epoch = epoch & 0xFFFFFFFF
        self._counter = 0
        self._own: dict[bytes, ChaCha20Poly1305] = {}
        self._senders: OrderedDict[tuple[bytes, int], tuple[ChaCha20Poly1305, ReplayWindow]] = OrderedDict()

    def seal(self, head: bytes, body: bytes) -> bytes:
        """Return the sealed body of a frame with this Ethernet header; ``SEAL_BYTES`` longer."""
        self._counter += 1
        counter = self._counter
        fixed = (wire.SEALED, self._keys[self._sealing], counter >> 32, counter & 0xFFFFFFFF, self._epoch)
        header = _HEADER.pack(*fixed, len(body) + TAG_BYTES)
        source = head[6:12]
        cipher = self._own.get(source)
        if cipher is None:
            cipher = self._own[source] = self._cipher(epoch_key(self._sealing, self._epoch, source))
        return header + cipher.encrypt(_NONCE.pack(0, counter), body, head + header)

    def open(self, frame: bytes) -> bytes | Drop:
        """Return the body of a received frame as its sender built it, or why it is not believed. Never raises."""
        if len(frame) < _ADDRESSES_BYTES + 1 or frame[_ADDRESSES_BYTES] != wire.SEALED:
            return Drop.UNSEALED
        body_at = _ADDRESSES_BYTES + _HEADER.size
        if len(frame) < body_at + TAG_BYTES:
            return Drop.TOO_SHORT
        _kind, ident, high, low, epoch, length = _HEADER.unpack_from(frame, _ADDRESSES_BYTES)
        sealed = frame[body_at : body_at + length]
        counter, source = high << 32 | low, frame[6:12]
        known = self._senders.get((source, epoch))
        if known is not None and not known[1].is_new(counter):
            return Drop.REPLAYED
        keys = [key for key, known_id in self._keys.items() if known_id == ident]
        if not keys:
            return Drop.UNKNOWN_KEY
        for key in keys:
            cipher = self._cipher(epoch_key(key, epoch, source)) if known is None or len(keys) > 1 else known[0]
            try:
                body: bytes = cipher.decrypt(_NONCE.pack(0, counter), sealed, frame[:body_at])
            except self._invalid:
                continue
            self._take(source, epoch, counter, cipher)
            return body
        return Drop.FORGED

    def _take(self, source: bytes, epoch: int, counter: int, cipher: ChaCha20Poly1305) -> None:
        known = self._senders.get((source, epoch))
        if known is None:
            if len(self._senders) >= _MAX_SENDERS:
                self._senders.popitem(last=False)
            known = self._senders[source, epoch] = (cipher, ReplayWindow())
        else:
            self._senders.move_to_end((source, epoch))
        known[1].take(counter)
