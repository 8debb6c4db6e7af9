"""Cross-reference check of rose: who runs it, and whose services the settings name."""

from __future__ import annotations

from collections.abc import Iterator

from netlab.scenario.check_topology import Names
from netlab.scenario.model import Scenario
from netlab.scenario.problems import Problem


def check_rose(scenario: Scenario, names: Names) -> Iterator[Problem]:
    """Yield every mistake in nodes' services."""
    for name, node in scenario.nodes.items():
        if node.rose is not None and node.process("rose") is None:
            yield ("nodes", name, "rose"), f"'{name}' does not run it; add processes: [rose]"
        for place, service in enumerate(node.rose.services if node.rose else ()):
            for other in sorted(service.named_nodes()):
                if complaint := names.complaint(other):
                    yield ("nodes", name, "rose", "services", place, "settings"), complaint
