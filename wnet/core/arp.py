"""ARP answered out of what HELLO and TC tell, so that requests need not be broadcast (WNet paper, III-F; RFC 826)."""

from __future__ import annotations

import struct
from collections.abc import Iterable

from wnet.core.topology import Node
from wnet.core.wire_control import MAX_LISTED

_ETHERTYPE = b"\x08\x06"
_PACKET = struct.Struct("!HHBBH6s4s6s4s")
_AT = 14
_REQUEST, _REPLY = 1, 2
_NONE = bytes(4)
_OWNERS_MAX = 1024


class Arp:
    """This node's IPv4 addresses, and answers about those of others."""

    def __init__(self, mac: bytes) -> None:
        self._mac = mac
        self._told: tuple[bytes, ...] = ()
        self._learnt: dict[bytes, None] = {}
        self._owners: dict[bytes, bytes] = {}  # of addresses that were asked for

    @property
    def addresses(self) -> tuple[bytes, ...]:
        """This node's addresses: those that it was told, then those of its own ARP, the newest first."""
        learnt = [address for address in reversed(self._learnt) if address not in self._told]
        return (*self._told, *learnt)[:MAX_LISTED]

    def tell(self, addresses: Iterable[bytes]) -> None:
        """Set the addresses of the mesh interface; what was learnt before is forgotten."""
        self._told = tuple(addresses)
        self._learnt.clear()

    def read(self, inner: bytes, nodes: Iterable[Node]) -> bytes | None:
        """Read an ARP frame of this node; return the answer to it if one of ``nodes`` is known to have the address.

        So if one had it that is out of reach now: a host whose question stays unanswered asks once a second, and would
        wait for that long when the other is back (RFC 1122, 2.3.2.1).
        """
        if inner[12:14] != _ETHERTYPE or len(inner) < _AT + _PACKET.size:
            return None
        hardware, protocol, *sizes, operation, sender_mac, sender, _target_mac, target = _PACKET.unpack_from(inner, _AT)
        if (hardware, protocol, sizes) != (1, 0x0800, [6, 4]) or sender_mac != self._mac:
            return None
        if sender != _NONE:
            self._learn(sender)
        if operation != _REQUEST or sender == target:
            return None
        owner = next((node.mac for node in nodes if target in node.info.addresses), self._owners.get(target))
        if owner is None or owner == self._mac:
            return None
        self._remember(target, owner)
        packet = _PACKET.pack(1, 0x0800, 6, 4, _REPLY, owner, target, self._mac, sender)
        return self._mac + owner + _ETHERTYPE + packet

    def _remember(self, address: bytes, owner: bytes) -> None:
        self._owners.pop(address, None)
        self._owners[address] = owner
        if len(self._owners) > _OWNERS_MAX:
            del self._owners[next(iter(self._owners))]

    def _learn(self, address: bytes) -> None:
        self._learnt.pop(address, None)
        self._learnt[address] = None
        if len(self._learnt) > MAX_LISTED:
            del self._learnt[next(iter(self._learnt))]
