"""Labs in the background: `down`, `ls`, `exec`, `shell`, `link`, `move`, `logs`.

They only talk to a supervisor, and import nothing of scenarios: `netlab exec` must not cost more than it does.
"""

from __future__ import annotations

import os
import signal
import sys
import time
from typing import Any

import click

from netlab.cli.terminal import exec_with_terminal
from netlab.errors import LabError
from netlab.lab import registry
from netlab.lab.commands import exec_request
from netlab.lab.control import ControlClient

lab_option = click.option("--lab", "lab_name", metavar="NAME", help="Which lab, where more than one is running.")


def _ask(lab_name: str | None, request: dict[str, Any]) -> dict[str, Any]:
    connection = ControlClient(registry.find(lab_name).control_socket)
    try:
        return connection.request(request)
    finally:
        connection.close()


@click.command()
@lab_option
@click.argument("name", required=False)
@click.option("--all", "all_labs", is_flag=True, help="Stop every lab of yours.")
def down(lab_name: str | None, name: str | None, all_labs: bool) -> None:
    """Stop the lab NAME (or the only one) and wait until nothing of it is left."""
    for folder in registry.running() if all_labs else [registry.find(name or lab_name)]:
        connection = ControlClient(folder.control_socket)
        connection.request({"do": "down"})
        connection.close()
        deadline = time.monotonic() + 10
        while folder.path in [lab.path for lab in registry.running()]:
            if time.monotonic() > deadline:
                raise LabError(f"{folder.name} did not end within 10 s")
            time.sleep(0.02)


@click.command()
def ls() -> None:
    """List your running labs: name, phase, scenario time, engine, nodes."""
    labs = registry.running()
    if not labs:
        click.echo("no lab is running", err=True)
    width = max((len(folder.name) for folder in labs), default=0)
    for folder in labs:
        try:
            connection = ControlClient(folder.control_socket)
            status = connection.request({"do": "status"}, timeout_s=5.0)
            connection.close()
        except LabError as error:
            click.echo(f"{folder.name:{width}}  (does not answer: {error})")
            continue
        time_s = "" if status["t_s"] is None else f"  t={status['t_s']:.1f}s"
        click.echo(
            f"{folder.name:{width}}  {status['phase']}{time_s}  engine={status['engine']}  "
            f"nodes: {' '.join(status['nodes'])}"
        )
        for text in (*status["failures"], *status["problems"], *status["notices"]):
            click.echo(f"{'':{width}}  ! {text.splitlines()[0]}")


@click.command("exec", context_settings={"ignore_unknown_options": True, "allow_interspersed_args": False})
@lab_option
@click.argument("node")
@click.argument("argv", nargs=-1, required=True, type=click.UNPROCESSED)
def exec_command(lab_name: str | None, node: str, argv: tuple[str, ...]) -> None:
    """Run a command in NODE; its exit code is ours. Example: netlab exec robot1 -- ping -c3 base"""
    command = argv[1:] if argv[0] == "--" else argv
    connection = ControlClient(registry.find(lab_name).control_socket)
    request = exec_request(node, command, _terminal_env())
    if sys.stdin.isatty() and sys.stdout.isatty():
        sys.exit(exec_with_terminal(connection, request))
    connection.request(request, [0, 1, 2])
    try:
        sys.exit(_exit_code(connection.next_reply()["exit"]))
    except KeyboardInterrupt:
        sys.exit(128 + signal.SIGINT)
    finally:
        connection.close()  # the lab ends the command when its connection goes


@click.command()
@lab_option
@click.argument("node")
def shell(lab_name: str | None, node: str) -> None:
    """Open your shell in NODE."""
    connection = ControlClient(registry.find(lab_name).control_socket)
    argv = [os.environ.get("SHELL") or "/bin/sh"]
    request = exec_request(node, argv, _terminal_env())
    if sys.stdin.isatty():
        sys.exit(exec_with_terminal(connection, request))
    connection.request(request, [0, 1, 2])  # a script on standard input
    sys.exit(_exit_code(connection.next_reply()["exit"]))


@click.command()
@lab_option
@click.argument("a")
@click.argument("b")
@click.argument("change")
@click.option("--one-way", is_flag=True, help="Only from A to B.")
def link(lab_name: str | None, a: str, b: str, change: str, one_way: bool) -> None:
    """Change the link between A and B: `down`, `up`, or words as in a scenario file: loss=5%,delay=20ms,rate=10mbit"""
    request: dict[str, Any] = {"between": [a, b], "one_way": one_way}
    if change in ("down", "up"):
        if one_way:
            request |= {"do": "outage", "active": change == "down"}
        else:
            request |= {"do": "carrier", "up": change == "up"}
    else:
        words = dict(part.partition("=")[::2] for part in _split_words(change))
        request |= {"do": "link", "words": words}
    _ask(lab_name, request)


@click.command(context_settings={"ignore_unknown_options": True})
@lab_option
@click.argument("node")
@click.argument("x", type=float)
@click.argument("y", type=float)
@click.option("--speed", "speed_mps", type=click.FloatRange(min=0, min_open=True), help="Go there, in m/s.")
def move(lab_name: str | None, node: str, x: float, y: float, speed_mps: float | None) -> None:
    """Put NODE at X Y (metres) at once, or send it there with --speed; it leaves its own motion."""
    _ask(lab_name, {"do": "move", "node": node, "to": [x, y], "speed_mps": speed_mps})


@click.command()
@lab_option
@click.argument("node")
@click.argument("process", required=False)
def logs(lab_name: str | None, node: str, process: str | None) -> None:
    """Print what NODE's processes have written, or only PROCESS."""
    folder = registry.find(lab_name)
    directory = folder.logs / node
    files = sorted(directory.glob("*.log")) if directory.is_dir() else []
    if process is not None:
        files = [file for file in files if file.stem == process]
    if not files:
        status = _ask(lab_name, {"do": "status"})
        known = ", ".join(f"{p['node']}/{p['process']}" for p in status["processes"]) or "none"
        raise LabError(f"no output of {node}{'/' + process if process else ''}; processes: {known}")
    for file in files:
        if len(files) > 1:
            click.echo(f"==> {file.stem} <==")
        click.echo(file.read_text(errors="replace"), nl=False)


def _split_words(change: str) -> list[str]:
    """Split at commas, but not inside the braces of a value such as loss={gemodel: {p: 1%, r: 25%}}."""
    parts, depth = [""], 0
    for character in change:
        depth += (character in "{[") - (character in "]}")
        if character == "," and depth == 0:
            parts.append("")
        else:
            parts[-1] += character
    return [part.strip() for part in parts if part.strip()]


def _terminal_env() -> dict[str, str]:
    return {key: os.environ[key] for key in ("TERM", "LANG", "COLORTERM", "LC_ALL") if key in os.environ}


def _exit_code(status: int) -> int:
    return status if status >= 0 else 128 - status
