"""The supervisor's side of the capture: starts the recorder, opens feeds for processes, writes the lab's own topics.

Without a capture every method is a no-op, so that nobody else has to ask.
"""

from __future__ import annotations

import json
import os
import socket
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from netlab.capture.handle import Recorder
from netlab.capture.messages import RecorderStats
from netlab.errors import LabError
from netlab.ipc import start_module
from netlab.lab.process import ProcessSpec


class Recording:
    """One run's recording, or none (``Recording(None)``)."""

    def __init__(self, recorder: Recorder | None, file: str | None = None) -> None:
        self._recorder = recorder
        #: The file that is written to now, None for none.
        self.file = file
        self._is_over = False
        self._log_feeds: dict[tuple[str, str], int] = {}
        self.lines_dropped = 0
        #: A file for the timeline's rows (JSON lines), with a capture or without.
        self.journal: Path | None = None

    @classmethod
    def start(cls, path: Path, metadata: Mapping[str, str], attachments: Mapping[str, bytes], nodes: int) -> Recording:
        """Start the recorder's process and create the file.

        Raises:
            CaptureError: The file cannot be created.
        """
        channel, _pid = start_module("netlab.capture.recorder")
        recorder = Recorder(channel)
        recorder.open(str(path), metadata, attachments, nodes=nodes)
        return cls(recorder, str(path))

    @property
    def active(self) -> bool:
        """Whether anything is recorded."""
        return self._recorder is not None

    def add_node(self, node: str, net_fd: int, interfaces: list[str]) -> None:
        """Record all packets at a node's interfaces."""
        if self._recorder is not None:
            self._recorder.add_interfaces(node, net_fd, interfaces)

    def add_verdicts(self) -> int | None:
        """A stream for the medium's verdicts; the caller gives it to the engine and closes it."""
        return self._feed("verdicts", "/air/verdicts", "", "air")

    def open_events(self, spec: ProcessSpec) -> int | None:
        """The events stream of a process that is about to start."""
        topics = {
            "traffic-source": f"/{spec.node}/traffic/published",
            "traffic-sink": f"/{spec.node}/traffic/received",
        }
        topic = topics.get(spec.name, f"/{spec.node}/{spec.name}/events")
        return self._feed("events", topic, spec.node, spec.name)

    def line(self, node: str, process: str, text: str) -> None:
        """Record a line of output; a recorder that cannot keep up loses lines, and they are counted."""
        if self._recorder is None:
            return
        key = (node, process)
        if key not in self._log_feeds:
            feed = self._feed("log", f"/{node}/log/{process}", node, process)
            assert feed is not None  # the recorder exists
            os.set_blocking(feed, False)
            self._log_feeds[key] = feed
        try:
            os.write(self._log_feeds[key], text.encode() + b"\n")
        except OSError:
            self.lines_dropped += 1

    def timeline(self, kind: str, label: str, *, at_s: float | None, ago_s: float = 0.0, **more: Any) -> None:
        """Record an act on the lab, stamped ``ago_s`` before now."""
        payload = {"kind": kind, "label": label, "at_s": at_s, **more}
        if self.journal is not None:
            with self.journal.open("a") as journal:
                journal.write(json.dumps(payload) + "\n")
        self.message("/timeline", payload, time.time_ns() - round(ago_s * 1e9))

    def links(self, rows: list[dict[str, Any]]) -> None:
        """Record the state of links, stamped now."""
        for row in rows:
            self._message("/links", row)

    def message(self, topic: str, payload: dict[str, Any], t_ns: int) -> None:
        """Record one object of the lab's own, stamped by the caller."""
        if self._recorder is not None:
            self._recorder.message(topic, payload, t_ns)

    def open_file(self, path: Path) -> None:
        """Finish the present file and go on in another one.

        Raises:
            LabError: Nothing has been recorded from the start: nobody listens to the processes then.
            CaptureError: The file cannot be created.
        """
        if self._recorder is None:
            never = "this lab was started without a recorder; start it with --capture FILE"
            raise LabError("the scenario is over, and its recorder has ended" if self._is_over else never)
        self._recorder.open_file(str(path))
        self.file = str(path)

    def close_file(self) -> None:
        """Finish the present file; onlookers go on."""
        if self._recorder is not None:
            self._recorder.close_file()
        self.file = None

    def subscribe(self, fd: int, *, packets: bool) -> None:
        """Show what is recorded at a stream socket too. Raises LabError where nothing is recorded."""
        if self._recorder is None:
            raise LabError("this lab records nothing, so there is nothing to follow; start it with --capture FILE")
        self._recorder.subscribe(fd, packets=packets)

    def set_t0(self, t0_ns: int) -> None:
        """Declare scenario time zero."""
        if self._recorder is not None:
            self._recorder.set_t0(t0_ns)

    def set_duration(self, duration_s: float) -> None:
        """Declare for how long traffic is published, when that has changed."""
        if self._recorder is not None:
            self._recorder.set_metadata({"duration_s": repr(duration_s)})

    def sync(self) -> None:
        """Wait until all that was asked for is recorded from now on. Raises CaptureError."""
        if self._recorder is not None:
            self._recorder.sync()

    def notices(self) -> list[str]:
        """What the recorder has to say, such as a full disk."""
        return self._recorder.notices() if self._recorder is not None else []

    def close(self) -> RecorderStats | None:
        """Finish the file; None where nothing was recorded."""
        for feed in self._log_feeds.values():
            os.close(feed)
        self._log_feeds.clear()
        recorder, self._recorder = self._recorder, None
        self.file, self._is_over = None, recorder is not None or self._is_over
        return recorder.close() if recorder is not None else None

    def _feed(self, kind: str, topic: str, node: str, process: str) -> int | None:
        if self._recorder is None:
            return None
        theirs, ours = _feed_pair()
        self._recorder.add_feed(kind, topic, node, process, theirs)
        os.close(theirs)
        return ours

    def _message(self, topic: str, payload: dict[str, Any]) -> None:
        if self._recorder is not None:
            self._recorder.message(topic, payload, time.time_ns())


def _feed_pair() -> tuple[int, int]:
    """A stream with roomy buffers between a producer in a node and the recorder: (recorder's end, producer's end)."""
    recorder, producer = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
    for end in (recorder, producer):
        end.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, 1 << 20)
    return recorder.detach(), producer.detach()
