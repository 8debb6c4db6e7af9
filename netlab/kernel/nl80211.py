"""802.11 interfaces over nl80211: move a radio, make an interface on it, join a mesh or an IBSS, ask for stations.

Source of commands, attributes and their types: linux/nl80211.h. Encoding functions take the family's number, which
differs from kernel to kernel; :class:`Nl80211` sends them.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from pyroute2.netlink.rtnl.ifinfmsg import ifinfmsg

from netlab.kernel import genl, messages
from netlab.kernel.netlink import NetlinkSocket, attributes

NAME = "nl80211"
IFTYPE_ADHOC = 1
IFTYPE_MONITOR = 6
IFTYPE_MESH_POINT = 7

_GET_WIPHY, _SET_WIPHY, _SET_WIPHY_NETNS, _NEW_INTERFACE, _GET_STATION = 1, 2, 49, 7, 17
_JOIN_IBSS, _JOIN_MESH = 43, 68
_WIPHY, _WIPHY_NAME, _IFINDEX, _IFNAME, _IFTYPE, _MAC, _BEACON_INTERVAL = 1, 2, 3, 4, 5, 6, 12
_STA_INFO, _MNTR_FLAGS, _MESH_ID, _WIPHY_FREQ, _SSID, _FREQ_FIXED = 21, 23, 24, 38, 52, 60
_CHANNEL_WIDTH, _NETNS_FD = 159, 219
_MNTR_FLAG_CONTROL, _MNTR_FLAG_OTHER_BSS = 3, 4
_CHAN_WIDTH_20_NOHT = 0
_STA_INFO_PLINK_STATE, _STA_INFO_SIGNAL, _STA_INFO_TX_PACKETS = 6, 7, 10
_STA_INFO_TX_RETRIES, _STA_INFO_TX_FAILED = 11, 12
_PLINK_ESTABLISHED = 4
#: Time units of 1.024 ms between beacons: what access points use. The mesh default of 1000 makes peering slow.
BEACON_INTERVAL_TU = 100


@dataclass(frozen=True, slots=True)
class Station:
    """A neighbour as an interface knows it.

    ``signal_dbm`` is that of the last frame heard from it, None before the first. ``established``: a mesh peer with
    which data may be exchanged. ``tx_retries`` counts attempts beyond the first, ``tx_failed`` frames given up.
    """

    mac: bytes
    signal_dbm: int | None
    established: bool
    tx_packets: int
    tx_retries: int
    tx_failed: int


def move_wiphy(family: int, wiphy: int, namespace_fd: int) -> bytes:
    """Move a radio with all its interfaces into the network namespace behind a descriptor."""
    where = genl.number(_WIPHY, wiphy) + genl.number(_NETNS_FD, namespace_fd)
    return genl.message(family, _SET_WIPHY_NETNS, where)


def new_interface(family: int, wiphy: int, ifname: str, iftype: int, mac: bytes | None = None) -> bytes:
    """Make an interface on a radio; a monitor hears every frame on the channel, control frames too."""
    parts = [genl.number(_WIPHY, wiphy), genl.text(_IFNAME, ifname), genl.number(_IFTYPE, iftype)]
    if mac is not None:
        parts.append(genl.attribute(_MAC, mac))
    if iftype == IFTYPE_MONITOR:
        flags = (genl.attribute(flag) for flag in (_MNTR_FLAG_CONTROL, _MNTR_FLAG_OTHER_BSS))
        parts.append(genl.nested(_MNTR_FLAGS, *flags))
    return genl.message(family, _NEW_INTERFACE, *parts)


def join_mesh(family: int, ifindex: int, mesh_id: bytes, frequency_mhz: int) -> bytes:
    """Join the 802.11s mesh ``mesh_id`` (1..32 bytes) on a 20 MHz channel without HT; the interface is up."""
    return genl.message(family, _JOIN_MESH, *_network(ifindex, frequency_mhz), genl.attribute(_MESH_ID, mesh_id))


def join_ibss(family: int, ifindex: int, ssid: bytes, frequency_mhz: int, bssid: bytes) -> bytes:
    """Join the ad-hoc network ``ssid`` with a fixed cell identifier: no scan, no merge, no waiting."""
    cell = (genl.attribute(_SSID, ssid), genl.attribute(_MAC, bssid), genl.attribute(_FREQ_FIXED))
    return genl.message(family, _JOIN_IBSS, *_network(ifindex, frequency_mhz), *cell)


def set_channel(family: int, ifindex: int, frequency_mhz: int) -> bytes:
    """Tune a radio whose only interfaces are monitors, by one that is up, to a 20 MHz channel without HT."""
    width = genl.number(_CHANNEL_WIDTH, _CHAN_WIDTH_20_NOHT)
    where = genl.number(_IFINDEX, ifindex) + genl.number(_WIPHY_FREQ, frequency_mhz)
    return genl.message(family, _SET_WIPHY, where, width)


def set_mtu(ifindex: int, mtu_bytes: int) -> bytes:
    """RTM_NEWLINK that changes an interface's MTU; for a route socket."""
    order = ifinfmsg()
    order["index"] = ifindex
    order["attrs"] = [("IFLA_MTU", mtu_bytes)]
    return messages.encode_message(order, messages.RTM_NEWLINK, 0)


