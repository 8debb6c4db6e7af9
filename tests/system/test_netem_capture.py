"""What was set on links is what happened, told from the capture's packets alone; the netem engine, in virtual time.

Bounds are those of the statistics (99.99 % for what is drawn) and 0.2 ms for what is not: virtual time is exact, so
these tests say nothing about a busy machine, and need none to be quiet. They run in the box (``make test-vm``).
"""

from __future__ import annotations

import math
import statistics
import sys
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from netlab.capture.reader import Capture
from netlab.capture.records import Kind, PacketRecord
from netlab.capture.schemas import Direction
from netlab.clock import clock_here
from netlab.engines.plan import compile_plan
from netlab.lab.facade import Lab

pytestmark = [
    pytest.mark.usefixtures("netem_kernel"),
    pytest.mark.skipif(clock_here() != "virtual", reason="exact delays need virtual time: `make test-vm`"),
]

SCENARIO = {
    "name": "measured",
    "seed": 3,
    "duration": "34s",
    "nodes": {"a": {}, "b": {}, "c": {}},
    "links": [
        {"from": "a", "to": "b", "delay": "20ms", "jitter": "4ms", "loss": "5%"},
        {
            "from": "b",
            "to": "a",
            "delay": "50ms",
            "jitter": "5ms",
            "distribution": "normal",
            "loss": {"gemodel": {"p": "2%", "r": "20%"}},
        },
        {"from": "a", "to": "c", "rate": "2mbit", "limit": 30},
        {"from": "c", "to": "a", "delay": "10ms", "duplicate": "10%", "corrupt": "5%"},
    ],
    "events": [
        {"at": "20s", "link": {"from": "a", "to": "b", "delay": "80ms", "jitter": "0ms", "loss": "20%"}},
        {"at": "28s", "outage": {"between": ["a", "b"], "for": "3s"}},
    ],
}
DELAY_S = 0.0002
Z = 3.9  # of a normal distribution, 99.99 % lie within
MARK = b"\x88\xb5netem"

# Frames of a hundred numbered words, at their times; no answer comes, as it would to a datagram.
SENDER = """
import socket, struct, sys, time
ifname, start_ns, count, every_ns, size = sys.argv[1], *map(int, sys.argv[2:])
sock = socket.socket(socket.AF_PACKET, socket.SOCK_RAW)
sock.bind((ifname, 0))
for number in range(count):
    time.sleep(max(0, start_ns + number * every_ns - time.time_ns()) / 1e9)
    frame = bytes([255] * 6) + sock.getsockname()[4] + b"\\x88\\xb5netem" + struct.pack("!I", number) * 300
    sock.send(frame[:size])
"""
STREAMS = {  # sender and receiver -> frames, ns between them, bytes
    ("a", "b"): (3300, 10_000_000, 119),
    ("b", "a"): (3300, 10_000_000, 119),
    ("a", "c"): (2000, 2_000_000, 1000),
    ("c", "a"): (2000, 5_000_000, 119),
}


@dataclass
class Crossing:
    """The marked frames of one direction: by number, when they left and when they arrived."""

    sent_ns: dict[int, int] = field(default_factory=dict)
    frames: dict[int, bytes] = field(default_factory=dict)
    arrived_ns: dict[int, list[int]] = field(default_factory=dict)
    damaged: list[tuple[bytes, int]] = field(default_factory=list)  # as it arrived, and its number

    def missing(self, numbers: Iterable[int]) -> list[int]:
        return [number for number in numbers if number not in self.arrived_ns]

    def delays_s(self, numbers: Iterable[int]) -> list[float]:
        return [
            (self.arrived_ns[n][0] - self.sent_ns[n]) / 1e9
            for n in numbers
            if n in self.arrived_ns and n in self.sent_ns
        ]


@dataclass(frozen=True)
class Measured:
    """A run: what its capture shows, and its report."""

    crossings: dict[tuple[str, str], Crossing]
    links: dict[tuple[str, str], dict[str, Any]]
    others: int  # frames that are not the streams'
    t0_ns: int


