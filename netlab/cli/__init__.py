"""The `netlab` command: one module per subcommand, imported only when it is called.

Exit codes: 0 done (and expectations met), 1 not met or failed, 2 bad scenario, bad usage, an unfit machine or a lab
that broke, 130 interrupted.
"""

from __future__ import annotations

import importlib
import sys

import click

from netlab import __version__
from netlab.errors import NetlabError

#: command -> (module, one line of help); the help is repeated here so that `netlab --help` imports nothing.
COMMANDS = {
    "lab": ("run", "Run a scenario with a live status (interactive lab)."),
    "run": ("run", "Run a scenario, evaluate its expectations."),
    "up": ("up", "Start a lab in the background."),
    "down": ("background", "Stop a lab."),
    "ls": ("background", "List running labs."),
    "exec": ("background", "Run a command in a node."),
    "shell": ("background", "Open a shell in a node."),
    "link": ("background", "Cut, restore or change a link of a running lab."),
    "move": ("background", "Move a node of a running lab."),
    "logs": ("background", "Print the output of a node's processes."),
    "check": ("check", "Validate a scenario file and print every problem."),
    "inspect": ("inspect", "Look into a capture."),
    "report": ("report", "Draw a page of plots from a capture."),
    "export": ("export", "Export a capture's packets to pcapng."),
    "wireshark": ("wireshark", "Install the dissectors for Wireshark and tshark."),
    "vm": ("vm", "Run a command in a throw-away kernel, in real or virtual time."),
    "doctor": ("doctor", "Say what this machine can do and what is missing."),
}


class _Lazy(click.Group):
    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"netlab.cli.{COMMANDS[cmd_name][0]}")
        command = getattr(module, f"{cmd_name}_command", None) or getattr(module, cmd_name)
        assert isinstance(command, click.Command)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_module, text) in COMMANDS.items()])


@click.group(cls=_Lazy, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(__version__, prog_name="netlab")
def cli() -> None:
    """Build robot mesh networks out of network namespaces, run real daemons in them, capture and judge."""


def main(argv: list[str] | None = None) -> None:
    """Entry point: a person's mistake ends in one message and exit code 2, never in a traceback."""
    try:
        sys.exit(cli.main(args=argv, prog_name="netlab", standalone_mode=False) or 0)
    except click.exceptions.Abort:
        sys.exit(130)
    except click.ClickException as error:
        error.show()
        sys.exit(2)
    except NetlabError as error:
        print(error, file=sys.stderr)
        sys.exit(2)
    except OSError as error:  # a full disk, a folder that may not be written: the machine's state, not our defect
        print(f"netlab: {error}", file=sys.stderr)
        sys.exit(2)
