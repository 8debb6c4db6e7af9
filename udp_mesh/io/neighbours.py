"""By which carriers fixed neighbours are reached."""

from __future__ import annotations

import socket
from collections.abc import Sequence
from dataclasses import replace

from udp_mesh.config_carriers import CarrierKind
from udp_mesh.config_neighbours import Neighbour
from udp_mesh.io.carrier import CarrierFacts

_ANY_PORT = 9


def with_neighbours(carriers: Sequence[CarrierFacts], neighbours: Sequence[Neighbour]) -> list[CarrierFacts]:
    """Return the carriers with the neighbours that each of them reaches; a serial line keeps its broadcast.

    An IPv4 address belongs to the interface by which the kernel routes to it now, perhaps over routers; others to the
    interface that they name, or to all of their kind.
    """
    sources = {n: _source_of(n.address) for n in neighbours if n.kind is CarrierKind.UDP and not n.interface}
    found = []
    for facts in carriers:
        if facts.kind is not CarrierKind.SERIAL:
            mine = [n.address for n in neighbours if n.kind is facts.kind and _is_on(n, facts, sources)]
            facts = replace(facts, neighbours=tuple(mine))
        found.append(facts)
    return found


def _is_on(neighbour: Neighbour, facts: CarrierFacts, sources: dict[Neighbour, str]) -> bool:
    if neighbour.interface or neighbour.kind is not CarrierKind.UDP:
        return neighbour.interface in ("", facts.name)
    return sources[neighbour] == facts.address


def _source_of(address: str) -> str:
    """Return this host's address from which packets to ``address`` leave; empty without a route. Sends nothing."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((address, _ANY_PORT))
        except OSError:
            return ""
        return str(probe.getsockname()[0])
