"""The flood over the kernel's own physics."""

from __future__ import annotations

from typing import Any

import pytest

from netlab.pytest_plugin import MakeLab
from tests.system.test_lab_flood import BY_RADIO, LINE


@pytest.mark.usefixtures("netem_kernel", "taps")
@pytest.mark.parametrize("scenario", [LINE, BY_RADIO], ids=["wires", "radio"])
def test_on_the_kernel_s_own_physics_too(make_lab: MakeLab, scenario: dict[str, Any]) -> None:
    result = make_lab(scenario, engine="netem").run()
    assert result.stream("t")["delivered"] == 40, result.report()
