"""Numbers and sentences as the panels write them. Pure."""

from __future__ import annotations

from textwrap import wrap


def counted(count: int, what: str) -> str:
    """A number of things."""
    return f"{count} {what}{'' if count == 1 else 's'}"


def ms(value_s: float | None) -> str:
    """A time in milliseconds, from a second on in seconds."""
    if value_s is None:
        return "-"
    return f"{value_s * 1e3:.1f} ms" if value_s < 1 else f"{value_s:.1f} s"


def rate(value_bps: float | None) -> str:
    """A rate."""
    if not value_bps:
        return "-"
    for unit, factor in (("Gbit/s", 1e9), ("Mbit/s", 1e6), ("kbit/s", 1e3)):
        if value_bps >= factor:
            return f"{value_bps / factor:.3g} {unit}"
    return f"{value_bps:.0f} bit/s"


def size(value_bytes: float) -> str:
    """A size."""
    for unit, factor in (("MB", 1e6), ("kB", 1e3)):
        if value_bytes >= factor:
            return f"{value_bytes / factor:.3g} {unit}"
    return f"{value_bytes:.0f} B"


def wrapped(sentence: str, width: int, *, indent: int) -> list[str]:
    """In lines of at most ``width`` cells, all of them indented."""
    space = " " * indent
    return wrap(sentence, max(indent + 8, width), initial_indent=space, subsequent_indent=space)
