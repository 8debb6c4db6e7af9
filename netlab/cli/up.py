"""`netlab up`: a lab in the background; and the options that every command shares which reads a scenario."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

import netlab
from netlab.cli.progress import Steps
from netlab.lab.launch import LaunchOptions, launch, make_room
from netlab.scenario import load_scenario

scenario_options = [
    click.option("--engine", type=click.Choice(["auto", "air", "netem"]), help="Overrides the scenario's engine."),
    click.option("--seed", type=int, help="Overrides the scenario's seed."),
    click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Overrides a key; dotted path."),
]


def with_scenario_options(command: Any) -> Any:
    """Add the options that `up`, `run` and `lab` share."""
    for option in reversed(scenario_options):
        command = option(command)
    return command


@click.command()
@click.argument("file", type=click.Path(path_type=Path))
@with_scenario_options
@click.option("--capture", type=click.Path(path_type=Path, dir_okay=False), help="Record to this MCAP file.")
def up(file: Path, engine: str | None, seed: int | None, overrides: tuple[str, ...], capture: Path | None) -> None:
    """Start FILE's nodes, links and processes in the background; its traffic and events are left to `netlab run`."""
    scenario = load_scenario(file, overrides=overrides, seed=seed, engine=engine)
    if capture is not None:
        make_room(capture)
    options = LaunchOptions(
        engine=engine or str(scenario.engine),
        scenario_text=file.read_text(),
        overrides=overrides,
        capture=capture.resolve() if capture else None,
        background=True,
        keep_visible=(Path(netlab.__file__).parent.parent, Path.cwd()),
    )
    with Steps() as steps:
        lab = launch(scenario, options, on_stage=steps.begin)
    click.echo(lab.folder.name)
