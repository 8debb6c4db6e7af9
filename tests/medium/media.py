"""Small media and long streams of frames for the tests of this folder."""

from __future__ import annotations

from netlab.medium.impairments import Impairment
from netlab.medium.medium import Medium
from netlab.medium.pair import DROPPED, Outcome
from netlab.medium.segments import Port, Segment, SegmentKind
from netlab.medium.verdicts import Verdict

GROUP = b"\xff" * 6


def port(index: int, *, monitor: bool = False) -> Port:
    """Port ``index`` of node ``n<index>``."""
    return Port(index, f"n{index}", "eth0", bytes([2, 0, 0, 0, 0, index]), None, monitor=monitor)


def frame(sender: int, to: int | None = None, size: int = 100, source: bytes | None = None) -> bytes:
    """An Ethernet frame of ``size`` bytes to a port, or to all."""
    destination = GROUP if to is None else port(to).mac
    return (destination + (source or port(sender).mac) + b"\x88\xb5").ljust(size, b".")


def wire(impairment: Impairment | None, *, seed: int = 1) -> Medium:
    """Two ports; ``impairment`` from 0 to 1."""
    pairs = {} if impairment is None else {(0, 1): impairment}
    return Medium([port(0), port(1)], [Segment("w", SegmentKind.WIRE, (0, 1), pairs)], seed)


def radio(count: int, impairment: Impairment, *, seed: int = 1, monitors: frozenset[int] = frozenset()) -> Medium:
    """``count`` ports, all in range of each other."""
    ports = [port(index, monitor=index in monitors) for index in range(count)]
    pairs = {(a, b): impairment for a in range(count) for b in range(count) if a != b}
    return Medium(ports, [Segment("r", SegmentKind.RADIO, tuple(range(count)), pairs)], seed)


def stream(medium: Medium, count: int, *, every_s: float = 0.001, size: int = 100, start: float = 0.0) -> list[Outcome]:
    """Send ``count`` equal frames from port 0; return all outcomes in order."""
    sent = frame(0, 1, size)
    return [o for k in range(count) for o in medium.transmit(0, sent, now=start + k * every_s)]


def lost(outcomes: list[Outcome]) -> list[bool]:
    """Which of them the loss model took."""
    return [outcome[3] is Verdict.LOST for outcome in outcomes]


def delays(outcomes: list[Outcome], *, every_s: float = 0.001) -> list[float]:
    """Delay of every frame of a stream without duplicates; what was dropped is left out."""
    return [outcome[0] - k * every_s for k, outcome in enumerate(outcomes) if outcome[0] != DROPPED]
