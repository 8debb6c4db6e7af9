"""What the plots show of one mission's capture: distributions, one message's way, reconnects, evidence, marks."""

from __future__ import annotations

import itertools
import json
import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from netlab.errors import CaptureError
from netlab.report import palette
from netlab.report.cdf import Cdf, latency_cdfs
from netlab.report.data import thinned_path
from netlab.report.drawing import columns_that_fit, look
from netlab.report.expected import evidence, expectations_of
from netlab.report.lane import Cargo, Flight, Lane, busy_spans, thinned_flights
from netlab.report.marks import streams_down_s
from netlab.report.run import Run, Wishes, load_run
from netlab.report.words import counted, listed, typeset
from netlab.traces.messages import MessageLife
from netlab.traces.model import Delivery, Published, Stream, Trace
from tests.report.conftest import OUTAGE_S, SCENARIO, MakeMission, ns

LATENCIES = st.lists(st.floats(1e-6, 1e3), min_size=1, max_size=300)


@pytest.fixture(scope="module")
def run(make_mission: MakeMission) -> Run:
    return load_run(make_mission(), Wishes())


@given(LATENCIES, st.integers(0, 50), st.integers(1, 40))
def test_a_thinned_distribution_keeps_its_ends_and_never_exceeds_its_columns(
    values: list[float], lost: int, columns: int
) -> None:
    cdf = Cdf(tuple(sorted(values)), len(values) + lost)
    steps = cdf.steps(columns=columns)
    assert len(steps) <= 2 * columns
    assert steps == sorted(steps)
    assert steps[0] == (min(values), 1 / cdf.published)
    assert steps[-1] == (max(values), cdf.delivered_ratio)


def test_a_message_that_never_came_weighs_as_one_that_takes_for_ever() -> None:
    cdf = Cdf((0.1, 0.2, 0.3), 4)
    assert cdf.delivered_ratio == 0.75
    assert [cdf.quantile_s(ratio) for ratio in (0.25, 0.5, 0.75, 0.76)] == [0.1, 0.2, 0.3, None]
    assert Cdf((), 3).quantile_s(0.5) is None
    assert Cdf((), 0).delivered_ratio == 0.0


def test_distributions_are_by_priority_with_what_was_published(run: Run) -> None:
    cdfs = latency_cdfs(run.trace)
    assert list(cdfs) == [1, 5]
    assert (cdfs[1].published, cdfs[5].published) == (120, 12)
    assert min(cdfs[1].latencies_s) == pytest.approx(0.0058, abs=1e-4)
    assert cdfs[1].delivered_ratio < 0.8, "none of the outage came"


def test_the_slowest_of_the_most_urgent_is_followed_through_the_outage(run: Run) -> None:
    lane = run.lane
    assert lane is not None
    assert str(lane.life.stream) == "telemetry robot1->base"
    assert lane.interfaces == (("robot1", "radio0"), ("base", "radio0"))
    sent = [flight for flight in lane.flights if flight.cargo is not Cargo.ACK]
    assert [flight.cargo for flight in sent] == [Cargo.FIRST, *[Cargo.AGAIN] * (len(sent) - 1)]
    assert {flight.lost for flight in sent[:-1]} == {"outage"}
    assert all(flight.arrived_ns is None for flight in sent[:-1])
    assert sent[-1].arrived_ns == sent[-1].sent_ns + 5_000_000
    [ack] = [flight for flight in lane.flights if flight.cargo is Cargo.ACK]
    assert (ack.sender, ack.receiver) == (("base", "radio0"), ("robot1", "radio0"))
    assert lane.count(Cargo.AGAIN) == len(sent) - 1
    assert lane.count(Cargo.FIRST, lost=True) == 1


def test_another_message_is_followed_when_it_is_asked_for(make_mission: MakeMission) -> None:
    path = make_mission()
    lane = load_run(path, Wishes(message="image#2")).lane
    assert lane is not None
    assert (lane.life.stream.topic, lane.life.published.seq) == ("image", 2)
    firsts = [flight.fragments for flight in lane.flights if flight.cargo is Cargo.FIRST]
    assert firsts == [(index,) for index in range(6)]
    lost = load_run(path, Wishes(message="image#7")).lane
    assert lost is not None
    assert lost.life.delivery is None
    assert all(flight.lost == "outage" for flight in lost.flights)


@pytest.mark.parametrize(
    ("message", "complaint"),
    [
        ("image", "'image' names no message; write TOPIC#NUMBER, for example image#7"),
        ("imag#2", "no stream has the topic 'imag'; known are image, telemetry"),
        ("image#99", "there is no message image#99; try `netlab inspect"),
    ],
)
def test_a_message_that_is_not_there_is_answered_with_what_is(
    make_mission: MakeMission, message: str, complaint: str
) -> None:
    with pytest.raises(CaptureError, match=complaint.replace("(", r"\(")):
        load_run(make_mission(), Wishes(message=message))


