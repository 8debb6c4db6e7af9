"""Contacts of radios that move: made and lost with patience, and what that means for nodes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from netlab.engines.base import Pair
from netlab.engines.plan import compile_plan
from netlab.lab.contacts import LOST_AFTER_S, MADE_AFTER_S, Contacts, ContactWatch
from netlab.lab.links import Links
from netlab.lab.recording import Recording
from netlab.scenario import parse_scenario

TICK_S = 0.05


def heard(*pairs: tuple[int, int], count: int = 3) -> np.ndarray:
    matrix = np.zeros((count, count), dtype=bool)
    for one, other in pairs:
        matrix[one, other] = matrix[other, one] = True
    return matrix


def changes(
    contacts: Contacts, matrix: np.ndarray, from_s: float, to_s: float
) -> list[tuple[float, float, tuple[int, int]]]:
    found = []
    for number in range(round(from_s / TICK_S), round(to_s / TICK_S)):
        at_s = number * TICK_S
        found += [(at_s, since_s, (one, other)) for one, other, since_s in contacts.update(matrix, at_s)]
    return found


def test_what_is_heard_at_the_beginning_is_no_news() -> None:
    contacts = Contacts(3)
    assert contacts.update(heard((0, 1)), 0.0) == []
    assert contacts.made[0, 1]
    assert not contacts.made[1, 2]


def test_a_contact_is_made_soon_and_lost_late() -> None:
    contacts = Contacts(3)
    contacts.update(heard(), 0.0)
    [(made_s, since_s, pair)] = changes(contacts, heard((1, 2)), 1.0, 3.0)
    assert pair == (1, 2)
    assert since_s == pytest.approx(1.0)
    assert made_s == pytest.approx(1.0 + MADE_AFTER_S)
    [(lost_s, since_s, pair)] = changes(contacts, heard(), 3.0, 6.0)
    assert pair == (1, 2)
    assert lost_s == pytest.approx(3.0 + LOST_AFTER_S)


def test_one_direction_is_no_contact() -> None:
    contacts = Contacts(2)
    contacts.update(np.zeros((2, 2), dtype=bool), 0.0)
    one_way = np.array([[False, True], [False, False]])
    assert changes(contacts, one_way, 0.0, 3.0) == []


def test_a_fade_in_between_begins_the_wait_anew() -> None:
    contacts = Contacts(2)
    contacts.update(heard((0, 1), count=2), 0.0)
    assert changes(contacts, heard(count=2), 0.05, 1.0) == []
    assert changes(contacts, heard((0, 1), count=2), 1.0, 1.05) == []
    assert changes(contacts, heard(count=2), 1.05, 2.0) == []
    [(lost_s, since_s, _)] = changes(contacts, heard(count=2), 2.0, 2.2)
    assert since_s == pytest.approx(1.05)
    assert lost_s == pytest.approx(2.05)


class Notes(Recording):
    """Keeps what would be recorded on the timeline."""

    def __init__(self) -> None:
        super().__init__(None)
        self.acts: list[dict[str, Any]] = []

    def message(self, topic: str, payload: dict[str, Any], t_ns: int) -> None:
        self.acts.append(payload)


class Held(Links):
    """Links of which some pairs are held down."""

    def __init__(self, *pairs: Pair) -> None:
        self._pairs = pairs

    def is_held(self, pair: Pair) -> bool:
        return pair in self._pairs


def acts(matrices: list[np.ndarray], held: Held, mesh: str = "none") -> list[dict[str, Any]]:
    """What is recorded of radios a, b and c (ports 0, 1, 2) when each matrix holds for two seconds."""
    node = {"processes": ["udp_mesh"]}
    scenario = parse_scenario(
        {
            "duration": "60s",
            "mesh": mesh,
            "radio": {"propagation": {"model": "none"}},
            "nodes": {"a": node, "b": node, "c": node},
            "traffic": [{"from": "a", "to": "c", "topic": "t", "size": "99B", "rate": "1Hz"}],
        }
    )
    plan, notes = compile_plan(scenario), Notes()
    watch = ContactWatch(scenario, plan, plan.segments, held, notes)
    for number, matrix in enumerate(matrices):
        for tick in range(40):
            watch.update([matrix], 2.0 * number + tick * TICK_S)
    assert watch.is_made("a", "b") is bool(matrices[-1][0, 1])
    return notes.acts


def test_a_contact_that_is_made_restores_its_nodes() -> None:
    lost, made = acts([heard((0, 1)), heard(), heard((0, 1))], Held())
    assert (lost["label"], lost["at_s"], lost["restores"]) == ("a and b lose each other", 2.0, None)
    assert (made["label"], made["at_s"], made["restores"]) == ("a and b hear each other", 4.0, ["a", "b"])


def test_what_is_held_down_is_not_restored() -> None:
    _lost, made = acts([heard((0, 1)), heard(), heard((0, 1))], Held((1, 0)))
    assert made["restores"] is None


def test_in_a_mesh_the_ends_of_streams_are_joined_by_paths() -> None:
    line, triangle = heard((0, 1), (1, 2)), heard((0, 1), (1, 2), (0, 2))
    more, less, broken, whole = acts([line, triangle, line, heard((0, 1)), line], Held(), mesh="flood")
    assert (more["label"], more["rejoins"]) == ("a and c hear each other", [])
    assert (less["label"], less["reroutes"]) == ("a and c lose each other", [("a", "c")])
    assert (broken["label"], broken["reroutes"]) == ("b and c lose each other", [])
    assert (whole["label"], whole["rejoins"], whole["restores"]) == ("b and c hear each other", [("a", "c")], None)
