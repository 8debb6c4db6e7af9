"""Short texts about events, for people."""

from __future__ import annotations

from netlab.scenario.events import MoveWords
from netlab.scenario.links import Ends
from netlab.scenario.quantities import DURATION, POWER, RATE, RATIO, SPEED
from netlab.scenario.words import Words


def path_name(ends: Ends) -> str:
    """`a-b` for both directions, `a->b` for one."""
    a, b = ends.ends
    return f"{a}-{b}" if ends.between is not None else f"{a}->{b}"


def move_text(move: MoveWords) -> str:
    """`move a to [3, 4]`, with the speed if it has one."""
    place = ", ".join(f"{value:g}" for value in move.to)
    speed = "" if move.speed_mps is None else f" at {SPEED.format(move.speed_mps)}"
    return f"move {move.node} to [{place}]{speed}"


def words_text(words: Words) -> str:
    """The given words with their values, as in a file: `delay 20ms, loss 5%`."""
    parts = []
    for key, value, dimension in (
        ("delay", words.delay_s, DURATION),
        ("jitter", words.jitter_s, DURATION),
        ("delay_correlation", words.delay_correlation, RATIO),
        ("rate", words.rate_bps, RATE),
        ("rssi", words.rssi_dbm, POWER),
    ):
        if value is not None:
            parts.append(f"{key} {dimension.format(value)}")
    if words.loss is not None:
        parts.append(f"loss {_loss_text(words)}")
    for key in ("duplicate", "reorder", "corrupt"):
        if (chance := getattr(words, key)) is not None:
            parts.append(f"{key} {RATIO.format(chance.ratio)}")
    if words.distribution is not None:
        parts.append(f"distribution {words.distribution}")
    if words.limit is not None:
        limit = words.limit
        parts.append(f"limit {limit.packets}" if limit.size_bytes is None else f"limit {limit.size_bytes}B")
    return ", ".join(parts)


def _loss_text(words: Words) -> str:
    loss = words.loss
    if loss is not None and loss.ratio is not None:
        return RATIO.format(loss.ratio)
    models = ("gemodel", "state", "periodic", "trace")
    return next(f"by {name}" for name in models if getattr(loss, name) is not None)
