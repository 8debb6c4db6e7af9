"""Which tests run in virtual time, and whether this machine can do that."""

from __future__ import annotations

from pathlib import Path

import pytest

from netlab.vm import fitness, kernels, places
from netlab.vm.request import BoxError, BoxRequest, Clock, KernelChoice

MARKER = "lab_clock"
LAB_FIXTURES = frozenset({"lab", "make_lab"})
CLOCKS = [clock.value for clock in Clock]


def wanted_clock(item: pytest.Item) -> Clock | None:
    """What the test's marker asks for; None if it has none.

    Raises:
        pytest.UsageError: The marker is wrong.
    """
    marker = item.get_closest_marker(MARKER)
    if marker is None:
        return None
    if len(marker.args) != 1 or marker.kwargs or marker.args[0] not in CLOCKS:
        raise pytest.UsageError(f'{item.nodeid}: write @pytest.mark.{MARKER}("virtual"), or "real"')
    return Clock(marker.args[0])


def is_lab_test(item: pytest.Item) -> bool:
    """Whether a test uses a lab, directly or by another fixture."""
    return not LAB_FIXTURES.isdisjoint(getattr(item, "fixturenames", ()))


def clock_of(item: pytest.Item, option: str | None) -> Clock:
    """By which clock a test runs: its marker decides, else ``--lab-clock`` does for tests with a lab."""
    clock = wanted_clock(item)
    if clock is None:
        return Clock.VIRTUAL if option == Clock.VIRTUAL.value and is_lab_test(item) else Clock.REAL
    return clock


def obstacle() -> str | None:
    """Why this machine has no box with virtual time, with the way out; None if it has."""
    try:
        fitness.check_uml()
        kernels.select(KernelChoice.UML, Clock.VIRTUAL)
        places.choose(places.candidates(), BoxRequest(("true",), Path("/")).memory_bytes)
    except BoxError as error:
        return str(error)
    return None
