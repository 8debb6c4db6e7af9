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


class WifiMode(StrEnum):
    """How 802.11 radios form a network: 802.11s with its own path selection, or ad hoc between neighbours."""

    MESH = "mesh"
    IBSS = "ibss"


@dataclass(frozen=True, slots=True)
class Wifi:
    """A segment whose ports are real 802.11 interfaces of the kernel (mac80211_hwsim).

    ``network`` is the mesh identifier or the SSID (1..32 bytes in UTF-8), ``frequency_mhz`` the channel's centre,
    ``retry_limit`` the most attempts per unicast frame, at least 1. With ``monitor`` every node also has an interface
    that hears all frames with their radiotap header.
    """

    mode: WifiMode
    network: str
    frequency_mhz: int
    retry_limit: int
    monitor: bool = False


@dataclass(frozen=True, slots=True)
class Segment:
    """Ports that share a medium. A pair (sender, receiver) that is missing from ``pairs`` is out of range.

    With ``wifi`` the ports are 802.11 interfaces and their frames go through :mod:`netlab.medium.wifi`.
    """

    name: str
    kind: SegmentKind
    ports: tuple[int, ...]
    pairs: Mapping[tuple[int, int], Impairment]
    wifi: Wifi | None = None
