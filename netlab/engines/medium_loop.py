"""What the processes that carry frames have in common: they wait, answer the lab and write verdicts, in one thread."""

from __future__ import annotations

import argparse
import gc
import select
import time
from typing import Any

from netlab.engines.air_messages import Close, Done, Failed, RecordVerdicts, SetOutage, SetPairs
from netlab.engines.air_verdicts import VerdictStream
from netlab.engines.priority import prefer_this_process
from netlab.ipc import Channel
from netlab.kernel import syscalls
from netlab.medium.medium import Medium
from netlab.medium.wifi import WifiMedium


class MediumLoop:
    """Base of a data plane; a subclass carries frames, and obeys what is its own."""

    def __init__(self, channel: Channel, medium: Medium | WifiMedium) -> None:
        self._channel = channel
        self._readers = [channel.fileno()]
        self._open = True
        self._pairs = medium
        self._verdicts: VerdictStream | None = None
        self._lost_before = 0  # verdicts, of earlier streams

    def _begin(self, medium: Medium | WifiMedium, source: int) -> None:
        """Carry frames by this medium from now on, and wake up when the descriptor ``source`` has some."""
        self._pairs = medium
        self._readers.append(source)
        # What lives now lives on, and frames make no cycles: no collection ever needs to stop the loop.
        gc.collect()
        gc.freeze()
        gc.disable()

    def _wait(self, due_s: float | None, *, busy: bool) -> None:
        """Sleep until ``due_s`` (monotonic), a frame is there or the lab speaks; not at all if ``busy``."""
        verdicts = self._verdicts
        writing: list[int] = []
        if verdicts is not None and verdicts.pending:
            verdicts.flush()
            writing = [verdicts.fileno()] if verdicts.pending else []
        most_s = None if due_s is None else max(0.0, due_s - time.monotonic())
        readable = select.select([*self._readers, *self._sources()], writing, [], 0.0 if busy else most_s)[0]
        if self._readers[0] in readable:
            self._answer()

    def _sources(self) -> list[int]:
        """Descriptors beside the one of :meth:`_begin` that have frames when they are readable."""
        return []

    def _answer(self) -> None:
        try:
            request, fds = self._channel.recv()
            try:
                answer = self._obey(request, fds)
            except (OSError, ValueError) as error:
                answer = Failed(str(error))
            self._channel.send(answer)
        except (EOFError, BrokenPipeError, ConnectionResetError):
            self._open = False

    def _obey(self, request: Any, fds: list[int]) -> Any:
        if isinstance(request, SetPairs):
            self._pairs.set_pairs(request.changes)
        elif isinstance(request, SetOutage):
            self._pairs.set_outage(request.pairs, active=request.active)
        elif isinstance(request, RecordVerdicts):
            self._close_verdicts()
            self._verdicts = VerdictStream(fds[0])
        else:
            assert isinstance(request, Close)
            self._open = False
        return Done()

    def _close_verdicts(self) -> None:
        if self._verdicts is not None:
            self._verdicts.close()
            self._lost_before += self._verdicts.lost

    @property
    def _lost_verdicts(self) -> int:
        return self._lost_before + (self._verdicts.lost if self._verdicts is not None else 0)


def lab_channel(name: str, argv: list[str]) -> Channel:
    """Name this process, give it its priority, and return the channel to the lab (``--channel-fd``)."""
    parser = argparse.ArgumentParser(prog=name)
    parser.add_argument("--channel-fd", type=int, required=True)
    options = parser.parse_args(argv)
    syscalls.set_name(name)
    prefer_this_process()
    return Channel.from_fd(options.channel_fd)
