"""``netlab report F.mcap -o DIR``: one HTML page of plots."""

from __future__ import annotations

from pathlib import Path

import click

from netlab.report.build import STEPS, STEPS_MORE, require_plots, write_report


@click.command("report")
@click.argument("file", type=click.Path(path_type=Path))
@click.option("-o", "--output", type=click.Path(path_type=Path, file_okay=False), help="Default: beside FILE, .report.")
@click.option("--topic", help="Whose times between messages are shown (default: management, or the nearest to 1 Hz).")
@click.option("--base", help="To whom nodes are connected or not (default: base, or who received most).")
@click.option(
    "--message",
    metavar="TOPIC#NUMBER",
    help="Whose way through the network is shown (default: the slowest of the most urgent priority).",
)
@click.option("--with", "other", type=click.Path(path_type=Path), metavar="FILE", help="A capture to compare with.")
def report(
    file: Path, output: Path | None, topic: str | None, base: str | None, message: str | None, other: Path | None
) -> None:
    """Write a page of plots from the capture FILE into a folder; any browser opens it, no network is needed.

    Expectations with their evidence, latencies, the way of one message, reconnects, map, times between messages, data
    volumes, queue depths, link quality. With a second capture the two stand side by side.
    """
    from netlab.cli.progress import Steps

    require_plots()
    with Steps(STEPS + (STEPS_MORE if other else 0)) as steps:
        page = write_report(
            file,
            output or file.with_suffix(".report"),
            topic=topic,
            base=base,
            message=message,
            other=other,
            on_step=steps.begin,
            on_read=steps.within,
        )
    click.echo(f"{page}: {page.stat().st_size / 1e3:.0f} kB", err=True)
