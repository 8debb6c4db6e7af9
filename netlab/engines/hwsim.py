"""Radios that are real 802.11 interfaces, beside whichever engine carries the wires.

mac80211_hwsim gives the nodes interfaces with the kernel's own 802.11 stack above them; a process
(:mod:`netlab.engines.hwsim_process`) carries their frames by the rules of :mod:`netlab.medium.wifi`. Ports of wires
come first in a plan with such radios, so that the wires' engine knows its own ports by the same numbers.
"""

from __future__ import annotations

import time
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from netlab.engines import hwsim_setup
from netlab.engines.air_messages import AskStats, RecordVerdicts, SetOutage, SetPairs
from netlab.engines.base import Engine, LabPlan, Pair, PairCounters
from netlab.engines.helper import HelperProcess
from netlab.engines.hwsim_messages import HwsimStats, MakeRadios
from netlab.errors import LabError, MachineError
from netlab.kernel import hwsim
from netlab.medium.impairments import Impairment

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_WAY_OUT = (
    "run it in a kernel that has it: add --in vm (`netlab vm build` once), "
    "or as root load it here: modprobe mac80211_hwsim radios=0"
)


def has_wifi(plan: LabPlan) -> bool:
    """Whether some ports of a plan are 802.11 interfaces."""
    return any(hwsim_setup.is_wifi(segment) for segment in plan.segments)


def wires_of(plan: LabPlan) -> LabPlan:
    """The part of a plan that is left to the wires' engine: all nodes, but no 802.11 port or segment.

    Raises:
        ValueError: An 802.11 port stands before one of another kind, whose number would change.
    """
    wifi = {port for segment in plan.segments if hwsim_setup.is_wifi(segment) for port in segment.ports}
    ports = tuple(port for port in plan.ports if port.index not in wifi)
    if any(port.index != place for place, port in enumerate(ports)):
        raise ValueError("802.11 ports must have the last numbers of a plan")
    segments = tuple(segment for segment in plan.segments if not hwsim_setup.is_wifi(segment))
    return replace(plan, ports=ports, segments=segments, meshes=())


def require() -> None:
    """Make sure that this kernel can make radios.

    Raises:
        MachineError: It cannot; names the way out.
    """
    problem = hwsim.missing()
    if problem is not None:
        raise MachineError(f"radio: driver: hwsim cannot run here: {problem}; {_WAY_OUT}")


