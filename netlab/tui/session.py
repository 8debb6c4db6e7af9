"""What the screen asks of a lab: an interface, and the one that runs a real lab. All calls may block."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from netlab.capture.records import Record
from netlab.cli.terminal import exec_with_terminal
from netlab.errors import NetlabError
from netlab.lab.commands import exec_request
from netlab.lab.facade import Lab
from netlab.live.feed import Feed

_MOST_MESSAGES = 20_000  # taken at once, so that a flood of records does not freeze the screen


@dataclass(frozen=True, slots=True)
class Verdict:
    """How a run went: ``brief`` for a panel, the whole ``report`` for when the screen is gone."""

    brief: str
    report: str


class Session(Protocol):
    """One lab, as the screen sees it."""

    @property
    def title(self) -> str:
        """The scenario's name."""

    @property
    def carriers(self) -> Mapping[str, str]:
        """Who carries each node that can be deployed."""

    @property
    def files(self) -> Sequence[tuple[str, Path]]:
        """What it has written: (what, where)."""

    def start(self) -> None:
        """Bring it up and let its scenario begin."""

    def metadata(self) -> Mapping[str, str]:
        """The run's metadata, as known by now."""

    def records(self) -> list[Record]:
        """What has been recorded since the last call. Does not wait."""

    def status(self) -> Mapping[str, Any]:
        """What the supervisor says."""

    def act(self, do: str, **values: Any) -> Mapping[str, Any]:
        """Do something to it. Raises LabError."""

    def save(self, path: Path) -> Sequence[str]:
        """Write a scenario file that does it all again; returns what it cannot say. Raises LabError."""

    def shell(self, node: str) -> None:
        """A shell in a node, on this terminal."""

    def judge(self) -> Verdict:
        """The verdict, once the scenario has come to its end."""

    def close(self) -> None:
        """End it."""


class LabSession:
    """A real lab of this process."""

    def __init__(self, lab: Lab, shown: Callable[[Lab], AbstractContextManager[object]] = nullcontext) -> None:
        """``shown``: how else the lab is shown, from its start to its end."""
        self.lab = lab
        self._shown, self._scope = shown, ExitStack()
        self._feed: Feed | None = None
        self._interrupted = False
        self.files: list[tuple[str, Path]] = [("capture", lab.capture)]

    @property
    def title(self) -> str:
        """The scenario's name."""
        return self.lab.scenario.name

    @property
    def carriers(self) -> dict[str, str]:
        """Who carries each node that can be deployed."""
        nodes = self.lab.scenario.nodes
        return {name: node.carried_by for name, node in nodes.items() if node.carried_by is not None}

    def start(self) -> None:
        """Bring it up and let its scenario begin."""
        self.lab.start()
        self._scope.enter_context(self._shown(self.lab))
        self._feed = self.lab.feed()
        self.lab.begin()

    def metadata(self) -> dict[str, str]:
        """The run's metadata, as known by now."""
        return self._feed.metadata if self._feed is not None else {}

    def records(self) -> list[Record]:
        """What has been recorded since the last call."""
        feed, found = self._feed, list[Record]()
        while feed is not None and len(found) < _MOST_MESSAGES and (messages := feed.receive()):
            found += [record for record in map(feed.decode, messages) if record is not None]
        return found

    def status(self) -> dict[str, Any]:
        """What the supervisor says."""
        return self.lab.status()

    def act(self, do: str, **values: Any) -> dict[str, Any]:
        """Do something to it."""
        reply = self.lab.act(do, **values)
        self._interrupted |= do == "record"
        if do == "record" and values.get("file"):
            self.files.append(("capture", Path(values["file"])))
        return reply

    def save(self, path: Path) -> tuple[str, ...]:
        """Write a scenario file that does it all again."""
        left_out = self.lab.save(path)
        self.files.append(("scenario", path))
        return left_out

    def shell(self, node: str) -> None:
        """A shell in a node, on this terminal; returns at its end."""
        env = {key: os.environ[key] for key in ("TERM", "LANG", "COLORTERM", "LC_ALL") if key in os.environ}
        argv = [os.environ.get("SHELL") or "/bin/sh"]
        exec_with_terminal(self.lab.connect(), exec_request(node, argv, env))

    def judge(self) -> Verdict:
        """The verdict, once the scenario has come to its end."""
        try:
            result = self.lab.finish()
        except NetlabError as error:
            return Verdict(str(error), str(error))
        remark = f"the recording was interrupted: this is what {self.lab.capture.name} holds"
        remarks = [remark] if self._interrupted else []
        brief, report = ("\n\n".join(filter(None, [text, *remarks])) for text in (result.brief(), result.report()))
        return Verdict(brief or "nothing was expected, and nothing went wrong", report)

    def close(self) -> None:
        """End it."""
        if self._feed is not None:
            self._feed.close()
        self._scope.close()
        self.lab.close()
