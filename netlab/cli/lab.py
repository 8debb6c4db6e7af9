"""`netlab lab`: the interactive lab on a terminal or in a browser; elsewhere lines of progress and the verdict."""

from __future__ import annotations

import contextlib
import importlib.util
import os
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import click

from netlab.cli.foxglove import shown, with_foxglove
from netlab.cli.run import run_with_status
from netlab.cli.up import with_scenario_options
from netlab.errors import LabError, MachineError
from netlab.lab.facade import Lab
from netlab.live.foxglove import require_foxglove

if TYPE_CHECKING:
    from netlab.tui.chooser import Topology

DEFAULT_SCENARIO = Path("topologies/default.yaml")
_WEB_DRIVER = "textual.drivers.web_driver:WebDriver"  # how textual-serve says that the screen is a browser


@click.command()
@click.argument("file", type=click.Path(path_type=Path), required=False)
@with_scenario_options
@click.option("--capture", type=click.Path(path_type=Path, dir_okay=False), help="Keep the capture (MCAP) here.")
@with_foxglove
@click.option("--plain", is_flag=True, help="Lines of progress and the verdict, as without a terminal.")
@click.option(
    "--web",
    type=click.IntRange(0, 65535),
    is_flag=False,
    flag_value=0,
    metavar="[PORT]",
    help="The screen in a browser of this machine; any free port unless you name one.",
)
def lab(
    file: Path | None,
    engine: str | None,
    seed: int | None,
    overrides: tuple[str, ...],
    capture: Path | None,
    foxglove_port: int | None,
    plain: bool,
    web: int | None,
) -> None:
    """Run FILE on a live screen: look at it, cut and degrade links, move robots, kill programs (keys: ?).

    Without FILE choose one of topologies/. Without a terminal: lines of progress, the verdict, and its exit code.
    """

    def kept(scenario: Path) -> Path:
        return capture or Path("captures") / f"{scenario.stem}.mcap"

    def make(scenario: Path) -> Lab:
        return Lab(scenario, engine=engine, seed=seed, overrides=overrides, capture=kept(scenario))

    if plain and web is not None:
        raise click.UsageError("--plain has no screen that --web could show; leave one of them out")
    if foxglove_port is not None:
        require_foxglove()
    if web is not None:
        options = {"--engine": engine, "--seed": seed, "--capture": capture, "--foxglove": foxglove_port}
        given = [word for name, value in options.items() if value is not None for word in (name, str(value))]
        given += [word for override in overrides for word in ("--set", override)]
        _in_browser(make, file, given, port=web)
        return
    if plain or not _has_screen():
        file = file or DEFAULT_SCENARIO
        result = run_with_status(make(file), foxglove_port)
        click.echo(result.report())
        click.echo(f"capture: {kept(file)}  (netlab inspect {kept(file)})")
        sys.exit(result.exit_code)
    _on_screen(make, file, foxglove_port)


def _has_screen() -> bool:
    return _is_web() or (sys.stdin.isatty() and sys.stdout.isatty() and os.environ.get("TERM", "dumb") != "dumb")


def _is_web() -> bool:
    return os.environ.get("TEXTUAL_DRIVER") == _WEB_DRIVER


def _in_browser(make: Callable[[Path], Lab], file: Path | None, options: list[str], *, port: int) -> None:
    if importlib.util.find_spec("textual_serve") is None:
        raise MachineError("the lab in a browser needs textual-serve; install it: pip install 'udp-mesh-lab[web]'")
    from netlab.tui.web import serve

    if file is not None:
        make(file)  # a mistake in it shows here, not in the browser
    else:
        _choices()
    argv = [sys.executable, "-m", "netlab", "lab", *options, *([] if file is None else ["--", str(file)])]
    serve(argv, port, announce=lambda url: click.echo(f"open {url}\nThe address works once. Ctrl-C ends."))


def _choices() -> list[Topology]:
    from netlab.tui.chooser import topologies

    choices = topologies(DEFAULT_SCENARIO.parent)
    if not choices:
        raise LabError("there is no topologies/ here to choose from; name a scenario: netlab lab FILE")
    return choices


def _on_screen(make: Callable[[Path], Lab], file: Path | None, foxglove_port: int | None) -> None:
    from netlab.tui.app import LabApp  # Textual, which all other commands do without
    from netlab.tui.session import LabSession

    choices = [] if file is not None else _choices()
    first = make(file) if file is not None else None  # a mistake in it shows before the screen does

    @contextlib.contextmanager
    def to_foxglove(lab: Lab) -> Iterator[None]:
        with shown(lab, foxglove_port) as server:
            if server is not None:
                app.notify(f'{server.url}  ("Open connection"; this machine only)', title="Foxglove", timeout=20)
            yield

    app = LabApp(lambda path: LabSession(first or make(path), to_foxglove), file, choices=choices)
    try:
        error = app.run()
    finally:
        if app.session is not None:
            app.session.close()
    if error is not None:
        raise error
    if app.session is not None:
        click.echo(app.farewell(), err=_is_web())  # there the standard output is the screen
    sys.exit(app.return_code or 0)