class HwsimEngine:
    """See :class:`netlab.engines.base.Engine`. Everything about wires is passed on to ``wires``."""

    def __init__(self, plan: LabPlan, wires: Engine) -> None:
        """``wires`` is made for :func:`wires_of` the plan."""
        self._plan = plan
        self._wires = wires
        self._segments = tuple(filter(hwsim_setup.is_wifi, plan.segments))
        self._ports = {port for segment in self._segments for port in segment.ports}
        self._process: HelperProcess | None = None

    @property
    def namespace_fds(self) -> dict[str, int]:
        """Network namespace of every node, held open for the lab's life."""
        return self._wires.namespace_fds

    def bring_up(self) -> float:
        """Bring the wires up, then the radios; mesh peers in range of each other have met then.

        Returns:
            Seconds from before the first namespace to the last radio in its network.

        Raises:
            MachineError: The kernel lacks or refuses something; after that nothing is left.
        """
        require()
        took_s = self._wires.bring_up()
        try:
            started = time.perf_counter()
            process = self._process = HelperProcess("netlab.engines.hwsim_process", "hwsim")
            names = self._radio_names()
            process.ask(MakeRadios(self._plan.ports, self._segments, self._plan.seed, names))
            for segment in self._segments:
                mine = {port: names[port] for port in segment.ports}
                hwsim_setup.set_up(self._plan.ports, segment, mine, self.namespace_fds)
            return took_s + time.perf_counter() - started
        except (OSError, LabError) as error:
            self.close()
            raise MachineError(f"the 802.11 radios cannot start: {error}") from error
        except BaseException:
            self.close()
            raise

    def set_pairs(self, changes: dict[Pair, Impairment | None]) -> None:
        """Change pairs at once; None takes a pair out of range.

        Raises:
            LabError: Radios cannot do it (then nothing is changed), or the process is gone.
            MachineError: As of the wires' engine.
        """
        radio, wires = self._split(changes)
        for impairment in filter(None, (changes[pair] for pair in radio)):
            if impairment.duplicate_ratio or impairment.reorder_ratio or impairment.corrupt_ratio:
                raise LabError("802.11 radios cannot duplicate, reorder or corrupt; use loss or jitter")
        if wires:
            self._wires.set_pairs({pair: changes[pair] for pair in wires})
        if radio:
            self._running().ask(SetPairs({pair: changes[pair] for pair in radio}))

    def set_outage(self, pairs: set[Pair], *, active: bool) -> None:
        """Lose everything on ``pairs`` silently, or end that; frames under way still arrive.

        Raises:
            LabError: As for :meth:`set_pairs`.
        """
        radio, wires = self._split(pairs)
        if wires:
            self._wires.set_outage(set(wires), active=active)
        if radio:
            self._running().ask(SetOutage(frozenset(radio), active))

    def set_rssi(self, segment: str, rssi_dbm: NDArray[np.float64]) -> None:
        """Refuse: the driver's radios share no airtime here; ``rssi`` is a word of their pairs.

        Raises:
            LabError: Always.
        """
        raise LabError(f"{segment}: radios of driver: hwsim share no airtime; remove the driver")

    def set_carrier(self, ports: set[int], *, up: bool) -> None:
        """Pull or plug cables.

        Raises:
            LabError: One of the ports is a radio.
        """
        if ports & self._ports:
            raise LabError("a radio has no cable to pull; cut it with an outage")
        self._wires.set_carrier(ports, up=up)

    def record_verdicts(self, fd: int) -> None:
        """Write the decisions on radio frames to this stream socket, beside what the wires' engine writes there."""
        if self._ports != set(range(len(self._plan.ports))):
            self._wires.record_verdicts(fd)
        self._running().ask(RecordVerdicts(), [fd])

    def pair_counters(self) -> dict[Pair, PairCounters]:
        """Those of the wires; of radios the verdicts tell more."""
        return self._wires.pair_counters()

    def stats(self) -> HwsimStats:
        """Counters of the radios since the start.

        Raises:
            LabError: The process is gone.
        """
        answer = self._running().ask(AskStats())
        assert isinstance(answer, HwsimStats)
        return answer

    def timing(self) -> dict[str, float] | None:
        """That of the wires' engine."""
        return self._wires.timing()

    def problem(self) -> str | None:
        """What has gone wrong since the start, for a person; None if nothing."""
        if self._process is not None and self._process.ended:
            return "the hwsim process ended; the radios are gone; its last words are in the supervisor's log"
        return self._wires.problem()

    def close(self) -> None:
        """Stop the process, with which the radios go, and the wires' engine; idempotent."""
        if self._process is not None:
            self._process.close()
            self._process = None
        self._wires.close()

    def _running(self) -> HelperProcess:
        if self._process is None:
            raise RuntimeError("the engine is not up")
        return self._process

    def _split(self, pairs: Iterable[Pair]) -> tuple[list[Pair], list[Pair]]:
        chosen = list(pairs)
        radio = [pair for pair in chosen if pair[0] in self._ports]
        return radio, [pair for pair in chosen if pair[0] not in self._ports]

    def _radio_names(self) -> dict[int, str]:
        """Names of radios are common to all namespaces of a machine; the inode tells this lab's from the others'."""
        lab = Path("/proc/thread-self/ns/net").stat().st_ino
        return {port: f"nl{lab}-{port}" for port in sorted(self._ports)}
