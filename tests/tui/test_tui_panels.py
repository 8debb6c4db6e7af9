"""The panels' texts: nothing that matters is cut off where a terminal of 80 columns leaves them little room."""

from __future__ import annotations

from dataclasses import replace

import pytest
from rich.text import Text

from netlab.live.links import Direction, Link
from netlab.live.model import LiveModel, Moment, Peer, Stream
from netlab.tui import panels
from netlab.tui.standing import Standing

NARROW, LINES = 32, 10  # of the right panels at 80 x 24
STREAMS = 44
RUNNING = Standing(phase="running", t_s=34.25, end_s=151.62137, recording="captures/corner.mcap")


def model() -> LiveModel:
    made = LiveModel(name="corner", engine="air")
    base = made._node("base")
    base.peers["robot"] = Peer(online=True, srtt_s=0.0166, rate_bps=84.7e6)
    base.retransmissions = 1
    made._node("robot")
    made.streams[0] = Stream(0, "robot", "base", "telemetry", 1)
    return made


def lines(text: Text, width: int) -> list[str]:
    """Its lines, each of which fits."""
    found = text.plain.splitlines()
    assert [line for line in found if len(line.rstrip()) > width] == []
    return found


def test_the_head_rounds_times_and_leaves_the_engine_out_first() -> None:
    [head] = lines(panels.head_text(model(), RUNNING, 80), 80)
    assert " 34.2 / 151.6 s " in head
    assert head.endswith("engine air")
    held = replace(RUNNING, held=True, recording="captures/corner-of-the-mine.mcap")
    [head] = lines(panels.head_text(model(), held, 80), 80)
    assert "engine" not in head
    assert "● rec corner-of-the-mine.mcap" in head


def test_what_is_over_is_not_being_recorded() -> None:
    head = panels.head_text(model(), replace(RUNNING, phase="finished", recording=None), 80).plain
    assert "rec" not in head


def test_a_node_in_a_narrow_panel() -> None:
    found = lines(panels.node_text(model().nodes["base"], RUNNING, width=NARROW, lines=LINES), NARROW)
    assert any(line.split() == ["peers", "1", "online", "rtt", "rate"] for line in found)
    assert any(line.split() == ["●", "robot", "16.6", "ms", "84.7", "Mbit/s"] for line in found)
    assert " 1 fragment sent again" in found


def test_what_was_dropped_and_what_waits_for_others_is_told_whole() -> None:
    node = model().nodes["base"]
    for number, event in enumerate(("message_queued", "message_stored")):
        node.queues.take({"event": event, "peer": "far", "message_id": 1, "sequence": 1, "size_bytes": 100})
        node.queues.take({"event": "message_dropped", "reason": f"a_reason_{number}", "peer": "x", "message_id": 9})
    found = " ".join(" ".join(lines(panels.node_text(node, RUNNING, width=NARROW, lines=LINES), NARROW)).split())
    assert "for peers away: 1 in memory, 1 stored (200 B) dropped: a_reason_0 1, a_reason_1 1" in found


def test_a_link_in_a_narrow_panel() -> None:
    link = Link("a", "b", {("a", "b", "radio"): Direction("radio", "up", rssi_dbm=-63.2, snr_db=27.9)})
    assert " signal   -63 dBm, SNR 28 dB" in lines(panels.link_text(link), NARROW)


def test_troubles_are_told_in_whole_sentences() -> None:
    standing = replace(RUNNING, troubles=("the capture missed packets at robot: this machine is too slow for them",))
    found = lines(panels.overview_text(model(), standing, width=NARROW), NARROW)
    assert "this machine is too slow for them" in " ".join(" ".join(found).split())


@pytest.mark.parametrize(("width", "has_history"), [(STREAMS, False), (60, True), (92, True)])
def test_streams_have_a_history_where_there_is_room(width: int, has_history: bool) -> None:
    head, *_, stream = lines(panels.streams_text(model(), width=width, lines=LINES), width)
    assert ("last" in head) is has_history
    assert "telemetry robot→" in stream
    assert ("base" in stream) is (width != 60)


def test_the_timeline_tells_the_newest_in_whole_sentences() -> None:
    made = model()
    made.moments.extend(Moment(float(at_s), "radio", f"event {at_s}", by_hand=False) for at_s in range(20))
    made.moments.append(Moment(30.0, "radio", "base and robot lose each other", by_hand=True))
    found = lines(panels.timeline_text(made, RUNNING, width=NARROW, lines=8), NARROW)
    assert len(found) == 8
    assert found[-4:] == ["   30.0 ✎ base and robot lose", "          each other", *found[-2:]]
    assert found[-2].startswith("   34.2 ▶ now")
    assert found[-1] == "          nothing comes any more"
    assert found[0] == "   16.0   event 16"


def test_the_verdict_in_a_narrow_panel() -> None:
    brief = "expectations\n  NOT MET  latency of telemetry p99 <= 50.0 ms  (measured 126.3 ms)\n\nproblems\n  none"
    found = lines(panels.verdict_text(brief, width=NARROW), NARROW)
    assert "(measured 126.3 ms)" in " ".join(" ".join(found).split())
