from __future__ import annotations

import shutil
import subprocess
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest
from click.testing import CliRunner
from scapy.utils import RawPcapNgReader

from netlab.capture.export import VerdictIndex
from netlab.capture.reader import Capture
from netlab.capture.records import Kind, PacketRecord
from netlab.capture.schemas import Direction, encode_packet, encode_packet_names, encode_verdict, encode_verdict_ends
from netlab.capture.topics import Topics
from netlab.capture.writer import CaptureWriter
from netlab.cli.export import export
from netlab.medium.verdicts import Verdict

needs_tshark = pytest.mark.skipif(shutil.which("tshark") is None, reason="tshark is missing: apt install tshark")
FIELDS = ["frame.interface_name", "frame.time_epoch", "frame.len", "frame.packet_flags_direction", "udp.port"]


def exported(path: Path) -> tuple[Path, list[PacketRecord]]:
    target = path.with_suffix(".pcapng")
    result = CliRunner().invoke(export, [str(path), "-o", str(target)])
    assert result.exit_code == 0, result.output
    with Capture.open(path) as capture:
        return target, [record for record in capture.records({Kind.PACKET}) if isinstance(record, PacketRecord)]


def tshark(path: Path, *fields: str) -> list[list[str]]:
    arguments = [part for field in fields for part in ("-e", field)]
    command = ["tshark", "-r", str(path), "-T", "fields", "-E", "separator=|", *arguments]
    result = subprocess.run(command, capture_output=True, text=True, check=True, timeout=60)
    assert "cut short" not in result.stderr
    return [line.split("|") for line in result.stdout.splitlines()]


@needs_tshark
def test_tshark_sees_names_times_lengths_and_directions(write_capture: Callable[..., Path]) -> None:
    target, records = exported(write_capture(packets=9))
    rows = tshark(target, *FIELDS)
    assert len(rows) == len(records) == 15
    for row, record in zip(rows, records, strict=True):
        name, epoch, length, direction, ports = row
        seconds, nanoseconds = epoch.split(".")
        assert name == f"{record.node}/{record.interface}"
        assert int(seconds) * 10**9 + int(nanoseconds.ljust(9, "0")) == record.t_ns
        assert int(length) == len(record.frame)
        assert int(direction, 0) == (1 if record.direction is Direction.INBOUND else 2)
        assert ports == "8700,8700"


@needs_tshark
def test_drop_reasons_stand_beside_the_packets_that_they_befell(write_capture: Callable[..., Path]) -> None:
    target, records = exported(write_capture(packets=9))
    comments = [row[0] for row in tshark(target, "frame.comment")]
    sent = [text for text, record in zip(comments, records, strict=True) if record.node == "base"]
    assert sent == ["", "", "robot1/eth0: lost on the way"] * 3
    assert not any(text for text, record in zip(comments, records, strict=True) if record.node == "robot1")


def test_reasons_find_the_right_one_of_equal_frames(tmp_path: Path) -> None:
    """A beacon is the same bytes each time; it is heard by two, and each copy has its own fate."""
    first = {"b": Verdict.LOST, "c": Verdict.DELIVERED}
    second = {"b": Verdict.DELIVERED, "c": Verdict.QUEUE_FULL}
    writer = CaptureWriter(tmp_path / "same.mcap")
    topics = Topics(writer)
    frame, names = bytes(60), encode_packet_names("a", "eth0")
    for number, fates in enumerate((first, second)):
        t_ns = 10**18 + number * 10**6
        channel, _ = topics.packets("a", "eth0", 1)
        head = encode_packet(zlib.crc32(frame), 60, 1, Direction.OUTBOUND, names, 60)
        writer.add_message(channel, t_ns, t_ns, head, frame)
        for receiver, verdict in fates.items():
            ends = encode_verdict_ends(("a", "eth0"), (receiver, "eth0"))
            body = encode_verdict(ends, verdict, 0, 60, zlib.crc32(frame))
            writer.add_message(topics.verdicts(), t_ns + 10_000, t_ns + 10_000, body)
    writer.close()
    with Capture.open(tmp_path / "same.mcap") as capture:
        index = VerdictIndex(capture)
        found = [
            index.comments(record) for record in capture.records({Kind.PACKET}) if isinstance(record, PacketRecord)
        ]
    assert found == [("b/eth0: lost on the way",), ("c/eth0: dropped: queue full",)]


def test_scapy_reads_the_same_bytes(write_capture: Callable[..., Path]) -> None:
    target, records = exported(write_capture(packets=9))
    with RawPcapNgReader(str(target)) as reader:
        packets = list(reader)
    assert [data for data, _ in packets] == [record.frame for record in records]
    stamps = [(meta.tshigh << 32 | meta.tslow, meta.tsresol, meta.wirelen, meta.ifname) for _, meta in packets]
    assert stamps == [
        (record.t_ns, 10**9, len(record.frame), f"{record.node}/{record.interface}".encode()) for record in records
    ]


def test_frames_of_every_length_and_no_frames_at_all(write_capture: Callable[..., Path]) -> None:
    target, records = exported(write_capture(packets=0))
    assert records == []
    assert target.stat().st_size % 4 == 0


def test_a_target_that_cannot_be_written_is_one_clear_line(write_capture: Callable[..., Path], tmp_path: Path) -> None:
    path = write_capture(packets=1)
    result = CliRunner().invoke(export, [str(path), "-o", str(tmp_path / "no" / "such.pcapng")])
    assert "such.pcapng: No such file or directory" in str(result.exception)
