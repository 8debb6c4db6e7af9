"""What the lab asks of an engine, and the plan that it is given. Engines know nothing of scenarios or processes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

from netlab.medium.impairments import Impairment
from netlab.medium.meshes import MeshInterface
from netlab.medium.segments import Port, Segment

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class LabPlan:
    """Everything static that an engine builds. ``ports[i].index == i``; nodes are in scenario order.

    ``meshes`` are no engine's business: :mod:`netlab.engines.mesh_interfaces` makes them on top of the ports.
    """

    name: str
    seed: int
    nodes: tuple[str, ...]
    ports: tuple[Port, ...]
    segments: tuple[Segment, ...]
    meshes: tuple[MeshInterface, ...] = ()


Pair = tuple[int, int]  # (sender port, receiver port)


@dataclass(frozen=True, slots=True)
class PairCounters:
    """What the kernel counted of one directed pair since bring-up, in frames, where nobody decides frame by frame.

    ``queue_full``: found the queue at its limit; None if that cannot be told from other losses. ``waiting``: in the
    queue now. ``reordered``: left at once, ahead of the delayed ones.
    """

    queue_full: int | None
    waiting: int
    reordered: int


class Engine(Protocol):
    """Builds the namespaces and interfaces of a plan and keeps them as told. All calls block and are quick."""

    @property
    def namespace_fds(self) -> dict[str, int]:
        """Network namespace of every node, held open for the lab's life."""

    def bring_up(self) -> float:
        """Create namespaces, interfaces and addresses, all up.

        Returns:
            Seconds from before the first namespace to the last interface up and addressed.

        Raises:
            MachineError: The kernel lacks something; names it and the way out.
        """

    def set_pairs(self, changes: dict[Pair, Impairment | None]) -> None:
        """Change pairs at once; None takes a pair out of range."""

    def set_rssi(self, segment: str, rssi_dbm: NDArray[np.float64]) -> None:
        """Say how strongly the ports of a segment with a shared channel hear each other.

        Args:
            segment: Its name.
            rssi_dbm: (ports, ports), ``[sender, receiver]`` in the order of ``Segment.ports``; -inf for nothing.

        Raises:
            LabError: The engine or the segment has no shared channel.
        """

    def set_outage(self, pairs: set[Pair], *, active: bool) -> None:
        """Lose everything on ``pairs`` silently, carrier stays up; or end that. Frames under way still arrive."""

    def set_carrier(self, ports: set[int], *, up: bool) -> None:
        """Pull or plug the cable at these ports: the node sees its carrier go and come."""

    def record_verdicts(self, fd: int) -> None:
        """Write one ``VERDICT_RECORD`` per decision to this stream socket from now on (``air`` only)."""

    def pair_counters(self) -> dict[Pair, PairCounters]:
        """Counts of every pair since bring-up; empty where verdicts tell more (``air``)."""

    def timing(self) -> dict[str, float] | None:
        """How late frames left the medium (``late_p99_s``, ``late_max_s``); None where the kernel is the medium."""

    def problem(self) -> str | None:
        """What has gone wrong since the start, for a person; None if nothing."""

    def close(self) -> None:
        """Stop helper processes. Namespaces go when the last descriptor closes."""
