"""Whether two runs with the same seed did the same to every single frame. Pure."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from agreement_rig.tracks import Track, Tracks


@dataclass(frozen=True, slots=True)
class Fates:
    """``receptions``: frames times receivers. ``delay_s``: the largest difference among those that fared alike."""

    receptions: int
    differing: int
    delay_s: float


def compare(one: Iterable[Tracks], other: Iterable[Tracks]) -> Fates:
    """Compare how often each frame arrived, whether changed, and when."""
    receptions = differing = 0
    largest_s = 0.0
    for a, b in ((x, y) for c, d in zip(one, other, strict=True) for x, y in _tracks(c, d)):
        fates_a, fates_b = _fates(a), _fates(b)
        receptions += a.frames
        for number in fates_a.keys() | fates_b.keys():
            fate_a, fate_b = sorted(fates_a.get(number, [])), sorted(fates_b.get(number, []))
            if [changed for changed, _ in fate_a] == [changed for changed, _ in fate_b]:
                largest_s = max([largest_s, *(abs(p - q) for (_, p), (_, q) in zip(fate_a, fate_b, strict=True))])
            else:
                differing += 1
    return Fates(receptions, differing, largest_s)


def _tracks(one: Tracks, other: Tracks) -> Iterable[tuple[Track, Track]]:
    return ((a, b) for p, q in zip(one, other, strict=True) for a, b in zip(p, q, strict=True))


def _fates(track: Track) -> dict[int, list[tuple[int, float]]]:
    fates: dict[int, list[tuple[int, float]]] = {}
    for number, changed, delay_s in zip(track.numbers, track.corrupted, track.delays_s, strict=True):
        fates.setdefault(number, []).append((changed, delay_s))
    return fates
