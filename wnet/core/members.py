"""What a mesh and its owner exchange about members, the interfaces that belong to a mesh. Values only."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Member:
    """One interface of the mesh. ``rates_bps``: what the radio can send at; empty if unknown, and on wires.

    A frame of a member carries up to ``mtu_bytes`` after its Ethernet header.
    """

    mac: bytes
    is_radio: bool
    mtu_bytes: int = 1532
    rates_bps: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class Reception:
    """What a radio tells of one received frame; None where it does not know."""

    signal_dbm: float | None = None
    noise_dbm: float | None = None
    rate_bps: int | None = None


@dataclass(frozen=True, slots=True)
class Outgoing:
    """A frame to send on a member, from its destination address on.

    ``rate_bps``: None leaves it to the driver. ``urgency``: 0 is the most urgent (control), 7 the least.
    """

    member: int
    frame: bytes
    rate_bps: int | None
    urgency: int