def _network(ifindex: int, frequency_mhz: int) -> tuple[bytes, ...]:
    return (
        genl.number(_IFINDEX, ifindex),
        genl.number(_WIPHY_FREQ, frequency_mhz),
        genl.number(_CHANNEL_WIDTH, _CHAN_WIDTH_20_NOHT),
        genl.number(_BEACON_INTERVAL, BEACON_INTERVAL_TU),
    )


def parse_station(answer: bytes) -> Station:
    """Read one message of a station dump."""
    outer = attributes(answer, genl.ATTRIBUTES_AT)
    info = attributes(outer.get(_STA_INFO, b""), 0)
    signal = info.get(_STA_INFO_SIGNAL)
    return Station(
        mac=outer[_MAC],
        signal_dbm=struct.unpack("=b", signal[:1])[0] if signal else None,
        established=info.get(_STA_INFO_PLINK_STATE, b"")[:1] == bytes([_PLINK_ESTABLISHED]),
        tx_packets=_u32(info.get(_STA_INFO_TX_PACKETS)),
        tx_retries=_u32(info.get(_STA_INFO_TX_RETRIES)),
        tx_failed=_u32(info.get(_STA_INFO_TX_FAILED)),
    )


def _u32(data: bytes | None) -> int:
    return int.from_bytes(data, "little") if data else 0


class Nl80211:
    """The 802.11 side of the network namespace in which it is made.

    Raises:
        NetlinkError: This kernel has no cfg80211.
    """

    def __init__(self) -> None:
        self._sock = NetlinkSocket(genl.GENERIC)
        try:
            self.family = genl.family_id(self._sock, NAME)
        except BaseException:
            self._sock.close()
            raise

    def close(self) -> None:
        """Close the socket."""
        self._sock.close()

    def request(self, *orders: bytes) -> None:
        """Send encoded orders.

        Raises:
            NetlinkError: The first that the kernel refused.
        """
        self._sock.request(orders)

    def wiphys(self) -> dict[str, int]:
        """The radios in this namespace: their indices by name."""
        found = {}
        for answer in self._sock.dump(genl.message(self.family, _GET_WIPHY, flags=genl.NLM_F_DUMP)):
            radio = attributes(answer, genl.ATTRIBUTES_AT)
            found[radio[_WIPHY_NAME].rstrip(b"\0").decode()] = _u32(radio[_WIPHY])
        return found

    def stations(self, ifindex: int) -> list[Station]:
        """The neighbours that an interface knows."""
        order = genl.message(self.family, _GET_STATION, genl.number(_IFINDEX, ifindex), flags=genl.NLM_F_DUMP)
        return [parse_station(answer) for answer in self._sock.dump(order)]
