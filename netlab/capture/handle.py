"""The supervisor's hold on the recorder. A recorder that dies ends the recording, never the run."""

from __future__ import annotations

import select
import time
from collections.abc import Mapping, Sequence

from netlab.capture.messages import (
    AddFeed,
    AddInterfaces,
    Close,
    CloseFile,
    Done,
    FeedKind,
    Message,
    Notice,
    Open,
    OpenFile,
    RecorderStats,
    SetMetadata,
    Subscribe,
    Sync,
)
from netlab.errors import CaptureError
from netlab.ipc import Channel

_ANSWER_TIMEOUT_S = 30.0


class Recorder:
    """Speaks to the recorder at the other end of ``channel``.

    Descriptors that are passed in are duplicated: the caller may close its own at once. After the recorder's death
    every call is a quick no-op, ``failure`` says what happened, and ``close`` returns what is known.
    """

    def __init__(self, channel: Channel) -> None:
        self._channel = channel
        self._notices: list[str] = []
        self.failure: str | None = None

    def fileno(self) -> int:
        """Readable when there are notices."""
        return self._channel.fileno()

    def open(self, path: str, metadata: Mapping[str, str], attachments: Mapping[str, bytes], *, nodes: int = 2) -> None:
        """Create the file and wait for that.

        Args:
            path: Absolute; overwritten if it exists.
            metadata: The record ``netlab.run``, from :func:`netlab.capture.metadata.run_metadata`.
            attachments: File name to content.
            nodes: How many nodes will be sniffed; their rings share the memory.

        Raises:
            CaptureError: The file cannot be created, or the recorder is gone.
        """
        self._send(Open(path, dict(metadata), dict(attachments), nodes))
        self._wait_done()

    def add_interfaces(self, node: str, netns_fd: int, interfaces: Sequence[str]) -> None:
        """Sniff all interfaces of a node but lo; ``interfaces`` are those known by now. Takes effect by ``sync``."""
        self._send(AddInterfaces(node, tuple(interfaces)), [netns_fd])

    def add_feed(self, kind: str, topic: str, node: str, process: str, fd: int) -> None:
        """Record what can be read from ``fd``: ``events`` (JSON lines), ``verdicts`` (packed) or ``log`` (text)."""
        self._send(AddFeed(FeedKind(kind), topic, node, process), [fd])

    def message(self, topic: str, payload: Mapping[str, object], t_ns: int) -> None:
        """Record one object of the lab's own: ``/timeline``, ``/links``. ``t_ns`` is CLOCK_REALTIME."""
        self._send(Message(topic, {"t_ns": t_ns, **payload}, t_ns))

    def set_t0(self, t0_ns: int) -> None:
        """Declare scenario time zero."""
        self.set_metadata({"t0_ns": str(t0_ns)})

    def set_metadata(self, values: Mapping[str, str]) -> None:
        """Change values of the record ``netlab.run``."""
        self._send(SetMetadata(dict(values)))

    def subscribe(self, fd: int, *, packets: bool) -> None:
        """Show everything that is recorded at a stream socket too, from the static records on; never waits for it."""
        self._send(Subscribe(packets), [fd])

    def open_file(self, path: str) -> None:
        """Finish the present file, if there is one, and begin another one.

        Raises:
            CaptureError: It cannot be created, or the recorder is gone.
        """
        self._send(OpenFile(path))
        self._wait_done()

    def close_file(self) -> None:
        """Finish the present file; producers and onlookers go on.

        Raises:
            CaptureError: The recorder is gone.
        """
        self._send(CloseFile())
        self._wait_done()

    def sync(self) -> None:
        """Wait until everything asked before has taken effect: from now on no packet is missed.

        Raises:
            CaptureError: Some of it failed, or the recorder is gone.
        """
        self._send(Sync())
        self._wait_done()

    def notices(self) -> list[str]:
        """What the recorder had to say since the last call, such as a full disk. Does not block."""
        while self.failure is None and self._channel.fileno() >= 0 and select.select([self._channel], [], [], 0)[0]:
            self._receive()
        notices, self._notices = self._notices, []
        return notices

    def close(self, *, timeout_s: float = _ANSWER_TIMEOUT_S) -> RecorderStats:
        """Finish the file. Never raises: a recorder that died shows in ``RecorderStats.failure``."""
        self._send(Close())
        deadline = time.monotonic() + timeout_s
        while self.failure is None:
            answer = self._answer(deadline)
            if isinstance(answer, RecorderStats):
                self._channel.close()
                return answer
        self._channel.close()
        return RecorderStats(failure=self.failure)

    def _wait_done(self) -> None:
        deadline = time.monotonic() + _ANSWER_TIMEOUT_S
        while self.failure is None:
            answer = self._answer(deadline)
            if isinstance(answer, Done):
                if answer.errors:
                    raise CaptureError("the capture cannot be recorded: " + "; ".join(answer.errors))
                return
        raise CaptureError(self.failure)

    def _answer(self, deadline: float) -> object:
        if not select.select([self._channel], [], [], max(deadline - time.monotonic(), 0))[0]:
            self._fail("the recorder does not answer")
            return None
        return self._receive()

    def _receive(self) -> object:
        try:
            message, _ = self._channel.recv()
        except (EOFError, OSError) as error:
            self._fail(f"the recorder ended early ({error}); the capture holds what was written until then")
            return None
        if isinstance(message, Notice):
            self._notices.append(message.text)
        return message

    def _send(self, message: object, fds: Sequence[int] = ()) -> None:
        if self.failure is not None:
            return
        try:
            self._channel.send(message, fds)
        except OSError as error:
            self._fail(f"the recorder ended early ({error}); the capture holds what was written until then")

    def _fail(self, text: str) -> None:
        if self.failure is None:
            self.failure = text
            self._notices.append(text)
