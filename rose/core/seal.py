"""Group keys: who has a service's key can read and check what it publishes, and nobody else. Pure.

Theory.
* Each service has keys (up to four), known to it and to its subscribers; the first seals, all open. A key is changed
  by adding the new one behind the old one everywhere, then putting it first at the sender, then removing the old one.
* A start of the service (its epoch) seals with a key derived from the group's key, its id and its epoch (HMAC-SHA-256),
  by ChaCha20-Poly1305 (RFC 8439) with the header authenticated. The nonce counts that start's datagrams: none is used
  twice as long as a service's clock does not repeat a nanosecond across its starts.
* The number that makes the nonce stands behind the header. A receiver takes each number of an epoch once, and none of
  an epoch older than the newest believed.
* Multicast is one-way, so a receiver cannot ask a stranger whether it is alive. What speaks for the first datagram of
  an unknown epoch is its time: further than ``fresh_s`` from the receiver's clock, it may be a recording and is
  dropped. Hosts whose clocks differ by more need a larger ``fresh_s``; freshly started subscribers then believe
  recordings of that age. A subscriber that has heard the sender since does not.
* Whoever has the key can also speak as the service: keys are shared, not signed.

Needs the package ``cryptography``; only services that have a key import this module.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import ChaCha20Poly1305

from rose.core.addressing import ServiceId
from rose.core.keys import KeyRing, epoch_key, key_id
from rose.core.wire import HEADER_BYTES, SEAL_BYTES, Fault, Header
from udp_mesh.core.replay import ReplayWindow

_NUMBER = struct.Struct("!Q")
_NONCE = struct.Struct("!IQ")


def _by_id(keys: Sequence[bytes]) -> dict[int, bytes]:
    return {key_id(key): key for key in reversed(keys)}


def _cipher(key: bytes, sender: ServiceId, epoch_ns: int) -> ChaCha20Poly1305:
    return ChaCha20Poly1305(epoch_key(key, sender, epoch_ns))


class Sealer:
    """Seals what one service sends in one start."""

    def __init__(self, sender: ServiceId, epoch_ns: int, keys: Sequence[bytes]) -> None:
        """``keys``: at least one of 32 bytes; the first seals."""
        self._sender, self._epoch_ns = sender, epoch_ns
        self._number = 0
        self.use(keys)

    def use(self, keys: Sequence[bytes]) -> None:
        """Change the keys; numbers go on."""
        self.key_id = key_id(keys[0])
        self._own = _cipher(keys[0], self._sender, self._epoch_ns)

    def seal(self, header: bytes, payload: bytes) -> bytes:
        """Return the datagram; ``header`` is encoded with the flag SEALED and :attr:`key_id`."""
        number = _NUMBER.pack(self._number)
        sealed = self._own.encrypt(_NONCE.pack(0, self._number), payload, header + number)
        self._number += 1
        return header + number + sealed


class Opener:
    """Opens what the senders seal whose keys are known; bounded by the number of those senders."""

    def __init__(self, keys: KeyRing, *, fresh_s: float = 60.0) -> None:
        """``fresh_s``: how old, by this host's clock, the first datagram of a start may be."""
        self._fresh_ns = round(fresh_s * 1e9)
        self._believed: dict[ServiceId, tuple[int, ReplayWindow]] = {}
        self._ciphers: dict[tuple[ServiceId, bytes], tuple[int, ChaCha20Poly1305]] = {}
        self.use(keys)

    def use(self, keys: KeyRing) -> None:
        """Change the keys; what was taken stays taken."""
        self._keys = {sender: _by_id(own) for sender, own in keys.by_service.items()}
        self._team = _by_id(keys.team)
        self._ciphers.clear()

    def expects(self, sender: ServiceId) -> bool:
        """Whether a sender's datagrams have to be sealed: it has a key here."""
        return bool(self._keys.get(sender, self._team))

    def open(self, header: Header, datagram: bytes, *, wall_ns: int) -> bytes | Fault:
        """Return the payload of a sealed datagram, or why it is not taken. Never raises.

        Args:
            header: What :func:`rose.core.wire.decode` read from ``datagram``.
            datagram: The whole of it.
            wall_ns: Nanoseconds since 1970 by this host's clock.
        """
        key = self._keys.get(header.sender, self._team).get(header.key_id)
        if key is None:
            return Fault.UNKNOWN_KEY
        if len(datagram) < HEADER_BYTES + SEAL_BYTES:
            return Fault.TRUNCATED
        (number,) = _NUMBER.unpack_from(datagram, HEADER_BYTES)
        epoch_ns, window = self._believed.get(header.sender, (0, ReplayWindow()))
        if header.epoch_ns < epoch_ns or (header.epoch_ns == epoch_ns and not window.is_new(number)):
            return Fault.REPLAYED
        payload = self._decrypt(key, header, number, datagram)
        if payload is None:
            return Fault.FORGED
        if header.epoch_ns > epoch_ns:
            if abs(wall_ns - header.published_ns) > self._fresh_ns:
                return Fault.STALE
            window = ReplayWindow()
            self._believed[header.sender] = (header.epoch_ns, window)
        window.take(number)
        return payload

    def _decrypt(self, key: bytes, header: Header, number: int, datagram: bytes) -> bytes | None:
        epoch_ns, cipher = self._ciphers.get((header.sender, key), (None, None))
        if cipher is None or epoch_ns != header.epoch_ns:
            cipher = _cipher(key, header.sender, header.epoch_ns)
        clear_bytes = HEADER_BYTES + _NUMBER.size
        try:
            payload = cipher.decrypt(_NONCE.pack(0, number), datagram[clear_bytes:], datagram[:clear_bytes])
        except InvalidTag:
            return None
        self._ciphers[header.sender, key] = (header.epoch_ns, cipher)
        return payload