def lane_of(*flights: tuple[float, float | None], delivered_s: float = 1.0) -> Lane:
    stream = Stream(0, "a", "b", "t", 1)
    life = MessageLife(
        stream,
        Published(0, 0, 0, ns(0), 10),
        Delivery(0, 0, ns(0), ns(delivered_s), 10),
        receipts=1,
        fragments=1,
        fragments_sent=1,
        first_sent_ns=ns(0),
    )
    made = tuple(
        Flight(Cargo.FIRST, ns(sent), ("a", "eth0"), ("b", "eth0"), None if arrived is None else ns(arrived))
        for sent, arrived in flights
    )
    return Lane(life, (("a", "eth0"), ("b", "eth0")), made, False)


def test_idle_times_are_cut_out_but_none_in_which_something_is_under_way() -> None:
    waits = lane_of((0.0, None), (10.0, 10.1), delivered_s=10.2)
    assert busy_spans(waits) == [(ns(0.0), ns(0.0)), (ns(10.0), ns(10.2))]
    flies = lane_of((0.0, 10.1), delivered_s=10.2)
    assert busy_spans(flies) == [(ns(0.0), ns(10.2))]
    often = lane_of((0.0, None), (4.0, None), (8.0, None), (12.0, 12.1), delivered_s=12.2)
    assert len(busy_spans(often)) == 3, "no more than three parts"


def test_thinning_flights_keeps_everything_that_went_wrong() -> None:
    flights = [Flight(Cargo.FIRST, ns(n / 1000), ("a", "e"), ("b", "e"), ns(n / 1000 + 0.1)) for n in range(1000)]
    lost = Flight(Cargo.FIRST, ns(0.5), ("a", "e"), ("b", "e"), None, "lost")
    again = Flight(Cargo.AGAIN, ns(0.6), ("a", "e"), ("b", "e"), ns(0.7))
    kept = thinned_flights([*flights[:500], lost, *flights[500:600], again, *flights[600:]], columns=20)
    assert len(kept) <= 2 * 20 * 2 + 2
    assert lost in kept
    assert again in kept
    assert kept[0] == flights[0]
    assert kept[-1] == flights[-1]
    assert thinned_flights(flights[:40], columns=20) == flights[:40]


def test_a_reconnect_falls_from_probe_to_delivery(run: Run) -> None:
    [fall] = run.falls
    assert fall.reconnect.restored_at_s == OUTAGE_S[1]
    assert fall.prober == "robot1"
    assert fall.probe_s is not None
    assert fall.heard_s == pytest.approx(fall.probe_s + 0.005)
    assert fall.answer_s == pytest.approx(fall.heard_s + 0.005)
    assert fall.delivery_s == pytest.approx(0.0068, abs=1e-4)


def test_evidence_is_the_figure_its_bound_and_the_worst_that_happened(run: Run) -> None:
    p50, slowest, reconnect, delivered, goodput = run.expected
    assert [entry.number for entry in run.expected] == [1, 2, 3, 4, 5]
    assert (p50.result.passed, slowest.result.passed) == (True, False)
    assert (slowest.limit, slowest.plot) == ("200.0 ms", "latency")
    assert slowest.share_of_limit is not None
    assert slowest.share_of_limit > 1
    assert slowest.worst == p50.worst, "one message is the slowest"
    assert slowest.worst is not None
    assert slowest.worst.text.startswith("telemetry robot1->base #")
    assert slowest.worst.latency_s == slowest.result.measured
    assert (reconnect.plot, reconnect.measured) == ("reconnects", "6.8 ms")
    assert (delivered.measured, delivered.limit) == ("75.00%", "10.00%")
    assert delivered.worst is not None
    assert delivered.worst.text == "image robot1->base #6 never came, the first of 3"
    assert goodput.worst is not None
    assert goodput.worst.at_s is None
    assert run.marks.worst == (("1–2", slowest.worst.at_s, slowest.worst.latency_s),)


def test_what_set_changed_of_the_expectations_counts() -> None:
    changed = ["expect.0.p50=50ms", "duration=3s", "expect.3={duplicates: {topic: image}, max: 0}"]
    found = expectations_of({"scenario": SCENARIO, "overrides": json.dumps(changed)})
    assert [type(entry).__name__.removesuffix("Expectation") for entry in found] == [
        "Latency",
        "Reconnect",
        "Delivered",
        "Duplicates",
    ]
    assert evidence(found, Trace())[0].limit == "50.0 ms"
    assert expectations_of({"scenario": SCENARIO, "overrides": '["expect=[]"]'}) == ()


@pytest.mark.parametrize("text", ["", "[", "expect: 3", "expect: [{latency: 3}]", "name: a"])
def test_a_scenario_that_cannot_be_read_expects_nothing(text: str) -> None:
    assert expectations_of({"scenario": text}) == ()


