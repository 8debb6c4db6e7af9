"""Short texts about events, for people."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from netlab.medium.impairments import (
    FourStateLoss,
    GilbertElliottLoss,
    Impairment,
    PeriodicLoss,
    RandomLoss,
    TraceLoss,
)
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


def impairment_words(impairment: Impairment, keys: Iterable[str]) -> dict[str, str]:
    """Say in a file's words what an impairment is, for these words only.

    A rate that is not limited has no word: it becomes 1 Tbit/s, at which a frame takes no time that shows. Nor has a
    driver's own signal strength: it is left out.
    """
    said = {key: _WORDS[key](impairment) for key in keys}
    return {key: text for key, text in said.items() if text}


def _limit_text(impairment: Impairment) -> str:
    if impairment.limit_packets is not None:
        return str(impairment.limit_packets)
    return f"{impairment.limit_bytes}B"


def _loss_words(impairment: Impairment) -> str:
    match impairment.loss:
        case None:
            return "0%"
        case RandomLoss(loss_ratio, correlation):
            return f"{{ratio: {RATIO.format(loss_ratio)}, correlation: {RATIO.format(correlation)}}}"
        case GilbertElliottLoss(p, r, in_bad, in_good):
            values = {"p": p, "r": r, "1-h": in_bad, "1-k": in_good}
            return f"{{gemodel: {_flow(values)}}}"
        case FourStateLoss(p13, p31, p32, p23, p14):
            return f"{{state: {_flow({'p13': p13, 'p31': p31, 'p32': p32, 'p23': p23, 'p14': p14})}}}"
        case PeriodicLoss(every, offset):
            return f"{{periodic: {{every: {every}, offset: {offset}}}}}"
        case TraceLoss(pattern):
            return f"{{trace: [{', '.join(str(int(lost)) for lost in pattern)}]}}"


def _flow(ratios: dict[str, float]) -> str:
    return "{" + ", ".join(f"{key}: {RATIO.format(value)}" for key, value in ratios.items()) + "}"


def _chance(ratio: float, correlation: float, gap: int | None = None) -> str:
    text = f"ratio: {RATIO.format(ratio)}, correlation: {RATIO.format(correlation)}"
    return "{" + text + ("}" if gap is None else f", gap: {gap}}}")


_WORDS: dict[str, Callable[[Impairment], str]] = {
    "delay": lambda i: DURATION.format(i.delay_s),
    "jitter": lambda i: DURATION.format(i.jitter_s),
    "delay_correlation": lambda i: RATIO.format(i.delay_correlation),
    "distribution": lambda i: i.distribution.value,
    "loss": _loss_words,
    "duplicate": lambda i: _chance(i.duplicate_ratio, i.duplicate_correlation),
    "reorder": lambda i: _chance(i.reorder_ratio, i.reorder_correlation, i.reorder_gap),
    "corrupt": lambda i: _chance(i.corrupt_ratio, i.corrupt_correlation),
    "rate": lambda i: "1tbit" if i.rate_bps is None else RATE.format(i.rate_bps),
    "limit": _limit_text,
    "rssi": lambda i: "" if i.rssi_dbm is None else POWER.format(i.rssi_dbm),
}
