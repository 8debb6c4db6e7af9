"""`netlab run`: a scenario from start to end, with progress on stderr and the verdict on stdout."""

from __future__ import annotations

import json
import signal
import sys
from pathlib import Path

import click

from netlab.cli.foxglove import announce, shown, with_foxglove
from netlab.cli.progress import Steps
from netlab.cli.status import Status
from netlab.cli.up import with_scenario_options
from netlab.lab.facade import Lab
from netlab.lab.results import RunResult, needs_packets
from netlab.live.foxglove import require_foxglove
from netlab.report.build import STEPS, require_plots, write_report
from netlab.scenario import load_scenario


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
@with_scenario_options
@click.option("--in", "where", type=click.Choice(["host", "vm"]), default="host", help="Where to run it.")
@click.option("--clock", type=click.Choice(["real", "virtual"]), default="real", help="By which clock.")
@click.option("--timeout", "timeout_s", type=float, default=1800.0, show_default=True, help="Of --in vm, host seconds.")
@click.option("--capture", type=click.Path(path_type=Path, dir_okay=False), help="Keep the capture (MCAP) here.")
@click.option(
    "--report",
    type=click.Path(path_type=Path, file_okay=False),
    help="Write an HTML report to this folder, and the capture too unless --capture says where.",
)
@with_foxglove
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object on stdout.")
def run(
    file: Path,
    engine: str | None,
    seed: int | None,
    overrides: tuple[str, ...],
    where: str,
    clock: str,
    timeout_s: float,
    capture: Path | None,
    report: Path | None,
    foxglove_port: int | None,
    as_json: bool,
) -> None:
    """Run FILE to its end and evaluate its expectations.

    Exit code: 0 met, 1 not met, 2 bad scenario or machine, or a run that broke and cannot be judged.
    """
    if report is not None:
        require_plots()  # before minutes are spent
        capture = capture or report / "capture.mcap"
    if clock == "virtual" and where != "vm":
        raise click.UsageError("the host's clock cannot be virtual; add --in vm")
    if foxglove_port is not None:
        if where == "vm":
            raise click.UsageError("nothing outside can look into a lab in a vm while it runs; leave out --foxglove")
        require_foxglove()
    if where == "vm":
        from netlab.cli.in_box import run_scenario_in_box  # a run on the host need not load it

        load_scenario(file, overrides=overrides, seed=seed, engine=engine)  # a mistake shows before a kernel boots
        words = _words(engine=engine, seed=seed, overrides=overrides, as_json=as_json)
        status = run_scenario_in_box(file, words, clock=clock, capture=capture, timeout_s=timeout_s)
        _write_report(capture, report)
        sys.exit(status)
    lab = Lab(file, engine=engine, seed=seed, overrides=overrides, capture=capture)
    lab.record_packets(capture is not None or foxglove_port is not None or needs_packets(lab.scenario))
    result = run_with_status(lab, foxglove_port)
    if as_json:
        click.echo(json.dumps(result.summary, indent=2))
        if complaints := result.complaints():
            click.echo(complaints, err=True)
    else:
        click.echo(result.report())
    _write_report(capture, report)
    sys.exit(result.exit_code)


def _write_report(capture: Path | None, directory: Path | None) -> None:
    if directory is not None and capture is not None and capture.exists():  # a run that could not begin has none
        with Steps(STEPS) as steps:
            page = write_report(capture, directory, on_step=steps.begin, on_read=steps.within)
        click.echo(f"report: {page}", err=True)


def _words(*, engine: str | None, seed: int | None, overrides: tuple[str, ...], as_json: bool) -> list[str]:
    """The same options again, for the command inside the box."""
    words = [word for override in overrides for word in ("--set", override)]
    words += ["--engine", engine] if engine is not None else []
    words += ["--seed", str(seed)] if seed is not None else []
    return words + (["--json"] if as_json else [])


def run_with_status(lab: Lab, foxglove_port: int | None = None) -> RunResult:
    """Run a lab to its end with its status on stderr; Ctrl-C and SIGTERM take it down in good order."""
    status = Status(lab.scenario, sys.stderr)
    for signum in (signal.SIGTERM, signal.SIGHUP):  # as Ctrl-C: the lab and its temporary capture go in good order
        signal.signal(signum, signal.default_int_handler)
    try:
        with Steps() as steps:
            lab.start(steps.begin)
        with lab, shown(lab, foxglove_port) as server, status:
            if server is not None:
                announce(server)
            status.ready(lab.name, lab.status())
            return lab.run(status.update)
    except KeyboardInterrupt:
        click.echo("interrupted; the lab has been taken down", err=True)
        raise click.Abort from None
