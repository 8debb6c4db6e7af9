"""The pytest plugin: labs as fixtures.

    @pytest.mark.scenario("topologies/pair.yaml", overrides=["seed=3"])
    def test_they_talk(lab):
        result = lab.run()
        assert result.passed, result.report()

    def test_built_here(make_lab):
        lab = make_lab({"name": "two", "nodes": {"a": {}, "b": {}}, "links": [{"between": ["a", "b"], "delay": "5ms"}]})
        assert lab.exec("a", "ping", "-c1", "b").returncode == 0

The capture of a failed test is kept below ``captures/`` and named in the report; those of passing tests are removed.
Labs are independent of each other, so ``pytest -n auto`` runs them side by side.

``--lab-clock=virtual`` runs every test with a lab in a box, in virtual time; the marker ``lab_clock("virtual")`` does
so with any test, see docs/vm.md. ``--lab-engine`` names the engine of labs whose test names none.
"""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable, Generator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import pytest

from netlab.clock import clock_here
from netlab.errors import NetlabError
from netlab.lab.builder import ScenarioBuilder
from netlab.lab.facade import Lab
from netlab.lab.nursery import Nursery
from netlab.pytest_virtual import selection
from netlab.pytest_virtual.records import FOLDER_VARIABLE
from netlab.vm.fitness import INSIDE
from netlab.vm.request import Clock

if TYPE_CHECKING:
    from netlab.pytest_virtual.inside import Inside

_FAILED = pytest.StashKey[bool]()
_CAPTURES = pytest.StashKey[list[tuple[Path, Path]]]()  # where each is recorded, where it is kept if the test fails
_INSIDE: pytest.StashKey[Inside] = pytest.StashKey()  # in a box that the outside opened
_NURSERY = pytest.StashKey[Nursery]()
_MARKER_KEYS = {"engine", "seed", "overrides", "packets"}

ScenarioSource = str | Path | Mapping[str, Any] | ScenarioBuilder


class MakeLab(Protocol):
    """Start a lab from a file, a mapping or a builder; it ends with the test."""

    def __call__(
        self,
        scenario: ScenarioSource,
        *,
        engine: str | None = None,
        seed: int | None = None,
        overrides: list[str] | tuple[str, ...] = (),
        packets: bool = True,
    ) -> Lab: ...


def pytest_addoption(parser: pytest.Parser) -> None:
    """Options of lab tests."""
    group = parser.getgroup("netlab", "labs of netlab")
    group.addoption("--lab-captures", default="captures", metavar="DIR", help="captures of failed lab tests go here")
    engine = {"choices": ["air", "netem", "auto"], "help": "engine of every lab whose test does not name one"}
    try:
        group.addoption("--lab-engine", "--engine", dest="lab_engine", **engine)
    except ValueError:  # another plugin has the short name
        group.addoption("--lab-engine", dest="lab_engine", **engine)
    group.addoption(
        "--lab-clock",
        choices=selection.CLOCKS,
        help="virtual: tests with a lab run in a box, in virtual time; real: nothing does, and tests that are marked "
        "so are skipped; default: tests that are marked so, where this machine can",
    )
    group.addoption(
        "--lab-patience",
        type=float,
        default=300.0,
        metavar="SECONDS",
        help="the longest that one test in a box may take, by the host's clock (300)",
    )
    group.addoption(
        "--lab-env", action="append", default=[], metavar="NAME[=VALUE]", help="give tests in a box this variable too"
    )


