"""``netlab inspect`` as a person uses it: questions, forms, and what it says to mistakes."""

from __future__ import annotations

import csv
import io
import json
import shutil
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from netlab.capture.schemas import Direction
from netlab.cli.inspect import inspect
from netlab.errors import NetlabError
from netlab.medium.verdicts import Verdict
from tests.traces.captures import EPOCHS, PORTS, STREAMS, T0_NS, Play

BOTH = [STREAMS[0], STREAMS[1], STREAMS[0] | {"stream": 2, "source": "b", "destination": "a"}]


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """Telemetry a->b: #0 prompt, #1 lost once, #2 refused; bulk #0 expired after it was held; telemetry b->a #0."""
    play = Play(tmp_path / "run.mcap", {"streams": json.dumps(BOTH)})
    play.publish(0, 0, 0.1)
    play.queue(0, 5, 0.1)
    play.send(0, 0, 0.1, message_id=5, number=1, arrives_s=0.122)
    play.receive(0, 0, 0.123, published_s=0.1, message_id=5, daemon_s=0.122)
    play.event(0.15, "message_acked", message_id=5)
    play.publish(1, 0, 0.2)
    play.queue(1, 6, 0.2)
    play.event(0.2, "message_held", message_id=6)
    play.publish(0, 1, 0.3)
    play.queue(0, 7, 0.3)
    play.send(0, 1, 0.3, message_id=7, number=2, verdict=Verdict.LOST)
    play.send(0, 1, 0.4, message_id=7, number=3, arrives_s=0.422)
    play.receive(0, 1, 0.423, published_s=0.3, message_id=7, daemon_s=0.422)
    play.event(0.45, "message_acked", message_id=7)
    play.event(0.45, "window", cwnd_bytes=9000, in_flight_bytes=197)
    play.publish(0, 2, 0.5, accepted=False, reason="peer_offline")
    dropped = {"message_id": 6, "topic": "bulk", "priority": 9, "size_bytes": 118}
    play.event(0.7, "message_dropped", reason="expired", **dropped)
    told = {"stream": 2, "seq": 0, "size_bytes": 118, "accepted": True}
    play.json("/b/traffic/published", 0.8, event="published", **told)
    play.step(2.0, "end", "over")
    play.writer.close()
    return play.path


def ask(run: Path, *arguments: str) -> Result:
    return CliRunner().invoke(inspect, [str(run), *arguments], env={"COLUMNS": "100"})


def text(run: Path, *arguments: str) -> str:
    result = ask(run, *arguments)
    assert result.exit_code == 0, result.output + repr(result.exception)
    return result.stdout


def rows(run: Path, *arguments: str) -> list[dict[str, Any]]:
    """The answer as JSON, which must be the same as CSV says."""
    as_json = [json.loads(line) for line in text(run, *arguments, "--json").splitlines()]
    as_csv = list(csv.DictReader(io.StringIO(text(run, *arguments, "--format", "csv"))))
    assert len(as_csv) == len(as_json)
    for row, cells in zip(as_json, as_csv, strict=True):
        shown = {key: cells[key] for key in cells.keys() & row.keys()}
        assert shown == {key: "" if row[key] is None else str(row[key]) for key in shown}
    return as_json


def complaint(run: Path, *arguments: str) -> str:
    result = ask(run, *arguments)
    assert result.exit_code != 0, result.output
    assert result.exception is None or isinstance(result.exception, NetlabError | SystemExit), repr(result.exception)
    return result.stderr + str(result.exception or "")


@pytest.mark.parametrize(
    ("words", "found"),
    [
        (["telemetry a->b #1"], "telemetry #1 a->b"),
        (["telemetry#1"], "telemetry #1 a->b"),  # only one stream has published it
        (["bulk #0"], "bulk #0 a->b"),
        (["slowest"], "telemetry #1 a->b"),
        (["slowest", "--to", "250ms"], "telemetry #0 a->b"),
        (["lost"], "bulk #0 a->b"),
        (["lost", "--topic", "telemetry"], "telemetry #2 a->b"),
        (["#0 b->a"], "telemetry #0 b->a"),
        (["telemetry", "--priority", "1"], "telemetry #1 a->b"),
    ],
)
def test_a_message_is_named_in_many_ways(run: Path, words: list[str], found: str) -> None:
    assert text(run, "--why", *words).splitlines()[0].startswith(found)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["telemtry#1"], "no topic 'telemtry' in this capture; topics are bulk, telemetry"),
        (["telemetry#0"], "telemetry #0 means 2 messages; name one of 'telemetry a->b #0', 'telemetry b->a #0'"),
        (["telemetry#77"], "telemetry #77 was never published; published were telemetry a->b: #0 to #2"),
        (["telemetry a->c #0"], "streams are telemetry a->b, bulk a->b, telemetry b->a"),
        (["slowest", "--node", "z"], "no stream is left of these choices"),
        (["slowest", "--from", "1s"], "nothing was published in that time"),
        (["slowest", "--topic", "bulk"], "none of these messages was delivered; ask --why lost"),
        (["lost", "--to", "150ms"], "all of these messages were delivered; ask --why slowest"),
        ([""], "names no message. To name one: TOPIC#SEQ"),
    ],
)
def test_a_message_that_is_not_there_is_answered_with_what_is(run: Path, words: list[str], said: str) -> None:
    assert said in complaint(run, "--why", *words)


