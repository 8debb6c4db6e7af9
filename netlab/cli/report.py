"""``netlab report F.mcap -o DIR``: one HTML page of plots."""

from __future__ import annotations

from pathlib import Path

import click

from netlab.report.build import write_report


@click.command("report")
@click.argument("file", type=click.Path(path_type=Path))
@click.option("-o", "--output", type=click.Path(path_type=Path, file_okay=False), help="Default: beside FILE, .report.")
@click.option("--topic", help="Whose times between messages are shown (default: management, or the nearest to 1 Hz).")
@click.option("--base", help="To whom nodes are connected or not (default: base, or who received most).")
def report(file: Path, output: Path | None, topic: str | None, base: str | None) -> None:
    """Write a page of plots from the capture FILE into a folder; any browser opens it, no network is needed.

    Times between messages, map with each robot's path, data volumes, latency by priority, queue depths, link quality.
    """
    page = write_report(file, output or file.with_suffix(".report"), topic=topic, base=base)
    click.echo(f"{page}: {page.stat().st_size / 1e3:.0f} kB", err=True)
