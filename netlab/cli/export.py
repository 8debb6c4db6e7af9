"""``netlab export F.mcap -o F.pcapng``: the packets of a capture for Wireshark."""

from __future__ import annotations

from pathlib import Path

import click

from netlab.capture.export import export_pcapng
from netlab.capture.reader import Capture
from netlab.cli.progress import Steps


@click.command("export")
@click.argument("file", type=click.Path(path_type=Path))
@click.option("-o", "--output", type=click.Path(path_type=Path, dir_okay=False), help="Default: beside FILE, .pcapng.")
def export(file: Path, output: Path | None) -> None:
    """Write all packets of the capture FILE as pcapng, which Wireshark and tshark open.

    Interfaces are called NODE/INTERFACE; what the medium did to a packet stands in the packet's comments.
    """
    target = output or file.with_suffix(".pcapng")
    with Steps() as steps, Capture.open(file, steps.at) as capture:
        steps.begin(f"exporting {file.name}")
        count = export_pcapng(capture, target)
        for note in capture.notes:
            click.echo(f"note: {note}", err=True)
    click.echo(f"{target}: {count} packets", err=True)
