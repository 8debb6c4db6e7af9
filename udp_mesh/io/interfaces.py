"""Which network interfaces there are, from the standard library alone."""

from __future__ import annotations

import array
import fcntl
import socket
from dataclasses import dataclass

_SIOCGIFFLAGS = 0x8913
_SIOCGIFADDR = 0x8915
_SIOCGIFBRDADDR = 0x8919
_IFF_UP = 0x1
_IFF_BROADCAST = 0x2
_IFF_LOOPBACK = 0x8
_NAME_BYTES = 16
_REQUEST_BYTES = 40  # struct ifreq


@dataclass(frozen=True, slots=True)
class Interface:
    """An interface that is up and has an IPv4 address. ``broadcast`` is where datagrams for everybody go."""

    index: int
    name: str
    address: str
    broadcast: str


def list_interfaces(wanted: tuple[str, ...]) -> list[Interface]:
    """Return the interfaces named in ``wanted`` that are usable now; all but loopback if it is empty."""
    found = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        for index, name in socket.if_nameindex():
            if not wanted or name in wanted:
                interface = _describe(probe, index, name, allow_loopback=bool(wanted))
                if interface is not None:
                    found.append(interface)
    return found


def _describe(probe: socket.socket, index: int, name: str, *, allow_loopback: bool) -> Interface | None:
    try:
        flags = int.from_bytes(_ask(probe, _SIOCGIFFLAGS, name)[:2], "little")
        if not flags & _IFF_UP or (flags & _IFF_LOOPBACK and not allow_loopback):
            return None
        address = socket.inet_ntoa(_ask(probe, _SIOCGIFADDR, name)[4:8])
        if flags & _IFF_LOOPBACK:
            return Interface(index, name, address, "127.255.255.255")
        if not flags & _IFF_BROADCAST:
            return None
        return Interface(index, name, address, socket.inet_ntoa(_ask(probe, _SIOCGIFBRDADDR, name)[4:8]))
    except OSError:  # it vanished, or it has no IPv4 address
        return None


def _ask(probe: socket.socket, request: int, name: str) -> bytes:
    buffer = array.array("B", name.encode()[: _NAME_BYTES - 1].ljust(_REQUEST_BYTES, b"\0"))
    fcntl.ioctl(probe.fileno(), request, buffer, True)
    return buffer.tobytes()[_NAME_BYTES:]
