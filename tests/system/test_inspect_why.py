"""Messages delayed on purpose in a real lab: ``inspect --why`` names the true cause, in words and with times.

In virtual time: a machine that is late adds causes of its own, and they are named, too.
"""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner

from netlab.capture.reader import Capture
from netlab.capture.records import Kind
from netlab.capture.view import Filter
from netlab.cli.inspect import inspect
from netlab.inspect.choose import choose_message
from netlab.pytest_plugin import MakeLab
from netlab.traces.causes import Cause
from netlab.traces.load import read_trace
from netlab.traces.sentences import because, fate_text
from netlab.traces.story import Fate, Sending, Story
from netlab.traces.tell import tell

pytestmark = pytest.mark.lab_clock("virtual")

BETWEEN = ["base", "robot1"]


def scenario(*traffic: dict[str, Any], rate: str = "10mbit", **more: Any) -> dict[str, Any]:
    """A base and a robot on a wire, and what the robot sends to the base."""
    return {
        "duration": "4s",
        "nodes": {name: {"processes": ["udp_mesh"]} for name in BETWEEN},
        "links": [{"between": BETWEEN, "rate": rate, "delay": "10ms"}],
        "traffic": [{"from": "robot1", "to": "base", "size": "200B", "rate": "10Hz", **entry} for entry in traffic],
        **more,
    }


def recorded(make_lab: MakeLab, what: dict[str, Any]) -> Path:
    lab = make_lab(what)
    lab.run()
    return lab.capture


def told(capture: Path, message: str, **filters: Any) -> Story:
    """The story of a message; its parts must sum up to what it took, whatever they are."""
    with Capture.open(capture) as opened:
        trace = read_trace(opened, with_packets=False)
        story = tell(opened, trace, *choose_message(trace, message, Filter(**filters)))
    assert sum(part.duration_s for part in story.parts) == pytest.approx(story.ended_s - story.published_s, abs=1e-6)
    assert [part.from_s for part in story.parts[1:]] == [part.to_s for part in story.parts[:-1]], "a gap or an overlap"
    assert all(part.duration_s > 0 for part in story.parts)
    return story


def look(capture: Path, *arguments: str) -> str:
    result = CliRunner().invoke(inspect, [str(capture), *arguments], env={"COLUMNS": "100"})
    assert result.exit_code == 0, result.output + repr(result.exception)
    return result.stdout


def has_verdicts(capture: Path) -> bool:
    """Whether the engine told what became of each frame (``air``), or only packets tell (``netem``)."""
    with Capture.open(capture) as opened:
        return any(topic.kind is Kind.VERDICT for topic in opened.topics)


def times_in(text: str) -> list[float]:
    return [float(number) for number in re.findall(r"(\d+\.\d{3}) s", text)]


def test_radio_loss(make_lab: MakeLab) -> None:
    air = {"propagation": {"model": "table", "pairs": [{"between": BETWEEN, "delay": "5ms", "loss": "45%"}]}}
    capture = recorded(make_lab, scenario({"topic": "telemetry", "priority": 1}, links=[], radio=air, seed=4))
    story = told(capture, "slowest")
    assert (story.fate, story.cause) == (Fate.DELIVERED, Cause.LOSS), because(story)
    assert story.shares[0].cause is Cause.LOSS
    (fragment,) = story.fragments
    sent = fragment.transmissions
    assert [entry.sending for entry in sent[:2]] != [Sending.FIRST], "it was sent more than once"
    first = next(part for part in story.parts if part.cause is Cause.LOSS)
    words = f"fragment 1/1 left at {sent[0].left_s:.3f} s and "
    if has_verdicts(capture):
        assert (sent[0].hops[0].verdict, sent[0].hops[0].sender) == ("lost", "robot1/radio0")
        assert first.words.startswith(f"{words}was lost on robot1/radio0 > base/radio0; it left again at ")
    else:
        assert first.words.startswith(f"{words}did not arrive; it left again at ")
        assert "this engine tells no verdicts" in "".join(story.notes)
    assert times_in(first.words) == pytest.approx([sent[0].left_s, sent[1].left_s], abs=0.001)
    assert because(story).startswith("Late: frames were lost on the way and sent again (")
    assert because(story) in " ".join(look(capture, "--why", "slowest").split())


def test_queueing_behind_bulk(make_lab: MakeLab) -> None:
    bulk = {"topic": "map", "priority": 5, "size": "300kB", "rate": "0.5Hz"}
    capture = recorded(make_lab, scenario({"topic": "telemetry", "priority": 5}, bulk, rate="4mbit"))
    story = told(capture, "slowest", topic="telemetry")
    assert (story.fate, story.cause) == (Fate.DELIVERED, Cause.QUEUE), because(story)
    assert story.shares[0].duration_s > 0.3, "300 kB take 0.6 s on this link"
    (part, *_) = story.shares[0].parts
    assert (part.ahead[0].topic, part.ahead[0].seq) == ("map", 0)
    assert 100_000 < part.ahead[0].payload_bytes <= 300_000
    assert re.match(r"behind map #0 \(\d+\.\d kB\)", part.words)
    text = look(capture, "--why", "slowest", "--topic", "telemetry")
    assert f"{part.from_s:.3f}-" in text
    assert "behind map #0 (" in text
    at_s = story.published_s + 0.05
    queues = json.loads(look(capture, "--queues-at", f"{at_s:.3f}s", "--format", "json"))
    waiting = {row["topic"]: row for row in queues["waiting"]}
    assert waiting["map"]["size_bytes"] == 300_000
    assert waiting["telemetry"]["messages"] >= 1
    assert any(row["from"] == "robot1/eth0" and row["frames"] for row in queues["in_links"]) is has_verdicts(capture)


