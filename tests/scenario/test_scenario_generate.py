"""`generate`: shapes, templates, what may stand beside it, and whom messages blame."""

from collections import Counter

import pytest
from hypothesis import given
from hypothesis import strategies as st

from netlab.errors import ScenarioError
from netlab.scenario import Scenario, parse_scenario
from netlab.scenario.generate import Generate


def generated(shape: str, count: int, **more: object) -> Scenario:
    return parse_scenario({"duration": "1s", "generate": {"shape": shape, "count": count, "name": "r", **more}})


def ends(scenario: Scenario) -> list[str]:
    return [f"{a}-{b}" for a, b in (link.ends for link in scenario.links)]


@pytest.mark.parametrize(
    ("shape", "count", "expected"),
    [
        ("line", 4, ["r1-r2", "r2-r3", "r3-r4"]),
        ("line", 1, []),
        ("star", 4, ["r1-r2", "r1-r3", "r1-r4"]),
        ("grid", 5, ["r1-r2", "r1-r4", "r2-r3", "r2-r5", "r4-r5"]),
        ("full", 3, ["r1-r2", "r1-r3", "r2-r3"]),
    ],
)
def test_the_shapes(shape: str, count: int, expected: list[str]) -> None:
    scenario = generated(shape, count)
    assert list(scenario.nodes) == [f"r{number}" for number in range(1, count + 1)]
    assert sorted(ends(scenario)) == sorted(expected)


@given(st.sampled_from(["line", "star", "grid", "full"]), st.integers(1, 60))
def test_every_shape_is_connected_without_doubles_and_nobody_stands_on_another(shape: str, count: int) -> None:
    generator = Generate(shape=shape, count=count)  # type: ignore[arg-type]
    joined = list(generator.joined())
    assert max(Counter(map(frozenset, joined)).values(), default=1) == 1
    reached, frontier = {0}, [0]
    while frontier:
        here = frontier.pop()
        near = {b if a == here else a for a, b in joined if here in (a, b)} - reached
        reached |= near
        frontier += near
    assert reached == set(range(count))
    assert len({tuple(generator.position(index)) for index in range(count)}) == count


def test_templates_reach_every_node_and_link() -> None:
    scenario = generated("line", 3, node={"processes": ["udp_mesh"]}, link={"delay": "2ms", "loss": "1%"})
    assert all(node.process("udp_mesh") for node in scenario.nodes.values())
    assert {link.delay_s for link in scenario.links} == {0.002}


def test_named_nodes_and_links_beside_it_are_kept_and_win() -> None:
    scenario = parse_scenario(
        """
duration: 1s
generate: {shape: line, count: 3, name: r, node: {processes: [udp_mesh], position: [1, 1]}}
nodes:
  base: {position: [9, 9]}
  r2: {position: [5, 5]}
links:
  - {between: [base, r1], delay: 1ms}
"""
    )
    assert list(scenario.nodes) == ["r1", "r2", "r3", "base"]
    assert scenario.nodes["r2"].position == (5.0, 5.0)
    assert scenario.nodes["r2"].process("udp_mesh") is not None
    assert ends(scenario) == ["base-r1", "r1-r2", "r2-r3"]


@pytest.mark.parametrize(
    ("block", "expected"),
    [
        ("{shape: line, count: 9999}", "s.yaml:2: generate.count: '9999' is impossible; it must be at most 2000"),
        ("{shape: full, count: 2000}", "s.yaml:2: generate: 2000 nodes in full make 1,999,000 links; the most is"),
        ("{shape: ring, count: 3}", "s.yaml:2: generate.shape: 'ring' is not possible here; use line, star, grid"),
        ("{shape: line, count: 3, link: {delay: 5}}", "s.yaml:2: generate.link.delay: 5 has no unit"),
        ("{shape: line, count: 3, node: {proc: []}}", "s.yaml:2: generate.node.proc: unknown key 'proc'"),
        ("{shape: line, count: 3, link: {reorder: 5%}}", "s.yaml:2: generate.link: reorder lets frames overtake"),
        ("{shape: line, count: 3, name: a_b}", "s.yaml:2: generate.name: 'a_b' is not a valid hostname"),
    ],
)
def test_a_mistake_in_the_block_is_reported_once_where_it_was_written(block: str, expected: str) -> None:
    with pytest.raises(ScenarioError) as caught:
        parse_scenario(f"duration: 1s\ngenerate: {block}\n", name="s.yaml")
    problems = [problem for problem in caught.value.problems if "nodes: is missing" not in problem]
    assert len(problems) == 1, problems
    assert problems[0].startswith(expected)
