from __future__ import annotations

import struct
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from netlab.capture.reader import Capture
from netlab.capture.record_file import MAGIC
from netlab.capture.records import JsonRecord, Kind, PacketRecord, VerdictRecord
from netlab.capture.schemas import Direction
from netlab.capture.topics import Topics
from netlab.capture.writer import CaptureWriter
from netlab.errors import CaptureError
from netlab.medium.verdicts import Verdict

T0_NS = 1_800_000_000_000_000_000  # of the fixture


def _record_ends(data: bytes) -> list[int]:
    ends, offset = [8], 8
    while offset + 9 <= len(data) - 8:
        offset += 9 + struct.unpack_from("<Q", data, offset + 1)[0]
        ends.append(offset)
    return ends


def test_records_are_typed_and_in_the_order_of_time(write_capture: Callable[..., Path]) -> None:
    with Capture.open(write_capture(packets=30)) as capture:
        records = list(capture.records())
        assert not capture.notes
        assert capture.t0_ns == T0_NS
        assert capture.attachments == {"scenario.yaml": b"name: test\n"}
        assert capture.counts()["/robot1/eth0/packets"] == 20
    times = [record.t_ns for record in records]
    assert times == sorted(times)  # although every chunk but the first begins before its predecessor ends
    assert sum(isinstance(record, PacketRecord) for record in records) == 50
    verdicts = [record for record in records if isinstance(record, VerdictRecord)]
    assert [record.verdict for record in verdicts[:3]] == [Verdict.DELIVERED, Verdict.DELIVERED, Verdict.LOST]
    assert verdicts[0].sender == ("base", "eth0")
    assert verdicts[0].departs_ns == verdicts[0].t_ns + 20_000_000


def test_filters_choose(write_capture: Callable[..., Path]) -> None:
    with Capture.open(write_capture(packets=30)) as capture:
        packets = list(capture.records({Kind.PACKET}, nodes={"base"}, start_ns=T0_NS + 10**7, end_ns=T0_NS + 2 * 10**7))
        assert [record.t_ns - T0_NS for record in packets] == [number * 10**6 for number in range(10, 20)]
        (event,) = capture.records({Kind.EVENT})
        assert isinstance(event, JsonRecord)
        assert (event.node, event.text("event")) == ("base", "peer_up")
        assert len(list(capture.records(topics={"/robot1/eth0/packets"}))) == 20


def test_verdicts_are_counted_in_passing(write_capture: Callable[..., Path]) -> None:
    counted: Counter[tuple[VerdictRecord, int]] = Counter()
    path = write_capture(packets=30)
    with Capture.open(path) as capture:
        kinds = {Kind.PACKET, Kind.VERDICT}
        seen = list(capture.records(kinds, tally=lambda record, count: counted.update({(record, count): 1})))
        one_by_one = Counter(record.verdict for record in capture.records({Kind.VERDICT}))
        only_packets = list(capture.records({Kind.PACKET}))
    assert seen == only_packets
    assert {record.verdict: count for record, count in counted} == one_by_one
    assert len(counted) == 2
    assert all(record[:3] == (0, ("base", "eth0"), ("robot1", "eth0")) for record, _ in counted)


def test_verdicts_of_a_time_are_counted(write_capture: Callable[..., Path]) -> None:
    counts = []
    with Capture.open(write_capture(packets=30)) as capture:
        records = capture.records(
            {Kind.TIMELINE}, end_ns=T0_NS + 10**7, tally=lambda record, count: counts.append(count)
        )
        assert len(list(records)) == 1
    assert sum(counts) == 10


def test_packets_that_came_in_can_be_left_out(write_capture: Callable[..., Path]) -> None:
    with Capture.open(write_capture(packets=30)) as capture:
        everything = list(capture.records())
        outbound = list(capture.records(with_inbound=False))
    inbound = [r for r in everything if isinstance(r, PacketRecord) and r.direction is Direction.INBOUND]
    assert inbound
    assert outbound == [record for record in everything if record not in inbound]


