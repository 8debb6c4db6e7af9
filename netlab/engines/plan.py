"""From a scenario to the plan that an engine builds: ports, addresses, one impairment for each directed pair.

Addresses: wire i is 10.{1 + i // 256}.{i % 256}.0/24 with .1 and .2 at its ends; the radio is 10.200.0.0/16 with the
node's place in the scenario, from 1, as host number. MAC addresses are locally administered and follow port indices.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import permutations

from netlab.engines.base import LabPlan, Pair
from netlab.medium.impairments import Impairment
from netlab.medium.segments import Port, Segment, SegmentKind
from netlab.scenario.links import Wire
from netlab.scenario.model import Scenario
from netlab.timeline.impairments import Impairments
from netlab.timeline.paths import RadioWords

RADIO_SEGMENT = "radio"
RADIO_INTERFACE = "radio0"


def compile_plan(scenario: Scenario) -> LabPlan:
    """Return everything static that an engine builds for ``scenario``. The same scenario gives an equal plan."""
    wires = scenario.wires()
    ports, wire_ports, radio_ports = _ports(scenario, wires)
    impairments = Impairments()
    segments = [
        Segment(
            f"{wire.a}-{wire.b}",
            SegmentKind.WIRE,
            (a, b),
            _wire_pairs(wire, a, b, impairments),
        )
        for wire, (a, b) in zip(wires, wire_ports, strict=True)
    ]
    if radio_ports:
        pairs = _radio_pairs(scenario, radio_ports, impairments)
        segments.append(Segment(RADIO_SEGMENT, SegmentKind.RADIO, tuple(radio_ports.values()), pairs))
    return LabPlan(scenario.name, scenario.seed, tuple(scenario.nodes), tuple(ports), tuple(segments))


def hosts(plan: LabPlan) -> list[tuple[str, str]]:
    """Return (address, name) lines for /etc/hosts.

    A node's name stands for the address of its first port; every port has an alias such as `base-eth1`.
    """
    lines: list[tuple[str, str]] = []
    named: set[str] = set()
    for port in plan.ports:
        if port.address is None:
            continue
        address = port.address.partition("/")[0]
        if port.node not in named:
            named.add(port.node)
            lines.append((address, port.node))
        lines.append((address, f"{port.node}-{port.ifname}"))
    return lines


@dataclass(frozen=True, slots=True)
class _End:
    """One interface before it has an index; ``wire`` is None for a radio."""

    ifname: str
    address: str
    wire: tuple[int, int] | None


def _ports(scenario: Scenario, wires: Iterable[Wire]) -> tuple[list[Port], list[Pair], dict[str, int]]:
    """Number the interfaces node by node; return the ports, those of every wire, and each node's radio port."""
    ends: dict[str, list[_End]] = {name: [] for name in scenario.nodes}
    count = 0
    for index, wire in enumerate(wires):
        for side, node in enumerate((wire.a, wire.b)):
            ends[node].append(_End(f"eth{len(ends[node])}", wire_address(index, side + 1), (index, side)))
        count += 1
    radio_nodes = set(scenario.radio_nodes)
    ports: list[Port] = []
    at: dict[tuple[int, int], int] = {}
    radio_ports: dict[str, int] = {}
    for place, node in enumerate(scenario.nodes, start=1):
        for end in ends[node]:
            assert end.wire is not None
            at[end.wire] = len(ports)
            ports.append(Port(len(ports), node, end.ifname, _mac(len(ports)), end.address))
        if node in radio_nodes:
            radio_ports[node] = len(ports)
            ports.append(Port(len(ports), node, RADIO_INTERFACE, _mac(len(ports)), _radio_address(place)))
    return ports, [(at[index, 0], at[index, 1]) for index in range(count)], radio_ports


def wire_address(wire: int, host: int) -> str:
    """The address of end ``host`` (1 or 2) of wire number ``wire``, with its prefix length."""
    return f"10.{1 + wire // 256}.{wire % 256}.{host}/24"


def _radio_address(place: int) -> str:
    return f"10.200.{place // 256}.{place % 256}/16"


def _mac(index: int) -> bytes:
    # The first octet's 0x02 bit marks a locally administered address (IEEE 802), its 0x01 bit stays clear: unicast.
    return b"\x02\x4e\x4c" + index.to_bytes(3, "big")


def _wire_pairs(wire: Wire, a: int, b: int, impairments: Impairments) -> dict[Pair, Impairment]:
    forward = impairments.of(wire.forward)
    backward = forward if wire.backward is wire.forward else impairments.of(wire.backward)
    return {(a, b): forward, (b, a): backward}


def _radio_pairs(scenario: Scenario, ports: dict[str, int], impairments: Impairments) -> dict[Pair, Impairment]:
    radio = RadioWords(scenario)
    pairs: dict[Pair, Impairment] = {}
    if radio.default is not None:
        pairs = dict.fromkeys(permutations(ports.values(), 2), impairments.of(radio.default))
    for sender, receiver in radio.special_hops():
        words = radio.get((sender, receiver))
        pair = (ports[sender], ports[receiver])
        if words is not None:
            pairs[pair] = impairments.of(words)
        else:
            pairs.pop(pair, None)
    return pairs
