"""A helper process of an engine, asked over a channel: start it, ask it, notice its end, end it."""

from __future__ import annotations

import contextlib
import os
import select
from collections.abc import Sequence
from typing import Any

from netlab.engines.air_messages import Close, Failed
from netlab.errors import LabError
from netlab.ipc import start_module

_ANSWER_LIMIT_S = 30.0


class HelperProcess:
    """``python -m MODULE --channel-fd N``, which answers every message; ``what`` names it for a person."""

    def __init__(self, module: str, what: str) -> None:
        """Start it; it inherits the caller's namespaces.

        Raises:
            OSError: It cannot be started.
        """
        self._what = what
        self._channel, self.pid = start_module(module)

    def ask(self, request: object, fds: Sequence[int] = ()) -> Any:
        """Send one request and wait until it is in force; returns the answer.

        Raises:
            LabError: It refused, or is gone.
        """
        try:
            self._channel.send(request, fds)
            if not select.select([self._channel], [], [], _ANSWER_LIMIT_S)[0]:
                raise LabError(f"the {self._what} process has not answered for {_ANSWER_LIMIT_S:g} s")
            answer = self._channel.recv()[0]
        except (EOFError, OSError) as error:
            raise LabError(
                f"the {self._what} process is gone ({error}); its last words are in the supervisor's log"
            ) from error
        if isinstance(answer, Failed):
            raise LabError(answer.problem)
        return answer

    @property
    def ended(self) -> bool:
        """Whether it has ended by itself: it only speaks when asked, so something to read is the end."""
        return bool(select.select([self._channel], [], [], 0)[0])

    def close(self) -> None:
        """Have it end and wait for that."""
        with contextlib.suppress(LabError):
            self.ask(Close())
        self._channel.close()
        with contextlib.suppress(ChildProcessError):  # somebody who collects every child was faster
            os.waitpid(self.pid, 0)
