from __future__ import annotations

import zlib
from typing import Any

import pytest

from netlab.capture.records import PacketRecord
from netlab.capture.schemas import Direction
from netlab.scenario.expect import RerouteExpectation
from netlab.traces.expectations import ExpectationResult, evaluate
from netlab.traces.links import PacketLinks
from netlab.traces.model import Step
from netlab.traces.reconnects import reconnects
from netlab.traces.reroutes import reroutes
from netlab.traces.summary import summary


def cut(story: Any, at_s: float, *, rejoins: bool = False) -> None:
    pairs = (("a", "b"),)
    t_ns = story.trace.t0_ns + round(at_s * 1e9)
    step = Step(t_ns, at_s, "outage r-b", "outage", None, () if rejoins else pairs, pairs if rejoins else ())
    story.trace.timeline.append(step)


def carry(story: Any, stream: int, *published_and_delivered: tuple[float, float]) -> None:
    for published_s, delivered_s in published_and_delivered:
        seq = len(story.trace.delivered[stream])
        story.publish(stream, seq, published_s)
        story.deliver(stream, seq, delivered_s, published_s=published_s)


def test_the_gap_begins_at_the_cut_and_ends_with_a_message_published_since(story: Any) -> None:
    cut(story, 5.0)
    carry(story, 0, (4.99, 5.01), (5.03, 7.5), (7.6, 7.61))  # the first was past the cut
    carry(story, 1, (5.0, 7.0))
    carry(story, 3, (5.02, 7.2))
    (entry,) = reroutes(story.trace)
    assert (entry.between, entry.cut_at_s) == (("a", "b"), 5.0)
    assert entry.delay_s == pytest.approx(2.2), "the way back; of the way there the sooner stream counts"


def test_a_stream_that_sends_seldom_hides_no_way_that_another_shows(story: Any) -> None:
    cut(story, 5.0)
    carry(story, 0, (5.1, 5.2))
    carry(story, 3, (5.1, 5.3))
    carry(story, 1, (25.0, 25.1))
    assert [entry.delay_s for entry in reroutes(story.trace)] == [pytest.approx(0.3)]


def test_a_direction_that_never_carries_again_is_no_reroute(story: Any) -> None:
    cut(story, 5.0)
    carry(story, 0, (5.1, 5.2))
    carry(story, 1, (5.1, 5.2))
    assert [entry.delay_s for entry in reroutes(story.trace)] == [None]


def test_streams_to_others_do_not_matter(story: Any) -> None:
    cut(story, 5.0)
    for stream in (0, 1, 3):
        carry(story, stream, (5.1, 5.2))
    carry(story, 2, (5.1, 9.0))  # a -> c
    assert [entry.delay_s for entry in reroutes(story.trace)] == [pytest.approx(0.2)]


def test_nodes_that_are_joined_again_count_as_restored(story: Any) -> None:
    cut(story, 5.0, rejoins=True)
    carry(story, 0, (5.1, 5.2))
    assert [(entry.between, entry.delay_s) for entry in reconnects(story.trace)] == [(("a", "b"), pytest.approx(0.2))]
    assert reroutes(story.trace) == []


def test_the_summary_has_reroutes_only_where_there_are_any(story: Any) -> None:
    assert "reroutes" not in summary(story.trace)
    cut(story, 5.0)
    assert summary(story.trace)["reroutes"] == [{"between": ["a", "b"], "cut_at_s": 5.0, "delay_s": None}]


def expectation(story: Any, limit: str) -> ExpectationResult:
    asked = RerouteExpectation.model_validate({"reroute": {"between": ["b", "a"]}, "max": limit})
    (result,) = evaluate([asked], story.trace)
    return result


def test_the_worst_of_all_cuts_is_held_against_the_limit(story: Any) -> None:
    cut(story, 2.0)
    cut(story, 5.0)
    for stream in (0, 1, 3):
        carry(story, stream, (2.1, 2.2), (5.1, 6.5))
    met, missed = expectation(story, "1500ms"), expectation(story, "1499ms")
    assert (met.passed, met.explanation) == (True, "")
    assert not missed.passed
    assert missed.measured == pytest.approx(1.5)
    assert "the first message published since came 1500.0 ms later" in missed.explanation


def test_no_cut_is_no_success(story: Any) -> None:
    result = expectation(story, "1s")
    assert (result.passed, result.measured) == (False, None)
    assert "no cut in this run left them another path" in result.explanation


def test_what_a_mesh_interface_sees_is_no_link_of_its_own() -> None:
    links = PacketLinks({b"\2aaaaa": ("a", "eth0"), b"\2bbbbb": ("b", "eth0")})
    for interface, kind in (("bat0", b"\x08\x00"), ("eth0", b"\x43\x05")):
        frame = b"\xff" * 6 + b"\2aaaaa" + kind + bytes(46)
        for node, direction in (("a", Direction.OUTBOUND), ("b", Direction.INBOUND)):
            links.packet(PacketRecord(0, node, interface, direction, 1, len(frame), zlib.crc32(frame), frame))
    assert list(links.counts()) == [(("a", "eth0"), ("b", "eth0"))]
