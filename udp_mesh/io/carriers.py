"""Opens carriers of every kind; only those that are used are imported."""

from __future__ import annotations

from collections import Counter

from udp_mesh.config import Config
from udp_mesh.config_carriers import CarrierKind
from udp_mesh.io.carrier import CarrierFacts, CarrierSocket


def open_carrier(facts: CarrierFacts, config: Config, counters: Counter[str]) -> CarrierSocket:
    """Open a carrier.

    Raises:
        OSError: The port or device is in use, the right to open it is missing, or it is gone.
    """
    if facts.kind is CarrierKind.SERIAL:
        from udp_mesh.io.serial import SerialCarrier

        return SerialCarrier(facts, counters)
    if facts.kind is CarrierKind.ETHERNET:
        from udp_mesh.io.ethernet import EthernetCarrier

        return EthernetCarrier(facts, counters)
    from udp_mesh.io.udp import UdpCarrier

    return UdpCarrier(facts, config.port, counters, marks=config.dscp)
