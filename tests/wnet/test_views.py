"""What the command prints of a link that carries nothing."""

from __future__ import annotations

import json
from typing import Any

import pytest

from wnet.views import answer, dot, table


def test_a_link_in_one_direction_has_no_cost_in_any_form(make_mesh_net: Any) -> None:
    net = make_mesh_net()
    net.line("ab")
    net.one_way("b", "a", is_cut=True)
    net.run(3.0)
    told = answer("links", net.stations["b"].mesh.snapshot(now=net.now))
    [link] = json.loads(json.dumps(told, allow_nan=False))["links"]
    assert (link["is_usable"], link["cost_out"]) == (False, None)
    assert table("links", told).splitlines()[1].split()[2] == "down"
    assert "->" not in dot("links", told)


def test_a_usable_link_is_an_edge_with_its_cost(make_mesh_net: Any) -> None:
    net = make_mesh_net()
    net.line("ab")
    net.run(3.0)
    told = answer("links", net.stations["a"].mesh.snapshot(now=net.now))
    assert told["links"][0]["cost_out"] == pytest.approx(1.0, abs=0.01)
    assert dot("links", told).count('[label="1.00"]') == 1
