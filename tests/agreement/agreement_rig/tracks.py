"""What came of a cell's frames: arrivals at one receiver in one phase, and the series behind the figures. Pure."""

from __future__ import annotations

from array import array
from collections.abc import Iterable
from dataclasses import dataclass, field

from agreement_rig.cells import Cell

#: A frame that is delayed by less has been sent at once (every reordering cell delays by 10 ms or so).
AT_ONCE_S = 0.003


@dataclass(slots=True)
class Track:
    """Arrivals in the order of their arrival, of ``frames`` frames that were sent; numbers count from 0 in a phase."""

    frames: int
    numbers: array[int] = field(default_factory=lambda: array("l"))
    delays_s: array[float] = field(default_factory=lambda: array("d"))
    arrived_s: array[float] = field(default_factory=lambda: array("d"))
    corrupted: array[int] = field(default_factory=lambda: array("b"))

    def add(self, number: int, sent_s: float, delay_s: float, corrupted: bool) -> None:
        """Note one arrival."""
        self.numbers.append(number)
        self.delays_s.append(delay_s)
        self.arrived_s.append(sent_s + delay_s)
        self.corrupted.append(corrupted)

    def without_first(self, skip: int) -> Track:
        """The track of the frames from number ``skip`` on."""
        if not skip:
            return self
        rest = Track(self.frames - skip)
        for number, delay_s, arrived_s, corrupted in zip(
            self.numbers, self.delays_s, self.arrived_s, self.corrupted, strict=True
        ):
            if number >= skip:
                rest.add(number - skip, arrived_s - delay_s, delay_s, bool(corrupted))
        return rest


#: [phase][receiver]
Tracks = list[list[Track]]


def empty(cell: Cell) -> Tracks:
    """Tracks of a cell before its first frame."""
    return [[Track(cell.frames) for _ in range(cell.receivers)] for _ in cell.phases]


Series = bytearray  # one small number per frame sent


def arrivals(track: Track) -> Series:
    """How often each frame arrived (at most 255)."""
    counts = bytearray(track.frames)
    for number in track.numbers:
        counts[number] += 1
    return counts


def lost(track: Track) -> Series:
    """1 for each frame that never arrived."""
    return bytearray(not count for count in arrivals(track))


def copies(track: Track) -> Series:
    """Arrivals beyond the first."""
    return bytearray(max(0, count - 1) for count in arrivals(track))


def corrupted(track: Track) -> Series:
    """1 for each frame of which some arrival was not what was sent."""
    return _marked(track, map(bool, track.corrupted))


def at_once(track: Track) -> Series:
    """1 for each frame that was delayed by less than ``AT_ONCE_S``."""
    return _marked(track, (delay_s < AT_ONCE_S for delay_s in track.delays_s))


def burst_starts(gone: Series) -> Series:
    """1 for each lost frame whose predecessor arrived."""
    return bytearray(here and not before for before, here in zip(b"\1" + gone[:-1], gone, strict=True))


def single_losses(gone: Series) -> Series:
    """1 for each lost frame between two that arrived."""
    around = zip(b"\1" + gone[:-1], gone, gone[1:] + b"\1", strict=True)
    return bytearray(here and not before and not after for before, here, after in around)


def both(one: Series, other: Series) -> Series:
    """1 where both series have one."""
    return bytearray(map(int.__and__, one, other))


def lag_one(track: Track) -> float:
    """Correlation of the delays of frames sent one after the other."""
    delays = dict(zip(track.numbers, track.delays_s, strict=True))
    mean = sum(delays.values()) / len(delays)
    products = [(delays[k] - mean) * (delays[k + 1] - mean) for k in delays if k + 1 in delays]
    variance = sum((delay - mean) ** 2 for delay in delays.values()) / len(delays)
    return sum(products) / len(products) / variance


def rate_bps(track: Track, size_bytes: int) -> float:
    """Bits per second that arrived, from the first arrival to the last."""
    span_s = max(track.arrived_s) - min(track.arrived_s)
    return (len(track.numbers) - 1) * size_bytes * 8 / span_s


def _marked(track: Track, marks: Iterable[bool]) -> Series:
    series = bytearray(track.frames)
    for number, mark in zip(track.numbers, marks, strict=True):
        if mark:
            series[number] = 1
    return series
