from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from netlab.medium.verdicts import Verdict
from netlab.traces.messages import message_lives
from netlab.traces.model import LinkCounts
from netlab.traces.retransmissions import retransmissions
from netlab.traces.streams import percentile, stream_report
from netlab.traces.summary import summary
from netlab.traces.tables import summary_text


@given(st.lists(st.floats(0, 100), min_size=1).map(sorted), st.floats(0, 1))
def test_a_percentile_is_a_value_with_enough_of_them_below(values: list[float], ratio: float) -> None:
    value = percentile(values, ratio)
    assert value in values
    assert sum(other <= value for other in values) >= ratio * len(values)
    below = [other for other in values if other < value]
    assert len(below) < max(ratio * len(values), 1)


def test_percentiles_of_a_hundred_and_of_nothing() -> None:
    values = [float(number) for number in range(1, 101)]
    assert [percentile(values, ratio) for ratio in (0.5, 0.9, 0.99, 1.0)] == [50, 90, 99, 100]
    with pytest.raises(ValueError, match="of 0 values"):
        percentile([], 0.5)


def test_latency_runs_to_the_first_receipt_and_duplicates_are_counted(story: Any) -> None:
    for seq, latency_s in enumerate((0.010, 0.030, 0.020)):
        story.publish(0, seq, seq)
        story.deliver(0, seq, seq + latency_s, published_s=seq)
    story.deliver(0, 1, 1.5, published_s=1.0)
    report = stream_report(story.trace, story.trace.streams[0])
    assert (report.sent, report.delivered, report.duplicates) == (3, 3, 1)
    assert report.latency is not None
    assert report.latency.p50 == pytest.approx(0.020)
    assert report.latency.max == pytest.approx(0.030)


def test_refused_messages_count_as_sent(story: Any) -> None:
    story.publish(0, 0, 1.0)
    story.publish(0, 1, 2.0, accepted=False)
    report = stream_report(story.trace, story.trace.streams[0])
    assert (report.sent, report.refused, report.delivered, report.latency) == (2, 1, 0, None)


def test_goodput_counts_distinct_bits_within_the_duration(story: Any) -> None:
    story.deliver(1, 0, 1.0, published_s=0.5, size_bytes=1000)
    story.deliver(1, 0, 1.1, published_s=0.5, size_bytes=1000)
    story.deliver(1, 1, 9.999, published_s=9.0, size_bytes=1000)
    story.deliver(1, 2, 10.5, published_s=9.0, size_bytes=1000)  # in the drain
    assert stream_report(story.trace, story.trace.streams[1]).goodput_bps == pytest.approx(2 * 8000 / 10)


@pytest.mark.parametrize(
    ("times", "gap"),
    [([1, 2, 5, 6], 4.0), ([1, 2, 9.5], 7.5), ([3], 7.0), ([], 10.0), ([9, 10.5], 1.5), ([5, 1, 9], 4.0)],
)
def test_the_longest_gap_lies_between_deliveries_or_before_the_end(story: Any, times: list[float], gap: float) -> None:
    for seq, at_s in enumerate(times):
        story.deliver(0, seq, at_s, published_s=0)
    assert stream_report(story.trace, story.trace.streams[0]).longest_gap_s == pytest.approx(gap)


def test_only_the_same_fragment_on_the_same_interface_to_the_same_node_is_sent_again(story: Any) -> None:
    story.send(1, 0, 1.0, index=0, count=2)
    story.send(1, 0, 1.1, index=1, count=2)
    story.send(1, 0, 1.2, index=0, count=2, interface="eth1")  # redundancy
    story.send(1, 0, 1.3, index=0, count=2, destination="c")  # fan-out
    story.send(1, 1, 1.4, index=0, count=2)  # another message
    assert retransmissions(story.trace, "a") == []
    story.send(1, 0, 1.5, index=1, count=2)
    story.send(1, 0, 1.6, index=1, count=2)
    again = retransmissions(story.trace, "a")
    assert [story.trace.seconds(fragment.t_ns) for fragment in again] == [1.5, 1.6]
    assert retransmissions(story.trace, "b") == []


def test_a_messages_life_is_told_whole(story: Any) -> None:
    story.publish(1, 0, 1.0)
    for at_s, index in ((1.01, 0), (1.02, 1), (1.10, 1)):
        story.send(1, 0, at_s, index=index, count=2)
    story.deliver(1, 0, 1.2, published_s=1.0)
    story.deliver(1, 0, 1.3, published_s=1.0)
    story.publish(0, 0, 0.5, accepted=False)
    refused, delivered = message_lives(story.trace)
    assert (refused.stream.topic, refused.delivery, refused.fragments) == ("telemetry", None, 0)
    assert (delivered.fragments, delivered.retransmissions, delivered.receipts) == (2, 1, 2)
    assert delivered.delivery is not None
    assert delivered.delivery.latency_s == pytest.approx(0.2)


def test_the_summary_has_the_promised_keys(story: Any) -> None:
    story.publish(0, 0, 1.0)
    story.deliver(0, 0, 1.25, published_s=1.0)
    story.restore(("a", "b"), 0.5)
    counts = {Verdict.DELIVERED: 6, Verdict.LOST: 2, Verdict.DUPLICATED: 1}
    story.trace.links[("a", "eth0"), ("b", "eth0")] = LinkCounts(9, 9000, counts)
    told = summary(story.trace)
    assert set(told) == {"streams", "reconnects", "links"}
    assert len(told["streams"]) == 4
    first = told["streams"][0]
    assert list(first) == [
        *("source", "destination", "topic", "priority", "sent", "delivered", "duplicates"),
        *("latency_s", "goodput_bps", "longest_gap_s"),
    ]
    assert first["latency_s"] == {"p50": 0.25, "p90": 0.25, "p99": 0.25, "max": 0.25}
    assert told["streams"][1]["latency_s"] == {"p50": None, "p90": None, "p99": None, "max": None}
    (reconnect,) = told["reconnects"]
    assert reconnect == {"between": ["a", "b"], "restored_at_s": 0.5, "first_delivery_s": 1.25, "delay_s": 0.75}
    (link,) = told["links"]
    assert (link["from"], link["to"], link["frames"], link["loss_ratio"]) == ("a/eth0", "b/eth0", 8, 0.25)


def test_the_text_fits_a_terminal_of_100_columns(story: Any) -> None:
    story.publish(0, 0, 1.0)
    story.deliver(0, 0, 1.25, published_s=1.0)
    story.send(0, 0, 1.1)
    story.restore(("a", "b"), 0.5)
    text = summary_text(story.trace)
    assert max(map(len, text.splitlines())) <= 100
    for title in ("streams", "senders", "reconnects", "timeline"):
        assert title in text.splitlines()
    assert "telemetry a->b" in text
    assert "250.0 ms" in text
