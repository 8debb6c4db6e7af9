"""The sender's side of stored messages: what is fed to the transport, what is dropped, what is sent again."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from udp_mesh.core import events
from udp_mesh.core.custody import FEED_BYTES, RESEND_AFTER_S, RETRY_AFTER_S, Custody
from udp_mesh.core.events import DropReason
from udp_mesh.core.outbox import Refused
from udp_mesh.core.settings import Keep, TopicPolicy
from udp_mesh.core.stored import Stored


def custody(limit_bytes: int = 1000, age_s: float = 100.0) -> Custody:
    return Custody(limit_bytes=limit_bytes, age_s=age_s)


def store(
    stored: Custody, size: int = 10, *, peer: str = "b", priority: int = 5, topic: str = "t", now: float = 0.0
) -> Stored:
    (entry,) = stored.admit(topic, size, [peer], TopicPolicy(priority), now=now)
    stored.committed(entry, now=now)
    return entry


def reasons(stored: Custody) -> list[DropReason]:
    return [event.reason for event in stored.events if isinstance(event, events.StoredDropped)]


def test_nothing_leaves_before_the_file_has_it() -> None:
    stored = custody()
    (entry,) = stored.admit("t", 10, ["b"], TopicPolicy(), now=0.0)
    assert stored.next_to_feed("b", now=0.0) is None
    stored.committed(entry, now=0.0)
    assert stored.next_to_feed("b", now=0.0) is entry


def test_a_failed_write_leaves_no_trace() -> None:
    stored = custody()
    (entry,) = stored.admit("t", 10, ["b"], TopicPolicy(), now=0.0)
    stored.not_committed(entry)
    assert (len(stored), stored.stored_bytes, stored.forgotten, list(stored.events)) == (0, 0, [], [])


def test_the_most_urgent_is_fed_first_and_passes_a_full_feed() -> None:
    stored = custody(limit_bytes=10 * FEED_BYTES)
    bulk = [store(stored, FEED_BYTES // 2, priority=9) for _ in range(4)]
    for expected in bulk[:2]:
        assert stored.next_to_feed("b", now=0.0) is expected
        stored.fed(expected)
    assert stored.next_to_feed("b", now=0.0) is None
    urgent = store(stored, priority=1)
    assert stored.next_to_feed("b", now=0.0) is urgent


def test_a_message_ends_when_its_receiver_confirms_and_only_then() -> None:
    stored = custody()
    entry = store(stored)
    stored.fed(entry)
    stored.on_acked(entry.sequence, now=1.0)
    assert len(stored) == 1
    assert not stored.on_confirmed(entry.sequence, "c", now=2.0)
    assert stored.on_confirmed(entry.sequence, "b", now=2.0)
    assert not stored.on_confirmed(entry.sequence, "b", now=2.0)
    assert (len(stored), stored.stored_bytes, stored.forgotten) == (0, 0, [entry.sequence])
    confirmed = stored.events[-1]
    assert isinstance(confirmed, events.MessageConfirmed)
    assert confirmed.latency_s == 2.0


def test_an_unconfirmed_message_is_sent_again_after_a_while() -> None:
    stored = custody()
    entry = store(stored)
    stored.fed(entry)
    stored.on_acked(entry.sequence, now=1.0)
    assert stored.next_timer() == 1.0 + RESEND_AFTER_S
    stored.handle_timer(now=1.0 + RESEND_AFTER_S)
    assert stored.next_to_feed("b", now=1.0 + RESEND_AFTER_S) is entry


@pytest.mark.parametrize("is_acked", [False, True])
def test_a_restarted_receiver_gets_the_unconfirmed_at_once(is_acked: bool) -> None:
    stored = custody()
    entry = store(stored)
    stored.fed(entry)
    if is_acked:
        stored.on_acked(entry.sequence, now=0.0)
    else:
        stored.on_dropped(entry.sequence, DropReason.PEER_RESTARTED, now=0.0)
    stored.on_peer_restarted("b")
    assert stored.next_to_feed("b", now=0.0) is entry


def test_what_the_transport_drops_waits_a_moment() -> None:
    stored = custody()
    entry = store(stored)
    stored.fed(entry)
    stored.on_dropped(entry.sequence, DropReason.QUEUE_FULL, now=0.0)
    assert stored.next_to_feed("b", now=0.0) is None
    assert stored.next_timer() == RETRY_AFTER_S
    assert stored.next_to_feed("b", now=RETRY_AFTER_S) is entry


def test_the_oldest_of_the_least_urgent_makes_room_and_a_lesser_newcomer_is_refused() -> None:
    stored = custody(limit_bytes=100)
    kept, old, young = (store(stored, 33, priority=p) for p in (1, 7, 7))
    newest = store(stored, 33, priority=5)
    assert stored.forgotten == [old.sequence]
    assert reasons(stored) == [DropReason.STORE_FULL]
    assert stored.counters["stored_dropped_store_full"] == 1
    with pytest.raises(Refused, match="store_full"):
        store(stored, 90, priority=8)
    assert [entry.is_done for entry in (kept, old, young, newest)] == [False, True, False, False]


def test_a_message_larger_than_the_store_is_refused_and_drops_nothing() -> None:
    stored = custody(limit_bytes=100)
    store(stored, 90)
    with pytest.raises(Refused, match="too_large"):
        store(stored, 101, priority=0)
    assert len(stored) == 1


def test_lifetime_and_age_end_a_message() -> None:
    stored = custody(age_s=50.0)
    stored.committed(stored.admit("t", 1, ["b"], TopicPolicy(lifetime_s=5.0), now=0.0)[0], now=0.0)
    store(stored, 1)
    stored.handle_timer(now=5.0)
    assert len(stored) == 1
    stored.handle_timer(now=50.0)
    assert reasons(stored) == [DropReason.EXPIRED, DropReason.EXPIRED]


def test_keep_latest_replaces_what_has_not_begun() -> None:
    stored = custody()
    policy = TopicPolicy(keep=Keep.LATEST)
    first, second, third = (stored.admit("t", 1, ["b"], policy, now=0.0)[0] for _ in range(3))
    assert (first.is_done, second.is_done, third.is_done) == (True, True, False)
    stored.committed(third, now=0.0)
    stored.fed(third)
    stored.admit("t", 1, ["b"], policy, now=0.0)
    assert not third.is_done, "a message under way is finished"


def test_the_floor_is_the_oldest_unsettled_of_that_destination() -> None:
    stored = custody()
    for_b, for_c = store(stored, peer="b"), store(stored, peer="c")
    assert (stored.floor("b"), stored.floor("c"), stored.floor("d")) == (for_b.sequence, for_c.sequence, 3)
    stored.on_confirmed(for_b.sequence, "b", now=0.0)
    assert stored.floor("b") == 3


def test_what_the_file_held_goes_on_and_no_sequence_is_used_twice() -> None:
    stored = custody()
    stored.next_sequence = 5
    stored.restore([Stored(7, "b", "t", TopicPolicy(), 10, 0.0, 50.0)])
    entry = stored.next_to_feed("b", now=0.0)
    assert entry is not None
    assert entry.sequence == 7
    assert store(stored).sequence == 8


@given(
    st.lists(
        st.tuples(st.sampled_from(["put", "feed", "ack", "confirm", "drop", "restart", "time"]), st.integers(0, 9)),
        max_size=80,
    )
)
def test_nothing_ends_without_a_word_and_the_limit_holds(steps: list[tuple[str, int]]) -> None:
    stored, entries, now = custody(limit_bytes=200), [], 0.0
    for step, number in steps:
        entry = entries[number % len(entries)] if entries else None
        if step == "put":
            try:
                entries.append(store(stored, 10 + number, priority=number, now=now))
            except Refused:
                assert stored.stored_bytes + 10 + number > 200
        elif step == "feed" and (waiting := stored.next_to_feed("b", now=now)) is not None:
            assert not waiting.is_done
            stored.fed(waiting)
        elif step == "ack" and entry:
            stored.on_acked(entry.sequence, now=now)
        elif step == "confirm" and entry:
            stored.on_confirmed(entry.sequence, "b", now=now)
        elif step == "drop" and entry:
            stored.on_dropped(entry.sequence, DropReason.QUEUE_FULL, now=now)
        elif step == "restart":
            stored.on_peer_restarted("b")
        elif step == "time":
            now += number * 4
            stored.handle_timer(now=now)
        assert stored.stored_bytes == sum(entry.size_bytes for entry in entries if not entry.is_done) <= 200
    ended = [e.sequence for e in stored.events if isinstance(e, events.StoredDropped | events.MessageConfirmed)]
    assert sorted(ended) == sorted(stored.forgotten) == [entry.sequence for entry in entries if entry.is_done]
