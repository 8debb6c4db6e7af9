"""The side in the box: run the tests that the outside wants, and write down every report as it comes."""

from __future__ import annotations

import json
import shutil
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from netlab.pytest_virtual.records import CAPTURES, WANTED, append


class Inside:
    """Registered as a plugin in the session inside."""

    def __init__(self, config: pytest.Config, folder: Path) -> None:
        self._config = config
        self._folder = folder
        wanted = json.loads((folder / WANTED).read_text())
        self._wanted: list[str] = wanted["tests"]
        self._trouble: list[str] = []
        # The command line was the outside's, for its options and conftests; what to collect is known better here.
        config.args = wanted["files"]

    @pytest.hookimpl(tryfirst=True)
    def pytest_sessionstart(self, session: pytest.Session) -> None:
        """The outside shows the results; here nobody looks."""
        session.config.pluginmanager.unregister(name="terminalreporter")

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Keep what is wanted, in the outside's order."""
        found = {item.nodeid: item for item in items}
        for test in self._wanted:
            if test not in found:
                why = "\n".join(["it was not collected in the box", *self._trouble])
                append(self._folder, {"event": "lost", "test": test, "why": why})
        items[:] = [found[test] for test in self._wanted if test in found]

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        """A module that cannot be imported in the box."""
        if report.failed:
            self._trouble.append(f"{report.nodeid}: {report.longreprtext}")
            append(self._folder, {"event": "trouble", "text": self._trouble[-1]})

    def pytest_runtest_logstart(self, nodeid: str) -> None:
        """Named before it begins, so that a box that breaks down is blamed on the right one."""
        append(self._folder, {"event": "start", "test": nodeid})

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """One phase of one test."""
        data = self._config.hook.pytest_report_to_serializable(config=self._config, report=report)
        append(self._folder, {"event": "report", "test": report.nodeid, "report": data})

    def pytest_runtest_logfinish(self, nodeid: str) -> None:
        """All its phases are over."""
        append(self._folder, {"event": "finish", "test": nodeid})

    def pytest_warning_recorded(
        self, warning_message: warnings.WarningMessage, when: str, nodeid: str, location: Sequence[Any] | None
    ) -> None:
        """Shown by the outside, once."""
        if when == "runtest":
            record = {
                "text": str(warning_message.message),
                "category": warning_message.category.__name__,
                "filename": warning_message.filename,
                "lineno": warning_message.lineno,
            }
            append(self._folder, {"event": "warning", "test": nodeid, **record})

    def keep_capture(self, test: str, capture: Path, name: str) -> None:
        """Carry the capture of a failed test out; the outside puts it in its place."""
        folder = self._folder / CAPTURES
        folder.mkdir(exist_ok=True)
        shutil.copyfile(capture, folder / name)
        append(self._folder, {"event": "capture", "test": test, "name": name})
