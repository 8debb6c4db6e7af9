"""What a run's capture holds, against tools that are not ours: tcpdump in a node, tshark, the plain mcap library."""

from __future__ import annotations

import os
import signal
import subprocess
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.reader import make_reader
from scapy.utils import RawPcapNgReader, RawPcapReader

from netlab.capture.export import export_pcapng
from netlab.capture.reader import Capture
from netlab.capture.records import Kind, VerdictRecord
from netlab.lab.control import ControlClient
from netlab.lab.facade import Lab
from netlab.medium.verdicts import Verdict
from netlab.pytest_plugin import MakeLab
from netlab.traces.load import load_trace

SCENARIO = {
    "name": "watched",
    "duration": "3s",
    "nodes": {"base": {"processes": ["udp_mesh"]}, "robot1": {"processes": ["udp_mesh"]}},
    "links": [{"between": ["base", "robot1"], "delay": "3ms", "loss": "3%", "rate": "20mbit"}],
    "traffic": [
        {"from": "robot1", "to": "base", "topic": "telemetry", "priority": 1, "size": "200B", "rate": "50Hz"},
        {"from": "robot1", "to": "base", "topic": "map", "priority": 7, "size": "30kB", "rate": "5Hz"},
    ],
}

Frame = tuple[int, bytes]  # nanoseconds, bytes


def _start_tcpdump(lab: Lab, tcpdump: str, node: str, file: Path) -> ControlClient:
    """Start it and wait until it listens; skip where it cannot run (it wants to give up root, which a user has not)."""
    words = [tcpdump, "-i", "eth0", "-s", "0", "-U", "--immediate-mode", "--time-stamp-precision=nano", "-w", str(file)]
    said = file.with_suffix(".said")
    tool = lab.spawn(node, "sh", "-c", f'exec "$@" 2>{said}', "sh", *words)
    while "listening on" not in (text := said.read_text() if said.exists() else ""):
        if lab.exec(node, "pgrep", "-x", "tcpdump").returncode and text:
            tool.close()
            pytest.skip(f"tcpdump cannot start here: {text.strip().splitlines()[-1]}")
    return tool


def _tcpdump_frames(file: Path) -> list[Frame]:
    with RawPcapReader(str(file)) as reader:
        return [(meta.sec * 10**9 + meta.usec, data) for data, meta in reader]  # usec holds nanoseconds in this format


def _exported_frames(file: Path, interface: str) -> list[Frame]:
    frames = []
    with RawPcapNgReader(str(file)) as reader:
        for data, meta in reader:
            if meta.ifname in (interface, interface.encode()):
                frames.append((((meta.tshigh << 32) | meta.tslow), data))
    return frames


def test_the_exported_capture_agrees_with_tcpdump_packet_for_packet(
    make_lab: MakeLab, need_tool: Callable[[str], str], tmp_path: Path
) -> None:
    tcpdump = need_tool("tcpdump")
    lab = make_lab(SCENARIO)
    tools = {node: _start_tcpdump(lab, tcpdump, node, tmp_path / f"{node}.pcap") for node in ("base", "robot1")}
    lab.run()
    lab.exec("base", "pkill", "-INT", "-x", "tcpdump")
    for tool in tools.values():
        tool.next_reply(timeout_s=5)
        tool.close()
    exported = tmp_path / "run.pcapng"
    with Capture.open(lab.capture) as capture:
        assert export_pcapng(capture, exported) > 500
    for node in tools:
        theirs, ours = _tcpdump_frames(tmp_path / f"{node}.pcap"), _exported_frames(exported, f"{node}/eth0")
        start, end = theirs[0][0], ours[-1][0]  # the recorder began before tcpdump and ended before it
        theirs = [frame for frame in theirs if frame[0] <= end]
        ours = [frame for frame in ours if frame[0] >= start]
        assert len(ours) > 250
        assert Counter(data for _t_ns, data in ours) == Counter(data for _t_ns, data in theirs)
        # Frames that two processors saw in the same microsecond may swap places between the two listeners.
        assert sorted(ours) == sorted(theirs)


