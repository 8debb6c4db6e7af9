"""zstd for topics with ``compress = true``. The package zstandard is loaded with the first message that needs it."""

from __future__ import annotations

import importlib.util

from udp_mesh.core.settings import MAX_MESSAGE_BYTES

MIN_BYTES = 128
_LEVEL = 1  # about 400 MB/s: the daemon's loop waits for it
_WORTH = 0.95


def is_available() -> bool:
    """Whether the package zstandard is installed."""
    return importlib.util.find_spec("zstandard") is not None


def compress(payload: bytes | memoryview) -> bytes | None:
    """Return one zstd frame that knows its size; None if that would save less than a twentieth."""
    if len(payload) < MIN_BYTES:
        return None
    import zstandard

    packed = zstandard.ZstdCompressor(level=_LEVEL, write_content_size=True).compress(payload)
    return packed if len(packed) < _WORTH * len(payload) else None


def decompress(packed: bytes | memoryview, original_bytes: int) -> bytes | None:
    """Return what was compressed; None if it is damaged, or larger than it says, or zstandard is missing."""
    if original_bytes > MAX_MESSAGE_BYTES or not is_available():
        return None
    import zstandard

    try:
        if zstandard.frame_content_size(packed) != original_bytes:
            return None
        return zstandard.ZstdDecompressor().decompress(packed, max_output_size=original_bytes)
    except zstandard.ZstdError:
        return None
