"""The recorder's process and its handle, without namespaces: feeds, messages, ends of every kind."""

from __future__ import annotations

import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

from netlab.capture.handle import Recorder
from netlab.capture.reader import Capture
from netlab.capture.records import JsonRecord, LogLine
from netlab.errors import CaptureError
from netlab.ipc import Channel

T0_NS = 1_800_000_000_000_000_000


@dataclass
class Rig:
    process: subprocess.Popen[bytes]
    channel: Channel
    recorder: Recorder


@pytest.fixture
def rig() -> Iterator[Rig]:
    ours, theirs = Channel.pair()
    argv = [sys.executable, "-m", "netlab.capture.recorder", "--channel-fd", str(theirs.fileno())]
    process = subprocess.Popen(argv, pass_fds=[theirs.fileno()])
    theirs.close()
    try:
        yield Rig(process, ours, Recorder(ours))
    finally:
        if process.poll() is None:
            process.kill()
        process.wait()
        ours.close()


def payloads(path: Path, topic: str) -> list[dict[str, object]]:
    with Capture.open(path) as capture:
        assert not capture.notes
        return [record.payload for record in capture.records(topics={topic}) if isinstance(record, JsonRecord)]


def test_a_recording_from_open_to_close(rig: Rig, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    rig.recorder.open(str(path), {"name": "pair", "seed": "7"}, {"scenario.yaml": b"name: pair\n"})
    events, log = os.pipe(), os.pipe()
    rig.recorder.add_feed("events", "/a/udp_mesh/events", "a", "udp_mesh", events[0])
    rig.recorder.add_feed("log", "/a/log/udp_mesh", "a", "udp_mesh", log[0])
    os.close(events[0])
    os.close(log[0])
    rig.recorder.set_t0(T0_NS)
    rig.recorder.message("/timeline", {"kind": "start", "at_s": 0.0, "label": "start"}, T0_NS)
    rig.recorder.sync()
    os.write(events[1], b'{"t_ns": %d, "event": "peer_up", "peer": "b"}\nrubbish\n' % (T0_NS + 5))
    os.write(log[1], b"ready\n")
    os.close(log[1])
    stats = rig.recorder.close()  # the daemon still holds its events pipe
    os.close(events[1])
    assert rig.process.wait(10) == 0
    assert stats.failure is None
    assert (stats.messages, stats.packets, stats.feed_lines_dropped) == (3, 0, 1)
    assert (stats.write_errors, stats.messages_lost, stats.kernel_drops) == ((), 0, {})
    assert payloads(path, "/timeline") == [{"t_ns": T0_NS, "kind": "start", "at_s": 0.0, "label": "start"}]
    assert [entry["peer"] for entry in payloads(path, "/a/udp_mesh/events")] == ["b"]
    with Capture.open(path) as capture:
        assert capture.losses == {"lines of feeds": 1}, "the file itself tells what it lacks"
        assert capture.metadata == {"name": "pair", "seed": "7", "t0_ns": str(T0_NS)}
        assert capture.attachments == {"scenario.yaml": b"name: pair\n"}
        assert [record.message for record in capture.records() if isinstance(record, LogLine)] == ["ready"]


def test_a_file_that_cannot_be_created_is_an_error_at_once(rig: Rig, tmp_path: Path) -> None:
    with pytest.raises(CaptureError, match=r"missing/run\.mcap: No such file"):
        rig.recorder.open(str(tmp_path / "missing" / "run.mcap"), {}, {})
    assert rig.recorder.close().messages == 0
    assert rig.process.wait(10) == 0


def test_requests_before_open_are_an_error_not_a_crash(rig: Rig) -> None:
    rig.recorder.message("/timeline", {"kind": "start"}, 1)
    with pytest.raises(CaptureError, match="before the file was opened"):
        rig.recorder.sync()


def test_a_descriptor_that_is_no_namespace_is_refused(rig: Rig, tmp_path: Path) -> None:
    rig.recorder.open(str(tmp_path / "run.mcap"), {}, {})
    with Path(os.devnull).open() as nothing:
        rig.recorder.add_interfaces("a", nothing.fileno(), ["eth0"])
        with pytest.raises(CaptureError, match="cannot sniff at a"):
            rig.recorder.sync()
    assert rig.recorder.close().failure is None


def test_a_killed_recorder_ends_the_recording_not_the_run(rig: Rig, tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    rig.recorder.open(str(path), {"name": "pair"}, {})
    rig.process.kill()
    rig.process.wait()
    for number in range(3):
        rig.recorder.message("/timeline", {"kind": "step"}, number)
    assert rig.recorder.failure is not None
    assert "ended early" in " ".join(rig.recorder.notices())
    assert rig.recorder.notices() == []
    with pytest.raises(CaptureError, match="ended early"):
        rig.recorder.sync()
    stats = rig.recorder.close()
    assert stats.failure is not None
    with Capture.open(path) as capture:
        assert "cut off" in capture.notes[0]


@pytest.mark.parametrize("how", ["sigterm", "supervisor gone"])
def test_the_file_is_finished_however_the_recorder_is_told_to_end(rig: Rig, tmp_path: Path, how: str) -> None:
    path = tmp_path / "run.mcap"
    rig.recorder.open(str(path), {}, {})
    rig.recorder.message("/timeline", {"kind": "start"}, T0_NS)
    rig.recorder.sync()
    if how == "sigterm":
        rig.process.send_signal(signal.SIGTERM)
    else:
        rig.channel.close()
    assert rig.process.wait(10) == 0
    assert [entry["kind"] for entry in payloads(path, "/timeline")] == ["start"]


def test_a_full_disk_is_told_once_and_the_run_goes_on(tmp_path: Path) -> None:
    ours, theirs = Channel.pair()
    path = tmp_path / "full.mcap"
    # A limit on the size of files fails writes as a full disk does, partly first and then wholly.
    script = (
        "import resource, sys; resource.setrlimit(resource.RLIMIT_FSIZE, (4000, 4000));"
        "from netlab.capture.recorder import main; sys.exit(main(sys.argv[1:]))"
    )
    argv = [sys.executable, "-c", script, "--channel-fd", str(theirs.fileno())]
    process = subprocess.Popen(argv, pass_fds=[theirs.fileno()])
    theirs.close()
    recorder = Recorder(ours)
    recorder.open(str(path), {"name": "full"}, {})
    recorder.message("/timeline", {"kind": "start"}, T0_NS)
    noise = [os.urandom(30_000).hex() for _ in range(2)]
    recorder.message("/links", {"noise": noise[0]}, T0_NS + 1)
    assert select.select([recorder], [], [], 10)[0]  # nobody asked: the recorder says so by itself
    (notice,) = recorder.notices()
    assert "full.mcap" in notice
    assert "the run goes on" in notice
    recorder.message("/links", {"noise": noise[1]}, T0_NS + 2)
    recorder.sync()
    stats = recorder.close()
    assert process.wait(10) == 0
    assert recorder.notices() == []
    assert len(stats.write_errors) == 1
    assert stats.messages_lost + stats.messages == 3
    assert stats.messages_lost >= 2
    with Capture.open(path) as capture:
        assert capture.metadata["name"] == "full"
        assert len(list(capture.records())) == stats.messages
