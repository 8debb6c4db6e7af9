"""`Lab`: a running scenario as one object, for tests, scripts and the commands.

with Lab("topologies/pair.yaml") as lab:
    assert lab.exec("robot1", "ping", "-c1", "base").returncode == 0
    result = lab.run()
    assert result.passed, result.report()
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import yaml

import netlab
from netlab.errors import LabError
from netlab.lab.commands import exec_request, run_command, start_command
from netlab.lab.control import ControlClient
from netlab.lab.launch import LabProcess, LaunchOptions, OnStage, launch, make_room
from netlab.lab.nursery import Nursery
from netlab.lab.results import RunResult, evaluate_run
from netlab.lab.saving import Original, read_journal, save
from netlab.live.feed import Feed, follow
from netlab.scenario import load_scenario, parse_scenario
from netlab.scenario.model import Scenario

Progress = Callable[[dict[str, Any]], None]
PROGRESS_INTERVAL_S = 0.5


class Lab:
    """One lab, from start to close. Use it as a context manager; leaving it leaves nothing behind."""

    def __init__(
        self,
        scenario: Scenario | Mapping[str, Any] | str | Path,
        *,
        engine: str | None = None,
        seed: int | None = None,
        overrides: Sequence[str] = (),
        capture: Path | str | None = None,
        packets: bool = True,
        nursery: Nursery | None = None,
    ) -> None:
        """Read and check the scenario; nothing is started yet.

        Args:
            scenario: A loaded scenario, a mapping with a scenario file's keys, or a file's path.
            engine: ``air``, ``netem`` or ``auto``; the scenario's own choice if None.
            seed: Replaces the scenario's seed.
            overrides: ``key.path=value`` as in ``netlab run --set``.
            capture: Where to keep the capture (MCAP). A temporary file, removed on close, if None.
            packets: Record packets and radio verdicts too, not only what applications and daemons report.
            nursery: Makes the start quicker for whoever starts many labs.

        Raises:
            ScenarioError: With every problem at once.
        """
        self._text = ""
        if isinstance(scenario, Scenario):
            self.scenario = scenario
        elif isinstance(scenario, Mapping):
            self.scenario = parse_scenario(dict(scenario), overrides=overrides, seed=seed, engine=engine)
            self._text = yaml.safe_dump(dict(scenario), sort_keys=False)
        else:
            self.scenario = load_scenario(Path(scenario), overrides=overrides, seed=seed, engine=engine)
            self._text = Path(scenario).read_text()
        given = {"seed": seed, "engine": engine}
        others = {key: value for key, value in given.items() if value is not None}
        self._original = Original(self._text, tuple(overrides), others)
        self._engine = engine or self.scenario.engine
        self._kept = Path(capture).resolve() if capture is not None else None
        self._scratch: Path | None = None
        self._packets = packets
        self._nursery = nursery
        self._process: LabProcess | None = None

    # -- life -----------------------------------------------------------------------------------------------------

    def start(self, on_stage: OnStage = lambda what: None) -> Lab:
        """Bring the lab up; returns when every process has reported ready. ``on_stage`` hears how far it is.

        Raises:
            MachineError: This machine cannot run it.
            LabError: A process could not start.
            CaptureError: The capture's folder cannot be made.
        """
        if self._process is not None:
            raise LabError("this lab has been started already")
        if self._kept is not None:
            make_room(self._kept)
        else:
            self._scratch = Path(tempfile.mkdtemp(prefix="netlab-"))
        keep = (Path(netlab.__file__).parent.parent, Path.cwd(), self.capture.parent)
        options = LaunchOptions(
            engine=self._engine,
            scenario_text=self._text,
            overrides=self._original.overrides,
            capture=self.capture,
            packets=self._packets,
            keep_visible=keep,
        )
        try:
            self._process = launch(self.scenario, options, self._nursery, on_stage)
        except BaseException:
            self.close()  # a temporary capture must not stay
            raise
        return self

    def close(self) -> None:
        """End everything; a temporary capture is removed."""
        if self._process is not None:
            self._process.stop()
            self._process = None
        if self._scratch is not None:
            shutil.rmtree(self._scratch, ignore_errors=True)
            self._scratch = None

    def __enter__(self) -> Lab:
        return self if self._process is not None else self.start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    @property
    def capture(self) -> Path:
        """The capture's file; complete after :meth:`finish`."""
        if self._kept is not None:
            return self._kept
        if self._scratch is None:
            raise LabError("the lab has not been started")
        return self._scratch / "capture.mcap"

    @property
    def name(self) -> str:
        """The lab's unique name, as in ``netlab ls``."""
        return self._running.folder.name

    @property
    def supervisor_pid(self) -> int:
        """Process id (on the host) whose end is the lab's end."""
        return self._running.pid

    def record_packets(self, wanted: bool) -> None:
        """Choose before the start whether packets and radio verdicts are recorded too."""
        self._packets = wanted

    # -- the scenario ---------------------------------------------------------------------------------------------

    def run(self, progress: Progress | None = None) -> RunResult:
        """Run the scenario from t = 0 to its end and judge it."""
        self.begin()
        return self.finish(progress)

    def begin(self) -> None:
        """Start the scenario's clock (t = 0): traffic and events begin. Returns when t = 0 is set."""
        self._request({"do": "run"}, timeout_s=30.0)

    def wait_until(self, at_s: float) -> None:
        """Return when scenario time ``at_s`` has come."""
        self._request({"do": "wait", "at_s": at_s}, timeout_s=at_s + 30.0)

    def finish(self, progress: Progress | None = None) -> RunResult:
        """Wait for the scenario's end (duration and one second of drain), close the capture, judge it."""
        duration_s = self.scenario.duration_s
        if progress is None:
            final = self._request({"do": "wait", "phase": "finished"}, timeout_s=duration_s + 60.0)
        else:
            deadline = time.monotonic() + duration_s + 60.0
            while (final := self.status())["phase"] != "finished":
                if time.monotonic() > deadline:
                    raise LabError("the scenario did not end in time")
                progress(final)
                time.sleep(PROGRESS_INTERVAL_S)
            progress(final)
        return evaluate_run(self.scenario, final, self.capture, kept=self._kept is not None)

    # -- acting on it ---------------------------------------------------------------------------------------------

    def status(self) -> dict[str, Any]:
        """Phase, scenario time, processes, links and streams as plain values."""
        return self._request({"do": "status"})

    def feed(self, *, packets: bool = False) -> Feed:
        """What the lab records, as it is recorded; close it when done. ``packets``: with packets and verdicts.

        Raises:
            LabError: The lab is not running any more, or its capture is finished.
        """
        return follow(self._running.folder, packets=packets)

    def connect(self) -> ControlClient:
        """A control connection of one's own, for what a request with descriptors needs; close it when done."""
        return self._running.connect()

    def exec(
        self, node: str, *argv: str, timeout_s: float = 30.0, env: Mapping[str, str] | None = None, text: str = ""
    ) -> subprocess.CompletedProcess[str]:
        """Run a command in a node to its end; ``text`` is its standard input.

        Raises:
            LabError: Unknown node or program.
            subprocess.TimeoutExpired: It did not end in time (it is ended then).
        """
        connection = self._running.connect()
        return run_command(connection, exec_request(node, argv, env), timeout_s=timeout_s, text=text)

    def spawn(self, node: str, *argv: str, env: Mapping[str, str] | None = None) -> ControlClient:
        """Start a command in a node and leave it running, its output thrown away.

        Closing the returned connection ends it; ``next_reply()`` on it waits for ``{"exit": status}``.

        Raises:
            LabError: Unknown node or program.
        """
        connection = self._running.connect()
        start_command(connection, exec_request(node, argv, env))
        return connection

    def outage(self, a: str, b: str, *, active: bool, one_way: bool = False) -> None:
        """Lose everything between two nodes silently (the carrier stays up), or end that."""
        self._request({"do": "outage", "between": [a, b], "active": active, "one_way": one_way})

    def carrier(self, a: str, b: str, *, up: bool) -> None:
        """Pull or plug the cable between two nodes (on a radio: as an outage)."""
        self._request({"do": "carrier", "between": [a, b], "up": up})

    def link(self, a: str, b: str, *, one_way: bool = False, **words: str) -> None:
        """Change a link's impairments, in a scenario file's words: ``lab.link("a", "b", loss="5%", delay="20ms")``."""
        self._request({"do": "link", "between": [a, b], "words": words, "one_way": one_way})

    def move(self, node: str, x_m: float, y_m: float, *, speed_mps: float | None = None) -> None:
        """Put a node elsewhere, or send it there; it leaves its own motion.

        Raises:
            LabError: Unknown node, it is still carried, or the place lies in the rock.
        """
        self._request({"do": "move", "node": node, "to": [x_m, y_m], "speed_mps": speed_mps})

    def kill(self, node: str, process: str) -> None:
        """SIGKILL a process of a node."""
        self._request({"do": "kill", "node": node, "process": process})

    def restart(self, node: str, process: str) -> None:
        """Start a process again; returns when it has reported ready."""
        self._request({"do": "start", "node": node, "process": process})

    def act(self, do: str, **values: Any) -> dict[str, Any]:
        """Do something to the lab that :mod:`netlab.lab.acts` knows, recorded with its inverse: ``act("undo")``.

        Raises:
            LabError: It cannot be done.
        """
        return self._request({"do": do, **values})

    def save(self, path: Path | str) -> tuple[str, ...]:
        """Write a scenario file that does again all that was done to this lab so far; returns what it cannot say.

        Raises:
            LabError: The file cannot be written.
            ScenarioError: It does not load, as it names files that are not beside it.
        """
        if not self._text:
            raise LabError("this lab was started from a scenario without a text; start it from a file or a mapping")
        rows = read_journal(self._running.folder.journal)
        end_s = max(0.0, self.status()["t_s"] or 0.0)
        return save(Path(path), self._original, rows, duration_s=self.scenario.duration_s, end_s=end_s)

    def log(self, node: str, process: str) -> str:
        """All output of a process so far."""
        path = self._running.folder.logs / node / f"{process}.log"
        return path.read_text(errors="replace") if path.exists() else ""

    @property
    def _running(self) -> LabProcess:
        if self._process is None:
            raise LabError("the lab is not running")
        return self._process

    def _request(self, request: dict[str, Any], *, timeout_s: float = 30.0) -> dict[str, Any]:
        connection = self._running.connect()
        try:
            return connection.request(request, timeout_s=timeout_s)
        finally:
            connection.close()
