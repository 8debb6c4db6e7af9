"""Commands: repeated until answered, carried out once."""

from __future__ import annotations

import itertools

import pytest

from rose.core.addressing import ServiceId
from rose.core.calls import RUNNING, AnswerCache, repeat_at

ASKER = ServiceId.parse("10.0.0.1/0.1")


def test_repetitions_grow_apart_and_end_before_the_time_is_over() -> None:
    assert list(repeat_at(timeout_s=2.0)) == pytest.approx([0.0, 0.05, 0.15, 0.35, 0.75, 1.55])
    assert list(repeat_at(timeout_s=0.01)) == [0.0]
    pauses = [b - a for a, b in itertools.pairwise(repeat_at(timeout_s=30.0))]
    assert max(pauses) == pytest.approx(1.0)


def test_a_command_begins_once_and_has_one_answer() -> None:
    cache: AnswerCache[str] = AnswerCache()
    key = (ASKER, 1, 7)
    assert cache.begin(key, now=0.0) is None
    assert cache.begin(key, now=0.1) is RUNNING
    cache.finish(key, "done", now=0.2)
    assert cache.begin(key, now=0.3) == "done"
    assert cache.begin((ASKER, 2, 7), now=0.3) is None  # the asker has started anew since


def test_answers_are_forgotten_after_their_time_and_beyond_their_number() -> None:
    cache: AnswerCache[str] = AnswerCache(answers_max=3, remember_s=10.0)
    for number in range(5):
        cache.begin((ASKER, 1, number), now=0.0)
        cache.finish((ASKER, 1, number), str(number), now=0.0)
    assert cache.begin((ASKER, 1, 4), now=1.0) == "4"
    assert cache.begin((ASKER, 1, 0), now=1.0) is None
    assert cache.begin((ASKER, 1, 4), now=10.5) is None
