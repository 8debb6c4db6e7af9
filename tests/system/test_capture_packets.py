"""The recorder against the kernel: what it writes is what an independent tcpdump in the node saw."""

from __future__ import annotations

import importlib.util
import os
import shutil
import subprocess
import sys
import zlib
from collections import Counter
from pathlib import Path
from types import ModuleType

import pytest
from click.testing import CliRunner
from scapy.utils import RawPcapNgReader, RawPcapReader

from netlab.capture.reader import Capture
from netlab.capture.records import Kind, PacketRecord
from netlab.capture.schemas import Direction
from netlab.cli.export import export
from netlab.traces.load import load_trace
from netlab.traces.messages import message_lives
from netlab.traces.retransmissions import retransmissions
from netlab.traces.streams import stream_reports


def _load(name: str) -> ModuleType:
    spec = importlib.util.spec_from_file_location(name, Path(__file__).with_name(f"{name}.py"))
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return module


rig, programs = _load("capture_rig"), _load("capture_programs")


def _namespaces_work() -> bool:
    user = [] if os.geteuid() == 0 else ["--map-root-user"]
    return (
        subprocess.run(["unshare", "--net", "--mount", *user, "true"], capture_output=True, check=False).returncode == 0
    )


pytestmark = pytest.mark.skipif(not _namespaces_work(), reason="this machine allows no namespaces")


def packets(path: Path, node: str) -> list[PacketRecord]:
    with Capture.open(path) as capture:
        assert not capture.notes
        records = capture.records({Kind.PACKET}, nodes={node})
        return [record for record in records if isinstance(record, PacketRecord)]


@pytest.mark.skipif(shutil.which("tcpdump") is None, reason="tcpdump is missing: apt install tcpdump")
def test_it_agrees_with_tcpdump_packet_for_packet(tmp_path: Path) -> None:
    result = rig.enter("beside_tcpdump", str(tmp_path))
    if result["tcpdump"]:
        pytest.skip("tcpdump cannot start here (it gives up its privileges, which a user namespace forbids)")
    assert result["drops"] == {}
    ours = packets(tmp_path / "run.mcap", "a")
    with RawPcapReader(str(tmp_path / "a.pcap")) as reader:
        theirs = [data for data, _ in reader]
    assert len(theirs) > 1200
    assert [record.frame for record in ours if record.interface == "eth0"] == theirs
    assert {record.interface for record in ours} == {"eth0"}  # nothing of the loopback
    assert all(record.crc32 == zlib.crc32(record.frame) for record in ours)  # what verdicts are matched by
    directions = Counter(record.direction for record in ours)
    assert directions[Direction.OUTBOUND] > 600
    assert directions[Direction.INBOUND] > 600
    heard = {record.frame: record for record in packets(tmp_path / "run.mcap", "b")}
    sent = [record for record in ours if record.direction is Direction.OUTBOUND]
    assert all(0 <= heard[record.frame].t_ns - record.t_ns < 10**9 for record in sent)  # one clock, cause before effect
    exported = tmp_path / "run.pcapng"
    assert CliRunner().invoke(export, [str(tmp_path / "run.mcap"), "-o", str(exported)]).exit_code == 0
    with RawPcapNgReader(str(exported)) as reader:
        assert [data for data, meta in reader if meta.ifname == b"a/eth0"] == theirs


def test_an_interface_that_appears_later_is_captured_and_tags_are_kept(tmp_path: Path) -> None:
    rig.enter("new_interface", str(tmp_path))
    for node in ("a", "b"):
        frames = {record.interface: record.frame for record in packets(tmp_path / "run.mcap", node)}
        assert frames == {"eth0": programs.TAGGED, "late0": programs.UNTAGGED}, node


def test_a_full_disk_ends_the_recording_not_the_run(tmp_path: Path) -> None:
    result = rig.enter("full_disk", str(tmp_path))
    assert result["alive"] is True
    assert len(result["notices"]) == 1
    assert "No space left on device" in result["notices"][0]
    assert result["lost"] > 0
    assert result["written"] > 100
    assert result["written"] + result["lost"] == result["packets"]
    with Capture.open(tmp_path / "copy.mcap") as capture:
        assert sum(1 for _ in capture.records({Kind.PACKET})) == result["written"]
        assert capture.metadata["name"] == "rig"


def test_what_real_daemons_do_becomes_a_trace(tmp_path: Path) -> None:
    result = rig.enter("daemons", str(tmp_path))
    assert result == {"received": 60, "lines_dropped": 0, "drops": {}}
    trace = load_trace(tmp_path / "run.mcap")
    telemetry, maps = stream_reports(trace)
    assert (telemetry.sent, telemetry.delivered, telemetry.duplicates) == (40, 40, 0)
    assert (maps.sent, maps.delivered, maps.duplicates) == (20, 20, 0)
    assert trace.presence["a", "b"].online[0] is True
    counts = {fragment.message: fragment.count for fragment in trace.fragments["a"]}
    assert set(counts.values()) == {1, max(counts.values())}
    for life in message_lives(trace):
        assert life.fragments == counts[life.stream.index, life.published.seq], life
        assert life.first_sent_ns is not None
        assert life.delivery is not None
        assert life.published.t_ns < life.first_sent_ns < life.delivery.t_ns
    fragments = trace.fragments["a"]
    assert {fragment.destination for fragment in fragments} == {"b"}
    assert {fragment.priority for fragment in fragments} == {1, 9}
    assert len(fragments) == sum(counts.values()) + len(retransmissions(trace, "a"))