OUTAGE = scenario(
    {"topic": "telemetry", "priority": 1},
    {"topic": "status", "priority": 2, "offline": "latest"},
    {"topic": "pulse", "priority": 3, "offline": "latest", "lifetime": "350ms", "rate": "2Hz"},
    duration="5s",
    events=[{"at": "1.5s", "outage": {"between": BETWEEN, "for": "2s"}}],
)


def test_an_outage_and_whom_it_takes_along(make_lab: MakeLab) -> None:
    capture = recorded(make_lab, OUTAGE)
    story = told(capture, "slowest", topic="telemetry")
    assert (story.fate, story.cause) == (Fate.DELIVERED, Cause.OUTAGE), because(story)
    (outage,) = [part for part in story.parts if part.cause is Cause.OUTAGE]
    assert outage.words.startswith("outage between robot1 and base from 1.5")
    assert times_in(outage.words) == pytest.approx([1.5, 3.5], abs=0.3)
    assert outage.to_s == pytest.approx(times_in(outage.words)[1], abs=0.001)
    assert {share.cause for share in story.shares} >= {Cause.OUTAGE, Cause.RECONNECT}
    assert because(story).startswith(f"Late: the link was cut ({1000 * outage.duration_s:.1f} ms, ")

    refused = told(capture, "lost", topic="telemetry", from_s=2.5, to_s=3.4)
    assert (refused.fate, refused.reason, refused.parts) == (Fate.REFUSED, "peer_offline", ())
    assert because(refused).startswith("Never sent: outage between robot1 and base from 1.5")

    replaced = told(capture, "lost", topic="status", from_s=2.5, to_s=3.4)
    assert (replaced.fate, replaced.reason) == (Fate.DROPPED, "superseded")
    assert replaced.cause is Cause.OUTAGE
    assert because(replaced).startswith("A newer one took its place meanwhile: the link was cut (")

    expired = told(capture, "lost", topic="pulse", from_s=2.5, to_s=3.1)
    assert (expired.fate, expired.reason) == (Fate.DROPPED, "expired")
    assert expired.ended_s - expired.published_s == pytest.approx(0.35, abs=0.2)
    assert because(expired).startswith("Its lifetime ended first: the link was cut (")
    assert "expired" in fate_text(expired)

    rows = [json.loads(line) for line in look(capture, "--drops", "--json").splitlines()]
    reasons = {(row["where"], row["reason"]) for row in rows}
    assert reasons >= {("publish", "peer_offline"), ("queue", "superseded"), ("queue", "expired"), ("link", "outage")}
    assert all(1.4 < row["first_s"] <= row["last_s"] < 4.1 for row in rows if row["first_s"] is not None)


def test_a_receivers_restart(make_lab: MakeLab) -> None:
    bulk = {"topic": "map", "priority": 5, "size": "150kB", "rate": "1Hz"}
    kill = {"at": "1.4s", "kill": {"node": "base", "process": "udp_mesh"}, "restart": "1s"}
    capture = recorded(make_lab, scenario(bulk, rate="2mbit", duration="5s", events=[kill]))
    story = told(capture, "slowest", to_s=1.4)
    assert (story.fate, story.cause) == (Fate.DELIVERED, Cause.RESTART), because(story)
    (part, *_) = [part for part in story.parts if part.cause is Cause.RESTART]
    assert part.words.startswith("the daemon of base was killed at 1.4")
    killed_s, started_s, met_s = times_in(part.words)
    assert (killed_s, started_s) == pytest.approx((1.4, 2.4), abs=0.3)
    assert started_s <= met_s
    assert part.to_s == pytest.approx(met_s, abs=0.001)
    assert Sending.ANEW in {sent.sending for fragment in story.fragments for sent in fragment.transmissions}
    assert because(story).startswith("Late: a daemon was restarted (")


