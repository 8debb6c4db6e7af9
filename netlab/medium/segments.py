"""Who can hear whom: ports on segments, and one impairment for each directed pair of ports. Values only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from netlab.medium.impairments import Impairment


class SegmentKind(StrEnum):
    """A wire carries every frame to its other end; a radio delivers unicast frames to their addressee only."""

    WIRE = "wire"
    RADIO = "radio"


@dataclass(frozen=True, slots=True)
class Port:
    """One interface of one node.

    ``index`` is dense over the lab and equals the position in ``LabPlan.ports``. ``address`` is IPv4 with prefix length
    (``10.1.0.1/24``) or None where a mesh owns the port. A ``monitor`` port also hears unicast frames for others.
    """

    index: int
    node: str
    ifname: str
    mac: bytes
    address: str | None
    mtu: int = 1500
    monitor: bool = False


@dataclass(frozen=True, slots=True)
class Segment:
    """Ports that share a medium. A pair (sender, receiver) that is missing from ``pairs`` is out of range."""

    name: str
    kind: SegmentKind
    ports: tuple[int, ...]
    pairs: Mapping[tuple[int, int], Impairment]
