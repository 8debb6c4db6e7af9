"""The side on the host: stands in for the tests that run in a box, and reports what is heard of them."""

from __future__ import annotations

import builtins
import contextlib
import os
import shutil
import sys
import tempfile
import warnings
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest

from netlab.pytest_virtual import selection
from netlab.pytest_virtual.boxes import Boxes, Order
from netlab.vm.request import Clock, clean_environment

_NOT_FOR_THE_BOX = {"--pdb", "--trace"}
_FOLDER_OPTION = "--basetemp"
_WORKER_VARIABLES = ("PYTEST_XDIST", "PYTEST_CURRENT_TEST")
_SHARED = "netlab_shared_folder"
_ARGUMENTS = "netlab_arguments"


class TestLostError(Exception):
    """Nothing came from the box; the text says why."""

    __test__ = False


class BoxedItem(pytest.Item):
    """Stands for a test whose fixtures and body run in a box: each phase waits for the report from there."""

    fixturenames: tuple[str, ...] = ()

    def __init__(self, *, boxed: pytest.Item, outside: Outside, **arguments: Any) -> None:
        super().__init__(**arguments)
        self._boxed = boxed
        self._outside = outside
        self._reports: dict[str, pytest.TestReport] = {}
        self.funcargs: dict[str, object] = {}  # other plugins look for it in every item
        self.keywords.update(boxed.keywords)

    def setup(self) -> None:
        """Wait until it is set up in the box."""
        self._await("setup")

    def runtest(self) -> None:
        """Wait until it has run in the box."""
        self._await("call")

    def teardown(self) -> None:
        """Wait until it is torn down in the box; where it is lost, that has been told."""
        with contextlib.suppress(TestLostError):
            self._await("teardown")

    def report(self, phase: str) -> pytest.TestReport | None:
        """The report of a phase from the box; None if there is none."""
        if phase not in self._reports and (report := self._outside.report(self.nodeid, phase)) is not None:
            self._reports[phase] = report
        return self._reports.get(phase)

    def reportinfo(self) -> tuple[os.PathLike[str] | str, int | None, str]:
        """Where the test stands."""
        return self._boxed.reportinfo()

    def _await(self, phase: str) -> None:
        if self.report(phase) is None:
            raise TestLostError(self._outside.boxes.why_lost(self.nodeid))


