"""The receiver's side of stored messages: known by id, kept until taken by those who asked for the topic."""

from __future__ import annotations

from udp_mesh.core.envelope import DurableId
from udp_mesh.core.inbox import WINDOW_MESSAGES, Inbox, Kept


def message(sequence: int, *, size: int = 10, priority: int = 5, topic: str = "t", deadline_s: float = 100.0) -> Kept:
    return Kept(DurableId(1, sequence), "a", topic, priority, size, 0, deadline_s)


def receive(inbox: Inbox, sequence: int, **values: int) -> Kept:
    kept = message(sequence, **values)
    inbox.add(kept)
    inbox.committed(kept)
    return kept


def given_to(inbox: Inbox, application: int) -> list[int]:
    found = []
    while (kept := inbox.next_for(application)) is not None:
        inbox.give(application, kept)
        found.append(kept.durable_id.sequence)
    return found


def inbox(limit_bytes: int = 1000) -> Inbox:
    return Inbox(limit_bytes=limit_bytes, age_s=100.0)


def test_nothing_is_offered_or_confirmed_before_the_file_has_it() -> None:
    box = inbox()
    box.subscribe(1, "t")
    kept = message(1)
    box.add(kept)
    assert box.knows(kept.durable_id)
    assert box.is_committing(kept.durable_id)
    assert given_to(box, 1) == []
    box.committed(kept)
    assert not box.is_committing(kept.durable_id)
    assert given_to(box, 1) == [1]


def test_a_failed_write_makes_the_message_unknown_again() -> None:
    box = inbox()
    kept = message(1)
    box.add(kept)
    box.not_committed(kept)
    assert not box.knows(kept.durable_id)
    assert box.kept_bytes == 0


def test_a_message_stays_until_every_subscriber_of_its_topic_has_taken_it() -> None:
    box = inbox()
    box.subscribe(1, "t")
    box.subscribe(2, "t")
    kept = receive(box, 1)
    assert given_to(box, 1) == given_to(box, 2) == [1]
    box.take(1, kept.durable_id)
    assert box.taken == []
    box.take(2, kept.durable_id)
    assert box.taken == [kept.durable_id]
    assert box.knows(kept.durable_id)


def test_who_leaves_without_taking_does_not_hold_a_message_that_another_took() -> None:
    box = inbox()
    box.subscribe(1, "t")
    box.subscribe(2, "t")
    kept = receive(box, 1)
    box.take(1, kept.durable_id)
    box.leave(2)
    assert box.taken == [kept.durable_id]


def test_a_message_that_nobody_took_waits_for_the_next_subscriber() -> None:
    box = inbox()
    box.subscribe(1, "t")
    receive(box, 1)
    assert given_to(box, 1) == [1]
    box.leave(1)
    assert len(box) == 1
    box.subscribe(2, "t")
    assert given_to(box, 2) == [1]
    box.unsubscribe(2, "t")
    assert len(box) == 1


def test_an_application_that_takes_nothing_is_given_a_window_and_no_more() -> None:
    box = inbox(limit_bytes=10_000)
    box.subscribe(1, "t")
    kept = [receive(box, number) for number in range(WINDOW_MESSAGES + 5)]
    assert len(given_to(box, 1)) == WINDOW_MESSAGES
    box.take(1, kept[0].durable_id)
    assert given_to(box, 1) == [WINDOW_MESSAGES]


def test_the_oldest_of_the_least_urgent_makes_room_and_is_counted() -> None:
    box = inbox(limit_bytes=100)
    receive(box, 1, size=40, priority=1)
    receive(box, 2, size=40, priority=9)
    receive(box, 3, size=40, priority=5)
    assert box.taken == [DurableId(1, 2)]
    assert box.counters["inbox_dropped_store_full"] == 1
    assert box.kept_bytes == 80


def test_an_old_message_is_dropped_and_still_known() -> None:
    box = inbox()
    kept = message(1, deadline_s=10.0)
    box.add(kept)
    box.committed(kept)
    assert box.next_timer() == 10.0
    box.handle_timer(now=10.0)
    assert (len(box), box.taken, box.knows(kept.durable_id)) == (0, [kept.durable_id], True)


def test_the_floor_replaces_the_ids_below_it() -> None:
    box = inbox()
    receive(box, 5)
    assert box.settle_below(1, 6)
    assert not box.settle_below(1, 6)
    assert box.knows(DurableId(1, 5))
    assert box.knows(DurableId(1, 4)), "below the floor everything is settled"
    assert not box.knows(DurableId(1, 6))
    assert not box.knows(DurableId(2, 5)), "another store, other numbers"


def test_what_the_file_held_is_offered_and_known() -> None:
    box = inbox()
    box.restore({1: 3}, [DurableId(1, 4), DurableId(1, 5)], [message(5)])
    assert box.knows(DurableId(1, 2))
    assert box.knows(DurableId(1, 4))
    box.subscribe(1, "t")
    assert given_to(box, 1) == [5]
