"""Scenario files: the format, its units, reading with line-numbered problems, and the cross-reference check.

Knows nothing of kernels, engines and processes. ``load_scenario`` and ``parse_scenario`` are the way in.
"""

from netlab.scenario.loader import load_scenario, parse_scenario
from netlab.scenario.model import Scenario

__all__ = ["Scenario", "load_scenario", "parse_scenario"]
