"""From radios that exist to 802.11 interfaces in the nodes: moved, made, addressed, up, joined to their network."""

from __future__ import annotations

import contextlib
import ipaddress
import time
from collections.abc import Iterator, Mapping, Sequence

from netlab.kernel import links, messages, monitors, nl80211
from netlab.kernel import namespaces as netns
from netlab.kernel.netlink import NetlinkError, NetlinkSocket
from netlab.kernel.nl80211 import Nl80211
from netlab.kernel.syscalls import CLONE_NEWNET, setns
from netlab.medium.segments import Port, Segment, Wifi, WifiMode

MONITOR_INTERFACE = "mon0"
# All radios of an ad-hoc segment share one cell: locally administered, unicast.
_BSSID = bytes.fromhex("024e4cff0000")
_PEERING_LIMIT_S = 3.0
_PEERING_STEP_S = 0.01


class _Site:
    """The sockets of one node's namespace."""

    def __init__(self, node: str) -> None:
        self.node = node
        self.wifi = Nl80211()
        self.route = NetlinkSocket()
        self.ifindex: dict[int, int] = {}  # by port

    def close(self) -> None:
        self.wifi.close()
        self.route.close()


def set_up(ports: Sequence[Port], segment: Segment, names: Mapping[int, str], namespace_fds: Mapping[str, int]) -> None:
    """Give every port of an 802.11 segment its interface; returns when mesh peers in range have found each other.

    The calling thread visits the nodes' namespaces and returns. Peers that lose too much to find each other within
    three seconds are left to go on trying.

    Args:
        ports: The lab's.
        segment: With ``wifi``.
        names: Name of the radio of each port; the radios are in the calling thread's namespace.
        namespace_fds: By node.

    Raises:
        OSError: The kernel refuses; names node and interface.
    """
    wifi = segment.wifi
    assert wifi is not None
    with contextlib.ExitStack() as stack:
        _move(ports, names, namespace_fds)
        sites: dict[int, _Site] = {}
        for index in segment.ports:
            port = ports[index]
            with _named(port), netns.returning():
                setns(namespace_fds[port.node], CLONE_NEWNET)
                site = sites[index] = _Site(port.node)
                stack.callback(site.close)
                make = _make_monitor if port.radiotap else _make_interface
                make(site, port, names[index], wifi)
        joined = [index for index in sites if not ports[index].radiotap]
        for index in joined:
            links.wait_until_running([(sites[index].route, sites[index].ifindex[index])])
        if wifi.mode is WifiMode.MESH and joined:
            _wait_for_peers(ports, segment, sites)


def _move(ports: Sequence[Port], names: Mapping[int, str], namespace_fds: Mapping[str, int]) -> None:
    here = Nl80211()
    try:
        wiphys = here.wiphys()
        for index, name in names.items():
            with _named(ports[index]):
                here.request(nl80211.move_wiphy(here.family, wiphys[name], namespace_fds[ports[index].node]))
    finally:
        here.close()


def _make_interface(site: _Site, port: Port, radio: str, wifi: Wifi) -> None:
    family, wiphy = site.wifi.family, site.wifi.wiphys()[radio]
    mesh = wifi.mode is WifiMode.MESH
    iftype = nl80211.IFTYPE_MESH_POINT if mesh else nl80211.IFTYPE_ADHOC
    site.wifi.request(nl80211.new_interface(family, wiphy, port.ifname, iftype, port.mac))
    if wifi.monitor:
        site.wifi.request(nl80211.new_interface(family, wiphy, MONITOR_INTERFACE, nl80211.IFTYPE_MONITOR))
    found = {link.ifname: link.index for link in links.list_links(site.route)}
    index = site.ifindex[port.index] = found[port.ifname]
    orders = [nl80211.set_mtu(index, port.mtu), messages.set_up(index, up=True)]
    if port.address is not None:
        orders.append(messages.add_address(index, ipaddress.IPv4Interface(port.address)))
    if wifi.monitor:
        orders.append(messages.set_up(found[MONITOR_INTERFACE], up=True))
    site.route.request(orders)
    network = wifi.network.encode()
    if mesh:
        site.wifi.request(nl80211.join_mesh(family, index, network, wifi.frequency_mhz))
    else:
        site.wifi.request(nl80211.join_ibss(family, index, network, wifi.frequency_mhz, _BSSID))


def _make_monitor(site: _Site, port: Port, radio: str, wifi: Wifi) -> None:
    """The radio of a node whose mesh sends and hears in monitor mode: it joins no network."""
    family, wiphy = site.wifi.family, site.wifi.wiphys()[radio]
    site.wifi.request(nl80211.new_interface(family, wiphy, port.ifname, nl80211.IFTYPE_MONITOR, port.mac))
    index = next(link.index for link in links.list_links(site.route) if link.ifname == port.ifname)
    site.ifindex[port.index] = index
    site.route.request([nl80211.set_mtu(index, monitors.MTU_BYTES), messages.set_up(index, up=True)])
    site.wifi.request(nl80211.set_channel(family, index, wifi.frequency_mhz))


def _wait_for_peers(ports: Sequence[Port], segment: Segment, sites: Mapping[int, _Site]) -> None:
    deadline = time.monotonic() + _PEERING_LIMIT_S
    meets = {pair for pair in segment.pairs if not any(ports[index].radiotap for index in pair)}
    missing = {pair for pair in meets if (pair[1], pair[0]) in segment.pairs}
    while missing and time.monotonic() < deadline:
        for index in {sender for sender, _ in missing}:
            stations = sites[index].wifi.stations(sites[index].ifindex[index])
            established = {station.mac for station in stations if station.established}
            missing -= {pair for pair in missing if pair[0] == index and ports[pair[1]].mac in established}
        if missing:
            time.sleep(_PEERING_STEP_S)


@contextlib.contextmanager
def _named(port: Port) -> Iterator[None]:
    try:
        yield
    except NetlinkError as error:
        raise OSError(error.errno, f"node {port.node}: interface {port.ifname}: {error.strerror}") from error


def is_wifi(segment: Segment) -> bool:
    """Whether a segment's ports are 802.11 interfaces."""
    return segment.wifi is not None
