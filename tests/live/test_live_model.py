"""Records in, what a screen shows out: nodes, peers, queues, links, latencies, the timeline."""

from __future__ import annotations

import json
from typing import Any

import pytest

from netlab.capture.records import JsonRecord, Kind, LogLine, kind_of
from netlab.capture.schemas import LogLevel
from netlab.live.links import Grade, direction_of, mean_loss
from netlab.live.model import LiveModel
from netlab.live.queues import Queues, Waiting
from netlab.live.windows import LatencyWindow, sparkline

T0_NS = 1_800_000_000_000_000_000
STREAMS = [{"stream": 0, "source": "a", "destination": "b", "topic": "t", "priority": 1}]


def record(topic: str, t_s: float, /, **payload: Any) -> JsonRecord:
    node = topic.split("/")[1] if topic.count("/") > 1 else ""
    return JsonRecord(T0_NS + round(t_s * 1e9), kind_of(topic), topic, node, payload)


@pytest.fixture
def model() -> LiveModel:
    model = LiveModel()
    ports = json.dumps([{"node": "a"}, {"node": "b"}])
    model.describe({"name": "x", "engine": "air", "ports": ports, "streams": json.dumps(STREAMS), "t0_ns": str(T0_NS)})
    return model


def link(state: str, sender: str = "a", receiver: str = "b", segment: str = "w", **more: Any) -> JsonRecord:
    return record("/links", 1.0, **{"segment": segment, "from": sender, "to": receiver, "state": state, **more})


def test_metadata_names_nodes_and_streams(model: LiveModel) -> None:
    assert list(model.nodes) == ["a", "b"]
    assert model.streams[0].topic == "t"
    assert model.seconds(T0_NS + 1_500_000_000) == 1.5


def test_peers_come_and_go_with_their_flows(model: LiveModel) -> None:
    model.take(record("/a/udp_mesh/events", 1.0, event="peer_up", peer="b"))
    flow = {"srtt_s": 0.01, "rate_bps": 2e6, "in_flight_bytes": 10, "cwnd_bytes": 20}
    model.take(record("/a/udp_mesh/events", 1.1, event="window", peer="b", **flow))
    assert model.nodes["a"].online == ["b"]
    assert (model.nodes["a"].peers["b"].srtt_s, model.nodes["a"].peers["b"].rate_bps) == (0.01, 2e6)
    model.take(record("/a/udp_mesh/events", 2.0, event="peer_down", peer="b"))
    assert model.nodes["a"].online == []


def test_a_daemon_that_ends_has_neither_peers_nor_queues(model: LiveModel) -> None:
    model.take(record("/a/udp_mesh/events", 1.0, event="peer_up", peer="b"))
    queued = {"message_id": 1, "priority": 2, "size_bytes": 9, "peer": "b"}
    model.take(record("/a/udp_mesh/events", 1.0, event="message_queued", **queued))
    model.take(record("/timeline", 2.0, kind="exit", label="a: udp_mesh was ended by SIGKILL", at_s=2.0))
    assert model.nodes["a"].online == []
    assert model.nodes["a"].queues.by_priority() == {}


def test_latencies_count_each_message_once(model: LiveModel) -> None:
    model.take(record("/a/traffic/published", 1.0, event="published", stream=0, seq=0))
    for at_s in (1.02, 1.5):  # a duplicate
        received = {"stream": 0, "seq": 0, "published_ns": T0_NS + 1_000_000_000, "size_bytes": 7}
        model.take(record("/b/traffic/received", at_s, event="received", **received))
    stream, window = model.streams[0], model.priorities[1]
    assert (stream.sent, stream.window.delivered, window.delivered, window.size_bytes) == (1, 1, 1, 7)
    assert window.percentile_s(50, now_s=T0_NS / 1e9 + 2) == pytest.approx(0.02)


def test_a_link_is_as_good_as_its_worse_direction_of_its_better_way(model: LiveModel) -> None:
    model.take(link("up"))
    model.take(link("outage", "b", "a"))
    [one] = model.shown_links()
    assert (one.name, one.grade, one.is_cut) == ("a-b", Grade.DOWN, False)
    model.take(link("no_carrier"))
    assert one.is_cut
    model.take(link("up", segment="radio", snr_db=15.0))
    model.take(link("up", "b", "a", "radio", snr_db=30.0))
    assert one.grade is Grade.FAIR


def test_links_out_of_range_and_of_carried_nodes_are_not_shown(model: LiveModel) -> None:
    model.take(link("out_of_range"))
    assert model.shown_links() == []
    model.take(link("up"))
    assert len(model.shown_links()) == 1
    pose = {"position": {"x": 1.0, "y": 2.0, "z": 0.0}}
    model.take(record("/poses", 1.0, nodes=["a", "b"], poses=[pose, pose], active=[True, False], t_s=1.0))
    assert model.nodes["a"].position_m == (1.0, 2.0)
    assert model.shown_links() == []


