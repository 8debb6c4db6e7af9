"""What the engine tells the process of the medium, over one ``netlab.ipc.Channel``; every message is answered."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from netlab.engines.base import LabPlan, Pair
from netlab.medium.impairments import Impairment
from netlab.medium.verdicts import Verdict

if TYPE_CHECKING:
    from netlab.medium.channel_records import ChannelStats


@dataclass(frozen=True, slots=True)
class Setup:
    """The first message. ``ifindexes[i]`` is the far end of ``plan.ports[i]`` in the process's network namespace.

    0 for a radio in monitor mode, whose other end comes with :class:`AddMonitor`.
    """

    plan: LabPlan
    ifindexes: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class AddMonitor:
    """Comes with one descriptor: the other end of the interface of a port in monitor mode."""

    port: int


@dataclass(frozen=True, slots=True)
class SetPairs:
    """See ``Engine.set_pairs``."""

    changes: dict[Pair, Impairment | None]


@dataclass(frozen=True, slots=True)
class SetOutage:
    """See ``Engine.set_outage``."""

    pairs: frozenset[Pair]
    active: bool


@dataclass(frozen=True, slots=True)
class SetRssi:
    """See ``Engine.set_rssi``. ``matrix``: float32 in the machine's order, row by row, a row for each sender."""

    segment: str
    matrix: bytes


@dataclass(frozen=True, slots=True)
class RecordVerdicts:
    """Comes with one descriptor: a stream socket. Replaces an earlier one."""


@dataclass(frozen=True, slots=True)
class AskStats:
    """Answered with :class:`AirStats`."""


@dataclass(frozen=True, slots=True)
class Close:
    """Answered, then the process ends."""


Request = Setup | AddMonitor | SetPairs | SetOutage | SetRssi | RecordVerdicts | AskStats | Close


@dataclass(frozen=True, slots=True)
class Done:
    """The request is in force: every frame that leaves a node from now on meets it."""


@dataclass(frozen=True, slots=True)
class Failed:
    """The request changed nothing; ``problem`` is for a person."""

    problem: str


@dataclass(frozen=True, slots=True)
class AirStats:
    """Counters since the start. All but ``received`` and ``verdicts`` should stay 0 on a machine that keeps up."""

    received: int
    verdicts: dict[Verdict, int]
    ring_losses: int  # the process was too slow to empty the ring
    oversized: int  # longer than the ring's slots
    malformed: int  # without the headers of a radio in monitor mode, from one that is
    unaddressed: int  # unicast on a radio to an address that nobody owns
    not_sent: int  # refused by the kernel at the receiver's port: carrier pulled, longer than its MTU
    lost_verdicts: int  # records that the recorder did not take in time
    late_max_s: float  # the most that a departure was late
    late_p99_s: float = 0.0  # 99 % of the departures were late by less
    channels: dict[str, ChannelStats] = field(default_factory=dict)  # by segment


Answer = Done | Failed | AirStats
