"""The boxes of a pytest session: one share of the tests each, opened when needed, again if a test broke its box.

Theory. The tests are divided into several shares for each worker (xdist), so that none has nothing left to do while
another has a long share before it; into one without workers. Every worker divides alike. Whoever first needs a test of
a share takes its lock and opens its box; a worker that waits for somebody else's share opens an idle one meanwhile, one
at a time. Only the lock's holder writes to a share from outside. A worker that dies loses the lock, and its box ends by
its lifeline; the next one that waits goes on with what is left.

A test that ends its box (breakdown, time limit, pytest.exit) is lost, with the reason; those behind it get a new box.
"""

from __future__ import annotations

import contextlib
import fcntl
import itertools
import json
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

from netlab.pytest_virtual.records import CAPTURES, FOLDER_VARIABLE, WANTED, Records, append
from netlab.vm.control import last_lines
from netlab.vm.request import BoxError, BoxRequest, Clock, KernelChoice
from netlab.vm.run import Box, Streams, open_box

_LOG, _LOCK = "session.log", "lock"
_POLL_S = 0.05
_START_LIMIT_S = 120.0  # collecting the tests, before the first of them begins
_SHARES_PER_WORKER = 4  # a box costs some seconds to open
_NO_LIMIT_S = 7 * 24 * 3600.0  # of a whole box; what is limited is each test


@dataclass(frozen=True, slots=True)
class Order:
    """What all boxes of a session have in common.

    Attributes:
        argv: The pytest command.
        cwd: Its folder.
        env: Its environment.
        patience_s: The longest that one test may take, by the host's clock.
        echo: Where the tests' own output goes when it is not captured; None to keep it in a log.
    """

    argv: tuple[str, ...]
    cwd: Path
    env: dict[str, str]
    patience_s: float
    echo: BinaryIO | None = None