def test_why_in_three_forms(run: Path) -> None:
    told = text(run, "--why", "telemetry#1")
    assert "published 0.300 s, delivered 0.423 s: 123.0 ms (the stream's median is 23.0 ms, 5 times that)" in told
    assert "Late: frames were lost on the way and sent again (100.0 ms, 81 %)." in told
    assert "#2          0.300 s  first  lost on a/eth0 > b/eth0" in told
    assert max(map(len, told.splitlines())) <= 100
    body = json.loads(text(run, "--why", "telemetry#1", "--json"))
    assert (body["cause"], body["fate"], body["latency_s"]) == ("loss", "delivered", pytest.approx(0.123))
    assert body["fragments"][0]["transmissions"][0]["hops"][0]["verdict"] == "lost"
    parts = list(csv.DictReader(io.StringIO(text(run, "--why", "telemetry#1", "--format", "csv"))))
    assert sum(float(part["duration_s"]) for part in parts) == pytest.approx(0.123)
    assert next(part["cause"] for part in parts) == "loss"


def test_drops_by_place_and_reason(run: Path) -> None:
    found = rows(run, "--drops")
    assert [(row["where"], row["reason"], row["node"], row["topic"], row["count"]) for row in found] == [
        ("publish", "peer_offline", "a", "telemetry", 1),
        ("queue", "expired", "a", "bulk", 1),
        ("link", "lost", "a/eth0", "", 1),
    ]
    assert [row["where"] for row in rows(run, "--drops", "--topic", "bulk")] == ["queue"]
    assert [row["where"] for row in rows(run, "--drops", "--from", "0.6s")] == ["queue"]
    assert [row["where"] for row in rows(run, "--drops", "--node", "b", "--to", "0.45")] == ["link"]
    assert "nothing was dropped" in text(run, "--drops", "--from", "1s")


def test_queues_at_a_time(run: Path) -> None:
    at = json.loads(text(run, "--queues-at", "310ms", "--json"))
    assert [(row["topic"], row["messages"], row["held"]) for row in at["waiting"]] == [
        ("telemetry", 1, 0),
        ("bulk", 1, 1),
    ]
    assert [row["oldest_s"] for row in at["waiting"]] == pytest.approx([0.01, 0.11])
    assert at["in_links"] == [], "the frame was lost"
    assert at["windows"] == []
    later = json.loads(text(run, "--queues-at", "0.41", "--json"))
    assert [(row["from"], row["to"], row["frames"]) for row in later["in_links"]] == [("a/eth0", "b/eth0", 1)]
    end = json.loads(text(run, "--queues-at", "0.8s", "--json"))
    assert end["waiting"] == []
    assert end["windows"][0]["cwnd_bytes"] == 9000
    assert "queues of the nodes at 0.310 s" in text(run, "--queues-at", "310ms")
    assert "the capture ends at 2.000 s" in complaint(run, "--queues-at", "12.5s")
    assert "unknown unit 'parsec'" in complaint(run, "--queues-at", "3parsec")


def test_conversations(run: Path) -> None:
    (talk,) = rows(run, "--conversations")
    assert (talk["a"], talk["b"], talk["protocol"]) == ("a", "b", "udp_mesh")
    assert (talk["frames_ab"], talk["arrived_ab"], talk["missing_ab"], talk["frames_ba"]) == (3, 2, 1, 0)
    assert talk["bytes_ab"] == 3 * 207
    assert (talk["first_s"], talk["last_s"]) == pytest.approx((0.1, 0.4))
    assert rows(run, "--conversations", "--node", "z") == []
    assert "counts frames" in complaint(run, "--conversations", "--topic", "telemetry")
    assert rows(run, "--conversations", "--from", "350ms")[0]["frames_ab"] == 1


def test_conversations_tell_protocols_and_everybody_apart(tmp_path: Path) -> None:
    play = Play(tmp_path / "other.mcap")
    to_b, broadcast = bytes.fromhex("020000000002020000000001"), b"\xff" * 6 + bytes.fromhex("020000000001")
    ip = bytes.fromhex("4500003c00004000400600000a0100010a090009")
    play.packet("a", 0.1, to_b + b"\x08\x00" + ip + bytes.fromhex("c0001d17") + bytes(36), Direction.OUTBOUND)
    play.packet("a", 0.2, broadcast + b"\x08\x06" + bytes(28), Direction.OUTBOUND)
    play.packet("b", 0.21, broadcast + b"\x08\x06" + bytes(28), Direction.INBOUND)
    play.packet("a", 0.3, to_b + b"\x08\x06" + bytes(28), Direction.OUTBOUND)
    play.writer.close()
    found = {(row["a"], row["b"], row["protocol"]): row for row in rows(play.path, "--conversations")}
    assert set(found) == {("a", "10.9.0.9", "TCP 7447"), ("a", "all", "ARP"), ("a", "b", "ARP")}, (
        "no node has that address"
    )
    assert found["a", "all", "ARP"]["missing_ab"] is None
    assert found["a", "b", "ARP"]["arrived_ab"] == 0, "what was meant for all is no arrival of it"


