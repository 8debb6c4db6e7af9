"""``netlab wireshark``: install the dissectors for Wireshark and tshark."""

from __future__ import annotations

from pathlib import Path

import click

from netlab.wireshark import plugin

_dir = click.option(
    "--dir",
    "folder",
    type=click.Path(path_type=Path, file_okay=False),
    help="Folder of Lua plugins. Default: this user's, as tshark tells it.",
)


@click.group("wireshark")
def wireshark() -> None:
    """Teach Wireshark and tshark udp_mesh, the flood and netlab's traffic (docs/wireshark.md)."""


@wireshark.command()
@_dir
def install(folder: Path | None) -> None:
    """Install the dissectors, or bring them up to date."""
    target, has_changed = plugin.install(folder or plugin.plugin_folder())
    if has_changed:
        click.echo(f"{target}: installed; a running Wireshark loads them with Ctrl+Shift+L")
    else:
        click.echo(f"{target}: up to date")


@wireshark.command()
@_dir
def uninstall(folder: Path | None) -> None:
    """Remove the dissectors."""
    target, was_there = plugin.uninstall(folder or plugin.plugin_folder())
    click.echo(f"{target}: {'removed' if was_there else 'nothing was installed'}")


@wireshark.command()
def path() -> None:
    """Print where the dissectors lie in this installation, for `tshark -X lua_script:...`."""
    click.echo(plugin.LUA)