def test_a_file_cut_anywhere_reads_up_to_its_last_whole_chunk(
    write_capture: Callable[..., Path], tmp_path: Path
) -> None:
    data = write_capture(packets=12).read_bytes()
    with Capture.open(tmp_path / "run.mcap") as capture:
        whole = sorted((record.t_ns, repr(record)) for record in capture.records())
    ends = _record_ends(data)
    cuts = {end + shift for end in ends for shift in (-9, -1, 0, 1, 8, 10)} | set(range(8, len(data), 97))
    seen, path = set(), tmp_path / "cut.mcap"
    for cut in sorted(cut for cut in cuts if 8 <= cut < len(data)):
        path.write_bytes(data[:cut])
        with Capture.open(path) as capture:
            part = sorted((record.t_ns, repr(record)) for record in capture.records())
            footer_is_whole = cut >= ends[-1]
            assert bool(capture.notes) is not footer_is_whole, cut
        assert set(part) <= set(whole), cut
        seen.add(len(part))
    assert {0, len(whole)} <= seen
    assert len(seen) == 5  # nothing, then one to four chunks: a torn chunk gives all of itself or nothing


@pytest.mark.parametrize(
    ("content", "complaint"), [(b"", "is empty"), (b"hello world, no capture", "not an MCAP"), (b"\x89MCA", "not an")]
)
def test_what_is_no_capture_is_refused(tmp_path: Path, content: bytes, complaint: str) -> None:
    path = tmp_path / "odd.mcap"
    path.write_bytes(content)
    with pytest.raises(CaptureError, match=complaint):
        Capture.open(path)
    with pytest.raises(CaptureError, match="No such file"):
        Capture.open(tmp_path / "missing.mcap")


@settings(max_examples=150, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(data=st.data())
def test_damage_is_noted_or_refused_never_a_crash(
    write_capture: Callable[..., Path], tmp_path: Path, data: st.DataObject
) -> None:
    source = tmp_path / "run.mcap"
    sound = source.read_bytes() if source.exists() else write_capture(packets=12).read_bytes()
    damaged = bytearray(sound)
    for _ in range(data.draw(st.integers(1, 4))):
        damaged[data.draw(st.integers(0, len(sound) - 1))] = data.draw(st.integers(0, 255))
    path = tmp_path / "damaged.mcap"
    path.write_bytes(damaged)
    try:
        with Capture.open(path) as capture:
            assert len(list(capture.records())) <= 34
            capture.topics  # noqa: B018
    except CaptureError:
        pass


def test_a_length_beyond_all_memory_is_damage(tmp_path: Path) -> None:
    attachment = struct.pack("<QQIIQ", 0, 0, 0, 0, (1 << 63) + 11)
    path = tmp_path / "damaged.mcap"
    path.write_bytes(MAGIC + struct.pack("<BQ", 9, len(attachment)) + attachment)
    with Capture.open(path) as capture:
        assert "damaged at byte 8" in capture.notes[0]


def test_a_damaged_chunk_costs_only_itself(write_capture: Callable[..., Path], tmp_path: Path) -> None:
    data = bytearray(write_capture(packets=12).read_bytes())
    chunks = [start for start in _record_ends(bytes(data)) if start < len(data) and data[start] == 6]
    data[chunks[1] + 120] ^= 0xFF
    path = tmp_path / "damaged.mcap"
    path.write_bytes(data)
    with Capture.open(path) as capture:
        packets = list(capture.records({Kind.PACKET}, nodes={"base"}))
        assert len(packets) == 8
        assert "skipped" in capture.notes[0]


def test_later_metadata_replaces_earlier(tmp_path: Path) -> None:
    writer = CaptureWriter(tmp_path / "two.mcap")
    writer.add_metadata("netlab.run", {"seed": "1"})
    Topics(writer).add_json("/timeline", {"kind": "start"}, 77)
    writer.add_metadata("netlab.run", {"seed": "1", "t0_ns": "99"})
    writer.close()
    with Capture.open(tmp_path / "two.mcap") as capture:
        assert capture.metadata == {"seed": "1", "t0_ns": "99"}
        assert capture.t0_ns == 99
