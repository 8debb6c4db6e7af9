from __future__ import annotations

import contextlib
import random
import resource
import struct
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.message_factory import GetMessageClass
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap_protobuf.decoder import DecoderFactory

from netlab.capture import schemas
from netlab.capture.reader import Capture
from netlab.capture.records import PacketRecord
from netlab.capture.topics import Topics
from netlab.capture.writer import CaptureWriter
from netlab.errors import CaptureError

U32 = st.integers(0, 2**32 - 1)


def _class(file: object) -> type:
    pool = DescriptorPool()
    pool.Add(file)
    return GetMessageClass(pool.FindMessageTypeByName(f"netlab.{file.message_type[0].name}"))


PACKET, VERDICT = _class(schemas.packet_file()), _class(schemas.verdict_file())


@given(U32, U32, U32, st.sampled_from(schemas.Direction), st.text(max_size=300), st.text(), st.binary(max_size=600))
def test_packets_are_what_protobuf_itself_would_write(
    crc: int, length: int, linktype: int, direction: schemas.Direction, node: str, interface: str, frame: bytes
) -> None:
    names = schemas.encode_packet_names(node, interface)
    data = schemas.encode_packet(crc, length, linktype, direction, names, len(frame)) + frame
    decoded = PACKET.FromString(data)
    assert (decoded.frame_crc32, decoded.original_length, decoded.linktype) == (crc, length, linktype)
    assert (decoded.direction, decoded.node, decoded.interface, decoded.frame) == (direction, node, interface, frame)


@given(st.integers(1, 255), st.integers(-128, 127))
def test_attempts_behind_a_verdict_are_what_protobuf_itself_would_write(attempts: int, rssi_dbm: int) -> None:
    ends = schemas.encode_verdict_ends(("a", "radio0"), ("b", "radio0"))
    data = schemas.encode_verdict(ends, 0, 5, 60, 7) + schemas.encode_attempts(attempts, rssi_dbm)
    decoded = VERDICT.FromString(data)
    assert (decoded.attempts, decoded.rssi_dbm, decoded.crc32) == (attempts, rssi_dbm, 7)


@given(st.text(), st.text(), st.integers(0, 7), st.integers(0, 2**64 - 1), U32, U32)
def test_verdicts_are_what_protobuf_itself_would_write(
    node: str, interface: str, verdict: int, departs_ns: int, length: int, crc: int
) -> None:
    ends = schemas.encode_verdict_ends((node, interface), (interface, node))
    decoded = VERDICT.FromString(schemas.encode_verdict(ends, verdict, departs_ns, length, crc))
    assert (decoded.sender_node, decoded.sender_interface) == (node, interface)
    assert (decoded.receiver_node, decoded.receiver_interface) == (interface, node)
    assert (decoded.verdict, decoded.departs_ns, decoded.length, decoded.crc32) == (verdict, departs_ns, length, crc)


@given(st.text(), st.text(), st.integers(0, 7), st.integers(0, 2**64 - 1), U32, U32, st.binary(max_size=9))
def test_a_shape_is_the_verdict_without_what_tells_its_frame(
    node: str, interface: str, verdict: int, departs_ns: int, length: int, crc: int, rest: bytes
) -> None:
    ends = schemas.encode_verdict_ends((node, interface), (interface, node))
    data = schemas.encode_verdict(ends, verdict, departs_ns, length, crc) + schemas.encode_attempts(3, -70)
    shape = schemas.verdict_shape(data)
    whole, decoded = VERDICT.FromString(data), VERDICT.FromString(shape)
    if shape != data:  # names of more than 127 bytes may be left as they are
        whole.ClearField("departs_ns")
        whole.ClearField("crc32")
    assert decoded == whole
    assert shape != data or max(len(node.encode()), len(interface.encode())) > 127
    assert schemas.verdict_shape(data[: len(ends)] + rest) == data[: len(ends)] + rest  # damaged: nothing is taken off


@pytest.mark.parametrize("direction", schemas.Direction)
def test_packets_that_came_in_are_told_by_their_bytes(direction: schemas.Direction) -> None:
    data = schemas.encode_packet(1, 60, 1, direction, schemas.encode_packet_names("a", "eth0"), 60)
    assert schemas.is_inbound(data) is (direction is schemas.Direction.INBOUND)
    assert not schemas.is_inbound(data[:16])


