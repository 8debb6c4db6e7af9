"""What all tests share.

With ``--lab-clock=virtual`` every system test runs in a box, not only those with a lab (``make test-vm``). How long an
example of Hypothesis takes is the machine's affair: no test here fails by the clock.
"""

from __future__ import annotations

import os

import pytest

if "NETLAB_VM" not in os.environ:  # in a box nothing needs it, and imports are dear
    from hypothesis import HealthCheck, settings

    settings.register_profile("any_machine", deadline=None, suppress_health_check=[HealthCheck.too_slow])
    settings.load_profile("any_machine")

VIRTUAL_TOO = ("tests/system/", "tests/agreement/test_agreement_engines.py")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark them before the plugin chooses."""
    if config.getoption("--lab-clock") == "virtual":
        for item in items:
            if item.nodeid.startswith(VIRTUAL_TOO):
                item.add_marker(pytest.mark.lab_clock("virtual"))
