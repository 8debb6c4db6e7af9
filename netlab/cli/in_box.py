"""`netlab run --in vm`: the same command inside a throw-away kernel, its output and its capture brought out."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from pathlib import Path

import click

from netlab.errors import LabError
from netlab.lab.launch import make_room
from netlab.vm.guest import FRESH
from netlab.vm.request import BoxRequest, Clock, clean_environment
from netlab.vm.run import run_in_box


def run_scenario_in_box(file: Path, words: Sequence[str], *, clock: str, capture: Path | None, timeout_s: float) -> int:
    """Run ``netlab run FILE WORDS`` in a box; returns its exit code, 124 when ``timeout_s`` (host's clock) ended it.

    Raises:
        MachineError: The box cannot start; names the way out.
        LabError: The capture's folder cannot be made.
    """
    argv = [sys.executable, "-m", "netlab", "run", str(file.resolve()), *words]
    if str(file.resolve().parent) in FRESH:
        raise LabError(f"{file}: a box has a {file.resolve().parent} of its own; put the scenario into another folder")
    if capture is not None:
        capture = capture.resolve()
        make_room(capture)
        argv += ["--capture", str(capture)]
    request = BoxRequest(
        argv=tuple(argv),
        cwd=file.resolve().parent,  # stays visible, also below /tmp
        env=clean_environment(dict(os.environ)),
        output=capture.parent if capture is not None else None,
        clock=Clock(clock),
        timeout_s=timeout_s,
    )
    result = run_in_box(request)
    for note in result.notes:
        click.echo(note, err=True)
    if result.timed_out:
        click.echo(f"the box did not end within {timeout_s:g} s of the host's clock (--timeout)", err=True)
    return result.exit_code
