"""All that a report tells of one capture, read and worked out once."""

from __future__ import annotations

import json
import re
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from netlab.capture.reader import Capture, OnRead
from netlab.capture.records import Kind, PacketRecord, VerdictRecord
from netlab.errors import CaptureError
from netlab.report import data
from netlab.report.expected import Evidence, evidence, expectations_of
from netlab.report.follow import build_lane
from netlab.report.lane import Lane, chosen_life, window_ns
from netlab.report.marks import Marks, marks
from netlab.report.scene import Scene, load_scene
from netlab.report.waterfall import Fall, fall, span_ns
from netlab.traces.load import read_trace
from netlab.traces.messages import message_lives
from netlab.traces.model import Trace
from netlab.traces.reconnects import reconnects
from netlab.traces.story import Story
from netlab.traces.streams import StreamReport, stream_reports
from netlab.traces.tell import tell

#: Told what is being done.
OnStep = Callable[[str], None]
_MESSAGE = re.compile(r"(?P<topic>.+)#(?P<seq>\d+)")
_FALLS_MAX = 400


@dataclass(frozen=True, slots=True)
class Wishes:
    """What a person asked to see; None takes what tells most.

    ``topic``: whose times between messages; ``base``: to whom nodes are connected or not; ``message``: ``TOPIC#SEQ``.
    """

    topic: str | None = None
    base: str | None = None
    message: str | None = None


@dataclass(frozen=True, slots=True)
class Run:
    """One capture.

    ``label`` tells two runs apart, empty for a single one; ``story`` is that of the ``lane``'s message.
    """

    label: str
    path: Path
    trace: Trace
    scene: Scene
    streams: tuple[StreamReport, ...]
    topic: str | None
    base: str | None
    expected: tuple[Evidence, ...]
    falls: tuple[Fall, ...]
    lane: Lane | None
    story: Story | None
    marks: Marks

    @property
    def name(self) -> str:
        """The scenario's name, or the file's."""
        return self.scene.metadata.get("name", self.path.stem)


def load_run(
    path: Path,
    wishes: Wishes,
    *,
    label: str = "",
    on_step: OnStep = lambda what: None,
    on_read: OnRead = lambda done, total: None,
) -> Run:
    """Read a capture and answer everything.

    Raises:
        CaptureError: The file is no capture, or has no such topic, node or message.
    """
    on_step(f"reading {path.name}")
    with Capture.open(path, on_read) as capture:
        trace = read_trace(capture)
    _check(trace, wishes)
    on_step(f"reading the scene of {path.name}")
    scene = load_scene(path, on_read)
    on_step(f"judging {path.name}")
    expected = tuple(evidence(expectations_of(scene.metadata), trace))
    on_step(f"following packets of {path.name}")
    lane, story = _message(path, trace, wishes.message)
    return Run(
        label,
        path,
        trace,
        scene,
        tuple(stream_reports(trace)),
        wishes.topic or data.heartbeat_topic(trace),
        wishes.base or _busiest_receiver(trace),
        expected,
        _falls(path, trace),
        lane,
        story,
        marks(trace, scene.down_s, expected, is_meshed=_is_meshed(trace, scene)),
    )


def _is_meshed(trace: Trace, scene: Scene) -> bool:
    """Whether packets leave by an interface that is no port of the plan: a mesh's."""
    try:
        ports = {(port["node"], port["interface"]) for port in json.loads(scene.metadata.get("ports", "[]"))}
    except (ValueError, KeyError, TypeError):
        return False
    return bool(ports) and any(found and found[0].interface not in ports for found in trace.fragments.values())


def _check(trace: Trace, wishes: Wishes) -> None:
    topics = sorted({stream.topic for stream in trace.streams})
    nodes = sorted({node for stream in trace.streams for node in (stream.source, stream.destination)})
    for what, name, known in (("topic", wishes.topic, topics), ("node", wishes.base, nodes)):
        if name is not None and name not in known:
            raise CaptureError(
                f"{trace.path}: no stream has the {what} '{name}'; known are {', '.join(known) or 'none'}"
            )


def _busiest_receiver(trace: Trace) -> str | None:
    received: Counter[str] = Counter()
    for stream in trace.streams:
        received[stream.destination] += sum(delivery.size_bytes for delivery in trace.delivered.get(stream.index, []))
    return "base" if "base" in received else max(received, key=received.__getitem__, default=None)


def _message(path: Path, trace: Trace, message: str | None) -> tuple[Lane | None, Story | None]:
    topic, seq = _asked(trace, message)
    life = chosen_life(message_lives(trace), topic, seq)
    if life is None:
        if message is not None:
            raise CaptureError(f"{path}: there is no message {message}; try `netlab inspect {path} --topic {topic}`")
        return None, None
    start_ns, end_ns = window_ns(trace, life)
    with Capture.open(path) as capture:
        packets = capture.records({Kind.PACKET}, start_ns=start_ns, end_ns=end_ns)
        verdicts = capture.records({Kind.VERDICT}, start_ns=start_ns, end_ns=end_ns)
        lane = build_lane(
            trace,
            life,
            (record for record in packets if isinstance(record, PacketRecord)),
            (record for record in verdicts if isinstance(record, VerdictRecord)),
        )
        return lane, tell(capture, trace, life.stream, life.published)


def _asked(trace: Trace, message: str | None) -> tuple[str | None, int | None]:
    if message is None:
        return None, None
    match = _MESSAGE.fullmatch(message)
    topics = sorted({stream.topic for stream in trace.streams})
    if match is None:
        raise CaptureError(f"'{message}' names no message; write TOPIC#NUMBER, for example {(topics or ['map'])[0]}#7")
    if match["topic"] not in topics:
        raise CaptureError(f"{trace.path}: no stream has the topic '{match['topic']}'; known are {', '.join(topics)}")
    return match["topic"], int(match["seq"])


def _falls(path: Path, trace: Trace) -> tuple[Fall, ...]:
    found = []
    with Capture.open(path) as capture:
        for entry in reconnects(trace)[:_FALLS_MAX]:
            start_ns, end_ns = span_ns(trace, entry)
            records = capture.records({Kind.PACKET}, nodes=set(entry.between), start_ns=start_ns, end_ns=end_ns)
            found.append(fall(entry, (record for record in records if isinstance(record, PacketRecord))))
    return tuple(found)