def test_routes(run: Path) -> None:
    found = rows(run, "--routes")
    assert [(row["way"], row["datagrams"]) for row in found] == [("a > b", 2), ("did not arrive", 1)]
    assert [row["ratio"] for row in found] == pytest.approx([2 / 3, 1 / 3])
    assert rows(run, "--routes", "--topic", "bulk") == []
    assert [row["datagrams"] for row in rows(run, "--routes", "--topic", "telemetry", "--from", "350ms")] == [1]


def test_one_question_at_a_time(run: Path) -> None:
    assert "one question at a time: --why or --drops" in complaint(run, "--why", "slowest", "--drops")


def test_records_and_the_summary_in_csv(run: Path) -> None:
    packets = list(csv.DictReader(io.StringIO(text(run, "--kind", "packets", "--format", "csv"))))
    assert [packet["direction"] for packet in packets] == ["outbound", "inbound", "outbound", "outbound", "inbound"]
    events = list(csv.DictReader(io.StringIO(text(run, "--kind", "events", "--format", "csv"))))
    held = next(event for event in events if event["event"] == "message_held")
    assert json.loads(held["details"]) == {"message_id": 6, "peer": "b"}
    streams = list(csv.DictReader(io.StringIO(text(run, "--format", "csv"))))
    assert streams[0]["latency_p50_s"] == "0.023"
    assert len(text(run, "--topic", "telemetry", "--format", "csv").splitlines()) == 5


class TestDisplayFilters:
    def test_packets_that_match(self, run: Path) -> None:
        if shutil.which("tshark") is None:
            pytest.skip("tshark is not installed (sudo apt-get install tshark): --display is not tested with it")
        assert len(text(run, "--display", "udp.port == 8700").splitlines()) == 5
        assert len(text(run, "--display", "udp", "--node", "b").splitlines()) == 2
        (line,) = text(run, "--display", 'frame.interface_name == "a/eth0"', "--from", "350ms").splitlines()
        assert line.split()[0] == "0.400000"
        assert text(run, "--display", "tcp") == ""
        assert len(text(run, "--display", 'udp_mesh.topic == "telemetry"').splitlines()) == 5
        assert "nosuch" in complaint(run, "--display", "nosuch.field")
        assert "it does not go with --kind events" in complaint(run, "--display", "udp", "--kind", "events")

    def test_without_tshark_it_says_what_to_install_and_what_works_without(
        self, run: Path, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
    ) -> None:
        monkeypatch.setenv("PATH", str(tmp_path))
        said = complaint(run, "--display", "udp")
        assert "needs tshark, which is not installed here (sudo apt-get install tshark)" in said
        assert "--node, --peer, --topic" in said


def test_a_capture_of_nothing_answers_too(tmp_path: Path) -> None:
    play = Play(tmp_path / "none.mcap", {"streams": "[]"})
    play.writer.close()
    assert "no messages" in complaint(play.path, "--why", "slowest")
    for question in ("--drops", "--conversations", "--routes"):
        assert rows(play.path, question) == []


def test_the_play_is_what_the_loader_reads() -> None:
    """The rig's own numbers, on which the exact expectations above rest."""
    assert EPOCHS["b"] & 0xFFFFFFFF == 0xB
    assert T0_NS % 1_000_000_000 == 0
    assert {port["node"] for port in PORTS} == {"a", "b"}


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--node", "z"], "--node z: no such node in this capture; nodes are a, b"),
        (["--drops", "--peer", "z"], "--peer z: no such node in this capture; nodes are a, b"),
        (["--topic", "z"], "--topic z: not of this run's traffic; its topics are bulk, telemetry"),
        (["--conversations", "--peer", "all"], ""),
        (["--conversations", "--peer", "10.9.0.9"], ""),  # under which a host stands that is no node
        (["--topic", "bulk", "--node", "b", "--peer", "a"], ""),
    ],
)
def test_names_that_are_not_there_are_told_beside_the_answer(run: Path, arguments: list[str], said: str) -> None:
    result = ask(run, *arguments)
    assert result.exit_code == 0
    assert result.stderr == (f"note: {said}\n" if said else "")


def test_nodes_of_another_programs_capture_are_known_by_its_topics(tmp_path: Path) -> None:
    play = Play(tmp_path / "other.mcap", {"ports": "odd", "streams": '{"odd": 1}'})
    play.json("/c/other/events", 0.1, event="something")
    play.writer.close()
    assert not ask(play.path, "--kind", "events", "--node", "c").stderr
    assert "nodes are a, c" in ask(play.path, "--kind", "events", "--node", "b").stderr


def test_a_time_that_ends_before_it_begins_is_a_mistake(run: Path) -> None:
    result = ask(run, "--from", "2s", "--to", "1s")
    assert result.exit_code == 2
    assert "there is no time from 2 s to before 1 s" in result.stderr
