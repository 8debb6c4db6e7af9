"""Cross-reference check of motion: who follows and carries whom, what lies in the rock, what is dropped and moved."""

from __future__ import annotations

from collections.abc import Iterator

from netlab.scenario.check_topology import Names
from netlab.scenario.document import Path
from netlab.scenario.model import Scenario
from netlab.scenario.motion import choreography
from netlab.scenario.problems import Problem
from netlab.scenario.recover import Doubt
from netlab.world.choreography import Choreography
from netlab.world.motion import MotionError


def check_motion(scenario: Scenario, doubt: Doubt) -> Iterator[Problem]:
    """Yield every mistake in how nodes move."""
    names = Names(scenario, doubt)
    found = [
        *_nodes(scenario, names),
        *_file(scenario, names),
        *_deployments(scenario, names),
        *_moves(scenario, names),
    ]
    yield from found
    certain = not found and names.certain and not {"terrain", "motion"} & doubt.sections
    if certain and not doubt.nodes:  # else somebody's leader may be missing
        yield from _places(scenario)


def _nodes(scenario: Scenario, names: Names) -> Iterator[Problem]:
    for name, node in scenario.nodes.items():
        for key, other in (("follow", node.follow), ("carried_by", node.carried_by)):
            if other is not None and (complaint := names.complaint(other)):
                yield ("nodes", name, key), complaint
    for index, link in enumerate(scenario.links):
        for end in link.ends:
            if end in scenario.nodes and scenario.nodes[end].carried_by is not None:
                yield ("links", index), f"'{end}' is carried until it is dropped, and no wire can join it; remove one"


def _file(scenario: Scenario, names: Names) -> Iterator[Problem]:
    if scenario.motion is None:
        return
    for name in scenario.motion.tracks:
        if complaint := names.complaint(name):
            yield ("motion", "file"), f"{scenario.motion.file}: {complaint}"
        elif name in scenario.nodes and (key := scenario.nodes[name].motion_key):
            yield ("nodes", name, key), f"the motion of '{name}' is in {scenario.motion.file}; remove one of the two"


def _deployments(scenario: Scenario, names: Names) -> Iterator[Problem]:
    deployed: dict[str, int] = {}
    for index, event in enumerate(scenario.events):
        if (name := event.deploy) is None:
            continue
        if complaint := names.complaint(name):
            yield ("events", index, "deploy"), complaint
        elif name in scenario.nodes and scenario.nodes[name].carried_by is None:
            yield ("events", index, "deploy"), f"nobody carries '{name}'; add carried_by to it, or remove the event"
        elif (first := deployed.setdefault(name, index)) != index:
            yield ("events", index, "deploy"), f"'{name}' is dropped twice (first by events[{first}]); remove one"
    times = {name: scenario.events[index].at_s for name, index in deployed.items()}
    for index, event in enumerate(scenario.events):
        part = event.move or event.kill
        node = scenario.nodes.get(part.node) if part is not None else None
        if part is None or node is None or node.carried_by is None:
            continue
        if event.at_s < times.get(part.node, scenario.duration_s):
            path: Path = ("events", index, "kill" if event.move is None else "move", "node")
            yield path, f"'{part.node}' is still carried then; let it be dropped before"


def _moves(scenario: Scenario, names: Names) -> Iterator[Problem]:
    for index, event in enumerate(scenario.events):
        if event.move is not None and (complaint := names.complaint(event.move.node)):
            yield ("events", index, "move", "node"), complaint


def _places(scenario: Scenario) -> Iterator[Problem]:
    moving = scenario.terrain is not None or any(node.motion_key for node in scenario.nodes.values())
    if not moving:
        return
    plan = choreography(scenario)
    for name in scenario.nodes:
        if (problem := _track_problem(plan, scenario, name)) is not None:
            yield problem


def _track_problem(plan: Choreography, scenario: Scenario, name: str) -> Problem | None:
    try:
        plan.track(name)
    except MotionError as error:
        if error.node != name:  # told where it belongs
            return None
        return _written(error, scenario), f"{_sample(error, scenario)}{error}"
    return None


def _sample(error: MotionError, scenario: Scenario) -> str:
    """File and time of the sample that a problem is about, if it is about one."""
    if error.part != "sample" or error.index is None:
        return ""
    own, common = scenario.nodes[error.node].motion, scenario.motion
    if own is not None:
        return f"{own.file}: at {own.track.times_s[error.index]:g} s: "
    assert common is not None
    return f"{common.file}: at {common.tracks[error.node].times_s[error.index]:g} s: "


def _written(error: MotionError, scenario: Scenario) -> Path:
    """The part of the file that a problem is about."""
    name, node = error.node, scenario.nodes[error.node]
    if error.part == "move":
        events = [index for index, event in enumerate(scenario.events) if event.move is not None]
        return ("events", events[error.index or 0], "move", "to")
    if error.part == "sample":
        return ("motion", "file") if node.motion is None else ("nodes", name, "motion", "file")
    if error.part == "waypoint":
        skipped = 0 if "position" in node.model_fields_set else 1
        return ("nodes", name, "waypoints", (error.index or 0) + skipped)
    if error.part == "start":
        return (
            ("nodes", name, "waypoints", 0)
            if node.waypoints and "position" not in node.model_fields_set
            else ("nodes", name, "position")
        )
    return ("nodes", name, node.motion_key or "position")
