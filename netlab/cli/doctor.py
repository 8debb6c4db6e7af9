"""`netlab doctor`: what this machine can do, which engine it gets, what to install and why."""

from __future__ import annotations

import json

import click
from rich.console import Console
from rich.table import Table

from netlab.kernel.machine import Finding, as_json, auto_engine, can_run, examine
from netlab.vm import findings as vm_findings


@click.command()
@click.option("--json", "as_object", is_flag=True, help="Print one JSON object on standard output.")
@click.pass_context
def doctor(ctx: click.Context, as_object: bool) -> None:
    """Say what this machine can do, which engine `auto` gets, what to install and why.

    Exit code 0 if the lab can run here, 1 if not.
    """
    findings = [*examine(), *vm_findings.examine()]
    runs = can_run(findings)
    if as_object:
        click.echo(json.dumps(as_json(findings), indent=2))
    else:
        _print(findings, runs)
    ctx.exit(0 if runs else 1)


def _print(findings: list[Finding], runs: bool) -> None:
    console = Console(highlight=False)
    table = Table("", "what", "for", "found", box=None, pad_edge=False)
    for finding in findings:
        table.add_row(_mark(finding), finding.name, finding.needed_for, finding.detail)
    console.print(table)
    missing = [finding for finding in findings if not finding.available and finding.remedy]
    if missing:
        console.print("\nWhat to do:")
    for finding in missing:
        console.print(f"  {finding.name}: {finding.remedy}", markup=False)
    if runs:
        console.print(f"\nThe lab can run here; `--engine auto` takes {auto_engine(findings)}.", markup=False)
    else:
        console.print("\nThe lab cannot run here.")
    available = {finding.name for finding in findings if finding.available}
    if {"box: uml", "box: ptrace", "box: memory"} <= available:
        console.print("Virtual time works: netlab run FILE --in vm --clock virtual", markup=False)


def _mark(finding: Finding) -> str:
    if finding.available:
        return "[green]yes[/]"
    return "[bold red]NO[/]" if finding.essential else "[yellow]no[/]"
