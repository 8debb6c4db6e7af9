"""`netlab lab`: the interactive lab on a terminal; elsewhere a scenario from start to end with lines of progress."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from pathlib import Path

import click

from netlab.cli.run import run_with_status
from netlab.cli.up import with_scenario_options
from netlab.errors import LabError
from netlab.lab.facade import Lab

DEFAULT_SCENARIO = Path("topologies/default.yaml")


@click.command()
@click.argument("file", type=click.Path(path_type=Path), required=False)
@with_scenario_options
@click.option("--capture", type=click.Path(path_type=Path, dir_okay=False), help="Keep the capture (MCAP) here.")
@click.option("--plain", is_flag=True, help="Lines of progress and the verdict, as without a terminal.")
def lab(
    file: Path | None,
    engine: str | None,
    seed: int | None,
    overrides: tuple[str, ...],
    capture: Path | None,
    plain: bool,
) -> None:
    """Run FILE on a live screen: look at it, cut and degrade links, move robots, kill programs (keys: ?).

    Without FILE choose one of topologies/. Without a terminal: lines of progress, the verdict, and its exit code.
    """

    def kept(scenario: Path) -> Path:
        return capture or Path("captures") / f"{scenario.stem}.mcap"

    def make(scenario: Path) -> Lab:
        return Lab(scenario, engine=engine, seed=seed, overrides=overrides, capture=kept(scenario))

    if plain or not _has_screen():
        file = file or DEFAULT_SCENARIO
        result = run_with_status(make(file))
        click.echo(result.report())
        click.echo(f"capture: {kept(file)}  (netlab inspect {kept(file)})")
        sys.exit(result.exit_code)
    _on_screen(make, file)


def _has_screen() -> bool:
    return sys.stdin.isatty() and sys.stdout.isatty() and os.environ.get("TERM", "dumb") != "dumb"


def _on_screen(make: Callable[[Path], Lab], file: Path | None) -> None:
    from netlab.tui.app import LabApp  # Textual, which all other commands do without
    from netlab.tui.chooser import topologies
    from netlab.tui.session import LabSession

    choices = [] if file is not None else topologies(DEFAULT_SCENARIO.parent)
    if file is None and not choices:
        raise LabError("there is no topologies/ here to choose from; name a scenario: netlab lab FILE")
    first = make(file) if file is not None else None  # a mistake in it shows before the screen does
    app = LabApp(lambda path: LabSession(first or make(path)), file, choices=choices)
    try:
        error = app.run()
    finally:
        if app.session is not None:
            app.session.close()
    if error is not None:
        raise error
    if app.session is not None:
        click.echo(app.farewell())
    sys.exit(app.return_code or 0)
