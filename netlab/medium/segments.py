"""Who can hear whom: ports on segments, and one impairment for each directed pair of ports. Values only."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from enum import StrEnum

from netlab.medium.impairments import Impairment

#: Thermal noise of 20 MHz, -101 dBm, and a receiver's noise figure of 7 to 10 dB.
DEFAULT_NOISE_DBM = -91.0
#: What an interface and its driver hold; more would only wait.
DEFAULT_LIMIT_PACKETS = 64
#: How strongly a receiver hears a sender of which nothing is said.
DEFAULT_RSSI_DBM = -50.0


class SegmentKind(StrEnum):
    """A wire carries every frame to its other end; a radio delivers unicast frames to their addressee only."""

    WIRE = "wire"
    RADIO = "radio"


@dataclass(frozen=True, slots=True)
class Port:
    """One interface of one node.

    ``index`` is dense over the lab and equals the position in ``LabPlan.ports``. ``address`` is IPv4 with prefix length
    (``10.1.0.1/24``) or None where a mesh owns the port. A ``monitor`` port also hears unicast frames for others.
    A ``radiotap`` port is a radio in monitor mode, one that shares airtime or an 802.11 interface: all that it sends is
    for everybody, once, at the rate that its header asks for, and it is told how strongly it heard each frame.
    """

    index: int
    node: str
    ifname: str
    mac: bytes
    address: str | None
    mtu: int = 1500
    monitor: bool = False
    radiotap: bool = False


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
class ChannelSpec:
    """A radio segment whose ports share one channel and its airtime (:mod:`netlab.medium.channel`).

    ``phy`` is a name in ``netlab.medium.phy.PHYS``. ``rate_bps`` fixes the rate of unicast frames, None leaves it to
    rate control. ``cca_dbm``: a station that hears this or more defers; None takes the radio's own. At most
    ``limit_packets`` and ``limit_bytes`` (None: no limit) wait in a station, the frame under way included.
    """

    phy: str
    noise_dbm: float = DEFAULT_NOISE_DBM
    rate_bps: float | None = None
    cca_dbm: float | None = None
    limit_packets: int | None = DEFAULT_LIMIT_PACKETS
    limit_bytes: int | None = None


@dataclass(frozen=True, slots=True)
class Segment:
    """Ports that share a medium. A pair (sender, receiver) that is missing from ``pairs`` is out of range.

    With ``wifi`` the ports are 802.11 interfaces and their frames go through :mod:`netlab.medium.wifi`; with
    ``channel`` they share airtime, and the pairs' impairments, without rate and limit, act on what has arrived.
    """

    name: str
    kind: SegmentKind
    ports: tuple[int, ...]
    pairs: Mapping[tuple[int, int], Impairment]
    wifi: Wifi | None = None
    channel: ChannelSpec | None = None
