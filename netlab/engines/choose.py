"""Which engine a scenario gets: the one it names, or for `auto` netem where kernel and scenario allow it, else air."""

from __future__ import annotations

from collections.abc import Iterable

from netlab.engines.air import AirEngine
from netlab.engines.base import Engine, LabPlan
from netlab.engines.hwsim import HwsimEngine, has_wifi, wires_of
from netlab.engines.netem import NetemEngine
from netlab.engines.netem_radio import NetemRadios, without_airtime
from netlab.kernel.netem import inexpressible
from netlab.kernel.probe import in_child, tc_features
from netlab.medium.impairments import Impairment


def make_engine(wanted: str, plan: LabPlan, later: Iterable[Impairment]) -> tuple[str, Engine]:
    """Return the engine's name and the engine, not yet brought up.

    Args:
        wanted: ``auto``, ``air`` or ``netem``.
        plan: What to build.
        later: Impairments that the timeline will set.

    Raises:
        MachineError: ``netem`` was asked for and cannot express the scenario.
    """
    if any(segment.channel is not None for segment in plan.segments):
        if wanted == "netem":
            return "netem", NetemRadios(plan, NetemEngine(without_airtime(plan)))
        return "air", AirEngine(plan)
    if has_wifi(plan):
        name, wires = make_engine(wanted, wires_of(plan), later)
        return name, HwsimEngine(plan, wires)
    if wanted == "netem" or (wanted == "auto" and _netem_suits(plan, later)):
        return "netem", NetemEngine(plan)
    return "air", AirEngine(plan)


def _netem_suits(plan: LabPlan, later: Iterable[Impairment]) -> bool:
    now = (impairment for segment in plan.segments for impairment in segment.pairs.values())
    if any(inexpressible(impairment) is not None for group in (now, later) for impairment in group):
        return False
    return in_child(lambda: tc_features().netem_problem) is None
