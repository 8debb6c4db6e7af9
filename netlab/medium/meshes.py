"""A node's mesh: the ports that belong to it, and the one interface of the node that has an address. Values only.

With a mesh all of a node's ports are its *members*; only the mesh interface has an address. Either the kernel makes
that interface (batman-adv) or a process of the node does (a daemon behind a tap): ``MeshKind.made_by_kernel`` tells.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

#: A member's frames carry the mesh's own header around a whole Ethernet frame. batman-adv asks for 1532 bytes on its
#: members (net/batman-adv/main.c, batadv_max_header_len), and then leaves 1500 for the mesh interface.
MEMBER_MTU_BYTES = 1532
MESH_MTU_BYTES = 1500


class MeshKind(StrEnum):
    """What routes between nodes below IP; the words of a scenario file."""

    BATMAN_ADV = "batman-adv"

    @property
    def ifname(self) -> str:
        """The mesh interface's name in every node."""
        return "bat0"

    @property
    def made_by_kernel(self) -> bool:
        """Whether the mesh interface exists before the node's first process; else a process makes it."""
        return self is MeshKind.BATMAN_ADV


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
class MeshInterface:
    """One node's mesh interface. ``ports`` are its members' places in ``LabPlan.ports``; ``address`` as of a port."""

    node: str
    kind: MeshKind
    ifname: str
    mac: bytes
    address: str
    ports: tuple[int, ...]
    mtu: int = MESH_MTU_BYTES
    batman: BatmanOptions = BatmanOptions()
