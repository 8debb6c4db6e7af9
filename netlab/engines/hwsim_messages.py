"""What the lab tells the process of the 802.11 radios, over one ``netlab.ipc.Channel``; every message is answered.

``SetPairs``, ``SetOutage``, ``RecordVerdicts``, ``AskStats``, ``Close``, ``Done`` and ``Failed`` are the air process's.
"""

from __future__ import annotations

from dataclasses import dataclass

from netlab.engines.air_messages import AskStats, Close, Done, Failed, RecordVerdicts, SetOutage, SetPairs
from netlab.medium.segments import Port, Segment
from netlab.medium.verdicts import Verdict


@dataclass(frozen=True, slots=True)
class MakeRadios:
    """The first message, answered with :class:`RadiosMade`. ``names`` has one name per port of the segments."""

    ports: tuple[Port, ...]
    segments: tuple[Segment, ...]
    seed: int
    names: dict[int, str]


@dataclass(frozen=True, slots=True)
class RadiosMade:
    """All radios exist in the process's network namespace, without interfaces, and the medium carries their frames."""


@dataclass(frozen=True, slots=True)
class HwsimStats:
    """Counters since the start. All but ``frames`` and ``verdicts`` should stay 0 on a machine that keeps up."""

    frames: int
    verdicts: dict[Verdict, int]
    unaddressed: int  # unicast to an address that no radio has
    unknown_radio: int
    malformed: int
    overruns: int  # times that the kernel found the process too slow
    refused: dict[str, int]  # deliveries and statuses that the kernel did not take, by error
    lost_verdicts: int


HwsimRequest = MakeRadios | SetPairs | SetOutage | RecordVerdicts | AskStats | Close
HwsimAnswer = Done | Failed | RadiosMade | HwsimStats
