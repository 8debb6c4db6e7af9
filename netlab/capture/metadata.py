"""The metadata record ``netlab.run``: what a reader must know about the run to judge its records."""

from __future__ import annotations

import json
import platform
from collections.abc import Iterable, Mapping
from importlib.metadata import PackageNotFoundError, version
from typing import Protocol

from netlab.engines.base import LabPlan

_DISTRIBUTIONS = ("udp-mesh-lab", "mcap", "pyroute2", "pydantic")


class StreamLike(Protocol):
    """A numbered stream of the scenario."""

    @property
    def index(self) -> int: ...
    @property
    def source(self) -> str: ...
    @property
    def destination(self) -> str: ...
    @property
    def topic(self) -> str: ...
    @property
    def priority(self) -> int: ...


def run_metadata(
    *,
    scenario_text: str,
    overrides: Iterable[str] = (),
    engine: str,
    clock: str,
    duration_s: float,
    plan: LabPlan,
    streams: Iterable[StreamLike],
    kept_latest: Iterable[int] = (),
    extra: Mapping[str, str] | None = None,
) -> dict[str, str]:
    """Build the record; ``t0_ns`` is added by the recorder when the run starts.

    Args:
        scenario_text: The file that was run.
        overrides: What ``--set`` changed of it, as ``key.path=value``.
        engine: ``air``, ``netem``.
        clock: ``real``, ``virtual``.
        duration_s: Scenario time in which traffic is published.
        plan: Gives the ports that verdicts name by number, and the rate of each.
        streams: All streams, in scenario order.
        kept_latest: Indices of the streams whose newest message is kept while its destination is away.
        extra: Further keys.
    """
    latest = set(kept_latest)
    listed = [
        {
            "stream": stream.index,
            "source": stream.source,
            "destination": stream.destination,
            "topic": stream.topic,
            "priority": stream.priority,
            "keep": "latest" if stream.index in latest else "all",
        }
        for stream in streams
    ]
    return {
        "name": plan.name,
        "seed": str(plan.seed),
        "engine": engine,
        "clock": clock,
        "duration_s": repr(duration_s),
        "scenario": scenario_text,
        "overrides": json.dumps(list(overrides)),
        "streams": json.dumps(listed),
        "ports": json.dumps(_ports(plan)),
        "meshes": json.dumps(_meshes(plan)),
        "versions": json.dumps(_versions()),
        **(extra or {}),
    }


def _ports(plan: LabPlan) -> list[dict[str, object]]:
    """A port's rate is that of its slowest pair: an upper bound of how long a fragment keeps it busy."""
    rates: dict[int, float] = {}
    segments = {port: segment.name for segment in plan.segments for port in segment.ports}
    for segment in plan.segments:
        for (sender, _), impairment in segment.pairs.items():
            if impairment.rate_bps is not None:
                rates[sender] = min(rates.get(sender, impairment.rate_bps), impairment.rate_bps)
    return [
        {
            "node": port.node,
            "interface": port.ifname,
            "segment": segments.get(port.index),
            "mac": port.mac.hex(":"),
            "address": port.address,
            "rate_bps": rates.get(port.index),
        }
        for port in plan.ports
    ]


def _meshes(plan: LabPlan) -> list[dict[str, object]]:
    """The nodes' mesh interfaces, which have the addresses that their ports then do not have."""
    return [
        {
            "node": mesh.node,
            "interface": mesh.ifname,
            "kind": mesh.kind.value,
            "mac": mesh.mac.hex(":"),
            "address": mesh.address,
        }
        for mesh in plan.meshes
    ]


def _versions() -> dict[str, str]:
    found = {"python": platform.python_version(), "kernel": platform.release()}
    for name in _DISTRIBUTIONS:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found
