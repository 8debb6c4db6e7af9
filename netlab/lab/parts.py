"""The parts of one running lab that its scenario, a person's acts and the control socket's requests work on."""

from __future__ import annotations

from dataclasses import dataclass

from netlab.engines.base import LabPlan
from netlab.lab.links import Links
from netlab.lab.motion import Motion
from netlab.lab.processes import Processes
from netlab.lab.recording import Recording
from netlab.scenario.model import Scenario


@dataclass(frozen=True, slots=True)
class Parts:
    """What the scenario says, and what has been brought up of it."""

    scenario: Scenario
    plan: LabPlan
    links: Links
    processes: Processes
    recording: Recording
    motion: Motion
