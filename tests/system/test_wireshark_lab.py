"""A lab's capture in tshark: its expert infos stand where the project's own traces say so, frame by frame."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import pytest

from netlab.capture.export import export_pcapng
from netlab.capture.reader import Capture
from netlab.pytest_plugin import MakeLab
from netlab.traces.inversions import inversions
from netlab.traces.load import load_trace
from netlab.traces.model import Trace
from netlab.traces.retransmissions import retransmissions
from tests.wireshark.tshark_rig import Row, Tshark, installed_tshark
from udp_mesh.core.wire import MAX_NUMBER

RATE_BPS = 4_000_000
SCENARIO = {
    "name": "dissected",
    "duration": "3s",
    "seed": 3,
    "nodes": {
        "base": {"processes": ["udp_mesh"]},
        "robot": {"processes": ["udp_mesh"], "udp_mesh": {"prioritise": False}},
    },
    "links": [{"between": ["base", "robot"], "delay": "3ms", "loss": "3%", "rate": "4mbit"}],
    "traffic": [
        {"from": "robot", "to": "base", "topic": "telemetry", "priority": 1, "size": "3000B", "rate": "20Hz"},
        {"from": "robot", "to": "base", "topic": "map", "priority": 7, "size": "30kB", "rate": "10Hz"},
    ],
}
GRACE_US = 1000
FRAME_US = round(1442 * 8 / RATE_BPS * 1e6)
SENT = "frame.packet_flags_direction == 2"
RECEIVED = "frame.packet_flags_direction == 1"


class Run(NamedTuple):
    """One run: what the project makes of it, and its packets for tshark."""

    trace: Trace
    pcapng: Path


@pytest.fixture(scope="module")
def tshark(tmp_path_factory: pytest.TempPathFactory) -> Tshark:
    return installed_tshark(tmp_path_factory.mktemp("home"))


@pytest.fixture
def run(make_lab: MakeLab, tmp_path: Path) -> Run:
    lab = make_lab(SCENARIO)
    lab.run()
    pcapng = tmp_path / "run.pcapng"
    with Capture.open(lab.capture) as capture:
        export_pcapng(capture, pcapng)
    return Run(load_trace(lab.capture), pcapng)


def times_ns(rows: list[Row]) -> set[int]:
    return {
        int(seconds) * 10**9 + int(rest) for row in rows for seconds, rest in [row["frame.time_epoch"][0].split(".")]
    }


def test_tshark_and_the_traces_agree_on_a_run(run: Run, tshark: Tshark) -> None:
    trace, pcapng = run

    def found(where: str, grace_us: int = GRACE_US) -> set[int]:
        words = ("-o", f"udp_mesh.grace_us:{grace_us}")
        return times_ns(tshark.rows(pcapng, "frame.time_epoch", where=f"{where} && {SENT}", words=words))

    again = {fragment.t_ns for node in trace.fragments for fragment in retransmissions(trace, node)}
    copies = {fragment.t_ns for fragments in trace.fragments.values() for fragment in fragments if fragment.is_copy}
    assert again
    assert found("udp_mesh.retransmission") == again | copies  # on the wire a copy looks like a retransmission

    early = {inversion.fragment.t_ns for node in trace.fragments for inversion in inversions(trace, node)}
    assert len(early) > 100
    # The traces know each frame's time on the link; here one grace holds for all, with or without a full frame's.
    assert found("udp_mesh.inversion", GRACE_US + FRAME_US) <= early <= found("udp_mesh.inversion")

    deliveries = {delivery.seq: delivery for delivery in trace.delivered[0]}
    where = f'netlab_traffic && udp_mesh.topic == "telemetry" && {RECEIVED}'
    rows = tshark.rows(pcapng, "netlab_traffic.sequence", "netlab_traffic.latency", where=where)
    latencies_s = {int(row["netlab_traffic.sequence"][0]): float(row["netlab_traffic.latency"][0]) for row in rows}
    assert len(deliveries) > 30
    # What an application sees comes after its last fragment, or after the end of the run.
    assert all(0.003 <= latencies_s[seq] <= delivery.latency_s for seq, delivery in deliveries.items())


def test_what_the_medium_did_and_what_the_nodes_know_fit_together(run: Run, tshark: Tshark) -> None:
    names = ["udp_mesh.acked_in", "udp_mesh.bad", "udp_mesh.fragment_index", "frame.comment"]
    sent = tshark.rows(run.pcapng, *names, where=f"udp_mesh && {SENT}")
    assert [row for row in sent if row["udp_mesh.bad"]] == []
    lost = [row for row in sent if "lost" in "".join(row["frame.comment"])]
    assert len(lost) > 10
    assert [row for row in lost if row["udp_mesh.acked_in"]] == []
    data = [row for row in sent if row["udp_mesh.fragment_index"] and row not in lost]
    assert sum(bool(row["udp_mesh.acked_in"]) for row in data) > len(data) * 0.95  # some are under way at the end
    names = ["udp_mesh.transit_time", "udp_mesh.first_seen_in"]
    numbered = f"udp_mesh.packet_number != {MAX_NUMBER} && {RECEIVED}"  # introductions are all alike
    received = tshark.rows(run.pcapng, *names, where=numbered)
    followed = [row for row in received if row["udp_mesh.first_seen_in"]]
    assert all(float(row["udp_mesh.transit_time"][0]) >= 0.003 for row in followed)
    assert len({row["udp_mesh.first_seen_in"][0] for row in followed}) == len(followed)
    # At the very end some are under way, and one node is recorded a moment longer than the other.
    assert 0.95 * (len(sent) - len(lost)) < len(followed) <= len(sent) - len(lost)
    assert len(followed) > 0.98 * len(received)
