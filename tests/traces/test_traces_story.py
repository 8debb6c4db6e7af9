"""What a latency is divided into, to the microsecond: one short play per cause."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from netlab.capture.reader import Capture
from netlab.capture.schemas import Direction
from netlab.medium.verdicts import Verdict
from netlab.traces.causes import Cause
from netlab.traces.load import read_trace
from netlab.traces.sentences import because, fate_text
from netlab.traces.story import Fate, Sending, Story
from netlab.traces.tell import tell
from tests.traces.captures import EPOCHS, Play, data, frame
from udp_mesh.core import wire

FRAME_S = 0.001656  # 207 bytes at 1 Mbit/s
NEW_EPOCH = 11 << 32 | 0xC


@pytest.fixture
def play(tmp_path: Path) -> Play:
    return Play(tmp_path / "play.mcap")


def story(play: Play, stream: int = 0, seq: int = 0) -> Story:
    play.json("/timeline", 2.0, kind="end", label="over", at_s=2.0)
    play.writer.close()
    with Capture.open(play.path) as capture:
        trace = read_trace(capture, with_packets=False)
        published = trace.find_published(stream, seq)
        assert published is not None
        found = tell(capture, trace, trace.streams[stream], published)
    assert sum(part.duration_s for part in found.parts) == pytest.approx(found.ended_s - found.published_s, abs=1e-9)
    return found


def parts(found: Story) -> list[tuple[str, float, float]]:
    return [(part.cause.value, round(part.from_s, 6), round(part.to_s, 6)) for part in found.parts]


def test_a_prompt_message_is_divided_and_nothing_held_it_up(play: Play) -> None:
    play.publish(0, 0, 0.1)
    play.queue(0, 5, 0.1001)
    play.send(0, 0, 0.1003, message_id=5, number=1, arrives_s=0.1003 + FRAME_S + 0.02)
    play.acknowledge(0.15, 1)
    play.receive(0, 0, 0.1225, published_s=0.1, message_id=5, daemon_s=0.122)
    found = story(play)
    assert parts(found) == [
        ("handover", 0.1, 0.1001),
        ("pacing", 0.1001, 0.1003),
        ("transmission", 0.1003, 0.101956),
        ("propagation", 0.101956, 0.121956),
        ("reassembly", 0.121956, 0.1225),
    ]
    assert (found.fate, found.cause, found.message_id) == (Fate.DELIVERED, None, 5)
    (sent,) = found.fragments[0].transmissions
    assert (sent.sending, sent.packet_number, sent.acked_s) == (Sending.FIRST, 1, pytest.approx(0.15))
    assert because(found) == "Nothing held it up: propagation is most of it (20.0 ms, 89 %)."
    assert fate_text(found) == "published 0.100 s, delivered 0.122 s: 22.5 ms (the stream's median is 22.5 ms)"


def test_losses_last_until_it_left_again(play: Play) -> None:
    play.publish(0, 0, 0.1)
    play.queue(0, 5, 0.1)
    play.send(0, 0, 0.101, message_id=5, number=1, verdict=Verdict.LOST)
    play.send(0, 0, 0.161, message_id=5, number=2, verdict=Verdict.QUEUE_FULL)
    play.event(0.161, "fragment_retransmitted", packet_number=2, message_id=5, fragment_index=0)
    play.event(0.171, "fragment_copied", packet_number=3, message_id=5, fragment_index=0)
    play.send(0, 0, 0.171, message_id=5, number=3, arrives_s=0.171 + FRAME_S + 0.02)
    play.receive(0, 0, 0.2, published_s=0.1, message_id=5, daemon_s=0.2)
    found = story(play)
    assert parts(found)[1:3] == [("loss", 0.101, 0.161), ("queue_full", 0.161, 0.171)]
    assert found.cause is Cause.LOSS
    assert found.parts[1].words == (
        "fragment 1/1 left at 0.101 s and was lost on a/eth0 > b/eth0; it left again at 0.161 s"
    )
    assert [sent.sending for sent in found.fragments[0].transmissions] == [Sending.FIRST, Sending.AGAIN, Sending.COPY]
    assert because(found) == (
        "Late: frames were lost on the way and sent again (60.0 ms, 60 %). Also queue full (10.0 ms, 10 %), "
        "reassembly (7.3 ms, 7 %)."
    )


def test_the_wait_belongs_to_whoever_left_meanwhile(play: Play) -> None:
    play.publish(1, 0, 0.09)
    play.queue(1, 4, 0.09, fragments=3)
    play.publish(0, 0, 0.1)
    play.queue(0, 5, 0.1)
    for index, at_s in enumerate((0.095, 0.11, 0.13)):
        play.send(1, 0, at_s, message_id=4, number=index + 1, index=index, count=3, arrives_s=at_s + 0.03)
    play.send(0, 0, 0.14, message_id=5, number=4, arrives_s=0.14 + FRAME_S + 0.025)
    play.receive(0, 0, 0.17, published_s=0.1, message_id=5, daemon_s=0.169)
    found = story(play)
    assert parts(found)[:3] == [("queue", 0.1, 0.13), ("pacing", 0.13, 0.14), ("link_queue", 0.14, 0.145)]
    assert found.cause is Cause.QUEUE
    (ahead,) = found.parts[0].ahead
    assert (ahead.topic, ahead.seq, ahead.fragments, ahead.payload_bytes) == ("bulk", 0, 2, 236)
    assert found.parts[0].words == "behind bulk #0 (236 B)"
    assert found.parts[2].words == "behind bulk #0 (118 B) at a/eth0 > b/eth0"


def test_a_messages_own_fragments_and_those_between_them(play: Play) -> None:
    play.publish(1, 0, 0.1)
    play.queue(1, 4, 0.1, fragments=3)
    play.publish(0, 0, 0.105)
    play.queue(0, 5, 0.105)
    for index, at_s in enumerate((0.1, 0.11, 0.13)):
        play.send(1, 0, at_s, message_id=4, number=index + 1, index=index, count=3, arrives_s=at_s + FRAME_S + 0.02)
    play.send(0, 0, 0.125, message_id=5, number=9, arrives_s=0.15)
    play.receive(1, 0, 0.16, published_s=0.1, message_id=4, daemon_s=0.16)
    found = story(play, 1)
    assert found.critical_index == 2
    assert parts(found)[:5] == [
        ("sending", 0.1, 0.101616),
        ("pacing", 0.101616, 0.11),
        ("queue", 0.11, 0.125),
        ("sending", 0.125, 0.126576),
        ("pacing", 0.126576, 0.13),
    ]
    assert found.parts[2].words == "behind telemetry #0 (118 B)"


def test_what_its_other_fragments_take_again_is_loss(play: Play) -> None:
    play.publish(1, 0, 0.1)
    play.queue(1, 4, 0.1, fragments=2)
    play.send(1, 0, 0.1, message_id=4, number=1, count=2, verdict=Verdict.LOST)
    play.send(1, 0, 0.15, message_id=4, number=2, count=2, arrives_s=0.172)
    play.send(1, 0, 0.2, message_id=4, number=3, index=1, count=2, arrives_s=0.2 + FRAME_S + 0.02)
    play.receive(1, 0, 0.23, published_s=0.1, message_id=4, daemon_s=0.23)
    found = story(play, 1)
    assert parts(found)[:3] == [("loss", 0.1, 0.15), ("sending", 0.15, 0.151616), ("pacing", 0.151616, 0.2)]
    assert found.parts[0].words == "its fragment 1/2 left again"


def test_a_rate_limit_holds_before_the_queue(play: Play) -> None:
    play.publish(0, 0, 0.1)
    play.queue(0, 5, 0.1)
    play.event(0.1, "message_held", message_id=5)
    play.event(0.4, "message_released", message_id=5, held_s=0.3)
    play.send(0, 0, 0.4, message_id=5, number=1, arrives_s=0.4 + FRAME_S + 0.02)
    play.receive(0, 0, 0.422, published_s=0.1, message_id=5, daemon_s=0.422)
    found = story(play)
    assert parts(found)[0] == ("rate_limit", 0.1, 0.4)
    assert found.parts[0].words == "the rate limit of telemetry held it back until 0.400 s"
    assert found.cause is Cause.RATE_LIMIT


def test_an_outage_then_the_time_to_find_each_other(play: Play) -> None:
    play.link(0.2, "outage")
    play.publish(0, 0, 0.3)
    play.queue(0, 5, 0.3)
    play.send(0, 0, 0.301, message_id=5, number=1, verdict=Verdict.OUTAGE)
    play.event(0.8, "peer_down", epoch=EPOCHS["b"], reason="silent")
    play.link(1.0)
    play.event(1.03, "peer_up", epoch=EPOCHS["b"], reason="returned")
    play.send(0, 0, 1.05, message_id=5, number=2, arrives_s=1.05 + FRAME_S + 0.02)
    play.receive(0, 0, 1.08, published_s=0.3, message_id=5, daemon_s=1.08)
    found = story(play)
    assert parts(found)[:3] == [("outage", 0.3, 1.0), ("reconnect", 1.0, 1.03), ("reconnect", 1.03, 1.05)]
    assert found.parts[0].words == "outage between a and b from 0.200 s to 1.000 s"
    assert found.parts[1].words == "the path was back at 1.000 s; a heard b at 1.030 s"
    assert found.parts[2].words.endswith("was lost in an outage on a/eth0 > b/eth0; it left again at 1.050 s")
    assert found.cause is Cause.OUTAGE


def test_a_short_outage_that_nobody_noticed(play: Play) -> None:
    play.link(0.2, "out_of_range")
    play.publish(0, 0, 0.21)
    play.queue(0, 5, 0.21)
    play.send(0, 0, 0.21, message_id=5, number=1, verdict=Verdict.OUT_OF_RANGE)
    play.link(0.25)
    play.send(0, 0, 0.31, message_id=5, number=2, arrives_s=0.31 + FRAME_S + 0.02)
    play.receive(0, 0, 0.34, published_s=0.21, message_id=5, daemon_s=0.34)
    found = story(play)
    assert parts(found)[:2] == [("out_of_range", 0.21, 0.25), ("reconnect", 0.25, 0.31)]


def test_a_peer_that_was_offline_for_no_known_reason(play: Play) -> None:
    play.event(0.1, "peer_down", epoch=EPOCHS["b"], reason="silent")
    play.publish(0, 0, 0.2)
    play.queue(0, 5, 0.2)
    play.event(0.7, "peer_up", epoch=EPOCHS["b"], reason="returned")
    play.send(0, 0, 0.71, message_id=5, number=2, arrives_s=0.71 + FRAME_S + 0.02)
    play.receive(0, 0, 0.74, published_s=0.2, message_id=5, daemon_s=0.74)
    found = story(play)
    assert parts(found)[:2] == [("peer_absent", 0.2, 0.7), ("pacing", 0.7, 0.71)]
    assert found.parts[0].words == "a held b offline since 0.100 s; a heard b at 0.700 s"


@pytest.mark.parametrize("is_told", [True, False])
def test_what_left_for_a_daemon_that_is_gone_begins_anew(play: Play, is_told: bool) -> None:
    if is_told:
        play.step(0.2, "kill", "kill udp_mesh on b")
        play.step(0.5, "start_process", "start udp_mesh on b")
    play.publish(0, 0, 0.15)
    play.queue(0, 5, 0.15)
    play.send(0, 0, 0.21, message_id=5, number=7, arrives_s=0.21 + FRAME_S + 0.02)
    play.event(0.55, "peer_up", epoch=NEW_EPOCH, reason="restarted")
    play.send(0, 0, 0.56, message_id=5, number=0, arrives_s=0.56 + FRAME_S + 0.02, epoch_b=NEW_EPOCH)
    play.acknowledge(0.6, 0, epoch=NEW_EPOCH)
    play.receive(0, 0, 0.6, published_s=0.15, message_id=5, daemon_s=0.6)
    found = story(play)
    assert found.cause is Cause.RESTART
    first, second = found.fragments[0].transmissions
    assert (first.sending, first.counts, first.acked_s) == (Sending.FIRST, False, None)
    assert (second.sending, second.counts, second.acked_s) == (Sending.ANEW, True, pytest.approx(0.6))
    if is_told:
        assert parts(found)[:3] == [("pacing", 0.15, 0.2), ("restart", 0.2, 0.55), ("restart", 0.55, 0.56)]
        assert found.parts[1].words == (
            "the daemon of b was killed at 0.200 s and started again at 0.500 s; a met its new epoch at 0.550 s"
        )
    else:
        assert parts(found)[:2] == [("pacing", 0.15, 0.21), ("restart", 0.21, 0.56)]
        assert found.parts[1].words == (
            "fragment 1/1 left at 0.210 s for a daemon of b that has forgotten it; it left again at 0.560 s"
        )


def test_a_message_begun_anew_is_followed_by_its_new_id(play: Play) -> None:
    play.publish(0, 0, 0.1)
    play.queue(0, 5, 0.1)
    play.send(0, 0, 0.1, message_id=5, number=1, arrives_s=0.13)
    play.event(0.4, "message_begun_anew", message_id=5, wire_id=9)
    play.send(0, 0, 0.41, message_id=9, number=2, arrives_s=0.41 + FRAME_S + 0.02)
    play.receive(0, 0, 0.44, published_s=0.1, message_id=9, daemon_s=0.44)
    found = story(play)
    assert [sent.sending for sent in found.fragments[0].transmissions] == [Sending.FIRST, Sending.ANEW]
    assert parts(found)[0] == ("restart", 0.1, 0.41)


def test_a_more_urgent_backlog_elsewhere(play: Play) -> None:
    play.publish(1, 0, 0.1)
    play.queue(1, 4, 0.1)
    play.hear(0.12, wire.encode_backlog(2))
    play.send(1, 0, 0.3, message_id=4, number=1, arrives_s=0.3 + FRAME_S + 0.02)
    play.receive(1, 0, 0.33, published_s=0.1, message_id=4, daemon_s=0.33)
    found = story(play, 1)
    assert parts(found)[:2] == [("pacing", 0.1, 0.12), ("yielding", 0.12, 0.3)]
    assert found.parts[1].words == "b had something of priority 2 waiting"


def test_each_destination_has_its_own_packet_numbers(play: Play) -> None:
    play.publish(0, 0, 0.1)
    play.queue(0, 5, 0.1)
    play.send(0, 0, 0.1, message_id=5, number=1, verdict=Verdict.LOST)
    broadcast = frame("a", data(1, 0, message_id=9), number=1, broadcast=True)
    play.packet("a", 0.15, broadcast, Direction.OUTBOUND)
    play.packet("b", 0.17, broadcast, Direction.INBOUND)
    play.send(0, 0, 0.2, message_id=5, number=2, arrives_s=0.2 + FRAME_S + 0.02)
    play.receive(0, 0, 0.23, published_s=0.1, message_id=5, daemon_s=0.23)
    assert parts(story(play))[0] == ("loss", 0.1, 0.2)


def test_ids_that_begin_again_after_a_restart_mean_other_messages(play: Play) -> None:
    play.publish(0, 0, 0.1)
    play.queue(0, 0, 0.1)
    play.send(0, 0, 0.1, message_id=0, number=0, verdict=Verdict.LOST)
    play.publish(0, 1, 0.9)
    play.queue(0, 0, 0.9)
    play.send(0, 1, 0.95, message_id=0, number=0, arrives_s=0.95 + FRAME_S + 0.02)
    play.receive(0, 1, 0.98, published_s=0.9, message_id=0, daemon_s=0.98)
    found = story(play, seq=1)
    assert parts(found)[0] == ("pacing", 0.9, 0.95)
    assert len(found.fragments[0].transmissions) == 1


def test_a_stored_message_waits_in_its_senders_store(play: Play) -> None:
    play.event(0.05, "peer_down", epoch=EPOCHS["b"], reason="silent")
    for seq, at_s in ((0, 0.1), (1, 0.2)):
        play.publish(0, seq, at_s)
        about = {"topic": "telemetry", "priority": 1, "size_bytes": 118}
        play.event(at_s + 0.01, "message_stored", sequence=seq + 7, **about)
    play.event(0.6, "stored_dropped", sequence=7, reason="expired", **about)
    play.event(0.7, "peer_up", epoch=EPOCHS["b"], reason="returned")
    play.queue(0, 5, 0.72, size_bytes=143)
    play.send(0, 1, 0.72, message_id=5, number=1, arrives_s=0.72 + FRAME_S + 0.02)
    play.receive(0, 1, 0.75, published_s=0.2, message_id=5, daemon_s=0.745)
    found = story(play, seq=1)
    assert parts(found)[:2] == [("peer_absent", 0.2, 0.7), ("queue", 0.7, 0.72)]
    assert found.parts[1].words == "in the store of a"
    with Capture.open(play.path) as capture:
        trace = read_trace(capture, with_packets=False)
        dropped = tell(capture, trace, trace.streams[0], trace.published[0][0])
    assert (dropped.fate, dropped.reason, dropped.message_id) == (Fate.DROPPED, "expired", None)
    assert parts(dropped) == [("peer_absent", 0.1, 0.6)]


def test_a_message_of_which_no_packet_can_be_read(play: Play) -> None:
    play.publish(0, 0, 0.1)
    play.queue(0, 5, 0.11)
    play.event(0.3, "message_acked", message_id=5)
    play.receive(0, 0, 0.25, published_s=0.1, message_id=5, daemon_s=0.25)
    found = story(play)
    assert parts(found) == [("handover", 0.1, 0.11), ("unexplained", 0.11, 0.25)]
    assert found.notes == ("no packet of it can be read: sealed by a key, or missing in the capture",)


def test_of_a_delivered_message_a_fragment_may_be_missing_in_the_capture(play: Play) -> None:
    play.publish(1, 0, 0.1)
    play.queue(1, 4, 0.1, fragments=2)
    play.send(1, 0, 0.1, message_id=4, number=1, count=2)
    play.send(1, 0, 0.11, message_id=4, number=2, index=1, count=2, arrives_s=0.14)
    play.receive(1, 0, 0.15, published_s=0.1, message_id=4, daemon_s=0.15)
    assert story(play, 1).critical_index == 1


FATES: list[tuple[dict[str, Any], Fate, str, str]] = [
    ({"accepted": False, "reason": "queue_full"}, Fate.REFUSED, "queue_full", "refused at once: queue_full"),
    ({"dropped": "expired"}, Fate.DROPPED, "expired", "given up by its sender 0.600 s (500.0 ms later): expired"),
    ({"acked": True}, Fate.NOT_HANDED_OVER, "", "the subscribing process did not get it"),
    ({}, Fate.UNDELIVERED, "", "not delivered by the end of the capture (2.000 s)"),
]


@pytest.mark.parametrize(("what", "fate", "reason", "words"), FATES)
def test_what_became_of_those_that_did_not_get_there(
    play: Play, what: dict[str, Any], fate: Fate, reason: str, words: str
) -> None:
    play.publish(0, 0, 0.1, accepted=what.get("accepted", True), reason=what.get("reason"))
    if fate is not Fate.REFUSED:
        play.queue(0, 5, 0.1)
    if what.get("dropped"):
        play.event(0.6, "message_dropped", message_id=5, topic="telemetry", reason=what["dropped"])
    if what.get("acked"):
        play.send(0, 0, 0.1, message_id=5, number=1, arrives_s=0.13)
        play.event(0.16, "message_acked", message_id=5)
    found = story(play)
    assert (found.fate, found.reason, found.delivered_s) == (fate, reason, None)
    assert words in fate_text(found)


def test_without_verdicts_a_frame_that_did_not_arrive_is_lost_and_a_note_says_what_is_unknown(tmp_path: Path) -> None:
    play = Play(tmp_path / "kernel.mcap")
    play.publish(0, 0, 0.1)
    play.queue(0, 5, 0.1)
    for number, at_s in ((1, 0.1), (2, 0.2)):
        content = play.frame(data(0, 0, message_id=5), number)
        play.packet("a", at_s, content, Direction.OUTBOUND)
        if number == 2:
            play.packet("b", at_s + FRAME_S + 0.02, content, Direction.INBOUND)
    play.receive(0, 0, 0.23, published_s=0.1, message_id=5, daemon_s=0.23)
    found = story(play)
    assert parts(found)[:3] == [
        ("loss", 0.1, 0.2),
        ("transmission", 0.2, round(0.2 + FRAME_S, 6)),
        ("propagation", round(0.2 + FRAME_S, 6), round(0.22 + FRAME_S, 6)),
    ]
    assert any("this engine tells no verdicts" in note for note in found.notes)


def test_a_message_of_another_transport_is_not_explained_but_told(play: Play) -> None:
    play.publish(0, 0, 0.1)
    told = {"stream": 0, "seq": 0, "published_ns": 0, "size_bytes": 118, "source": "a"}
    play.json("/b/traffic/received", 0.3, event="received", **told)
    found = story(play)
    assert (found.fate, found.cause) == (Fate.DELIVERED, Cause.UNEXPLAINED)
    assert parts(found) == [("unexplained", 0.1, 0.3)]
    assert because(found) == "Late: the capture does not say why (200.0 ms, 100 %)."
