"""From a scenario to the plan that an engine builds: ports, addresses, one impairment for each directed pair.

Addresses: wire i is 10.{1 + i // 256}.{i % 256}.0/24 with .1 and .2 at its ends; radios are in 10.200.0.0/16 with the
node's place in the scenario, from 1, as host number, those on a second frequency in 10.201.0.0/16 and so on; meshes are
10.240.0.0/16 alike, and their members have none. MAC addresses are locally administered and follow port indices, those
of mesh interfaces the node's place.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import permutations

from netlab.engines.base import LabPlan, Pair
from netlab.medium.impairments import Impairment
from netlab.medium.meshes import MeshInterface, MeshKind
from netlab.medium.segments import ChannelSpec, Port, Segment, SegmentKind, Wifi, WifiMode
from netlab.scenario.links import Wire
from netlab.scenario.model import Scenario
from netlab.scenario.radio import Radio
from netlab.timeline.impairments import Impairments
from netlab.timeline.paths import RadioWords

RADIO_SEGMENT = "radio"
RADIO_PREFIX = "radio"
_RadioPorts = dict[float, list[tuple[str, int]]]  # by frequency in Hz: nodes and their ports


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
    segments += _radio_segments(scenario, radio_ports, impairments)
    meshes = tuple(_meshes(scenario, ports))
    return LabPlan(scenario.name, scenario.seed, tuple(scenario.nodes), tuple(ports), tuple(segments), meshes)


def hosts(plan: LabPlan) -> list[tuple[str, str]]:
    """Return (address, name) lines for /etc/hosts.

    A node's name stands for the address of its mesh interface or else of its first port; every address has an alias
    such as `base-eth1`.
    """
    lines: list[tuple[str, str]] = []
    named: set[str] = set()
    interfaces: tuple[Port | MeshInterface, ...] = (*plan.ports, *plan.meshes)
    for interface in interfaces:
        if interface.address is None:
            continue
        address = interface.address.partition("/")[0]
        if interface.node not in named:
            named.add(interface.node)
            lines.append((address, interface.node))
        lines.append((address, f"{interface.node}-{interface.ifname}"))
    return lines


@dataclass(frozen=True, slots=True)
class _End:
    """One interface before it has an index; ``wire`` is None for a radio."""

    ifname: str
    address: str
    wire: tuple[int, int] | None


def _ports(scenario: Scenario, wires: Iterable[Wire]) -> tuple[list[Port], list[Pair], _RadioPorts]:
    """Number the interfaces node by node; return the ports, those of every wire, and those of every frequency."""
    ends: dict[str, list[_End]] = {name: [] for name in scenario.nodes}
    count = 0
    for index, wire in enumerate(wires):
        for side, node in enumerate((wire.a, wire.b)):
            ends[node].append(_End(f"eth{len(ends[node])}", wire_address(index, side + 1), (index, side)))
        count += 1
    wifi = _wifi(scenario.radio) is not None
    ports: list[Port] = []
    at: dict[tuple[int, int], int] = {}
    radio_ports: _RadioPorts = {}
    for place, node in enumerate(scenario.nodes, start=1):
        for end in ends[node]:
            assert end.wire is not None
            at[end.wire] = len(ports)
            ports.append(_port(scenario, node, len(ports), end.ifname, end.address))
        if not wifi:
            _add_radios(scenario, place, node, ports, radio_ports)
    for place, node in enumerate(scenario.nodes, start=1):
        if wifi:  # last: the engine of the wires knows nothing of them
            _add_radios(scenario, place, node, ports, radio_ports)
    return ports, [(at[index, 0], at[index, 1]) for index in range(count)], radio_ports


def _add_radios(scenario: Scenario, place: int, node: str, ports: list[Port], radio_ports: _RadioPorts) -> None:
    monitors = scenario.meshes[node] is MeshKind.WNET
    wifi = _wifi(scenario.radio) is not None
    for number, radio in enumerate(scenario.radios(node)):
        members = radio_ports.setdefault(radio.frequency_hz, [])
        channel = list(radio_ports).index(radio.frequency_hz)
        members.append((node, len(ports)))
        port = _port(scenario, node, len(ports), f"{RADIO_PREFIX}{number}", _radio_address(channel, place))
        ports.append(replace(port, radiotap=monitors and (radio.phy is not None or wifi)))


def _radio_segments(scenario: Scenario, radio_ports: _RadioPorts, impairments: Impairments) -> Iterator[Segment]:
    """One segment for each frequency; the first one found is simply the radio."""
    for channel, (frequency_hz, members) in enumerate(radio_ports.items()):
        yield Segment(
            f"{RADIO_SEGMENT}-{frequency_hz / 1e6:g}MHz" if channel else RADIO_SEGMENT,
            SegmentKind.RADIO,
            tuple(port for _, port in members),
            _radio_pairs(scenario, members, impairments),
            wifi=_wifi(scenario.radio),
            channel=_channel(scenario, frequency_hz),
        )


def _port(scenario: Scenario, node: str, index: int, ifname: str, address: str) -> Port:
    mesh = scenario.meshes[node]
    if mesh is None:
        return Port(index, node, ifname, _mac(index), address)
    return Port(index, node, ifname, _mac(index), None, mtu=mesh.member_mtu_bytes)


def _meshes(scenario: Scenario, ports: Iterable[Port]) -> Iterator[MeshInterface]:
    members: dict[str, list[int]] = {name: [] for name in scenario.nodes}
    for port in ports:
        members[port.node].append(port.index)
    for place, (node, kind) in enumerate(scenario.meshes.items(), start=1):
        if kind is not None:
            yield MeshInterface(
                node,
                kind,
                kind.ifname,
                _mesh_mac(place),
                _mesh_address(place, prefix_bits=32 if kind.routes_ip else 16),
                tuple(members[node]),
                batman=scenario.batman_options(node),
                flood=scenario.flood_options(node),
                babel=scenario.babel_options(node),
                wnet=scenario.wnet_settings(node),
            )


def _mesh_address(place: int, *, prefix_bits: int) -> str:
    return f"10.240.{place // 256}.{place % 256}/{prefix_bits}"


def _mesh_mac(place: int) -> bytes:
    return b"\x02\x4e\x4d" + place.to_bytes(3, "big")


def wire_address(wire: int, host: int) -> str:
    """The address of end ``host`` (1 or 2) of wire number ``wire``, with its prefix length."""
    return f"10.{1 + wire // 256}.{wire % 256}.{host}/24"


def _radio_address(channel: int, place: int) -> str:
    return f"10.{200 + channel}.{place // 256}.{place % 256}/16"


def _wifi(radio: Radio | None) -> Wifi | None:
    if radio is None or radio.driver != "hwsim":
        return None
    return Wifi(WifiMode(radio.mode), radio.network, radio.hwsim_frequency_mhz, radio.retry_limit, radio.monitor)


def _channel(scenario: Scenario, frequency_hz: float) -> ChannelSpec | None:
    """The airtime of a frequency; its radios are all of one kind, see check_radio."""
    everybody = (radio for node in scenario.radio_nodes for radio in scenario.radios(node))
    settings = next(radio for radio in everybody if radio.frequency_hz == frequency_hz)
    if settings.phy is None:
        return None
    spec = ChannelSpec(settings.phy, rate_bps=settings.rate_bps)
    if settings.noise_dbm is not None:
        spec = replace(spec, noise_dbm=settings.noise_dbm)
    limit = None if scenario.radio is None else scenario.radio.limit
    return spec if limit is None else replace(spec, limit_packets=limit.packets, limit_bytes=limit.size_bytes)


def _mac(index: int) -> bytes:
    # The first octet's 0x02 bit marks a locally administered address (IEEE 802), its 0x01 bit stays clear: unicast.
    return b"\x02\x4e\x4c" + index.to_bytes(3, "big")


def _wire_pairs(wire: Wire, a: int, b: int, impairments: Impairments) -> dict[Pair, Impairment]:
    forward = impairments.of(wire.forward)
    backward = forward if wire.backward is wire.forward else impairments.of(wire.backward)
    return {(a, b): forward, (b, a): backward}


def _radio_pairs(
    scenario: Scenario, members: list[tuple[str, int]], impairments: Impairments
) -> dict[Pair, Impairment]:
    radio = RadioWords(scenario)
    pairs: dict[Pair, Impairment] = {}
    if radio.default is not None:
        pairs = dict.fromkeys(permutations((port for _, port in members), 2), impairments.of(radio.default))
    ports = dict(members)  # only where each node has one radio are there special hops
    for sender, receiver in radio.special_hops():
        words = radio.get((sender, receiver))
        pair = (ports[sender], ports[receiver])
        if words is not None:
            pairs[pair] = impairments.of(words)
        else:
            pairs.pop(pair, None)
    return pairs
