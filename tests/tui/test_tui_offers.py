"""What a person can pick next: nodes and links in a circle, relays, processes."""

from __future__ import annotations

import pytest

from netlab.live.model import LiveModel
from netlab.tui import offers
from netlab.tui.standing import Standing


def nodes(*names: str, carried: tuple[str, ...] = ()) -> LiveModel:
    model = LiveModel()
    for name in (*names, *carried):
        model._node(name).active = name not in carried
    return model


@pytest.mark.parametrize(
    ("chosen", "step", "expected"),
    [(None, 1, "a"), (None, -1, "c"), ("a", 1, "b"), ("c", 1, "a"), ("a", -1, "c"), (frozenset("ab"), 1, "a")],
)
def test_nodes_go_in_a_circle(chosen: str | frozenset[str] | None, step: int, expected: str) -> None:
    assert offers.next_node(nodes("a", "b", "c", carried=("relay",)), chosen, step) == expected


def test_where_there_is_nothing_nothing_is_next() -> None:
    assert offers.next_node(LiveModel(), None, 1) is None
    assert offers.next_link(nodes("a", "b"), None, 1) is None


def test_relays_of_the_chosen_carrier_come_first() -> None:
    model = nodes("r1", "r2", "dropped", carried=("x", "y"))
    carriers = {"x": "r1", "y": "r2", "dropped": "r1"}
    assert offers.waiting_relays(model, carriers, None) == {"x": "r1", "y": "r2"}
    assert offers.waiting_relays(model, carriers, "r2") == {"y": "r2"}
    assert offers.waiting_relays(model, carriers, "base") == {"x": "r1", "y": "r2"}


def test_the_labs_own_traffic_is_not_offered() -> None:
    rows = [("udp_mesh", "ready"), ("traffic-source", "ready"), ("mapper", "exited")]
    standing = Standing(processes=tuple({"node": "a", "process": name, "state": state} for name, state in rows))
    own = offers.own_processes(standing, "a")
    assert offers.process_names(own, lambda state: state != "exited") == ["udp_mesh"]
    assert offers.told_states(own) == "udp_mesh is ready, mapper is exited"
    assert offers.told_states(offers.own_processes(standing, "b")) == "it runs nothing"
