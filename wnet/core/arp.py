"""ARP answered out of what HELLO and TC tell, so that requests need not be broadcast (WNet paper, III-F; RFC 826)."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping

from wnet.core.wire_control import MAX_LISTED

_ETHERTYPE = b"\x08\x06"
_PACKET = struct.Struct("!HHBBH6s4s6s4s")
_AT = 14
_REQUEST, _REPLY = 1, 2
_NONE = bytes(4)


class Arp:
    """This node's IPv4 addresses, and answers about those of others."""

    def __init__(self, mac: bytes) -> None:
        self._mac = mac
        self._told: tuple[bytes, ...] = ()
        self._learnt: dict[bytes, None] = {}

    @property
    def addresses(self) -> tuple[bytes, ...]:
        """This node's addresses: those that it was told, then those of its own ARP, the newest first."""
        learnt = [address for address in reversed(self._learnt) if address not in self._told]
        return (*self._told, *learnt)[:MAX_LISTED]

    def tell(self, addresses: Iterable[bytes]) -> None:
        """Set the addresses of the mesh interface; what was learnt before is forgotten."""
        self._told = tuple(addresses)
        self._learnt.clear()

    def read(self, inner: bytes, owners: Mapping[bytes, bytes]) -> bytes | None:
        """Read an ARP frame of this node; return the answer to it if ``owners`` has the address (4 bytes to a MAC)."""
        if inner[12:14] != _ETHERTYPE or len(inner) < _AT + _PACKET.size:
            return None
        hardware, protocol, *sizes, operation, sender_mac, sender, _target_mac, target = _PACKET.unpack_from(inner, _AT)
        if (hardware, protocol, sizes) != (1, 0x0800, [6, 4]) or sender_mac != self._mac:
            return None
        if sender != _NONE:
            self._learn(sender)
        if operation != _REQUEST or sender == target:
            return None
        owner = owners.get(target)
        if owner is None or owner == self._mac:
            return None
        packet = _PACKET.pack(1, 0x0800, 6, 4, _REPLY, owner, target, self._mac, sender)
        return self._mac + owner + _ETHERTYPE + packet

    def _learn(self, address: bytes) -> None:
        self._learnt.pop(address, None)
        self._learnt[address] = None
        if len(self._learnt) > MAX_LISTED:
            del self._learnt[next(iter(self._learnt))]
