"""From a file with real udp_mesh datagrams to a trace."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner

from netlab.capture.schemas import Direction
from netlab.capture.topics import Topics
from netlab.capture.writer import CaptureWriter
from netlab.cli.inspect import inspect
from netlab.errors import CaptureError
from netlab.medium.verdicts import Verdict
from netlab.traces.inversions import inversions
from netlab.traces.load import load_trace
from netlab.traces.messages import message_lives
from netlab.traces.model import Trace
from netlab.traces.retransmissions import retransmissions
from netlab.traces.streams import stream_report
from tests.traces.captures import PORTS, STREAMS, T0_NS, Writer, data, frame
from udp_mesh.core import wire


@pytest.fixture
def run(tmp_path: Path) -> Path:
    writer = Writer(tmp_path / "run.mcap")
    writer.json("/timeline", 0.0, kind="start", label="t = 0", at_s=0.0, restores=None)
    writer.json("/a/udp_mesh/events", -0.5, event="peer_up", peer="b", reason="discovered")
    beacon = wire.encode_hello(name="b", beacon_interval_s=1, floor=0)
    writer.packet("b", 0.001, frame("b", beacon, number=1), Direction.OUTBOUND)
    writer.json("/a/traffic/published", 0.1, event="published", stream=1, seq=0, size_bytes=236, accepted=True)
    writer.crossing(0.101, frame("a", data(1, 0, message_id=5, index=0, count=2), number=1))
    writer.json("/a/traffic/published", 0.11, event="published", stream=0, seq=0, size_bytes=118, accepted=True)
    writer.crossing(0.115, frame("a", data(1, 0, message_id=5, index=1, count=2), number=2), Verdict.LOST)
    writer.crossing(0.120, frame("a", data(0, 0, message_id=6), number=3))
    received = {"stream": 0, "seq": 0, "published_ns": T0_NS + 110_000_000, "size_bytes": 118, "source": "a"}
    writer.json("/b/traffic/received", 0.141, event="received", **received)
    writer.crossing(0.2, frame("a", data(1, 0, message_id=5, index=1, count=2), number=4))
    writer.json("/a/udp_mesh/events", 0.3, event="window", peer="b", cwnd_bytes=6000, in_flight_bytes=0)
    writer.json("/a/udp_mesh/events", 1.0, event="peer_down", peer="b", reason="silent")
    writer.json("/timeline", 1.2, kind="outage", label="outage a-b ends", at_s=1.2, restores=["a", "b"])
    writer.writer.close()
    return writer.path


def test_a_capture_becomes_a_trace(run: Path) -> None:
    trace = load_trace(run)
    assert (trace.t0_ns, trace.duration_s, trace.notes) == (T0_NS, 2.0, [])
    assert [(step.at_s, step.restores) for step in trace.timeline] == [(0.0, None), (1.2, ("a", "b"))]
    fragments = trace.fragments["a"]
    assert [(entry.message_id, entry.index, entry.count, entry.priority) for entry in fragments] == [
        (5, 0, 2, 9),
        (5, 1, 2, 9),
        (6, 0, 1, 1),
        (5, 1, 2, 9),
    ]
    assert {entry.destination for entry in fragments} == {"b"}  # known by b's own datagrams
    assert [entry.message for entry in fragments] == [(1, 0), (1, 0), (0, 0), (1, 0)]
    assert "b" not in trace.fragments  # what b hears is not what b sends
    assert trace.rates_bps == {("a", "eth0"): [(0, 1e7)]}
    assert trace.streams[1].keeps_latest
    assert trace.presence["a", "b"].at(T0_NS)
    assert not trace.presence["a", "b"].at(T0_NS + 1_100_000_000)
    assert trace.windows["a", "b"][0].cwnd_bytes == 6000
    assert trace.links[("a", "eth0"), ("b", "eth0")].verdicts == {Verdict.DELIVERED: 3, Verdict.LOST: 1}


def test_the_questions_work_on_it(run: Path) -> None:
    trace = load_trace(run)
    assert len(retransmissions(trace, "a")) == 1
    (found,) = inversions(trace, "a")
    assert (found.fragment.message_id, found.fragment.index, found.seq) == (5, 1, 0)
    report = stream_report(trace, trace.streams[0])
    assert (report.sent, report.delivered) == (1, 1)
    assert report.latency is not None
    assert report.latency.max == pytest.approx(0.031)


def test_a_publication_to_all_belongs_to_each_of_its_streams(tmp_path: Path) -> None:
    streams = [STREAMS[0], STREAMS[0] | {"stream": 1, "destination": "c"}]
    writer = Writer(tmp_path / "all.mcap", {"streams": json.dumps(streams)})
    for stream in (0, 1):
        writer.json("/a/traffic/published", 0.1, event="published", stream=stream, publication=0, seq=0, size_bytes=118)
    writer.crossing(0.2, frame("a", data(0, 0, message_id=6), number=3, broadcast=True))
    writer.writer.close()
    trace = load_trace(writer.path)
    assert [trace.published[stream][0].publication for stream in (0, 1)] == [0, 0]
    assert [entry.destination for entry in trace.fragments["a"]] == ["all"]
    assert [entry.message for entry in trace.fragments["a"]] == [(0, 0)]


def test_rates_follow_the_links(tmp_path: Path) -> None:
    ports = [port | {"segment": "a-b"} for port in PORTS] + [{"node": "a", "interface": "eth1", "segment": "a-c"}]
    writer = Writer(tmp_path / "rates.mcap", {"ports": json.dumps(ports)})
    for at_s, rate_bps in ((0.0, 1e7), (1.0, 2e6), (2.0, None)):
        row = {"segment": "a-b", "from": "a", "to": "b", "impairment": {"rate_bps": rate_bps}}
        writer.json("/links", at_s, **row)
    writer.json("/links", 2.0, segment="gone", **{"from": "a", "to": "b"})
    writer.writer.close()
    trace = load_trace(writer.path)
    at = [trace.rate_bps(("a", "eth0"), T0_NS + second * 10**9) for second in (-1, 0, 1, 2, 3)]
    assert at == [1e7, 1e7, 2e6, None, None]
    assert trace.rate_bps(("a", "eth1"), T0_NS) is None


def test_a_capture_without_metadata_is_an_empty_trace(tmp_path: Path) -> None:
    writer = CaptureWriter(tmp_path / "bare.mcap")
    Topics(writer).add_json("/timeline", {"kind": "start"}, T0_NS)
    writer.close()
    trace = load_trace(tmp_path / "bare.mcap")
    assert isinstance(trace, Trace)
    assert (trace.t0_ns, trace.streams, len(trace.timeline)) == (T0_NS, (), 1)


@pytest.mark.parametrize("streams", ["no json", '[{"stream": 1}]', '[{"stream": "x", "source": 1}]', "[3]", "17"])
def test_damaged_metadata_is_one_clear_error(tmp_path: Path, streams: str) -> None:
    writer = Writer(tmp_path / "odd.mcap", {"streams": streams})
    writer.writer.close()
    with pytest.raises(CaptureError, match=r"odd\.mcap: metadata of the run is damaged"):
        load_trace(writer.path)


def look(run: Path, *arguments: str) -> list[str]:
    result = CliRunner().invoke(inspect, [str(run), *arguments])
    assert result.exit_code == 0, result.output + repr(result.exception)
    return result.stdout.splitlines()


def test_inspect_summarises(run: Path) -> None:
    text = "\n".join(look(run))
    assert "telemetry a->b" in text
    assert "outage a-b ends" in text
    assert max(map(len, text.splitlines()[3:])) <= 100
    told = json.loads("".join(look(run, "--json")))
    assert told["messages"]["/a/eth0/packets"] == 4
    assert told["streams"][0]["delivered"] == 1


def test_inspect_lists_packets_by_every_filter(run: Path) -> None:
    assert len(look(run, "--kind", "packets")) == 8
    assert len(look(run, "--kind", "packets", "--node", "a")) == 4
    assert len(look(run, "--kind", "packets", "--node", "b", "--peer", "a")) == 4
    assert len(look(run, "--kind", "packets", "--node", "b", "--peer", "z")) == 0
    assert (
        len(look(run, "--kind", "packets", "--node", "a", "--topic", "bulk")) == 3
    )  # fragment 1 has no topic of its own
    assert len(look(run, "--kind", "packets", "--node", "a", "--priority", "1")) == 1
    assert len(look(run, "--kind", "packets", "--from-s", "0.1", "--to-s", "0.12")) == 2
    assert len(look(run, "--kind", "packets", "--limit", "2")) == 2
    (line,) = look(run, "--kind", "packets", "--node", "a", "--topic", "telemetry")
    assert (
        line.strip() == "0.120000  a/eth0           -> 10.1.0.1 > 10.1.0.2 mesh #3 data p1 m6 1/1 telemetry s0#0 118 B"
    )


def test_inspect_lists_the_other_kinds(run: Path) -> None:
    assert [line.split()[-2:] for line in look(run, "--kind", "verdicts", "--node", "b")][1] == ["197", "B"]
    assert "lost" in look(run, "--kind", "verdicts")[1]
    assert len(look(run, "--kind", "timeline", "--node", "a")) == 2
    assert len(look(run, "--kind", "events", "--peer", "b")) == 3
    assert len(look(run, "--kind", "events", "--priority", "1")) == 0
    bulk, telemetry = look(run, "--kind", "messages")
    assert bulk.endswith("2 fragments +1 again not delivered")
    assert telemetry.endswith("delivered after 31.0 ms")
    (as_json,) = look(run, "--kind", "messages", "--priority", "1", "--json")
    assert json.loads(as_json)["latency_s"] == pytest.approx(0.031)
    for kind in ("packets", "verdicts", "events", "timeline"):
        assert all(json.loads(line)["t_ns"] for line in look(run, "--kind", kind, "--json"))


def test_filters_alone_choose_a_sensible_kind(run: Path) -> None:
    assert "delivered after" in look(run, "--topic", "telemetry")[0]
    assert "a/eth0" in look(run, "--node", "a")[0]


def test_copies_are_no_retransmissions_and_a_drop_is_known_by_the_id_on_the_wire(tmp_path: Path) -> None:
    writer = Writer(tmp_path / "copies.mcap")
    beacon = wire.encode_hello(name="b", beacon_interval_s=1, floor=0)
    writer.packet("b", 0.001, frame("b", beacon, number=1), Direction.OUTBOUND)
    fragment = {"event": "fragment_copied", "peer": "b", "priority": 1, "message_id": 6, "fragment_index": 0}
    for number, at_s in enumerate((0.1, 0.102, 0.2)):
        writer.crossing(at_s, frame("a", data(0, 0, message_id=6), number=number))
    writer.json("/a/udp_mesh/events", 0.102, packet_number=1, **fragment)
    writer.json("/a/udp_mesh/events", 9.0, packet_number=2, **fragment)  # of a later life of the daemon
    writer.json("/a/udp_mesh/events", 0.3, event="message_begun_anew", peer="b", message_id=6, wire_id=11)
    writer.json("/a/udp_mesh/events", 0.4, event="message_dropped", peer="b", message_id=6, reason="expired")
    writer.writer.close()
    trace = load_trace(tmp_path / "copies.mcap")
    assert [entry.is_copy for entry in trace.fragments["a"]] == [False, True, False]
    assert [trace.seconds(entry.t_ns) for entry in retransmissions(trace, "a")] == [0.2]
    assert trace.dropped_ns == {("a", number): [T0_NS + 400_000_000] for number in (6, 11)}


def test_a_broadcast_to_fixed_neighbours_one_by_one_is_no_retransmission(tmp_path: Path) -> None:
    c = {"node": "c", "interface": "eth0", "address": "10.1.0.3/24"}
    writer = Writer(tmp_path / "neighbours.mcap", {"ports": json.dumps([*PORTS, c])})
    for seq in (0, 1):
        writer.json("/a/traffic/published", 0.1 + seq, stream=0, seq=seq, size_bytes=118)
    for at_s, to, seq in ((0.1, 2, 0), (0.101, 3, 0), (1.1, 2, 1), (1.101, 3, 1), (1.3, 3, 1)):
        body = data(0, seq, message_id=6 + seq)
        writer.crossing(at_s, frame("a", body, number=0, broadcast=True, last_byte=to))
    writer.writer.close()
    trace = load_trace(tmp_path / "neighbours.mcap")
    assert {entry.destination for entry in trace.fragments["a"]} == {"all"}
    assert [trace.seconds(entry.t_ns) for entry in retransmissions(trace, "a")] == [1.3]
    to_b = message_lives(trace)  # streams of this capture go to b: what went to c is no transmission of theirs
    assert [(life.fragments_sent, life.retransmissions) for life in to_b] == [(1, 0), (1, 0)]
