"""`netlab check`: validate a scenario file and print every problem, or print the JSON Schema for editors."""

from __future__ import annotations

import json
from pathlib import Path

import click

from netlab.engines.plan import compile_plan
from netlab.scenario import Scenario, load_scenario
from netlab.scenario.quantities import DURATION
from netlab.scenario.schema import json_schema
from netlab.timeline import compile_timeline


@click.command()
@click.argument("file", type=click.Path(path_type=Path), required=False)
@click.option("--set", "overrides", multiple=True, metavar="KEY=VALUE", help="Override a value, as in links.0.loss=5%.")
@click.option("--schema", is_flag=True, help="Print the JSON Schema of the format instead.")
def check(file: Path | None, overrides: tuple[str, ...], schema: bool) -> None:
    """Validate FILE; every problem is one line. Exit code: 0 sound, 2 not."""
    if schema:
        click.echo(json.dumps(json_schema(), indent=2))
    elif file is None:
        raise click.UsageError("name a scenario file, or use --schema")
    else:
        click.echo(f"{file}: ok: {summary(load_scenario(file, overrides=overrides))}")


def summary(scenario: Scenario) -> str:
    """What a scenario comes to, in one line."""
    plan = compile_plan(scenario)
    radios = len(scenario.radio_nodes)
    counts = (
        (len(plan.nodes), "node"),
        (len(scenario.wires()), "wire"),
        (radios, "radio"),
        (len(scenario.streams()), "stream"),
        (len(compile_timeline(scenario, plan)), "change"),
        (len(scenario.expect), "expectation"),
    )
    parts = [f"{count} {noun}{'' if count == 1 else 's'}" for count, noun in counts if count]
    return f"{', '.join(parts)}, {DURATION.format(scenario.duration_s)}"
