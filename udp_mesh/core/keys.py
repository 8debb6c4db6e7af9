"""The team's key: 32 bytes that every node is given, and what is derived from them. Pure hashing."""

from __future__ import annotations

import hmac

KEY_BYTES = 32
MAX_KEYS = 4


def parse_key(text: str) -> bytes:
    """Return the key that 64 hexadecimal digits stand for.

    Raises:
        ValueError: It is anything else. The message does not repeat the text.
    """
    try:
        key = bytes.fromhex(text)
    except ValueError:
        key = b""
    if len(key) != KEY_BYTES or len(text) != 2 * KEY_BYTES:
        raise ValueError("has to be 64 hexadecimal digits in quotes, such as `udp-mesh key` prints")
    return key


def key_id(key: bytes) -> int:
    """Return the byte that says in a datagram which key sealed it; it gives nothing of the key away."""
    return hmac.digest(key, b"udp_mesh 1 key id", "sha256")[0]


def epoch_key(key: bytes, epoch: int) -> bytes:
    """Return the 32 bytes with which the node that drew this epoch seals."""
    return hmac.digest(key, b"udp_mesh 1 epoch" + epoch.to_bytes(8, "big"), "sha256")
