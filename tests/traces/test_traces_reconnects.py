from __future__ import annotations

from typing import Any

import pytest

from netlab.traces.reconnects import reconnects


def delays(story: Any) -> list[float | None]:
    return [entry.delay_s for entry in reconnects(story.trace)]


def test_the_first_message_published_after_the_restoration_counts(story: Any) -> None:
    story.restore(("a", "b"), 5.0)
    story.publish(0, 0, 4.9)
    story.publish(0, 1, 5.01)
    story.deliver(0, 0, 5.02, published_s=4.9)  # older than the restoration
    story.deliver(0, 1, 5.08, published_s=5.01)
    (entry,) = reconnects(story.trace)
    assert entry.between == ("a", "b")
    assert entry.restored_at_s == 5.0
    assert entry.first_delivery_s == pytest.approx(5.08)
    assert entry.delay_s == pytest.approx(0.08)


def test_either_direction_counts_other_nodes_do_not(story: Any) -> None:
    story.restore(("a", "b"), 5.0)
    story.deliver(2, 0, 5.001, published_s=5.0)  # a -> c
    story.deliver(0, 0, 5.2, published_s=5.1)
    story.deliver(3, 0, 5.15, published_s=5.1)  # b -> a
    assert delays(story) == [pytest.approx(0.15)]


def test_the_order_of_the_names_does_not_matter(story: Any) -> None:
    story.restore(("b", "a"), 5.0)
    story.deliver(0, 0, 5.2, published_s=5.1)
    assert delays(story) == [pytest.approx(0.2)]


def test_the_kept_newest_message_counts_an_older_one_does_not(story: Any) -> None:
    story.restore(("a", "c"), 5.0)
    for seq in range(3):
        story.publish(2, seq, 3.0 + seq / 2)
    story.deliver(2, 1, 5.02, published_s=3.5)
    story.deliver(2, 2, 5.04, published_s=4.0)
    assert delays(story) == [pytest.approx(0.04)]


def test_a_stream_that_keeps_everything_has_no_kept_newest(story: Any) -> None:
    story.restore(("a", "b"), 5.0)
    story.publish(0, 0, 4.0)
    story.deliver(0, 0, 5.02, published_s=4.0)
    assert delays(story) == [None]


def test_a_kept_message_that_came_before_the_restoration_does_not_count(story: Any) -> None:
    story.restore(("a", "c"), 5.0)
    story.publish(2, 0, 3.0)
    story.deliver(2, 0, 3.1, published_s=3.0)
    assert delays(story) == [None]


def test_every_restoration_has_an_entry(story: Any) -> None:
    story.restore(("a", "b"), 2.0)
    story.restore(("a", "b"), 4.0)
    story.restore(("a", "b"), 9.0)
    story.deliver(0, 0, 2.5, published_s=2.4)
    story.deliver(0, 1, 4.1, published_s=4.05)
    assert delays(story) == [pytest.approx(0.5), pytest.approx(0.1), None]


def test_the_moment_of_the_act_counts_not_the_plan(story: Any) -> None:
    story.restore(("a", "b"), 5.03, planned_s=5.0)
    story.deliver(0, 0, 5.08, published_s=5.02)  # published before the act, although after the plan
    story.deliver(0, 1, 5.09, published_s=5.04)
    assert delays(story) == [pytest.approx(0.06)]


def test_without_restorations_there_is_no_entry(story: Any) -> None:
    story.deliver(0, 0, 1.0, published_s=0.9)
    assert reconnects(story.trace) == []