@pytest.fixture(scope="module")
def measured(tmp_path_factory: pytest.TempPathFactory) -> Measured:
    """One run serves all tests."""
    folder = tmp_path_factory.mktemp("measured")
    with Lab(SCENARIO, engine="netem", capture=folder / "measured.mcap") as lab:
        lab.begin()
        start_ns = lab.status()["t0_ns"] + 500_000_000
        senders = []
        ends = interfaces(lab)
        for ends_of, (count, every_ns, size) in STREAMS.items():
            words = [ends[ends_of], str(start_ns), str(count), str(every_ns), str(size)]
            senders.append(lab.spawn(ends_of[0], sys.executable, "-c", SENDER, *words))
        for process in senders:
            assert process.next_reply(timeout_s=60) == {"exit": 0}
            process.close()
        result = lab.finish()
        assert not result.failures
    by_interface = {(ends_of[0], ifname): ends_of for ends_of, ifname in ends.items()}
    links = {
        by_interface[sender, ifname]: row
        for row in result.summary["links"]
        for sender, _, ifname in [row["from"].partition("/")]
    }
    with Capture.open(folder / "measured.mcap") as capture:
        crossings, others = sort_out(capture.records({Kind.PACKET}), by_interface)
        return Measured(crossings, links, others, capture.t0_ns)


def interfaces(lab: Lab) -> dict[tuple[str, str], str]:
    """By sender and receiver: the sender's interface."""
    plan = compile_plan(lab.scenario)
    return {
        (plan.ports[i].node, plan.ports[j].node): plan.ports[i].ifname
        for segment in plan.segments
        for i, j in segment.pairs
    }


def sort_out(
    records: Iterable[object], by_interface: dict[tuple[str, str], tuple[str, str]]
) -> tuple[dict[tuple[str, str], Crossing], int]:
    """The streams' frames by direction, and how many others left."""
    crossings, others = {ends: Crossing() for ends in STREAMS}, 0
    for record in records:
        assert isinstance(record, PacketRecord)
        ends = by_interface[record.node, record.interface]
        words = Counter(record.frame[19 + 4 * n : 23 + 4 * n] for n in range(25))
        number = int.from_bytes(words.most_common(1)[0][0], "big")  # also of a frame with a flipped bit
        if record.direction is Direction.OUTBOUND:
            if record.frame[12:19] == MARK:
                crossings[ends].sent_ns[number] = record.t_ns
                crossings[ends].frames[number] = record.frame
            else:
                others += 1
            continue
        ends = (ends[1], ends[0])
        if record.frame == crossings[ends].frames.get(number):
            crossings[ends].arrived_ns.setdefault(number, []).append(record.t_ns)
        elif len(record.frame) == STREAMS[ends][2] and words.most_common(1)[0][1] >= 24:
            crossings[ends].damaged.append((record.frame, number))
    return crossings, others


def within(found: int, trials: int, ratio: float, *, clustering: float = 1.0) -> bool:
    """Whether a count is what independent draws give, or draws whose variance is ``clustering`` times theirs."""
    print(f"{found} of {trials}: {found / trials:.4f}, expected {ratio:.4f}")
    return abs(found - trials * ratio) <= Z * math.sqrt(trials * ratio * (1 - ratio) * clustering)


def test_uniform_jitter_and_random_loss_are_as_set(measured: Measured) -> None:
    crossing = measured.crossings["a", "b"]
    before = [n for n, t_ns in crossing.sent_ns.items() if t_ns < measured.t0_ns + 19_990_000_000]
    delays = crossing.delays_s(before)
    assert len(before) > 1900
    assert within(len(crossing.missing(before)), len(before), 0.05)
    assert 0.016 - DELAY_S <= min(delays) < 0.0163
    assert 0.0237 < max(delays) <= 0.024 + DELAY_S
    assert statistics.mean(delays) == pytest.approx(0.020, abs=Z * 0.004 / math.sqrt(3 * len(delays)))


def test_a_live_change_holds_from_its_time_on(measured: Measured) -> None:
    crossing = measured.crossings["a", "b"]
    after = [n for n, t_ns in crossing.sent_ns.items() if 20.01 <= (t_ns - measured.t0_ns) / 1e9 < 27.99]
    delays = crossing.delays_s(after)
    assert len(after) > 750
    assert within(len(crossing.missing(after)), len(after), 0.2)
    assert 0.08 <= min(delays) <= max(delays) <= 0.08 + DELAY_S


