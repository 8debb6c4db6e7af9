"""The engine whose physics is our own medium, in a process on the far ends of the veths. Any kernel serves."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from typing import TYPE_CHECKING

from netlab.engines.air_messages import (
    AddMonitor,
    AirStats,
    Answer,
    AskStats,
    RecordVerdicts,
    Request,
    SetOutage,
    SetPairs,
    SetRssi,
    Setup,
)
from netlab.engines.base import LabPlan, Pair, PairCounters
from netlab.engines.helper import HelperProcess
from netlab.errors import LabError, MachineError
from netlab.kernel import monitors
from netlab.kernel.wiring import VethSpec, Wiring, build
from netlab.medium.impairments import Impairment
from netlab.medium.segments import Port

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray


class AirEngine:
    """See :class:`netlab.engines.base.Engine`. Must be brought up in the lab's own network namespace."""

    name = "air"

    def __init__(self, plan: LabPlan) -> None:
        self._plan = plan
        self._wiring: Wiring | None = None
        self._process: HelperProcess | None = None
        self._veth_of: dict[int, int] = {}  # place in the wiring by port
        self._monitors: dict[int, int] = {}  # other ends of interfaces in monitor mode, by port

    @property
    def namespace_fds(self) -> dict[str, int]:
        """Network namespace of every node, held open for the lab's life."""
        return self._up().namespace_fds

    def bring_up(self) -> float:
        """Create namespaces, interfaces and addresses, all up, and the process that carries their frames.

        Returns:
            Seconds from before the first namespace to the last interface up and addressed.

        Raises:
            MachineError: The kernel refuses namespaces, veths or packet sockets; after that nothing is left.
        """
        try:
            # It loads while the interfaces are made.
            self._process = HelperProcess("netlab.engines.air_process", "air")
            started = time.perf_counter()
            veths = [port for port in self._plan.ports if not port.radiotap]
            self._wiring = build(self._plan.nodes, [_veth(port) for port in veths])
            took_s = time.perf_counter() - started
            far = dict(zip((port.index for port in veths), self._wiring.peer_ifindex, strict=True))
            self._veth_of = {port.index: place for place, port in enumerate(veths)}
            self._ask(Setup(self._plan, tuple(far.get(port.index, 0) for port in self._plan.ports)))
            started = time.perf_counter()
            self._add_monitors()
            took_s += time.perf_counter() - started
        except (OSError, LabError) as error:
            self.close()
            raise MachineError(f"the air engine cannot start: {error}; `netlab doctor` says what is missing") from error
        except BaseException:
            self.close()
            raise
        return took_s

    def set_pairs(self, changes: dict[Pair, Impairment | None]) -> None:
        """Change pairs at once; None takes a pair out of range.

        Raises:
            LabError: The process is gone, or two ports share no segment (then nothing is changed).
        """
        self._ask(SetPairs(changes))

    def set_rssi(self, segment: str, rssi_dbm: NDArray[np.float64]) -> None:
        """Say how strongly the ports of a segment with a shared channel hear each other: ``[sender, receiver]``, dBm.

        Raises:
            LabError: The process is gone, or the segment has no shared channel or another number of ports.
        """
        self._ask(SetRssi(segment, rssi_dbm.astype("f4").tobytes()))

    def set_outage(self, pairs: set[Pair], *, active: bool) -> None:
        """Lose everything on ``pairs`` silently, or end that; frames under way still arrive.

        Raises:
            LabError: As for :meth:`set_pairs`.
        """
        self._ask(SetOutage(frozenset(pairs), active))

    def set_carrier(self, ports: set[int], *, up: bool) -> None:
        """Pull or plug the cable at these ports; frames on their way to a pulled port are lost."""
        self._up().set_peers(sorted(self._veth_of[port] for port in ports - self._monitors.keys()), up=up)
        for port in ports & self._monitors.keys():
            monitors.set_carrier(self._monitors[port], up=up)

    def record_verdicts(self, fd: int) -> None:
        """Write one ``VERDICT_RECORD`` per decision to this stream socket from now on; the caller keeps ``fd``.

        Raises:
            LabError: The process is gone.
        """
        self._ask(RecordVerdicts(), [fd])

    def pair_counters(self) -> dict[Pair, PairCounters]:
        """Nothing: the verdicts tell more."""
        return {}

    def stats(self) -> AirStats:
        """Counters since the start.

        Raises:
            LabError: The process is gone.
        """
        answer = self._ask(AskStats())
        assert isinstance(answer, AirStats)
        return answer

    def timing(self) -> dict[str, float] | None:
        """How late frames left the medium: ``late_p99_s``, ``late_max_s``; None if the process is gone."""
        try:
            stats = self.stats()
        except LabError:
            return None
        return {"late_p99_s": stats.late_p99_s, "late_max_s": stats.late_max_s}

    def problem(self) -> str | None:
        """What has gone wrong since the start, for a person; None if nothing."""
        if self._process is not None and self._process.ended:
            return "the air process ended; no frame is carried any more; its last words are in the supervisor's log"
        return None

    def close(self) -> None:
        """Stop the process and close this process's descriptors; idempotent."""
        if self._process is not None:
            self._process.close()
            self._process = None
        for fd in self._monitors.values():
            os.close(fd)
        self._monitors = {}
        if self._wiring is not None:
            self._wiring.close()
            self._wiring = None

    def _add_monitors(self) -> None:
        """Give the ports in monitor mode their interfaces; the process has their other ends then."""
        for port in self._plan.ports:
            if port.radiotap:
                fd = monitors.create(self.namespace_fds[port.node], port.ifname)
                self._monitors[port.index] = fd
                self._ask(AddMonitor(port.index), [fd])

    def _up(self) -> Wiring:
        if self._wiring is None:
            raise RuntimeError("the engine is not up")
        return self._wiring

    def _ask(self, request: Request, fds: Sequence[int] = ()) -> Answer:
        """Send one request and wait until it is in force."""
        if self._process is None:
            raise RuntimeError("the engine is not up")
        answer: Answer = self._process.ask(request, fds)
        return answer


def _veth(port: Port) -> VethSpec:
    return VethSpec(port.node, port.ifname, port.mac, port.address, port.mtu, f"p{port.index}")