def test_tshark_reads_the_export_with_times_interfaces_and_reasons(
    make_lab: MakeLab, need_tool: Callable[[str], str], tmp_path: Path
) -> None:
    tshark = need_tool("tshark")
    lab = make_lab(SCENARIO)
    result = lab.run()
    exported = tmp_path / "run.pcapng"
    with Capture.open(lab.capture) as capture:
        count = export_pcapng(capture, exported)
    fields = ["frame.time_epoch", "frame.interface_name", "frame.len", "frame.comment"]
    words = [tshark, "-r", str(exported), "-T", "fields", *(word for field in fields for word in ("-e", field))]
    rows = subprocess.run(words, capture_output=True, text=True, check=True).stdout.splitlines()
    assert len(rows) == count
    columns = [row.split("\t") for row in rows]
    assert {row[1] for row in columns} == {"base/eth0", "robot1/eth0"}
    times = [float(row[0]) for row in columns]
    t0_s = result.trace.t0_ns / 1e9
    assert t0_s - 5 < min(times) < max(times) < t0_s + 6
    with Capture.open(lab.capture) as capture:  # the recording of packets ends a moment before that of verdicts
        last_ns = round(max(times) * 1e9) + 1_000_000  # the far end's stamp comes a moment after the sender's
        verdicts = [record for record in capture.records({Kind.VERDICT}) if record.t_ns <= last_ns]
        lost = sum(isinstance(record, VerdictRecord) and record.verdict is Verdict.LOST for record in verdicts)
    assert sum("lost" in row[3].lower() for row in columns if len(row) > 3) == lost > 0


def test_a_reader_that_is_not_ours_reads_the_capture(make_lab: MakeLab) -> None:
    lab = make_lab(SCENARIO)
    result = lab.run()
    with lab.capture.open("rb") as stream:
        reader = make_reader(stream)
        topics = Counter(channel.topic for _schema, channel, _message in reader.iter_messages())
        metadata = {record.name: record.metadata for record in reader.iter_metadata()}
    assert topics["/robot1/traffic/published"] == 150 + 15
    delivered = [result.stream(topic)["delivered"] for topic in ("telemetry", "map")]
    assert topics["/base/traffic/received"] == sum(delivered)
    assert topics["/robot1/eth0/packets"] > 250
    assert topics["/air/verdicts"] > 500
    assert {"/timeline", "/links", "/base/udp_mesh/events"} <= set(topics)
    assert metadata["netlab.run"]["engine"] == "air"
    assert int(metadata["netlab.run"]["t0_ns"]) == result.trace.t0_ns


def test_what_a_process_prints_is_in_the_capture(make_lab: MakeLab) -> None:
    argv = ["sh", "-c", "echo out; echo err >&2; printf unfinished"]
    nodes = {"a": {"processes": [{"argv": argv, "name": "talker"}]}, "b": {}}
    lab = make_lab({"name": "log", "duration": "1s", "nodes": nodes, "links": [{"between": ["a", "b"]}]})
    lab.run()
    with lab.capture.open("rb") as stream:
        bodies = [m.data for _s, c, m in make_reader(stream).iter_messages() if c.topic == "/a/log/talker"]
    assert [word for word in (b"out", b"err", b"unfinished") if any(word in body for body in bodies)] == [
        b"out",
        b"err",
        b"unfinished",
    ]
    assert lab.log("a", "talker") == "out\nerr\nunfinished"


def test_after_kill_nine_the_capture_is_read_up_to_its_last_whole_chunk(make_lab: MakeLab) -> None:
    lab = make_lab({**SCENARIO, "duration": "30s"})
    lab.begin()
    lab.wait_until(2.5)
    os.kill(lab.supervisor_pid, signal.SIGKILL)
    trace = load_trace(lab.capture)
    assert trace.notes
    assert len(trace.published[0]) > 25
