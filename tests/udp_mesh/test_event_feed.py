"""Events as JSON lines."""

from __future__ import annotations

import json
import os

from udp_mesh.core import events
from udp_mesh.io.feed import EventFeed, encode_event, event_name


def test_an_event_is_one_line_with_its_own_time_and_no_payload() -> None:
    event = events.MessageDelivered(2.5, 7, "t", 1, "robot1", b"secret")
    line = encode_event(event, offset_ns=1_000_000_000_000)
    assert line.endswith(b"\n")
    assert json.loads(line) == {
        "t_ns": 1_002_500_000_000,
        "event": "message_delivered",
        "message_id": 7,
        "topic": "t",
        "priority": 1,
        "source": "robot1",
        "size_bytes": 6,
    }
    dropped = events.MessageDropped(1.0, 7, "t", 1, 10, "b", events.DropReason.QUEUE_FULL)
    assert json.loads(encode_event(dropped, offset_ns=0))["reason"] == "queue_full"


def test_event_names_are_distinct_words() -> None:
    assert event_name(events.PeerUp) == "peer_up"
    assert event_name(events.FragmentRetransmitted) == "fragment_retransmitted"


def test_a_reader_that_stalls_costs_lines_not_time() -> None:
    read_fd, write_fd = os.pipe()
    feed = EventFeed(write_fd)
    event = events.PeerUp(1.0, "robot1", 5, "10.0.0.1", events.PeerUpReason.DISCOVERED)
    for _ in range(20_000):
        feed.add(event)
        feed.flush()
    os.set_blocking(read_fd, False)
    data = drain(feed, read_fd)
    feed.add(event)
    data += drain(feed, read_fd)
    lines = [json.loads(line) for line in data.splitlines()]
    lost = sum(line["count"] for line in lines if line["event"] == "events_lost")
    assert lost > 0
    assert lost + sum(line["event"] == "peer_up" for line in lines) == 20_001
    os.close(read_fd)
    feed.add(event)
    feed.flush()  # nobody reads any more: no exception
    os.close(write_fd)


def drain(feed: EventFeed, fd: int) -> bytes:
    data = b""
    while True:
        feed.flush()
        try:
            data += os.read(fd, 1 << 16)
        except BlockingIOError:
            return data