class Outside:
    """Registered as a plugin in a session that may have tests for a box."""

    def __init__(self, config: pytest.Config) -> None:
        self._config = config
        self._clock: str | None = config.getoption("--lab-clock")
        self._boxes: Boxes | None = None
        self._count = 0
        self._told: set[tuple[str, str]] = set()  # test and phase
        worker: dict[str, Any] = getattr(config, "workerinput", {})
        self._is_shared = bool(worker)
        self._worker_count = int(worker.get("workercount", 1))
        self._arguments: list[str] = worker.get(_ARGUMENTS, list(config.invocation_params.args))
        self._folder = Path(worker[_SHARED]) if worker else None

    @property
    def boxes(self) -> Boxes:
        """The boxes; there are tests for them."""
        assert self._boxes is not None
        return self._boxes

    @pytest.hookimpl(optionalhook=True)
    def pytest_configure_node(self, node: Any) -> None:
        """Tell a worker (xdist) where all of them share what comes from the boxes."""
        node.workerinput[_SHARED] = str(self._shared_folder())
        node.workerinput[_ARGUMENTS] = self._arguments

    @pytest.hookimpl(trylast=True)
    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        """Put stand-ins in the place of the tests for the box."""
        if self._config.option.collectonly:
            return
        wanted = [item for item in items if selection.clock_of(item, self._clock) is Clock.VIRTUAL]
        if not wanted:
            return
        obstacle = selection.obstacle() if self._clock != Clock.REAL.value else "--lab-clock=real was given"
        if obstacle is not None:
            for item in wanted:
                item.add_marker(pytest.mark.skip(reason=f"runs in virtual time only: {obstacle}"))
            return
        self._count = len(wanted)
        tests = {item.nodeid: item.path for item in wanted}
        self._boxes = Boxes(self._shared_folder(), tests, self._order(), worker_count=self._worker_count)
        boxed = set(wanted)
        items[:] = [self._stand_in(item) if item in boxed else item for item in items]

    def pytest_report_collectionfinish(self) -> list[str]:
        """Say what goes into boxes."""
        return [f"netlab: {self._count} tests run in a box, in virtual time"] if self._count else []

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_makereport(self, item: pytest.Item, call: pytest.CallInfo[None]) -> Generator[None, Any, Any]:
        """What the box reported, whatever the stand-in went through."""
        made = yield
        if not isinstance(item, BoxedItem):
            return made
        if call.excinfo is not None and call.excinfo.errisinstance(TestLostError):
            made.longrepr = str(call.excinfo.value)  # the text alone; our insides would bury it
            return made
        undisturbed = call.excinfo is None or call.excinfo.errisinstance(pytest.skip.Exception)
        return (item.report(call.when) if undisturbed else None) or made

    def report(self, test: str, phase: str) -> pytest.TestReport | None:
        """Wait for the report of a phase; None if the test is lost."""
        data = self.boxes.await_report(test, phase)
        if data is None:
            return None
        if phase == "teardown":
            self._bring_captures(test)
        report = self._config.hook.pytest_report_from_serializable(config=self._config, data=_with_tuples(data))
        assert isinstance(report, pytest.TestReport)
        return report

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Remember what has been told."""
        self._told.add((report.nodeid, report.when))

    def pytest_sessionfinish(self, session: pytest.Session, exitstatus: int) -> None:
        """End the boxes now: after this, a worker (xdist) may be interrupted at any moment.

        Other workers may still wait for a box of this one, unless the session was cut short.
        """
        if self._boxes is not None:
            interrupted = exitstatus == pytest.ExitCode.INTERRUPTED
            cut_short = session.shouldstop or session.shouldfail or interrupted
            try:
                if interrupted and not self._is_shared:
                    self._tell_finished()
                if self._is_shared and not cut_short:
                    self._boxes.finish()
                self._show_warnings()
            finally:
                self._boxes.close()

    def pytest_unconfigure(self) -> None:
        """Leave nothing."""
        if self._folder is not None and not self._is_shared:
            shutil.rmtree(self._folder, ignore_errors=True)

    def _stand_in(self, item: pytest.Item) -> BoxedItem:
        assert item.parent is not None
        made: BoxedItem = BoxedItem.from_parent(
            item.parent, name=item.name, nodeid=item.nodeid, boxed=item, outside=self
        )
        return made

    def _shared_folder(self) -> Path:
        if self._folder is None:
            self._folder = Path(tempfile.mkdtemp(prefix="netlab-pytest-")).resolve()
        return self._folder

    def _order(self) -> Order:
        arguments = _for_the_box(self._arguments)
        if self._config.pluginmanager.hasplugin("xdist"):
            arguments += ["-n0"]
        env = {name: value for name, value in os.environ.items() if not name.startswith(_WORKER_VARIABLES)}
        extra = {
            name: value if equals else os.environ.get(name, "")
            for name, equals, value in (word.partition("=") for word in self._config.getoption("--lab-env"))
        }
        return Order(
            argv=(sys.executable, "-m", "pytest", *arguments),
            cwd=self._config.invocation_params.dir,
            env=clean_environment(env, extra=extra),
            patience_s=self._config.getoption("--lab-patience"),
            echo=sys.stdout.buffer if self._config.option.capture == "no" else None,
        )

    def _tell_finished(self) -> None:
        """A box runs ahead of this session: what it has finished is not lost by an interrupt."""
        for test, phase in self.boxes.finished():
            if (test, phase) not in self._told and (report := self.report(test, phase)) is not None:
                self._config.hook.pytest_runtest_logreport(report=report)

    def _bring_captures(self, test: str) -> None:
        """Put the captures where the report says that they are."""
        for capture in self.boxes.captures(test):
            directory = Path(str(self._config.getoption("--lab-captures"))).resolve()
            directory.mkdir(parents=True, exist_ok=True)
            shutil.move(capture, directory / capture.name)

    def _show_warnings(self) -> None:
        for row in self.boxes.warnings():
            category = getattr(builtins, row["category"], UserWarning)
            message = warnings.WarningMessage(row["text"], category, row["filename"], row["lineno"])
            self._config.hook.pytest_warning_recorded.call_historic(
                kwargs={"warning_message": message, "when": "runtest", "nodeid": row["test"], "location": None}
            )


def _for_the_box(arguments: list[str]) -> list[str]:
    """The session's arguments without what has no meaning in a box, which has temporary folders of its own."""
    words = iter(arguments)
    kept = []
    for word in words:
        if word == _FOLDER_OPTION:
            next(words, None)
        elif word not in _NOT_FOR_THE_BOX and not word.startswith(f"{_FOLDER_OPTION}="):
            kept.append(word)
    return kept


def _with_tuples(data: dict[str, Any]) -> dict[str, Any]:
    """What JSON made lists of and pytest takes apart as tuples."""
    longrepr = data["longrepr"]
    pairs = {name: [tuple(pair) for pair in data[name]] for name in ("sections", "user_properties")}
    return {
        **data,
        **pairs,
        "location": tuple(data["location"]),
        "longrepr": tuple(longrepr) if isinstance(longrepr, list) else longrepr,
    }


def refuse_what_cannot_be(config: pytest.Config) -> None:
    """``--lab-clock=virtual`` was asked for by name: a machine that cannot do it is told before anything runs.

    Raises:
        pytest.UsageError: With the way out.
    """
    if config.getoption("--lab-clock") == Clock.VIRTUAL.value and not hasattr(config, "workerinput"):
        problem = selection.obstacle()
        if problem is not None:
            raise pytest.UsageError(f"--lab-clock=virtual: {problem}")