def test_a_rate_limit(make_lab: MakeLab) -> None:
    video = {"topic": "video", "priority": 7, "size": "2kB", "rate_limit": "7Hz"}
    brief = {"topic": "brief", "priority": 7, "rate_limit": "2Hz", "lifetime": "700ms"}
    capture = recorded(make_lab, scenario(video, brief))
    story = told(capture, "slowest", topic="video")
    assert (story.fate, story.cause) == (Fate.DELIVERED, Cause.RATE_LIMIT), because(story)
    (part,) = [part for part in story.parts if part.cause is Cause.RATE_LIMIT]
    assert part.duration_s > 0.5
    assert part.words == f"the rate limit of video held it back until {part.to_s:.3f} s"
    assert because(story).startswith("Late: the rate limit of its topic held it back (")
    dropped = told(capture, "lost", topic="brief")
    assert (dropped.fate, dropped.reason, dropped.cause) == (Fate.DROPPED, "expired", Cause.RATE_LIMIT)
    at_s = dropped.published_s + 0.3
    queues = json.loads(look(capture, "--queues-at", str(at_s), "--json"))
    assert {row["topic"]: row["held"] for row in queues["waiting"]}["brief"] >= 1


def test_several_causes_are_ranked_by_what_each_took(make_lab: MakeLab) -> None:
    bulk = {"topic": "map", "priority": 5, "size": "300kB", "rate": "0.5Hz"}
    cut = {"at": "0.4s", "outage": {"between": BETWEEN, "for": "300ms"}}
    what = scenario({"topic": "telemetry", "priority": 5}, bulk, rate="4mbit", events=[cut])
    story = told(recorded(make_lab, what), "slowest", topic="telemetry", to_s=0.4)
    causes = [share.cause for share in story.shares]
    assert set(causes[:2]) == {Cause.QUEUE, Cause.OUTAGE}, because(story)
    assert [share.duration_s for share in story.shares] == sorted((s.duration_s for s in story.shares), reverse=True)
    second = story.shares[1]
    name = {Cause.QUEUE: "queue", Cause.OUTAGE: "outage"}[second.cause]
    assert f"Also {name} ({1000 * second.duration_s:.1f} ms, {100 * second.ratio:.0f} %" in because(story)


def test_lost_for_good(make_lab: MakeLab) -> None:
    traffic = ({"topic": "pulse", "reliability": "best_effort"}, {"topic": "team", "to": "all"})
    cut = {"at": "1.5s", "link": {"from": "robot1", "to": "base", "loss": "100%"}}
    back = {"at": "1.9s", "link": {"from": "robot1", "to": "base", "loss": "0%"}}
    capture = recorded(make_lab, scenario(*traffic, duration="3s", events=[cut, back]))
    lost = told(capture, "lost", topic="pulse", from_s=1.5, to_s=1.8)
    assert (lost.fate, lost.reason, lost.cause) == (Fate.DROPPED, "lost", Cause.LOSS)
    assert because(lost).startswith("It was lost, and best effort does not send again: frames were lost on the way")
    if has_verdicts(capture):
        assert lost.fragments[0].transmissions[0].hops[0].verdict == "lost"
    everybody = told(capture, "lost", topic="team", from_s=1.5, to_s=1.8)
    assert (everybody.fate, everybody.cause) == (Fate.LOST, Cause.LOSS)
    assert "broadcasts are not repeated" in fate_text(everybody)


@pytest.mark.usefixtures("taps")
def test_which_relay_carried_it(make_lab: MakeLab) -> None:
    names = ("robot1", "relay1", "relay2", "base")
    air = [
        {"between": ["robot1", "relay1"], "delay": "2ms"},
        {"between": ["relay1", "base"], "delay": "2ms"},
        {"between": ["robot1", "relay2"], "delay": "20ms"},
        {"between": ["relay2", "base"], "delay": "20ms"},
    ]
    what = {
        "duration": "4s",
        "mesh": "flood",
        "nodes": {name: {"processes": ["udp_mesh"] if name in BETWEEN else []} for name in names},
        "links": air,
        "traffic": [{"from": "robot1", "to": "base", "topic": "telemetry", "size": "100B", "rate": "20Hz"}],
        "events": [{"at": "2s", "outage": {"between": ["relay1", "base"], "for": "10s"}}],
    }
    capture = recorded(make_lab, what)
    before, after = told(capture, "telemetry", to_s=1.5), told(capture, "telemetry", from_s=2.5, to_s=3.5)
    assert before.relays == ("relay1",)
    assert after.relays == ("relay2",)
    assert [(hop.sender, hop.receiver) for hop in after.fragments[0].transmissions[-1].hops] == [
        ("robot1/eth1", "relay2/eth0"),
        ("relay2/eth1", "base/eth1"),
    ]
    propagation = sum(part.duration_s for part in after.parts if part.cause is Cause.PROPAGATION)
    assert propagation == pytest.approx(0.04, abs=0.001)
    assert "its way  robot1 > relay2 > base" in look(capture, "--why", "telemetry", "--from", "2.5s", "--to", "3.5s")
    rows = [json.loads(line) for line in look(capture, "--routes", "--json", "--to", "3.9s").splitlines()]
    ways = {row["relays"]: row for row in rows if row["source"] == "robot1" and row["destination"] == "base"}
    assert ways["relay1"]["last_s"] == pytest.approx(2.0, abs=0.2)
    assert ways["relay2"]["first_s"] >= 1.9
    assert ways["relay1"]["ratio"] + ways["relay2"]["ratio"] == pytest.approx(1.0, abs=0.1)