def test_the_mcap_library_reads_all_of_it(write_capture: Callable[..., Path]) -> None:
    path = write_capture(packets=12)
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        summary = reader.get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == 12 + 12 + 8 + 2
        assert summary.statistics.chunk_count == 4
        messages = list(reader.iter_messages())
        assert [message.log_time for _, _, message in messages] == sorted(m.log_time for _, _, m in messages)
        by_topic = Counter(channel.topic for _, channel, _ in messages)
        only = list(reader.iter_decoded_messages(topics=["/robot1/eth0/packets"]))
        assert [record.metadata["name"] for record in reader.iter_metadata()] == ["test"]
        assert [record.data for record in reader.iter_attachments()] == [b"name: test\n"]
    assert by_topic == {
        "/timeline": 1,
        "/base/eth0/packets": 12,
        "/air/verdicts": 12,
        "/robot1/eth0/packets": 8,
        "/base/udp_mesh/events": 1,
    }
    assert len(only) == 8
    assert [message.sequence for _, _, message, _ in only] == list(range(8))  # a gap would show a lost message
    for _, channel, message, packet in only:
        assert channel.metadata == {
            "linktype": "1",
            "node": "robot1",
            "interface": "eth0",
            "snaplen": "262144",
        }
        assert zlib.crc32(packet.frame) == packet.frame_crc32
        assert message.log_time > 0


def test_the_summary_carries_its_checksum(write_capture: Callable[..., Path]) -> None:
    """By the specification: over the summary and the footer up to the checksum. The library does not look at it."""
    data = write_capture().read_bytes()
    summary_start, _, crc = struct.unpack_from("<QQI", data, len(data) - 8 - 20)
    assert crc == zlib.crc32(data[summary_start : len(data) - 8 - 4]) != 0


@contextlib.contextmanager
def file_size_limit(size: int) -> Iterator[None]:
    """Make writes past a file size fail, as on a full disk: partly at first, then wholly.

    Not a fixture: pytest reports a test before its fixtures end, perhaps to a file that is longer than that.
    """
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize("limit", [20_000, 50_001, 65_536])
def test_a_full_disk_keeps_what_was_written(tmp_path: Path, limit: int) -> None:
    path = tmp_path / "full.mcap"
    rng = random.Random(1)  # incompressible
    with file_size_limit(limit):
        writer = CaptureWriter(path, chunk_bytes=8_192)
        channel, _ = Topics(writer).packets("a", "eth0", 1)
        names = schemas.encode_packet_names("a", "eth0")
        for number in range(400):
            frame = b"%08d" % number + rng.randbytes(300)
            writer.add_message(channel, number, number, schemas.encode_packet(0, 9, 1, 2, names, len(frame)), frame)
        writer.close()
    assert writer.error is not None
    assert str(path) in writer.error
    assert path.stat().st_size <= limit
    assert 0 < writer.messages_written < 400
    assert writer.messages_written + writer.messages_lost == 400
    with Capture.open(path) as capture:
        frames = [record.frame[:8] for record in capture.records() if isinstance(record, PacketRecord)]
        assert capture.notes == []
    assert frames == [b"%08d" % number for number in range(writer.messages_written)]
    # Cutting the last chunk off made room for the summary: the file is as sound as any.
    with path.open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
        assert summary is not None
        assert summary.statistics is not None
        assert summary.statistics.message_count == writer.messages_written
        assert sum(1 for _ in make_reader(file).iter_messages()) == writer.messages_written


def test_without_any_room_the_writer_lives_on(tmp_path: Path) -> None:
    with file_size_limit(0):
        writer = CaptureWriter(tmp_path / "none.mcap")
        Topics(writer).add_json("/timeline", {"kind": "start"}, 5)
        writer.close()
    assert writer.messages_lost == 1
    with pytest.raises(CaptureError, match="is empty"):
        Capture.open(tmp_path / "none.mcap")


def test_a_slow_chunk_stays_readable_when_the_process_dies(tmp_path: Path) -> None:
    """What was flushed is in the file at once, summary or not."""
    writer = CaptureWriter(tmp_path / "crash.mcap")
    topics = Topics(writer)
    topics.add_json("/timeline", {"kind": "start"}, 1)
    writer.flush()
    topics.add_json("/timeline", {"kind": "late"}, 2)
    while writer.messages_written < 1:
        pass
    (tmp_path / "copy.mcap").write_bytes((tmp_path / "crash.mcap").read_bytes())
    writer.close()
    with Capture.open(tmp_path / "copy.mcap") as capture:
        assert [record.text("kind") for record in capture.records()] == ["start"]
        assert "cut off" in capture.notes[0]
