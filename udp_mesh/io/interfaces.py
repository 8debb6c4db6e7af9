"""Which network interfaces and serial lines there are, from the standard library alone."""

from __future__ import annotations

import array
import fcntl
import os
import socket
from pathlib import Path

from udp_mesh.config import Config
from udp_mesh.config_carriers import CarrierConfig, CarrierKind
from udp_mesh.io.carrier import CarrierFacts

_SIOCGIFFLAGS = 0x8913
_SIOCGIFADDR = 0x8915
_SIOCGIFBRDADDR = 0x8919
_SIOCGIFMTU = 0x8921
_IFF_UP = 0x1
_IFF_BROADCAST = 0x2
_IFF_LOOPBACK = 0x8
_IFF_MULTICAST = 0x1000
_NAME_BYTES = 16
_REQUEST_BYTES = 40  # struct ifreq
_IP_UDP_BYTES = 28
_IP6_UDP_BYTES = 48
_ETHERNET_LENGTH_BYTES = 2
_LINK_LOCAL_SCOPE = 0x20
_NOT_USABLE_FLAGS = 0x40 | 0x08  # tentative, duplicate
_MAX_UDP_BYTES = 65_507
MULTICAST_GROUP = "ff02::6d65:7368"
_FIRST_INDEX = {  # so that one interface may carry several kinds
    CarrierKind.UDP: 0,
    CarrierKind.UDP6: 1 << 24,
    CarrierKind.ETHERNET: 2 << 24,
    CarrierKind.SERIAL: 3 << 24,
}


def list_carriers(config: Config) -> list[CarrierFacts]:
    """Return the carriers of a configuration that are usable now."""
    found: dict[int, CarrierFacts] = {}
    serial = 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        for carrier in config.carriers:
            if carrier.kind is CarrierKind.SERIAL:
                line = _serial(carrier, _FIRST_INDEX[carrier.kind] + serial)
                serial += 1
                if line is not None:
                    found[line.index] = line
                continue
            for facts in _interfaces(probe, carrier.kind, carrier.interfaces or config.interfaces):
                found[facts.index] = facts
    if config.neighbours is not None:
        from udp_mesh.io.neighbours import with_neighbours  # only for whom it concerns

        return with_neighbours(list(found.values()), config.neighbours)
    return list(found.values())


def _serial(carrier: CarrierConfig, index: int) -> CarrierFacts | None:
    from udp_mesh.io.serial import datagram_bytes

    if not os.access(carrier.device, os.R_OK | os.W_OK):
        return None
    return CarrierFacts(
        index,
        carrier.kind,
        carrier.device,
        mtu_bytes=datagram_bytes(carrier.mtu_bytes),
        rate_bps=carrier.rate_bps,
        baud=carrier.baud,
    )


def _interfaces(probe: socket.socket, kind: CarrierKind, wanted: tuple[str, ...]) -> list[CarrierFacts]:
    describe = {CarrierKind.UDP: _udp, CarrierKind.UDP6: _udp6, CarrierKind.ETHERNET: _ethernet}[kind]
    found = []
    for number, name in socket.if_nameindex():
        if wanted and name not in wanted:
            continue
        try:
            flags = int.from_bytes(_ask(probe, _SIOCGIFFLAGS, name)[:2], "little")
            if flags & _IFF_UP and (wanted or not flags & _IFF_LOOPBACK):
                facts = describe(probe, _FIRST_INDEX[kind] + number, number, name, flags)
                if facts is not None:
                    found.append(facts)
        except OSError:  # it vanished, or it has no address of this kind
            continue
    return found


def _udp(probe: socket.socket, index: int, number: int, name: str, flags: int) -> CarrierFacts | None:
    address = socket.inet_ntoa(_ask(probe, _SIOCGIFADDR, name)[4:8])
    if flags & _IFF_LOOPBACK:
        broadcast = "127.255.255.255"
    elif flags & _IFF_BROADCAST:
        broadcast = socket.inet_ntoa(_ask(probe, _SIOCGIFBRDADDR, name)[4:8])
    else:
        return None
    mtu_bytes = min(_mtu(probe, name) - _IP_UDP_BYTES, _MAX_UDP_BYTES)
    return CarrierFacts(index, CarrierKind.UDP, name, number, address, broadcast, mtu_bytes)


def _udp6(probe: socket.socket, index: int, number: int, name: str, flags: int) -> CarrierFacts | None:
    if not flags & _IFF_MULTICAST:
        return None
    for line in Path("/proc/net/if_inet6").read_text().splitlines():
        digits, _number, _prefix, scope, state, interface = line.split()
        is_usable = int(scope, 16) == _LINK_LOCAL_SCOPE and not int(state, 16) & _NOT_USABLE_FLAGS
        if interface == name and is_usable:
            address = socket.inet_ntop(socket.AF_INET6, bytes.fromhex(digits))
            mtu_bytes = min(_mtu(probe, name) - _IP6_UDP_BYTES, _MAX_UDP_BYTES)
            return CarrierFacts(index, CarrierKind.UDP6, name, number, address, MULTICAST_GROUP, mtu_bytes)
    return None


def _ethernet(probe: socket.socket, index: int, number: int, name: str, flags: int) -> CarrierFacts | None:
    if not flags & _IFF_BROADCAST:
        return None
    mtu_bytes = _mtu(probe, name) - _ETHERNET_LENGTH_BYTES
    return CarrierFacts(index, CarrierKind.ETHERNET, name, number, mtu_bytes=mtu_bytes)


def _mtu(probe: socket.socket, name: str) -> int:
    return int.from_bytes(_ask(probe, _SIOCGIFMTU, name)[:4], "little")


def _ask(probe: socket.socket, request: int, name: str) -> bytes:
    buffer = array.array("B", name.encode()[: _NAME_BYTES - 1].ljust(_REQUEST_BYTES, b"\0"))
    fcntl.ioctl(probe.fileno(), request, buffer, True)
    return buffer.tobytes()[_NAME_BYTES:]
