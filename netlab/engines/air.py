"""The engine whose physics is our own medium, in a process on the far ends of the veths. Any kernel serves."""

from __future__ import annotations

import contextlib
import os
import select
import time

from netlab.engines.air_messages import (
    AirStats,
    Answer,
    AskStats,
    Close,
    Failed,
    RecordVerdicts,
    Request,
    SetOutage,
    SetPairs,
    Setup,
)
from netlab.engines.base import LabPlan, Pair, PairCounters
from netlab.errors import LabError, MachineError
from netlab.ipc import Channel, start_module
from netlab.kernel.wiring import VethSpec, Wiring, build
from netlab.medium.impairments import Impairment

_ANSWER_LIMIT_S = 30.0


class AirEngine:
    """See :class:`netlab.engines.base.Engine`. Must be brought up in the lab's own network namespace."""

    name = "air"

    def __init__(self, plan: LabPlan) -> None:
        self._plan = plan
        self._wiring: Wiring | None = None
        self._channel: Channel | None = None
        self._pid = 0

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
            self._start_process()  # it loads while the interfaces are made
            started = time.perf_counter()
            self._wiring = build(self._plan.nodes, _veths(self._plan))
            took_s = time.perf_counter() - started
            self._ask(Setup(self._plan, self._wiring.peer_ifindex))
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

    def set_outage(self, pairs: set[Pair], *, active: bool) -> None:
        """Lose everything on ``pairs`` silently, or end that; frames under way still arrive.

        Raises:
            LabError: As for :meth:`set_pairs`.
        """
        self._ask(SetOutage(frozenset(pairs), active))

    def set_carrier(self, ports: set[int], *, up: bool) -> None:
        """Pull or plug the cable at these ports; frames on their way to a pulled port are lost."""
        self._up().set_peers(sorted(ports), up=up)

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

    def problem(self) -> str | None:
        """What has gone wrong since the start, for a person; None if nothing."""
        # It only speaks when asked: something to read is the end.
        if self._channel is not None and select.select([self._channel], [], [], 0)[0]:
            return "the air process ended; no frame is carried any more; its last words are in the supervisor's log"
        return None

    def close(self) -> None:
        """Stop the process and close this process's descriptors; idempotent."""
        if self._channel is not None:
            with contextlib.suppress(LabError):
                self._ask(Close())
            self._channel.close()
            self._channel = None
        if self._pid:
            with contextlib.suppress(ChildProcessError):  # somebody who collects every child was faster
                os.waitpid(self._pid, 0)
            self._pid = 0
        if self._wiring is not None:
            self._wiring.close()
            self._wiring = None

    def _up(self) -> Wiring:
        if self._wiring is None:
            raise RuntimeError("the engine is not up")
        return self._wiring

    def _start_process(self) -> None:
        self._channel, self._pid = start_module("netlab.engines.air_process")

    def _ask(self, request: Request, fds: list[int] | None = None) -> Answer:
        """Send one request and wait until it is in force."""
        if self._channel is None:
            raise RuntimeError("the engine is not up")
        try:
            self._channel.send(request, fds or [])
            if not select.select([self._channel], [], [], _ANSWER_LIMIT_S)[0]:
                raise LabError(f"the air process has not answered for {_ANSWER_LIMIT_S:g} s")
            answer: Answer = self._channel.recv()[0]
        except (EOFError, OSError) as error:
            raise LabError(f"the air process is gone ({error}); its last words are in the supervisor's log") from error
        if isinstance(answer, Failed):
            raise LabError(answer.problem)
        return answer


def _veths(plan: LabPlan) -> list[VethSpec]:
    return [VethSpec(port.node, port.ifname, port.mac, port.address, port.mtu, f"p{port.index}") for port in plan.ports]
