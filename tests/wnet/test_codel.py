"""CoDel against RFC 8289: bursts pass, a standing queue is shortened at the pace of its control law."""

from __future__ import annotations

from collections import deque

import pytest

from wnet.core.codel import INTERVAL_S, CoDel

TARGET_S = 0.02


def served(offered_hz: float, served_hz: float, lasts_s: float) -> tuple[list[float], list[float]]:
    """A queue that is served at a constant rate: (when, waited) of what left it, and when something was dropped."""
    judge, queue, left, dropped = CoDel(TARGET_S), deque[float](), list[float](), list[float]()
    arrivals = 0
    for turn in range(round(lasts_s * served_hz)):
        now = turn / served_hz
        while arrivals / offered_hz <= now:
            queue.append(arrivals / offered_hz)
            arrivals += 1
        while queue:
            waited_s = now - queue.popleft()
            if not judge.should_drop(waited_s, is_last=not queue, now=now):
                left.append(waited_s)
                break
            dropped.append(now)
    return left, dropped


def test_what_the_channel_carries_is_never_dropped() -> None:
    _left, dropped = served(190.0, 200.0, 10.0)
    assert dropped == []


def test_of_too_much_as_much_leaves_as_before_and_soon_it_is_on_time() -> None:
    left, dropped = served(250.0, 200.0, 10.0)
    assert len(left) == 2000, "the channel is never idle"
    assert max(left) < 0.15, "before it has found its pace"
    late = sorted(left[400:])
    assert late[len(late) // 2] < 2 * TARGET_S, "then, not seconds late"
    assert len(dropped) == pytest.approx(500, rel=0.1)


def test_a_burst_that_drains_within_the_interval_passes() -> None:
    judge = CoDel(TARGET_S)
    waits = [(turn * 0.005, turn * 0.005) for turn in range(20)]  # twenty at once, served in 95 ms
    assert not any(judge.should_drop(waited_s, is_last=False, now=now) for waited_s, now in waits)


def test_the_pauses_between_drops_follow_the_control_law() -> None:
    judge = CoDel(TARGET_S)
    drops = [now for now in (turn / 1000 for turn in range(500)) if judge.should_drop(0.1, is_last=False, now=now)]
    pauses = [INTERVAL_S, *(INTERVAL_S / count**0.5 for count in range(1, 7))]
    due = [sum(pauses[: count + 1]) for count in range(len(pauses))]
    assert drops == pytest.approx(due[: len(drops)], abs=0.0011)
    assert len(drops) == 7


def test_a_queue_that_stood_just_now_is_shortened_at_the_pace_of_then() -> None:
    judge = CoDel(TARGET_S)
    for turn in range(1000):
        judge.should_drop(0.1, is_last=False, now=turn / 1000)
    assert not judge.should_drop(0.001, is_last=False, now=1.0)
    again = [
        now for now in (1.0 + turn / 1000 for turn in range(200)) if judge.should_drop(0.1, is_last=False, now=now)
    ]
    assert again[0] == pytest.approx(1.1, abs=0.0011)
    assert again[1] - again[0] < INTERVAL_S / 3


def test_the_last_frame_of_a_queue_stays() -> None:
    judge = CoDel(TARGET_S)
    assert not any(judge.should_drop(0.5, is_last=True, now=turn / 100) for turn in range(100))
