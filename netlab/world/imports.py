"""Motion from other programs' files: ns-2 `setdest`, BonnMotion `.movements`, and CSV. Text in, samples out.

Sources: the ns manual, chapter "Mobile Networking in ns" (node movements by `setdest`); the BonnMotion manual, section
"Trace files" (one line per node of `t x y` triples, `t x y z` by its 3-D models).
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from enum import StrEnum
from itertools import pairwise

from netlab.world.motion import Sampled

_CSV_PLACE = ("x", "y", "z")
#: The name of the node in a CSV file without a column for it.
ONLY_NODE = ""
_MOST_PROBLEMS = 20
_NUMBER = r"([-+0-9.eE]+)"
_INITIAL = re.compile(rf"\$node_\((\d+)\)\s+set\s+([XYZ])_\s+{_NUMBER}")
_SETDEST = re.compile(rf'\$\w+\s+at\s+{_NUMBER}\s+"\$node_\((\d+)\)\s+setdest\s+{_NUMBER}\s+{_NUMBER}\s+{_NUMBER}"')
#: Statements of ns-2 movement files that say nothing about motion: `$god_` distances, variables, comments.
_OTHER = re.compile(r'#|\$god_|\$\w+\s+at\s+[-+0-9.eE]+\s+"\$god_|set\s|puts\s')


class TraceFormat(StrEnum):
    """How a motion file is written."""

    NS2 = "ns2"
    BONNMOTION = "bonnmotion"
    BONNMOTION_3D = "bonnmotion_3d"
    CSV = "csv"


class TraceProblems(ValueError):
    """What is wrong with a motion file: one text per line of it, beginning with the line's number."""

    def __init__(self, problems: list[str]) -> None:
        super().__init__("\n".join(problems))
        self.problems = tuple(problems[:_MOST_PROBLEMS])


def read_motion(text: str, trace_format: TraceFormat) -> dict[str, Sampled]:
    """Return the motion of each node by its name in the file (its number, counted from 0, in ns-2 and BonnMotion).

    Raises:
        TraceProblems: Lines that make no sense.
    """
    match trace_format:
        case TraceFormat.NS2:
            return _read_ns2(text)
        case TraceFormat.BONNMOTION:
            return _read_bonnmotion(text, 2)
        case TraceFormat.BONNMOTION_3D:
            return _read_bonnmotion(text, 3)
        case TraceFormat.CSV:
            return _read_csv(text)


def _read_ns2(text: str) -> dict[str, Sampled]:
    problems: list[str] = []
    initial: dict[str, list[float]] = {}
    orders: dict[str, list[tuple[float, float, float, float]]] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        statement = line.strip()
        try:
            if match := _INITIAL.match(statement):
                place = initial.setdefault(match[1], [0.0, 0.0, 0.0])
                place["XYZ".index(match[2])] = _finite(match[3])
            elif match := _SETDEST.match(statement):
                at_s, x_m, y_m, speed_mps = (_finite(match[group]) for group in (1, 3, 4, 5))
                orders.setdefault(match[2], []).append((at_s, x_m, y_m, speed_mps))
            elif statement and not _OTHER.match(statement):
                raise ValueError('neither `$node_(0) set X_ 1.0` nor `$ns_ at 2.0 "$node_(0) setdest 5.0 6.0 1.5"`')
        except ValueError as error:
            problems.append(f"{number}: {error}")
    if problems:
        raise TraceProblems(problems)
    names = sorted({*initial, *orders}, key=int)
    return {name: _follow_orders(initial.get(name, [0.0, 0.0, 0.0]), orders.get(name, [])) for name in names}


def _follow_orders(place: list[float], orders: list[tuple[float, float, float, float]]) -> Sampled:
    """Each order starts the node from where it is then, straight to the goal at the speed given; speed 0 stops it."""
    x_m, y_m, z_m = place
    samples = [(0.0, (x_m, y_m, z_m))]
    ordered = sorted(orders, key=lambda order: order[0])
    ends = [*(order[0] for order in ordered), math.inf][1:]
    for (at_s, goal_x_m, goal_y_m, speed_mps), next_s in zip(ordered, ends, strict=True):
        samples.append((at_s, (x_m, y_m, z_m)))
        way_m = math.hypot(goal_x_m - x_m, goal_y_m - y_m)
        if speed_mps <= 0 or way_m == 0:
            continue
        share = min(1.0, (next_s - at_s) * speed_mps / way_m)
        x_m, y_m = x_m + share * (goal_x_m - x_m), y_m + share * (goal_y_m - y_m)
        samples.append((at_s + share * way_m / speed_mps, (x_m, y_m, z_m)))
    return _sampled(samples)


def _read_bonnmotion(text: str, dimensions: int) -> dict[str, Sampled]:
    problems: list[str] = []
    tracks: dict[str, Sampled] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        try:
            values = [_finite(word) for word in line.split()]
            tracks[str(len(tracks))] = _sampled(list(_chunks(values, dimensions + 1)))
        except ValueError as error:
            problems.append(f"{number}: {error}")
    if problems:
        raise TraceProblems(problems)
    return tracks


def _chunks(values: list[float], size: int) -> Iterator[tuple[float, tuple[float, ...]]]:
    times_s = values[::size]
    if len(values) % size or any(b <= a for a, b in pairwise(times_s)):
        raise ValueError(f"expected `{'t x y z'[: 2 * size - 1]}` again and again, with times that rise")
    for start in range(0, len(values), size):
        yield values[start], tuple(values[start + 1 : start + size])


def _read_csv(text: str) -> dict[str, Sampled]:
    problems: list[str] = []
    samples: dict[str, list[tuple[float, tuple[float, ...]]]] = {}
    columns: list[str] | None = None
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip() or line.lstrip().startswith("#"):
            continue
        stripped = [cell.strip() for cell in line.split(",")]
        if columns is None:
            columns = stripped
            if [column for column in columns if column != "node"] not in (["at_s", "x", "y"], ["at_s", "x", "y", "z"]):
                raise TraceProblems(
                    [f"{number}: the columns must be at_s,node,x,y or at_s,node,x,y,z, node perhaps not"]
                )
            continue
        try:
            if len(stripped) != len(columns):
                raise ValueError(f"{len(stripped)} cells; there must be {len(columns)}")
            _csv_row(dict(zip(columns, stripped, strict=True)), samples)
        except ValueError as error:
            problems.append(f"{number}: {error}")
    if problems:
        raise TraceProblems(problems)
    return {name: _sampled(own) for name, own in samples.items()}


def _csv_row(row: Mapping[str, str], samples: dict[str, list[tuple[float, tuple[float, ...]]]]) -> None:
    at_s, place = _finite(row["at_s"]), tuple(_finite(row[axis]) for axis in _CSV_PLACE if axis in row)
    name = row.get("node", ONLY_NODE)
    own = samples.setdefault(name, [])
    if own and at_s < own[-1][0]:
        whose = f" of '{name}'" if name else ""
        raise ValueError(f"{at_s:g} s is before the row above{whose}; sort the rows by time")
    own.append((at_s, place))


def _finite(word: str) -> float:
    try:
        value = float(word)
    except ValueError:
        raise ValueError(f"'{word}' is not a number") from None
    if not math.isfinite(value):
        raise ValueError(f"'{word}' is impossible")
    return value


def _sampled(samples: Sequence[tuple[float, tuple[float, ...]]]) -> Sampled:
    kept = list(dict.fromkeys(samples))
    return Sampled(tuple(at_s for at_s, _ in kept), tuple(place for _, place in kept))
