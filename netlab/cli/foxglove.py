"""``netlab foxglove [LAB]``: show a running lab to Foxglove; and the option with which other commands do the same."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import click

from netlab.capture.layout import layout_file
from netlab.lab.facade import Lab
from netlab.live.feed import follow_lab
from netlab.live.foxglove import DEFAULT_PORT, FoxgloveServer, require_foxglove

_POLL_S = 0.5
_DESCRIBED_S = 5.0


@click.command("foxglove")
@click.argument("lab", required=False)
@click.option("--port", type=click.IntRange(0, 65535), default=DEFAULT_PORT, show_default=True, help="0: a free one.")
@click.option(
    "--layout",
    type=click.Path(path_type=Path, dir_okay=False),
    help="Also save a layout for this lab; in Foxglove: Layout, Import from file.",
)
def foxglove(lab: str | None, port: int, layout: Path | None) -> None:
    """Show the running LAB to Foxglove, live, until it ends or Ctrl-C.

    In Foxglove choose "Open connection" and the address that is printed. Only this machine can reach it, and only to
    read. Without LAB: the only one that is running.
    """
    require_foxglove()
    feed = follow_lab(lab, packets=True)
    with FoxgloveServer(feed, name=lab or "netlab", port=port) as server:
        if layout is not None:
            server.described.wait(_DESCRIBED_S)
            layout.write_bytes(layout_file(server.metadata))
        announce(server)
        with contextlib.suppress(KeyboardInterrupt):
            while not server.ended.wait(_POLL_S):
                pass


def with_foxglove(command: Any) -> Any:
    """Add ``--foxglove [PORT]``."""
    option = click.option(
        "--foxglove",
        "foxglove_port",
        type=click.IntRange(0, 65535),
        is_flag=False,
        flag_value=DEFAULT_PORT,
        metavar="[PORT]",
        help=f"Show it live to Foxglove at 127.0.0.1:PORT ({DEFAULT_PORT} if none follows; write it last, or with =).",
    )
    return option(command)


@contextlib.contextmanager
def shown(lab: Lab, port: int | None) -> Iterator[FoxgloveServer | None]:
    """Show a running lab to Foxglove at a port of this machine (0: any that is free), if that was asked for.

    Raises:
        MachineError: foxglove-sdk is not installed, or the port is taken.
    """
    if port is None:
        yield None
        return
    with FoxgloveServer(lab.feed(packets=True), name=lab.name, port=port) as server:
        yield server


def announce(server: FoxgloveServer) -> None:
    """Say where to look."""
    click.echo(f'Foxglove: {server.url}  ("Open connection"; this machine only)', err=True)
