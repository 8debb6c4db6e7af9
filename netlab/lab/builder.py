"""A scenario built in Python: the same keys and units as a file, collected call by call and checked at the end."""

from __future__ import annotations

from typing import Any, Self

from netlab.scenario import parse_scenario
from netlab.scenario.model import Scenario


class ScenarioBuilder:
    """Collects a scenario; :meth:`build` checks it and reports every problem at once.

    ScenarioBuilder("two").node("a", processes=["udp_mesh"]).node("b").link("a", "b", delay="5ms").build()
    """

    def __init__(self, name: str, **top_level: Any) -> None:
        self._data: dict[str, Any] = {"name": name, "nodes": {}, "links": [], "traffic": [], "events": [], "expect": []}
        self._data.update(top_level)

    def node(self, name: str, **keys: Any) -> Self:
        """Add a node, with a scenario file's keys."""
        self._data["nodes"][name] = keys
        return self

    def link(self, a: str, b: str, **words: Any) -> Self:
        """Add a link in both directions."""
        self._data["links"].append({"between": [a, b], **words})
        return self

    def one_way(self, sender: str, receiver: str, **words: Any) -> Self:
        """Set one direction of a link."""
        self._data["links"].append({"from": sender, "to": receiver, **words})
        return self

    def traffic(self, sender: str, receiver: str, topic: str, **keys: Any) -> Self:
        """Add a stream of messages."""
        self._data["traffic"].append({"from": sender, "to": receiver, "topic": topic, **keys})
        return self

    def event(self, at: str, **event: Any) -> Self:
        """Add an event, e.g. ``event("5s", outage={"between": ["a", "b"], "for": "2s"})``."""
        self._data["events"].append({"at": at, **event})
        return self

    def expect(self, **expectation: Any) -> Self:
        """Add an expectation, e.g. ``expect(latency={...}, p99="50ms")``."""
        self._data["expect"].append(expectation)
        return self

    def build(self) -> Scenario:
        """The checked scenario. Raises ScenarioError."""
        return parse_scenario({key: value for key, value in self._data.items() if value or key == "nodes"})
