from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from netlab.capture.metadata import run_metadata
from netlab.capture.topics import Topics
from netlab.capture.writer import CaptureWriter
from netlab.engines.base import LabPlan
from netlab.medium.impairments import Impairment
from netlab.medium.segments import Port, Segment, SegmentKind
from netlab.traces.load import load_trace


@dataclass(frozen=True)
class Stream:
    index: int
    source: str
    destination: str
    topic: str
    priority: int


PORTS = tuple(
    Port(index, node, ifname, bytes([2, 0, 0, 0, 0, index]), f"10.1.{index}.1/24")
    for index, (node, ifname) in enumerate(
        [("a", "eth0"), ("b", "eth0"), ("a", "radio0"), ("b", "radio0"), ("c", "radio0")]
    )
)
SLOW, FAST, FREE = Impairment(rate_bps=1e6), Impairment(rate_bps=1e7), Impairment()
PLAN = LabPlan(
    "trio",
    7,
    ("a", "b", "c"),
    PORTS,
    (
        Segment("a-b", SegmentKind.WIRE, (0, 1), {(0, 1): FAST, (1, 0): FREE}),
        Segment("radio", SegmentKind.RADIO, (2, 3, 4), {(2, 3): SLOW, (2, 4): FAST, (3, 2): FREE}),
    ),
)


def test_a_trace_finds_in_the_metadata_what_it_needs(tmp_path: Path) -> None:
    streams = [Stream(0, "a", "b", "telemetry", 1), Stream(1, "b", "a", "fpv", 9)]
    metadata = run_metadata(
        scenario_text="name: trio\n",
        engine="air",
        clock="real",
        duration_s=12.5,
        plan=PLAN,
        streams=streams,
        kept_latest=[1],
        extra={"note": "x"},
    )
    assert all(isinstance(value, str) for value in metadata.values())
    assert (metadata["scenario"], metadata["seed"], metadata["note"]) == ("name: trio\n", "7", "x")
    assert set(json.loads(metadata["versions"])) >= {"python", "kernel", "mcap"}
    ports = json.loads(metadata["ports"])
    assert [port["node"] for port in ports] == ["a", "b", "a", "b", "c"]  # verdicts name ports by this position
    assert [port["segment"] for port in ports] == ["a-b", "a-b", "radio", "radio", "radio"]
    assert ports[1]["mac"] == "02:00:00:00:00:01"
    writer = CaptureWriter(tmp_path / "run.mcap")
    writer.add_metadata("netlab.run", metadata | {"t0_ns": "123"})
    Topics(writer).add_json("/timeline", {"kind": "start"}, 123)
    writer.close()
    trace = load_trace(tmp_path / "run.mcap")
    assert (trace.t0_ns, trace.duration_s) == (123, 12.5)
    assert [(stream.topic, stream.keeps_latest) for stream in trace.streams] == [("telemetry", False), ("fpv", True)]
    rates = [trace.rate_bps((port.node, port.ifname), 200) for port in PORTS]
    assert rates == [1e7, None, 1e6, None, None]