def test_normal_jitter_and_gilbert_elliott_loss_are_as_set(measured: Measured) -> None:
    crossing = measured.crossings["b", "a"]
    numbers = [n for n, t_ns in crossing.sent_ns.items() if t_ns < measured.t0_ns + 27_990_000_000]
    delays = crossing.delays_s(numbers)
    spread = 0.005 / math.sqrt(len(delays))
    assert statistics.mean(delays) == pytest.approx(0.050, abs=Z * spread)
    assert statistics.stdev(delays) == pytest.approx(0.005, abs=Z * spread)  # of it: sigma / sqrt(2 n)
    # p / (p + r) are lost, in bursts of 1 / r frames; successive states correlate by 1 - p - r.
    missing = crossing.missing(numbers)
    assert within(len(missing), len(numbers), 0.02 / 0.22, clustering=1.78 / 0.22)
    bursts = sum(number - 1 not in missing for number in missing)
    assert 3.3 < len(missing) / bursts < 7.5  # the mean of some 50 bursts of 5


def test_the_rate_and_the_queue_are_as_set(measured: Measured) -> None:
    """4 Mbit/s are offered to 2 Mbit/s, whose queue of 30 frames of 4 ms is full soon."""
    crossing = measured.crossings["a", "c"]
    times = sorted(t_ns for arrivals in crossing.arrived_ns.values() for t_ns in arrivals)
    gaps = [(later - earlier) / 1e9 for earlier, later in pairwise(times)]
    assert len(times) > 1000
    assert all(abs(gap - 0.004) <= DELAY_S for gap in gaps)
    delays = crossing.delays_s(crossing.sent_ns)
    assert 0.118 <= max(delays) <= 0.120 + DELAY_S
    assert delays[0] == pytest.approx(0.004, abs=DELAY_S)


def test_copies_and_flipped_bits_are_as_set(measured: Measured) -> None:
    crossing = measured.crossings["c", "a"]
    count = STREAMS["c", "a"][0]
    copies = sum(len(arrivals) for arrivals in crossing.arrived_ns.values()) + len(crossing.damaged) - count
    assert within(copies, count, 0.10)
    assert within(len(crossing.damaged), count + copies, 0.05)  # a copy may be damaged by itself
    for frame, number in crossing.damaged:
        difference = int.from_bytes(frame, "big") ^ int.from_bytes(crossing.frames[number], "big")
        assert difference.bit_count() == 1
    assert all(abs(delay_s - 0.01) <= DELAY_S for delay_s in crossing.delays_s(crossing.sent_ns))


def test_the_report_tells_full_queues_outages_and_losses_apart(measured: Measured) -> None:
    """Beside the streams, the nodes' kernels have sent a few frames of their own."""

    def near(found: object, expected: int) -> bool:
        assert isinstance(found, int)
        return expected <= found <= expected + measured.others

    narrow, wide, back = measured.links["a", "c"], measured.links["a", "b"], measured.links["b", "a"]
    assert near(narrow["queue_full"], len(measured.crossings["a", "c"].missing(range(2000))))
    assert narrow["lost"] == narrow["outage"] == 0
    for row, ends in ((wide, ("a", "b")), (back, ("b", "a"))):
        crossing = measured.crossings[ends]
        out = [n for n, t_ns in crossing.sent_ns.items() if 28 <= (t_ns - measured.t0_ns) / 1e9 < 31]
        missing = crossing.missing(crossing.sent_ns)
        assert 299 <= len(out) <= 301
        assert len(set(out) - set(missing)) <= 1  # sent in the instant when the outage began
        assert abs(int(row["outage"]) - len(out)) <= 1 + measured.others
        assert abs(int(row["lost"]) - (len(missing) - len(out))) <= 1 + measured.others
        assert row["queue_full"] == 0
    damaging, crossing = measured.links["c", "a"], measured.crossings["c", "a"]
    assert damaging["lost"] == damaging["queue_full"] == 0
    assert near(damaging["corrupted"], len(crossing.missing(crossing.sent_ns)))
    assert near(damaging["duplicated"], sum(len(arrivals) - 1 for arrivals in crossing.arrived_ns.values()))


def test_on_a_perfect_radio_every_frame_is_delivered(tmp_path: Path) -> None:
    """It takes no time there: the receiver's packet may be recorded before the sender's."""
    node = {"processes": ["udp_mesh"]}
    scenario = {
        "name": "perfect",
        "duration": "3s",
        "radio": {"propagation": {"model": "none"}},
        "nodes": {"a": node, "b": node, "c": node},
        "traffic": [{"from": "a", "to": "b", "topic": "t", "size": "200B", "rate": "20Hz"}],
    }
    with Lab(scenario, engine="netem", capture=tmp_path / "perfect.mcap") as lab:
        result = lab.run()
    assert len(result.summary["links"]) == 6
    for row in result.summary["links"]:
        assert row["delivered"] == row["frames"] > 0, row
        assert row["loss_ratio"] == row["duplicated"] == 0, row
