"""Commands in a node of a running lab, from a process outside: run to their end, or left running."""

from __future__ import annotations

import os
import subprocess
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from netlab.errors import LabError
from netlab.lab.control import ControlClient


def exec_request(node: str, argv: Sequence[str], env: Mapping[str, str] | None = None) -> dict[str, Any]:
    """The control request for a command in a node, in this process's folder; three descriptors go with it."""
    return {"do": "exec", "node": node, "argv": list(argv), "env": dict(env or {}), "cwd": str(Path.cwd())}


def run_command(
    connection: ControlClient, request: dict[str, Any], *, timeout_s: float, text: str = ""
) -> subprocess.CompletedProcess[str]:
    """Run a command (an ``exec_request``) to its end; ``text`` is its standard input. Hangs up.

    Raises:
        LabError: Unknown node or program.
        subprocess.TimeoutExpired: It did not end in time (it is ended then).
    """
    argv = tuple(request["argv"])
    with tempfile.TemporaryFile() as stdin, tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        stdin.write(text.encode())
        stdin.seek(0)
        try:
            connection.request(request, [stdin.fileno(), out.fileno(), err.fileno()])
            try:
                status = connection.next_reply(timeout_s=timeout_s)["exit"]
            except LabError as error:
                if isinstance(error.__cause__, TimeoutError):
                    raise subprocess.TimeoutExpired(argv, timeout_s) from error
                raise
        finally:
            connection.close()
        out.seek(0)
        err.seek(0)
        said, complained = (file.read().decode(errors="replace") for file in (out, err))
        return subprocess.CompletedProcess(argv, status, said, complained)


def start_command(connection: ControlClient, request: dict[str, Any]) -> None:
    """Start a command (an ``exec_request``), its output thrown away; it ends when the connection is closed.

    Raises:
        LabError: Unknown node or program; the connection is closed then.
    """
    with Path(os.devnull).open("r+b") as null:
        try:
            connection.request(request, [null.fileno()] * 3)
        except BaseException:
            connection.close()
            raise
