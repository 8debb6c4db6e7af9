"""What a session in a box writes down, and how the outside reads it: one JSON object a line in the shared folder."""

from __future__ import annotations

import json
from collections import defaultdict
from pathlib import Path
from typing import Any

#: Set for the session inside: the shared folder.
FOLDER_VARIABLE = "NETLAB_PYTEST_FOLDER"

WANTED, RECORDS, CAPTURES = "wanted.json", "records", "captures"


def append(folder: Path, record: dict[str, Any]) -> None:
    """Add a record; whoever reads the file, on the host too, has it whole when this returns."""
    with (folder / RECORDS).open("ab", buffering=0) as stream:
        stream.write(json.dumps(record, default=str).encode() + b"\n")


class Records:
    """All that has been written so far about the tests of one folder.

    Attributes:
        reports: Test -> phase (setup, call, teardown) -> serialised report.
        finished: Tests that have come to their end inside.
        lost: Test -> why nothing more will be heard of it.
        captures: Test -> names of the captures that it left.
        running: The test that was begun last and has not finished.
        trouble: What the session inside said of collecting the tests.
    """

    def __init__(self, folder: Path) -> None:
        self._path = folder / RECORDS
        self._read_bytes = 0
        self.reports: dict[str, dict[str, dict[str, Any]]] = defaultdict(dict)
        self.finished: set[str] = set()
        self.lost: dict[str, str] = {}
        self.captures: dict[str, list[str]] = defaultdict(list)
        self.warnings: list[dict[str, Any]] = []
        self.running: str | None = None
        self.trouble: list[str] = []

    def refresh(self) -> None:
        """Take in what is new."""
        try:
            with self._path.open("rb") as stream:
                stream.seek(self._read_bytes)
                data = stream.read()
        except FileNotFoundError:
            return
        whole = data[: data.rfind(b"\n") + 1]  # the rest of the last line is under way
        self._read_bytes += len(whole)
        for line in whole.splitlines():
            self._take(json.loads(line))

    def last_heard_s(self) -> float:
        """When something was last written, by the host's wall clock; 0 if nothing was."""
        try:
            return self._path.stat().st_mtime
        except FileNotFoundError:
            return 0.0

    def settled(self, test: str) -> bool:
        """Whether nothing more will be heard of a test."""
        return test in self.finished or test in self.lost

    def _take(self, record: dict[str, Any]) -> None:
        test = record.get("test", "")
        match record["event"]:
            case "start":
                self.running = test
            case "report":
                self.reports[test][record["report"]["when"]] = record["report"]
            case "capture":
                self.captures[test].append(record["name"])
            case "finish":
                self.finished.add(test)
                self.running = None
            case "lost":
                self.lost.setdefault(test, record["why"])
                self.running = None
            case "warning":
                self.warnings.append(record)
            case "trouble":
                self.trouble.append(record["text"])
