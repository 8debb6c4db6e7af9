"""The map without a widget: what a scene shows, what is where on it, what is written over it, rows as text."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from rich.style import Style

from netlab.capture.records import JsonRecord, kind_of
from netlab.live.links import Grade
from netlab.live.model import LiveModel, Tunnel
from netlab.tui import palette
from netlab.tui.braille import DOTS_X, Layer
from netlab.tui.map_labels import labels_of
from netlab.tui.map_rows import row_segments
from netlab.tui.projection import Bounds, Projection, fit
from netlab.tui.rock import ROCK_INK, draw_rock
from netlab.tui.scene import CHOSEN_INK, INKS, Chosen, Scene, places

ADIT = Tunnel("adit", ((0.0, 0.0), (100.0, 0.0)), 6.0)
COLUMNS, ROWS = 60, 16
PROJECTION = fit(Bounds(0, -20, 100, 20), COLUMNS, ROWS)


def team(where: Mapping[str, tuple[float, float]], *, carried: str = "", links: tuple[str, ...] = ()) -> LiveModel:
    """Nodes at places, and links such as `a-b`, all up."""
    model = LiveModel(tunnels=(ADIT,))
    for name, place in where.items():
        model._node(name).position_m = place
        model._node(name).active = name != carried
    for link in links:
        a, b = link.split("-")
        for sender, receiver in ((a, b), (b, a)):
            row: dict[str, object] = {"segment": "radio", "from": sender, "to": receiver, "state": "up"}
            model.take(JsonRecord(1, kind_of("/links"), "/links", "", row))
    return model


def scene_of(model: LiveModel, chosen: Chosen = None, target_m: tuple[float, float] | None = None) -> Scene:
    return Scene.of(model, PROJECTION, chosen=chosen, target_m=target_m)


def written(scene: Scene, **more: tuple[str, ...]) -> list[str]:
    labels = labels_of(scene, COLUMNS, ROWS, **more)
    return ["".join(labels.get(row, {}).get(column, (" ",))[0] for column in range(COLUMNS)) for row in range(ROWS)]


def test_scenes_are_equal_until_somebody_has_moved_by_a_dot() -> None:
    model = team({"a": (10, 0), "b": (50, 0)}, links=("a-b",))
    before = scene_of(model)
    model.nodes["a"].position_m = (10 + 0.01 / PROJECTION.dots_per_m, 0)
    assert scene_of(model) == before
    model.nodes["a"].position_m = (10 + 1.5 / PROJECTION.dots_per_m, 0)
    assert scene_of(model) != before
    assert scene_of(model, chosen="a") != scene_of(model)


def test_a_node_is_picked_before_a_link_and_nothing_far_off() -> None:
    scene = scene_of(team({"a": (0, 0), "b": (100, 0), "c": (0, 0)}, carried="c", links=("a-b",)))
    (a_column, row), (b_column, _) = scene.cells({"a", "b"}).values()
    assert scene.at(a_column + 2, row) == "a"  # and not the one that is carried
    assert scene.at((a_column + b_column) // 2, row) == frozenset(("a", "b"))
    assert scene.at((a_column + b_column) // 2, row + 4) is None


def test_lines_of_a_chosen_link_and_of_a_move() -> None:
    model = team({"a": (0, 0), "b": (100, 0)}, links=("a-b",))
    [plain] = scene_of(model).lines()
    assert plain[2] == INKS[Grade.GOOD]
    assert len(list(scene_of(model, chosen=frozenset(("a", "b"))).lines())) == 3
    *_, last = scene_of(model, chosen="a", target_m=(50.0, 0.0)).lines()
    assert last == (PROJECTION.dots((0, 0)), PROJECTION.dots((50, 0)), CHOSEN_INK, 4)


def test_names_stand_beside_their_nodes_and_make_room() -> None:
    lines = written(scene_of(team({"base": (0, 0), "robot": (100, 0), "relay": (0, 0)}, carried="relay")))
    assert any("● base" in line for line in lines)
    assert any("robot ●" in line for line in lines)  # no room at its right
    assert not any("relay" in line for line in lines)
    assert any("adit" in line for line in lines)
    assert any(" m" in line and "├" in line for line in lines)


def test_names_of_neighbours_do_not_cover_each_other() -> None:
    close_m = 4 * DOTS_X / PROJECTION.dots_per_m
    text = "\n".join(written(scene_of(team({"alpha": (50, 0), "bravo": (50 + close_m, 0)}))))
    assert text.count("●") == 2
    assert "alpha" in text
    assert "bravo" in text


def test_a_relay_has_a_sign_of_its_own_and_the_chosen_one_a_frame() -> None:
    model = team({"base": (0, 0), "relay": (50, 0)})
    assert any("▲  relay " in line for line in written(scene_of(model, chosen="relay"), relays=("relay",)))
    assert any("✚" in line for line in written(scene_of(model, chosen="relay", target_m=(20.0, 10.0))))


def test_without_places_there_is_no_scale() -> None:
    model = LiveModel()
    for name in ("a", "b"):
        model._node(name)
    assert len(set(places(model).values())) == 2
    assert not any("├" in line for line in written(scene_of(model)))


def test_bounds_widen_on_the_side_where_somebody_walks_out() -> None:
    shown = Bounds.of([(0, 0), (100, 50)])
    assert shown.holds(Bounds.of([(20, 20)]))
    out = Bounds.of([(110, 20)])
    assert not shown.holds(out)
    assert shown.widened(out) == Bounds(0, 0, pytest.approx(121), 50)


def test_rock_lies_around_a_floor_as_wide_as_the_tunnel() -> None:
    walls, floor = draw_rock([ADIT], PROJECTION, COLUMNS, ROWS)
    _, row = PROJECTION.cell((50, 0))
    assert floor[row, COLUMNS // 2]
    assert not floor[0].any()
    assert set(np.unique(walls.inks)) == {0, ROCK_INK}


def test_all_lines_are_drawn_at_once_as_one_by_one() -> None:
    lines = [((0.5, 0.5), (39.5, 20.5), 2, 1), ((5.5, 5.5), (5.5, 5.5), 3, 8), ((39.5, 0.5), (1.5, 30.5), 4, 3)]
    together, one_by_one = Layer(20, 8), Layer(20, 8)
    together.draw(lines)
    for (x0, y0), (x1, y1), ink, gap in lines:
        steps = max(1, round(max(abs(x1 - x0), abs(y1 - y0))))
        for step in range(0, steps + 1, gap):
            x, y = x0 + (x1 - x0) * step / steps, y0 + (y1 - y0) * step / steps
            one_by_one.set(np.array([x]), np.array([y]), np.array([ink], dtype=np.uint8))
    assert (together.masks == one_by_one.masks).all()
    assert (together.inks == one_by_one.inks).all()


def test_a_row_is_cut_where_the_style_changes() -> None:
    written_over = {1: ("x", Style(color=palette.DIM))}
    segments = list(row_segments("⠁⠁⠁⠁", [2, 2, 2, 3], [True, True, False, False], written_over))
    assert [segment.text for segment in segments] == ["⠁", "x", "⠁", "⠁"]
    styles = [segment.style for segment in segments]
    assert styles[1] == Style(color=palette.DIM, bgcolor=palette.FLOOR)
    assert styles[2] == Style(color=palette.GRADES[Grade.OUT_OF_RANGE], bgcolor=palette.GROUND)
    assert "".join(segment.text for segment in row_segments("⠁" * DOTS_X, [2, 2], [True, True], {})) == "⠁⠁"


def test_places_of_all_or_none() -> None:
    model = team({"a": (0, 0)})
    model._node("b")  # nobody has said where it is
    assert places(model)["a"] != (0, 0)


def test_projections_of_one_point_show_it() -> None:
    assert isinstance(fit(Bounds.of([]), 10, 10), Projection)
