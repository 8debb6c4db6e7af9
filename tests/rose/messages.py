"""Message types of these tests, in two versions where that matters."""

from __future__ import annotations

import rose


@rose.message("test/scan", sliced="ranges_m")
class Scan(rose.Message, array_like=True, frozen=True):
    stamp_s: float
    ranges_m: list[float]


@rose.message("test/names", sliced="names")
class Names(rose.Message, array_like=True, frozen=True):
    names: list[str]


@rose.message("test/pose")
class Pose(rose.Message, array_like=True, frozen=True):
    x_m: float
    y_m: float


@rose.message("test/note")
class Note(rose.Message, array_like=True, frozen=True):
    text: str
