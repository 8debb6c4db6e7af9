"""With ``--lab-clock=virtual`` every system test runs in a box, not only those with a lab (``make test-vm``)."""

from __future__ import annotations

import pytest

VIRTUAL_TOO = ("tests/system/", "tests/agreement/test_agreement_engines.py")


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Mark them before the plugin chooses."""
    if config.getoption("--lab-clock") == "virtual":
        for item in items:
            if item.nodeid.startswith(VIRTUAL_TOO):
                item.add_marker(pytest.mark.lab_clock("virtual"))