class Share:
    """One share of the tests, and its box if this process holds it."""

    def __init__(self, folder: Path, tests: dict[str, Path], order: Order) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder
        self.records = Records(folder)
        self._tests = tests
        self._order = order
        self._lock = os.open(folder / _LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
        self._is_held = False
        self._box: Box | None = None
        self._scope = contextlib.ExitStack()
        self._opened_s = 0.0
        self._settled_before = 0

    @property
    def is_held(self) -> bool:
        """Whether this process looks after the share."""
        return self._is_held

    @property
    def is_idle(self) -> bool:
        """Whether nobody has opened its box yet."""
        return not (self.folder / WANTED).exists()

    @property
    def is_done(self) -> bool:
        """Whether all its tests are settled."""
        return all(map(self.records.settled, self._tests))

    def hold(self) -> bool:
        """Look after the share from now on; False if another process does."""
        if not self._is_held:
            with contextlib.suppress(BlockingIOError):
                fcntl.flock(self._lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
                self._is_held = True
        return self._is_held

    def open(self) -> None:
        """Open a box for what is left; the share must be held."""
        self.records.refresh()
        left = [test for test in self._tests if not self.records.settled(test)]
        self.records.running = None
        self._settled_before = len(self._tests) - len(left)
        files = list(dict.fromkeys(str(self._tests[test]) for test in left))
        (self.folder / WANTED).write_text(json.dumps({"tests": left, "files": files}))
        request = BoxRequest(
            argv=self._order.argv,
            cwd=self._order.cwd,
            env={**self._order.env, FOLDER_VARIABLE: str(self.folder)},
            output=self.folder,
            kernel=KernelChoice.UML,
            clock=Clock.VIRTUAL,
            timeout_s=_NO_LIMIT_S,
        )
        echo = self._order.echo or self._scope.enter_context((self.folder / _LOG).open("wb", buffering=0))
        self._opened_s = time.time()
        try:
            self._box = self._scope.enter_context(open_box(request, Streams(echo, echo)))
        except BoxError as error:
            self._lose(left, str(error))

    def drive(self, condition: Callable[[], bool]) -> None:
        """Look after the box until the condition holds or no test is left."""
        while not condition() and not self.is_done:
            if self._box is None:
                self.open()
            elif not self._wait(condition):
                self._judge()

    def end(self) -> None:
        """End the box, if there is one; nobody needs it any more."""
        self._scope.close()
        self._box = None

    def close(self) -> None:
        """End the box, if there is one, and let go of the share."""
        self.end()
        if self._lock >= 0:
            os.close(self._lock)
        self._lock = -1
        self._is_held = False

    def _wait(self, condition: Callable[[], bool]) -> bool:
        """Whether the condition came to hold while the box ran, and was heard of in time."""

        def met() -> bool:
            self.records.refresh()
            return condition()

        assert self._box is not None
        with contextlib.suppress(BoxError):  # told when the box is asked for its result
            self._box.wait(lambda: met() or self._is_silent)
        return met()

    @property
    def _is_silent(self) -> bool:
        heard_s, limit_s = self.records.last_heard_s(), self._order.patience_s
        if heard_s < self._opened_s:
            heard_s, limit_s = self._opened_s, max(limit_s, _START_LIMIT_S)
        return time.time() - heard_s > limit_s

    def _judge(self) -> None:
        """The box has ended, or must: see which tests that cost."""
        why = self._end_box()
        self.records.refresh()
        settled = sum(map(self.records.settled, self._tests))
        if self.records.running is not None:
            self._lose([self.records.running], why)
        elif settled == self._settled_before:
            why = "\n".join([why, *self.records.trouble])
            self._lose([test for test in self._tests if not self.records.settled(test)], why)

    def _end_box(self) -> str:
        """End the box; returns how it went, for a person."""
        assert self._box is not None
        if self._is_silent and not self._box.ended:
            silent_s = time.time() - max(self._opened_s, self.records.last_heard_s())
            how = f"nothing was heard from the box for {silent_s:.0f} s of the host's clock (--lab-patience)"
        else:
            try:
                how = f"the session in the box ended early (exit code {self._box.result().exit_code})"
            except BoxError as error:
                how = str(error)
        self.end()
        return f"{how}. {last_lines(self.folder / _LOG, 'The session')}"

    def _lose(self, tests: list[str], why: str) -> None:
        for test in tests:
            append(self.folder, {"event": "lost", "test": test, "why": why})
        self.records.refresh()


class Boxes:
    """All shares of a session, as one of its processes sees them."""

    def __init__(self, folder: Path, tests: dict[str, Path], order: Order, *, worker_count: int) -> None:
        """Divide the tests.

        Args:
            folder: Shared by the processes of the session.
            tests: Node id -> file, in the order of the session.
            order: What to run.
            worker_count: Processes of the session, >= 1; each has at most one box at work.
        """
        ids = list(tests)
        count = 1 if worker_count == 1 else min(worker_count * _SHARES_PER_WORKER, len(ids))
        bounds = [round(len(ids) * i / count) for i in range(count + 1)]
        parts = [ids[start:end] for start, end in itertools.pairwise(bounds)]
        self.shares = [
            Share(folder / f"box{number}", {test: tests[test] for test in part}, order)
            for number, part in enumerate(parts)
        ]
        self._are_closed = False
        self._share_of = {test: share for share, part in zip(self.shares, parts, strict=True) for test in part}

    def await_report(self, test: str, phase: str) -> dict[str, Any] | None:
        """The report of one phase of a test, serialised; None if it is lost, see :meth:`why_lost`.

        Waits for it unless the boxes are closed: of an interrupted test, pytest wants the teardown after the end.
        """
        share = self._share_of[test]

        def known() -> bool:
            share.records.refresh()
            return phase in share.records.reports[test] or share.records.settled(test)

        while not known() and not self._are_closed:
            at_work = self._at_work() or (share if share.hold() else self._idle_one())
            if at_work is not None:
                at_work.drive(known)
            else:
                time.sleep(_POLL_S)
        return share.records.reports[test].get(phase)

    def finished(self) -> Iterator[tuple[str, str]]:
        """Every test that has come to its end in a box, with each phase that it reported."""
        for share in self.shares:
            share.records.refresh()
            for test in share.records.finished:
                yield from ((test, phase) for phase in share.records.reports[test])

    def why_lost(self, test: str) -> str:
        """Why there is no report."""
        lost = self._share_of[test].records.lost
        return f"this test ran in a box, in virtual time: {lost.get(test, 'it sent no report of this phase')}"

    def captures(self, test: str) -> list[Path]:
        """Captures that the test left in the shared folder."""
        share = self._share_of[test]
        return [share.folder / CAPTURES / name for name in share.records.captures.pop(test, [])]

    def warnings(self) -> list[dict[str, Any]]:
        """Warnings inside, from the boxes that this process looks after."""
        return [warning for share in self.shares if share.is_held for warning in share.records.warnings]

    def finish(self) -> None:
        """Look after the boxes until nothing is left to begin: other workers may wait for them."""
        while (share := self._at_work() or self._idle_one()) is not None:
            share.drive(lambda: False)

    def close(self) -> None:
        """End all boxes of this process."""
        self._are_closed = True
        for share in self.shares:
            share.close()

    def _at_work(self) -> Share | None:
        """The share that this process looks after and that has tests left."""
        for share in self.shares:
            if share.is_held:
                share.records.refresh()
                if not share.is_done:
                    return share
                share.end()
        return None

    def _idle_one(self) -> Share | None:
        """A share that nobody has begun, now this process's."""
        return next((share for share in self.shares if share.is_idle and share.hold()), None)
