"""The settings of wnet in a scenario are the daemon's own: the same words, the same bounds, told in the docs."""

from __future__ import annotations

import dataclasses
import math
import re
from pathlib import Path

import pytest

from netlab.scenario.quantities import Quantity
from netlab.scenario.wnet import WnetSettings
from wnet.config import CHECKS, MeshConfig, Metric


def test_a_scenario_has_every_setting_of_wnet() -> None:
    settings = {field.name for field in dataclasses.fields(MeshConfig)}
    assert WnetSettings.model_fields.keys() == CHECKS.keys() == settings


def bounds(name: str) -> tuple[float, float]:
    """The least and the most that a scenario's setting of wnet may be, in the daemon's unit."""
    told = WnetSettings.model_fields[name].annotation.__args__[0].__metadata__  # type: ignore[union-attr]
    quantities = [entry for entry in told if isinstance(entry, Quantity)]
    if quantities:
        return quantities[0].minimum, quantities[0].maximum
    limits = [limit for entry in told for limit in entry.metadata]
    return next(one.ge for one in limits if hasattr(one, "ge")), next(one.le for one in limits if hasattr(one, "le"))


@pytest.mark.parametrize("name", sorted(CHECKS.keys() - {"metric", "key"}))
def test_the_bounds_of_wnet_settings_are_those_of_its_daemon(name: str) -> None:
    check, (least, most) = CHECKS[name], bounds(name)
    assert [check(least), check(most)] == [least, most]
    for outside in (math.nextafter(least, -math.inf), math.nextafter(most, math.inf), least - 1, most + 1):
        with pytest.raises(ValueError, match="has to be"):
            check(outside)


def test_metrics_of_wnet_are_those_of_its_daemon() -> None:
    choices = WnetSettings.model_fields["metric"].annotation.__args__[0].__args__  # type: ignore[union-attr]
    assert set(choices) == set(Metric)


def test_every_setting_of_wnet_is_told_in_the_docs() -> None:
    told = (Path(__file__).parents[2] / "docs" / "scenario.md").read_text()
    names = [field.alias or name for name, field in WnetSettings.model_fields.items()]
    [table] = re.findall(r"^\| `wnet` \| default.*?\n\n", told, re.MULTILINE | re.DOTALL)
    first = " ".join(row.split("|")[1] for row in table.strip().splitlines()[2:])
    assert sorted(re.findall(r"`(\w+)`", first)) == sorted(names)
