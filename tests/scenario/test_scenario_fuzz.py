"""Whatever a file holds, the answer is a scenario that compiles or a list of problems, never another error."""

import copy
from typing import Any

from hypothesis import example, given, settings
from hypothesis import strategies as st

from netlab.engines.plan import compile_plan
from netlab.errors import ScenarioError
from netlab.scenario import parse_scenario
from netlab.timeline import compile_timeline

SOUND: dict[str, Any] = {
    "duration": "20s",
    "udp_mesh": {"window": 3},
    "radio": {"delay": "1ms", "propagation": {"model": "table", "pairs": [{"between": ["a", "c"], "loss": "2%"}]}},
    "nodes": {
        "a": {"processes": ["udp_mesh"], "position": [0, 0]},
        "b": {"processes": ["udp_mesh", {"argv": ["sleep", "9"]}]},
        "c": {},
    },
    "links": [{"between": ["a", "b"], "loss": {"gemodel": {"p": "1%"}}}, {"from": "b", "to": "a", "delay": "1ms"}],
    "traffic": [{"from": "a", "to": ["b"], "topic": "t", "size": "100B", "rate": "1Hz"}],
    "events": [
        {"at": "1s", "outage": {"between": ["a", "b"], "for": "2s"}},
        {"at": "2s", "flap": {"between": ["a", "c"], "up": "1s", "down": "1s", "until": "9s"}},
        {"at": "3s", "link": {"from": "a", "to": "b", "over": "wire", "loss": "5%"}},
        {"at": "4s", "kill": {"node": "b", "process": "sleep"}, "restart": "1s"},
    ],
    "expect": [{"latency": {"topic": "t"}, "p99": "1s"}, {"reconnect": {"between": ["a", "b"]}, "max": "1s"}],
    "generate": {"shape": "line", "count": 2, "name": "g", "node": {"radio": "none"}, "link": {"limit": "64kB"}},
}


def paths_of(data: object, here: tuple[str | int, ...] = ()) -> list[tuple[str | int, ...]]:
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    return [here, *(path for key, value in items for path in paths_of(value, (*here, key)))]


_PATHS = [path for path in paths_of(SOUND) if path]
_SCALARS = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-5, 2**70),
    st.floats(),
    st.sampled_from(["", "a", "c", "zz", "10ms", "5%", "-1s", "none", "all", "table", "udp_mesh", "{x}", "<latency>"]),
    st.text(max_size=4),
)
_VALUES = st.recursive(
    _SCALARS,
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.sampled_from(["a", "at", "to", "<x>"]), inner),
    max_leaves=4,
)
_DELETE = "delete this"


def edited(edits: list[tuple[tuple[str | int, ...], Any]]) -> dict[str, Any]:
    data: Any = copy.deepcopy(SOUND)
    for path, value in edits:
        here = data
        try:
            for part in path[:-1]:
                here = here[part]
            if value == _DELETE:
                del here[path[-1]]
            else:
                here[path[-1]] = value
        except (KeyError, IndexError, TypeError):
            continue  # an earlier edit took the place away
    return data  # type: ignore[no-any-return]


def outcome(data: dict[str, Any]) -> list[str] | None:
    """The problems of ``data``; None when it is sound and compiles."""
    try:
        scenario = parse_scenario(data)
    except ScenarioError as error:
        return error.problems
    compile_timeline(scenario, compile_plan(scenario))
    return None


def test_the_starting_point_is_sound() -> None:
    assert outcome(SOUND) is None


@settings(max_examples=300, deadline=None)
@given(st.lists(st.tuples(st.sampled_from(_PATHS), st.one_of(st.just(_DELETE), _VALUES)), min_size=1, max_size=4))
@example([(("links", 0), None), (("links", 1, "to"), "zz")])
def test_any_edit_gives_a_scenario_or_problems(edits: list[tuple[tuple[str | int, ...], Any]]) -> None:
    found = outcome(edited(edits))
    assert found is None or (found and all(text.strip() and "Value error" not in text for text in found))
