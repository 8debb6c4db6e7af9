"""The ``neighbours`` of a configuration: fixed addresses in place of every broadcast."""

from __future__ import annotations

import ipaddress
import re
from dataclasses import dataclass

from udp_mesh.config_carriers import CarrierKind

_MAC = re.compile("(?:[0-9a-f]{2}:){5}[0-9a-f]{2}")
MAX_NEIGHBOURS = 256


@dataclass(frozen=True, slots=True)
class Neighbour:
    """One address in the form in which its carrier tells senders. ``interface``: the only one to use, or empty."""

    kind: CarrierKind
    address: str
    interface: str = ""


def check(value: object) -> object:
    """Check the list.

    Raises:
        ValueError: With the first mistake.
    """
    if not isinstance(value, list) or len(value) > MAX_NEIGHBOURS or not all(isinstance(text, str) for text in value):
        raise ValueError(f'has to be a list of at most {MAX_NEIGHBOURS} addresses like ["10.0.0.2", "fe80::2%wlan0"]')
    return tuple(dict.fromkeys(parse(text) for text in value))


def parse(text: str) -> Neighbour:
    """Read an IPv4, IPv6 or MAC address, the last two perhaps followed by % and an interface.

    Raises:
        ValueError: It is none; host names are not looked up.
    """
    address, _, interface = text.partition("%")
    if _MAC.fullmatch(address.lower()):
        return Neighbour(CarrierKind.ETHERNET, address.lower(), interface)
    try:
        found = ipaddress.ip_address(address)
    except ValueError:
        raise ValueError(f"holds {text!r}, which is no IPv4, IPv6 or MAC address; names are not looked up") from None
    return Neighbour(CarrierKind.UDP if found.version == 4 else CarrierKind.UDP6, str(found), interface)


def describe(neighbours: tuple[Neighbour, ...] | None) -> list[str] | None:
    """Return them as a file has them."""
    if neighbours is None:
        return None
    return [f"{n.address}%{n.interface}" if n.interface else n.address for n in neighbours]
