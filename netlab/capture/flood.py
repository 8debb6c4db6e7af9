"""What a frame of ``mesh: flood`` says, in one line, and where the frame inside it begins. Never raises on a frame."""

from __future__ import annotations

from netlab.flood.wire import ETHERTYPE, INNER_AT, Fault, decode

__all__ = ["ETHERTYPE", "describe", "inner_offset"]


def inner_offset(frame: bytes) -> int | None:
    """Where the whole Ethernet frame inside begins; None if there is none."""
    return None if isinstance(decode(frame), Fault) else INNER_AT


def describe(frame: bytes) -> str:
    """Say what the header is, or what is wrong with it."""
    header = decode(frame)
    if isinstance(header, Fault):
        return f"flood? ({header})"
    return f"flood of {header.originator.hex(':')} #{header.sequence} hop limit {header.hop_limit}"
