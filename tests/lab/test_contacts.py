"""Contacts of radios that move: made and lost with patience, and what that means for nodes."""

from __future__ import annotations

import numpy as np
import pytest

from netlab.lab.contacts import LOST_AFTER_S, MADE_AFTER_S, Contacts

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