@pytest.mark.parametrize(
    ("row", "grade"),
    [
        ({"state": "up"}, Grade.GOOD),
        ({"state": "up", "impairment": {"loss": {"loss_ratio": 0.05}}}, Grade.FAIR),
        ({"state": "up", "impairment": {"loss": {"loss_ratio": 0.2}}}, Grade.POOR),
        ({"state": "up", "snr_db": 25.0}, Grade.GOOD),
        ({"state": "up", "snr_db": 8.0}, Grade.POOR),
        ({"state": "no_carrier"}, Grade.DOWN),
        ({"state": "out_of_range"}, Grade.OUT_OF_RANGE),
    ],
)
def test_grades(row: dict[str, Any], grade: Grade) -> None:
    assert direction_of(row).grade is grade


@pytest.mark.parametrize(
    ("loss", "mean"),
    [
        (None, 0.0),
        ({"loss_ratio": 0.1, "correlation": 0.0}, 0.1),
        ({"p": 0.01, "r": 0.24, "loss_in_bad": 1.0, "loss_in_good": 0.0}, 0.04),
        ({"every": 4, "offset": 0}, 0.25),
        ({"pattern": [True, False, False, False]}, 0.25),
    ],
)
def test_the_mean_of_each_loss_model(loss: object, mean: float) -> None:
    assert mean_loss(loss) == pytest.approx(mean)


def test_the_timeline_tells_deeds_by_hand(model: LiveModel) -> None:
    model.take(record("/timeline", 1.0, kind="outage", label="planned", at_s=1.0))
    model.take(record("/timeline", 2.0, kind="outage", label="by hand", at_s=2.0, act={"do": "outage"}))
    assert [(moment.label, moment.by_hand) for moment in model.moments] == [("planned", False), ("by hand", True)]


def test_the_map_and_logs(model: LiveModel) -> None:
    tunnel = {"name": "adit", "path": [[0, 0, 0], [9, 0, 0]], "width_m": 4}
    model.take(record("/map", 0.0, entities=[], tunnels=[tunnel]))
    assert model.tunnels[0].path_m == ((0.0, 0.0), (9.0, 0.0))
    model.take(LogLine(T0_NS + 10**9, "a", "p", LogLevel.ERROR, "boom"))
    assert list(model.nodes["a"].log) == [(1.0, "p", LogLevel.ERROR, "boom")]


def test_metadata_that_is_no_json_is_survived() -> None:
    model = LiveModel()
    model.describe({"ports": "rubbish", "streams": "[1, 2]"})
    assert model.nodes == {}


def queued(peer: str, number: int, *, priority: int = 1, size: int = 100) -> dict[str, object]:
    return {"event": "message_queued", "peer": peer, "message_id": number, "priority": priority, "size_bytes": size}


def test_what_waits_by_priority_and_for_whom() -> None:
    queues = Queues()
    for event in (queued("b", 1), queued("b", 2, priority=5, size=50), queued("c", 1), queued("all", 9)):
        queues.take(event)
    assert queues.by_priority() == {1: Waiting(2, 200), 5: Waiting(1, 50)}
    assert queues.offline({"b"}) == Waiting(1, 100)
    queues.take({"event": "message_acked", "peer": "b", "message_id": 1})
    queues.take({"event": "message_dropped", "peer": "b", "message_id": 2, "reason": "expired"})
    assert queues.by_priority() == {1: Waiting(1, 100)}
    assert queues.dropped == {"expired": 1}


def test_a_store_survives_its_daemon() -> None:
    queues = Queues()
    queues.take({"event": "message_stored", "peer": "b", "sequence": 4, "priority": 3, "size_bytes": 20})
    queues.restarted()
    assert queues.stored() == {3: Waiting(1, 20)}
    queues.take({"event": "message_confirmed", "peer": "b", "sequence": 4})
    assert queues.stored() == {}


def test_a_window_forgets_and_ranks() -> None:
    window = LatencyWindow(buckets=3)
    for second in range(5):
        window.add(second / 10, now_s=float(second))
    assert window.series_s(4, now_s=4.0) == [None, 0.2, 0.3, 0.4]
    assert window.percentile_s(50, now_s=4.0, within_s=3.0) == 0.3
    assert window.percentile_s(99, now_s=4.0) == 0.4
    assert window.percentile_s(50, now_s=400.0) is None
    assert window.delivered == 5


def test_sparklines_are_logarithmic() -> None:
    assert sparkline([None, 0.0, 0.001, 0.0316, 1.0, 99.0]) == "·▁▁▄██" or sparkline([0.0316]) in "▄▅"
    assert sparkline([0.001, 0.01, 0.1, 1.0]) == "".join(sorted(sparkline([0.001, 0.01, 0.1, 1.0])))


def test_events_of_strangers_are_survived(model: LiveModel) -> None:
    assert kind_of("/links") is Kind.LINKS
    model.take(record("/z/udp_mesh/events", 1.0, event="never heard of"))
    model.take(record("/z/traffic/received", 1.0, event="received", stream=77, seq=1))
    assert "z" in model.nodes