def test_times_without_a_link_are_merged_and_cut_to_the_run() -> None:
    trace = Trace(duration_s=10.0, streams=(Stream(0, "a", "b", "t", 1), Stream(1, "b", "a", "u", 2)))
    down = {("a", "b"): [(-1.0, 2.0), (5.0, math.inf)], ("b", "a"): [(1.0, 3.0)], ("a", "c"): [(0.0, 9.0)]}
    assert streams_down_s(trace, down) == ((0.0, 3.0), (5.0, 10.0))
    assert streams_down_s(trace, {("a", "b"): [(n / 10, n / 10 + 0.05) for n in range(41)]}) == ()


def test_the_mission_marks_its_outage(run: Run) -> None:
    assert run.marks.down_s == (OUTAGE_S,)
    assert run.marks.acts_s == OUTAGE_S


@given(st.lists(st.tuples(st.floats(0, 100), st.floats(0, 100)), min_size=1, max_size=300))
def test_a_thinned_path_begins_and_ends_where_the_path_does(places: list[tuple[float, float]]) -> None:
    kept = thinned_path(places, most=50)
    assert (kept[0], kept[-1]) == (places[0], places[-1])
    assert len(kept) <= max(50, 2)


def test_a_thinned_path_keeps_its_corners() -> None:
    straight = [(x / 10, 0.0) for x in range(1000)]
    corner = [(99.9, y / 10) for y in range(1, 1000)]
    assert thinned_path([*straight, *corner]) == [(0.0, 0.0), (99.9, 0.0), (99.9, 99.9)]


def test_words() -> None:
    assert typeset("latency a->b <= 3 and >= 2") == "latency a→b ≤ 3 and ≥ 2"
    assert (counted(1, "gap"), counted(2, "gap"), counted(0, "gap")) == ("1 gap", "2 gaps", "0 gaps")
    assert listed([1, 2, 3, 5, 7, 8]) == "1–3, 5, 7–8"


def test_a_legend_takes_as_many_columns_as_fit() -> None:
    assert columns_that_fit(["a", "b", "c"], 8.0) == 3
    assert columns_that_fit(["a long name for a series"] * 6, 4.0) == 1
    assert columns_that_fit(["a long name"] + ["b"] * 5, 4.0) in (3, 4, 5)


# Machado, Oliveira and Fernandes, "A Physiologically-based Model for Simulation of Color Vision Deficiency" (2009),
# severity 1.0, for linear RGB.
BLINDNESS = {
    "none": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    "protanopia": ((0.152286, 1.052583, -0.204868), (0.114503, 0.786281, 0.099216), (-0.003882, -0.048116, 1.051998)),
    "deuteranopia": ((0.367322, 0.860646, -0.227968), (0.280085, 0.672501, 0.047413), (-0.011820, 0.042940, 0.968881)),
    "tritanopia": ((1.255528, -0.076749, -0.178779), (-0.078411, 0.930809, 0.147602), (0.004733, 0.691367, 0.303900)),
}


def seen(colour: str, kind: str) -> tuple[float, float, float]:
    """A colour as somebody sees it, in CIE L*a*b*."""
    parts = [int(colour[at : at + 2], 16) / 255 for at in (1, 3, 5)]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    red, green, blue = (
        min(max(sum(a * b for a, b in zip(row, linear, strict=True)), 0.0), 1.0) for row in BLINDNESS[kind]
    )
    x = (0.4124 * red + 0.3576 * green + 0.1805 * blue) / 0.9505
    y = 0.2126 * red + 0.7152 * green + 0.0722 * blue
    z = (0.0193 * red + 0.1192 * green + 0.9505 * blue) / 1.089
    fx, fy, fz = (t ** (1 / 3) if t > 0.008856 else 7.787 * t + 16 / 116 for t in (x, y, z))
    return 116 * fy - 16, 500 * (fx - fy), 200 * (fy - fz)


@pytest.mark.parametrize("kind", BLINDNESS)
@pytest.mark.parametrize("colours", [palette.LIGHT, palette.DARK], ids=["light", "dark"])
def test_good_and_bad_and_all_series_are_told_apart_by_everybody(colours: dict[str, str], kind: str) -> None:
    series = [f"series{number}" for number in range(len(palette.SERIES))]
    for one, two in [("good", "bad"), *itertools.combinations(series, 2)]:
        assert math.dist(seen(colours[one], kind), seen(colours[two], kind)) > 15, (one, two)


def test_no_two_of_the_first_series_differ_by_colour_alone() -> None:
    looks = [look(number) for number in range(28)]
    assert len({(one.colour, one.dash, one.marker) for one in looks}) == 28
    for one, two in itertools.pairwise(looks):
        assert one.dash != two.dash
        assert one.marker != two.marker
        assert one.hatch != two.hatch


def test_a_capture_without_ports_reports_too(tmp_path: Path) -> None:
    from netlab.capture.writer import CaptureWriter

    writer = CaptureWriter(tmp_path / "odd.mcap")
    writer.add_metadata("netlab.run", {"name": "odd", "t0_ns": str(ns(0)), "duration_s": "1"})
    writer.close()
    found = load_run(tmp_path / "odd.mcap", Wishes())
    assert (found.lane, found.falls, found.expected, found.base, found.topic) == (None, (), (), None, None)
