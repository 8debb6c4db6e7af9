"""The cells as one lab, side by side: a port of the sender and of each receiver per cell, and the frames. Pure."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass

from agreement_rig.cells import RECEIVERS, Cell, Reach
from netlab.engines.base import LabPlan
from netlab.medium.impairments import Impairment
from netlab.medium.segments import Port, Segment, SegmentKind

SENDER = "tx"
ETHERTYPE = 0x88B5  # IEEE 802 local experimental
NUMBER = struct.Struct("!III")  # three times the same: one flipped bit does not hide it
NUMBER_AT = 14


def receiver_name(receiver: int) -> str:
    """Node of a cell's ``receiver``-th port."""
    return f"rx{receiver}"


@dataclass(frozen=True, slots=True)
class Place:
    """Where a cell is in the lab: its ports, and its frames but for their number."""

    cell: Cell
    sender: int
    receivers: tuple[int, ...]
    header: bytes

    def frame(self, number: int) -> bytes:
        """The ``number``-th frame, as sent."""
        numbered = self.header + NUMBER.pack(number, number, number)
        return numbered.ljust(self.cell.size_bytes, b".")

    def pairs(self, impairments: Sequence[Impairment]) -> dict[tuple[int, int], Impairment]:
        """What to set so that ``impairments[r]`` is in force towards receiver ``r``."""
        return {(self.sender, port): imp for port, imp in zip(self.receivers, impairments, strict=True)}


def number_of(frame: bytes) -> int:
    """The number of a frame that may have one bit flipped."""
    a, b, c = map(int, NUMBER.unpack_from(frame, NUMBER_AT))
    return a if a in (b, c) else b


def build(cells: Sequence[Cell], seed: int) -> tuple[LabPlan, tuple[Place, ...]]:
    """Lay all cells out in one lab, the impairments of the first phase in force."""
    ports: list[Port] = []
    segments: list[Segment] = []
    places: list[Place] = []
    for index, cell in enumerate(cells):
        nodes = [SENDER, *map(receiver_name, range(cell.receivers))]
        made = [_port(len(ports) + offset, node, index, offset) for offset, node in enumerate(nodes)]
        ports += made
        place = Place(cell, made[0].index, tuple(port.index for port in made[1:]), _header(cell, made))
        kind = SegmentKind.WIRE if cell.reach is Reach.WIRE else SegmentKind.RADIO
        members = tuple(port.index for port in made)
        segments.append(Segment(f"cell{index}", kind, members, place.pairs(cell.phases[0])))
        places.append(place)
    names = (SENDER, *map(receiver_name, range(RECEIVERS)))
    return LabPlan("agreement", seed, names, tuple(ports), tuple(segments)), tuple(places)


def _port(index: int, node: str, cell: int, offset: int) -> Port:
    return Port(index, node, f"cell{cell}", bytes([2, 0, 0, 0, cell, offset]), None)


def _header(cell: Cell, ports: Sequence[Port]) -> bytes:
    destination = b"\xff" * 6 if cell.addressee is None else ports[1 + cell.addressee].mac
    return destination + ports[0].mac + ETHERTYPE.to_bytes(2, "big")
