"""Quantities as options of commands: a scenario file's words, and plain numbers where the unit is plain."""

from __future__ import annotations

import re

import click

from netlab.scenario.quantities import DURATION

_PLAIN = re.compile(r"[+-]?\d+(\.\d*)?")


class _Seconds(click.ParamType[float]):
    """A time in seconds: ``12.5s``, ``300ms`` or ``12.5``."""

    name = "TIME"

    def convert(self, value: object, param: click.Parameter | None, ctx: click.Context | None) -> float:
        text = str(value)
        try:
            return float(text) if _PLAIN.fullmatch(text) else DURATION.parse(text)
        except ValueError as error:
            self.fail(f"{error}; or plain seconds, as in 12.5", param, ctx)


SECONDS = _Seconds()
