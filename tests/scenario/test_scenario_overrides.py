"""`--set`: dotted paths anywhere, applied before validation, blamed in messages."""

import pytest

from netlab.errors import ScenarioError
from netlab.scenario import Scenario, parse_scenario

TEXT = """\
duration: 20s
nodes: {a: {processes: [udp_mesh]}, b: {processes: [udp_mesh]}}
links:
  - {between: [a, b], delay: 20ms}
"""


def load(*overrides: str, **options: object) -> Scenario:
    return parse_scenario(TEXT, name="s.yaml", overrides=overrides, **options)  # type: ignore[arg-type]


def refused(*overrides: str, **options: object) -> list[str]:
    with pytest.raises(ScenarioError) as caught:
        load(*overrides, **options)
    return caught.value.problems


def test_values_of_every_shape_can_be_set() -> None:
    scenario = load(
        "duration=5s",
        "links.0.delay=1ms",
        "links[0].loss={gemodel: {p: 1%, r: 25%}}",
        "nodes.a.position=[3, 4]",
        "nodes.c.processes=[udp_mesh]",
        "udp_mesh.prioritise=off",
        "udp_mesh.topics.telemetry.priority=0",
    )
    assert scenario.duration_s == 5.0
    assert scenario.links[0].delay_s == 0.001
    assert scenario.links[0].loss is not None
    assert scenario.links[0].loss.gemodel is not None
    assert scenario.nodes["a"].position == (3.0, 4.0)
    assert list(scenario.nodes) == ["a", "b", "c"]
    assert scenario.mesh_settings("a") == {"prioritise": False, "topics": {"telemetry": {"priority": 0}}}


def test_the_last_of_several_overrides_wins() -> None:
    assert load("seed=1", "seed=2").seed == 2


def test_seed_and_engine_win_over_the_file() -> None:
    scenario = load("seed=1", "engine=netem", seed=9, engine="air")
    assert (scenario.seed, scenario.engine) == (9, "air")


def test_generate_can_be_resized() -> None:
    text = "duration: 1s\ngenerate: {shape: line, count: 2}\n"
    assert len(parse_scenario(text, overrides=["generate.count=30"]).nodes) == 30


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("links.0.delay=20", "--set links.0.delay=20: links[0].delay: 20 has no unit; write a duration like 20ms"),
        ("links.0.dely=20ms", "--set links.0.dely=20ms: links[0].dely: unknown key 'dely'; did you mean 'delay'?"),
        ("links.0={between: [a, x]}", "--set links.0={between: [a, x]}: links[0].between[1]: node 'x' is not defined"),
        ("links.3.delay=1ms", "--set links.3.delay=1ms: links has 1 entries, numbered from 0; there is no 3"),
        ("links.x.delay=1ms", "--set links.x.delay=1ms: links is a list; name an entry by its number, 0 to 0"),
        ("duration.x=1", "--set duration.x=1: duration is '20s', which has no 'x' in it"),
        ("duration", "--set duration: is not of the form key.path=value"),
        ("=5", "--set =5: is not of the form key.path=value"),
        ("seed=", "--set seed=: the value is missing"),
        ("seed=[1", "--set seed=[1: not YAML"),
    ],
)
def test_a_wrong_override_is_blamed_itself(override: str, expected: str) -> None:
    found = refused(override)
    assert len(found) == 1, found
    assert found[0].startswith(expected)


def test_a_wrong_engine_option_is_blamed_itself() -> None:
    assert refused(engine="sim") == ["--engine sim: engine: engine 'sim' is not available yet; use auto, air, netem"]