def pytest_configure(config: pytest.Config) -> None:
    """Register the markers, and the side of the box on which this session is."""
    config.addinivalue_line(
        "markers", "scenario(source, *, engine, seed, overrides, packets): the scenario of the `lab` fixture"
    )
    config.addinivalue_line("markers", 'lab_clock(clock): "virtual" runs the test in a box, "real" never does')
    if folder := os.environ.pop(FOLDER_VARIABLE, None):  # not for a session that a test here starts
        from netlab.pytest_virtual.inside import Inside

        config.stash[_INSIDE] = Inside(config, Path(folder))
        config.pluginmanager.register(config.stash[_INSIDE], "netlab-inside")
    elif INSIDE not in os.environ:
        from netlab.pytest_virtual.outside import Outside, refuse_what_cannot_be

        refuse_what_cannot_be(config)
        config.pluginmanager.register(Outside(config), "netlab-outside")


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """In a box that somebody else opened: by its clock, or not at all."""
    if INSIDE in os.environ and clock_here() != Clock.VIRTUAL.value:
        for item in items:
            if selection.clock_of(item, config.getoption("--lab-clock")) is Clock.VIRTUAL:
                item.add_marker(pytest.mark.skip(reason="runs in virtual time only; this box runs in real time"))


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item, call: pytest.CallInfo[None]) -> Generator[None, Any, Any]:
    """Note a failure for the fixture's end, and name the captures in the report.

    A fixture's error that is meant for a person is shown as its text alone.
    """
    error = call.excinfo.value if call.excinfo is not None else None
    report = yield
    if report.failed and isinstance(error, NetlabError) and report.when == "setup":
        report.longrepr = str(error)
    if report.failed:
        item.stash[_FAILED] = True
        for capture, path in item.stash.get(_CAPTURES, []):
            if capture.exists():
                report.sections.append(("capture", f"kept as {path}; look into it with: netlab inspect {path}"))
    return report


@pytest.fixture
def make_lab(request: pytest.FixtureRequest, tmp_path: Path) -> Generator[MakeLab, None, None]:
    """Factory of labs; all of them end with the test."""
    labs: list[Lab] = []
    captures = request.node.stash.setdefault(_CAPTURES, [])
    config = request.config
    directory = Path(str(config.getoption("--lab-captures"))).resolve()
    stem = re.sub(r"[^\w.-]+", "_", request.node.nodeid).strip("_")[-150:]

    def make(
        scenario: ScenarioSource,
        *,
        engine: str | None = None,
        seed: int | None = None,
        overrides: list[str] | tuple[str, ...] = (),
        packets: bool = True,
    ) -> Lab:
        __tracebackhide__ = True
        capture = tmp_path / f"capture{len(labs)}.mcap"
        try:
            source = scenario.build() if isinstance(scenario, ScenarioBuilder) else scenario
            lab = Lab(
                source,
                engine=engine or config.option.lab_engine,
                seed=seed,
                overrides=overrides,
                capture=capture,
                packets=packets,
                nursery=_nursery(config),
            )
            labs.append(lab)
            captures.append((capture, directory / f"{stem}{len(labs) if len(labs) > 1 else ''}.mcap"))
            return lab.start()
        except NetlabError as error:
            raise error.with_traceback(None) from None  # the text says it all; the lab's insides would bury it

    yield make
    for lab in labs:
        lab.close()
    failed = request.node.stash.get(_FAILED, False)
    for capture, destination in captures:
        if failed and capture.exists():
            _keep(config, request.node.nodeid, capture, destination)
        capture.unlink(missing_ok=True)


def _nursery(config: pytest.Config) -> Nursery:
    """The session's, begun with its first lab."""
    if _NURSERY not in config.stash:
        nursery = config.stash[_NURSERY] = Nursery()
        config.add_cleanup(nursery.close)
    return config.stash[_NURSERY]


def _keep(config: pytest.Config, test: str, capture: Path, destination: Path) -> None:
    inside = config.stash.get(_INSIDE, None)
    if inside is not None:
        inside.keep_capture(test, capture, destination.name)
    else:
        destination.parent.mkdir(parents=True, exist_ok=True)
        shutil.move(capture, destination)


@pytest.fixture
def lab(request: pytest.FixtureRequest, make_lab: MakeLab) -> Lab:
    """The lab of the test's ``scenario`` marker, started and ready."""
    marker = request.node.get_closest_marker("scenario")
    if marker is None or len(marker.args) != 1:
        pytest.fail("the `lab` fixture needs @pytest.mark.scenario(FILE or mapping); or use `make_lab`", pytrace=False)
    if unknown := set(marker.kwargs) - _MARKER_KEYS:
        known = ", ".join(sorted(_MARKER_KEYS))
        pytest.fail(
            f"@pytest.mark.scenario does not know {', '.join(sorted(unknown))}; it takes {known}", pytrace=False
        )
    start: Callable[..., Lab] = make_lab
    return start(*marker.args, **marker.kwargs)
