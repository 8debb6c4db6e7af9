"""A node's mesh: the ports that belong to it, and the one interface of the node that has an address. Values only.

With a mesh all of a node's ports are its *members*; only the mesh interface has an address. Either the kernel is the
mesh (batman-adv), or a process of the node that holds the other end of the interface: ``MeshKind.process`` tells.
babel is a mesh of another kind: it routes IP, so there is no mesh interface, and the node's one address is on all its
members and on ``lo``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from wnet.config import MEMBER_MTU_BYTES as WNET_MEMBER_MTU_BYTES

#: A member's frames carry the mesh's own header around a whole Ethernet frame. batman-adv asks for 1532 bytes on its
#: members (net/batman-adv/main.c, batadv_max_header_len), and then leaves 1500 for the mesh interface.
MEMBER_MTU_BYTES = 1532
MESH_MTU_BYTES = 1500
#: The flood's own header; with the Ethernet header inside it fills those 1532 bytes (netlab.flood.wire).
FLOOD_HEADER_BYTES = 18
assert FLOOD_HEADER_BYTES + 14 + MESH_MTU_BYTES <= MEMBER_MTU_BYTES


class MeshKind(StrEnum):
    """What routes between nodes below IP; the words of a scenario file."""

    BATMAN_ADV = "batman-adv"
    FLOOD = "flood"
    WNET = "wnet"
    BABEL = "babel"

    @property
    def ifname(self) -> str:
        """The mesh interface's name in every node; babel's, which has none, is where the node's address is for sure."""
        return _IFNAMES[self]

    @property
    def process(self) -> str | None:
        """The name of the process that is the mesh, in every node; None where the kernel is."""
        return _PROCESSES[self]

    @property
    def made_by_kernel(self) -> bool:
        """Whether the kernel is the mesh; else a process of the node is."""
        return self.process is None

    @property
    def routes_ip(self) -> bool:
        """Whether it routes packets between addresses instead of being one network below them."""
        return self is MeshKind.BABEL

    @property
    def member_mtu_bytes(self) -> int:
        """What members carry after their Ethernet header."""
        return {MeshKind.WNET: WNET_MEMBER_MTU_BYTES, MeshKind.BABEL: MESH_MTU_BYTES}.get(self, MEMBER_MTU_BYTES)


_IFNAMES = {MeshKind.BATMAN_ADV: "bat0", MeshKind.FLOOD: "flood0", MeshKind.WNET: "wnet0", MeshKind.BABEL: "lo"}
_PROCESSES = {MeshKind.BATMAN_ADV: None, MeshKind.FLOOD: "flood", MeshKind.WNET: "wnet", MeshKind.BABEL: "babeld"}


class RoutingAlgorithm(StrEnum):
    """batman-adv's, by the kernel's names: IV counts routing messages, V estimates throughput."""

    BATMAN_IV = "BATMAN_IV"
    BATMAN_V = "BATMAN_V"


@dataclass(frozen=True, slots=True)
class BatmanOptions:
    """batman-adv's settings; None leaves the kernel's default.

    ``originator_interval_s`` is between the routing messages (OGM), ``elp_interval_s`` between V's link probes, both
    with a grain of 1 ms. ``hop_penalty`` 0..255 is how much worse each hop makes a path, in 255ths.
    """

    routing_algorithm: RoutingAlgorithm = RoutingAlgorithm.BATMAN_IV
    originator_interval_s: float | None = None
    elp_interval_s: float | None = None
    hop_penalty: int | None = None
    bridge_loop_avoidance: bool = False


@dataclass(frozen=True, slots=True)
class FloodOptions:
    """The flood's settings: at most ``hop_limit`` (1..255) transmissions in a row; a relay waits 0 to ``jitter_s``
    before it sends on a radio."""

    hop_limit: int = 64
    jitter_s: float = 0.005


@dataclass(frozen=True, slots=True)
class BabelOptions:
    """babeld's settings, its own defaults: seconds between HELLOs, and whether links are judged by what they lose."""

    hello_interval_s: float = 4.0
    wireless: bool = False


@dataclass(frozen=True, slots=True)
class MeshInterface:
    """One node's mesh interface. ``ports`` are its members' places in ``LabPlan.ports``; ``address`` as of a port.

    ``wnet`` is the table of settings that the daemon's file has (:mod:`wnet.config`).
    """

    node: str
    kind: MeshKind
    ifname: str
    mac: bytes
    address: str
    ports: tuple[int, ...]
    mtu: int = MESH_MTU_BYTES
    batman: BatmanOptions = BatmanOptions()
    flood: FloodOptions = FloodOptions()
    babel: BabelOptions = BabelOptions()
    wnet: Mapping[str, object] = field(default_factory=dict)
