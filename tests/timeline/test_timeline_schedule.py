"""When entries are due while a person holds the timeline, lets it go on and steps through it."""

from __future__ import annotations

from netlab.timeline import Entry, Kind, Nothing
from netlab.timeline.schedule import Schedule, Standstill


def entry(at_s: float, label: str = "") -> Entry:
    return Entry(at_s, Kind.MARK, label or f"at {at_s:g}", Nothing())


def labels(entries: list[Entry]) -> list[str]:
    return [each.label for each in entries]


def test_entries_are_due_at_their_times() -> None:
    schedule = Schedule([entry(1.0), entry(2.0)])
    assert schedule.next_due_s(0.0) == 1.0
    assert schedule.take_due(0.9) == []
    assert labels(schedule.take_due(1.0)) == ["at 1"]
    assert labels(schedule.take_due(5.0)) == ["at 2"]
    assert schedule.next_due_s(5.0) is None
    assert [(each.label, at_s) for each, at_s in schedule.done] == [("at 1", 1.0), ("at 2", 5.0)]


def test_a_hold_makes_everything_later_by_its_length() -> None:
    schedule = Schedule([entry(3.0)])
    schedule.standstill.hold("person", 1.0)
    assert schedule.is_held
    assert schedule.next_due_s(2.0) is None
    assert schedule.take_due(100.0) == []
    assert schedule.script_s(50.0) == 1.0
    schedule.standstill.release("person", 6.0)
    assert schedule.next_due_s(6.0) == 8.0
    assert schedule.script_s(7.0) == 2.0
    assert schedule.take_due(7.9) == []
    assert labels(schedule.take_due(8.0)) == ["at 3"]


def test_a_step_takes_a_whole_moment_and_leaves_the_rest() -> None:
    schedule = Schedule([entry(3.0, "a"), entry(3.0, "b"), entry(4.0)])
    assert labels(schedule.step(1.0)) == ["a", "b"]
    assert schedule.next_due_s(1.0) == 4.0
    assert schedule.take_due(3.5) == []
    assert labels(schedule.step(3.5)) == ["at 4"]
    assert schedule.step(3.6) == []


def test_what_is_dropped_does_not_come() -> None:
    first, second = entry(1.0), entry(2.0)
    schedule = Schedule([first, second])
    schedule.drop(first)
    assert schedule.coming == (second,)


def test_a_standstill_lasts_as_long_as_anybody_holds() -> None:
    still = Standstill()
    still.hold("a", 1.0)
    still.hold("b", 2.0)
    still.release("a", 3.0)
    assert still
    assert still.total_s(4.0) == 3.0
    still.release("b", 5.0)
    still.release("b", 6.0)  # once is enough
    assert not still
    assert still.total_s(9.0) == 4.0
    assert still.spans == [(1.0, 4.0)]
