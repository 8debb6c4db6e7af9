"""Group keys as values: reading them, naming them, who has which. Pure hashing, no cipher."""

from __future__ import annotations

import hmac
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from rose.core.addressing import ServiceId
from udp_mesh.core.keys import KEY_BYTES, parse_key
from udp_mesh.core.keys import MAX_KEYS as KEYS_MAX

__all__ = ["KEYS_MAX", "KEY_BYTES", "KeyRing", "epoch_key", "key_id", "parse_key"]


def key_id(key: bytes) -> int:
    """Return the byte (1..255) that says in a header which key sealed it; it gives nothing of the key away."""
    return hmac.digest(key, b"rose 1 key id", "sha256")[0] or 1


def epoch_key(key: bytes, sender: ServiceId, epoch_ns: int) -> bytes:
    """Return the 32 bytes with which a service seals from one start to the next."""
    context = b"rose 1 epoch" + epoch_ns.to_bytes(8, "big") + str(sender).encode()
    return hmac.digest(key, context, "sha256")


@dataclass(frozen=True, slots=True)
class KeyRing:
    """The keys that a service was given: those of named services, and ``team`` for all others; () is no key."""

    by_service: Mapping[ServiceId, Sequence[bytes]] = field(default_factory=dict, repr=False)
    team: Sequence[bytes] = field(default=(), repr=False)

    def of(self, sid: ServiceId) -> Sequence[bytes]:
        """Return a service's keys, the one that seals first."""
        return self.by_service.get(sid, self.team)

    def __bool__(self) -> bool:
        return bool(self.team) or any(self.by_service.values())
