"""Nodes of a lab with a mesh and a probe in each: what the benchmarks of meshes have in common."""

from __future__ import annotations

import json
import sys
import threading
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from netlab.lab.facade import Lab

PROBE = Path(__file__).with_name("mesh_probe.py")
NS_PER_S = 1_000_000_000


@dataclass(frozen=True)
class Mesh:
    """A mesh with its settings, how long it takes until its routes are settled, and how long a cut lasts at most."""

    name: str
    overrides: tuple[str, ...]
    settle_s: float
    patience_s: float


MESHES = {
    mesh.name: mesh
    for mesh in (
        Mesh("wnet", ("mesh=wnet",), 6.0, 4.0),
        Mesh("flood", ("mesh=flood",), 2.0, 4.0),
        Mesh("babel", ("mesh=babel",), 40.0, 30.0),
        Mesh("babel-wireless-1s", ("mesh=babel", "babel.hello_interval=1s", "babel.wireless=true"), 30.0, 20.0),
        # batman-adv IV judges a link by its last 64 routing messages: sooner, it still makes up its mind.
        Mesh("BATMAN_IV", ("mesh=batman-adv", "batman_adv.routing_algorithm=BATMAN_IV"), 66.0, 15.0),
        Mesh("BATMAN_V", ("mesh=batman-adv", "batman_adv.routing_algorithm=BATMAN_V"), 66.0, 15.0),
    )
}


class Probes:
    """Probes that run in nodes at the same time; :meth:`results` when all have ended."""

    def __init__(self, lab: Lab) -> None:
        self._lab = lab
        self._threads: list[threading.Thread] = []
        self._told: dict[str, dict[str, Any]] = {}

    def start(self, node: str, *words: str, lasts_s: float) -> None:
        """Start one with the words of ``mesh_probe.py``."""
        thread = threading.Thread(target=self._run, args=(node, words, lasts_s))
        self._threads.append(thread)
        thread.start()

    def _run(self, node: str, words: tuple[str, ...], lasts_s: float) -> None:
        argv = (sys.executable, str(PROBE), "--lasts", str(lasts_s), *words)
        done = self._lab.exec(node, *argv, timeout_s=lasts_s + 600)
        assert done.returncode == 0, f"{node}: {done.stderr}"
        self._told[node] = json.loads(done.stdout)

    def results(self) -> dict[str, dict[str, Any]]:
        """What each told, by node."""
        for thread in self._threads:
            thread.join()
        return self._told


def fresh_delay_s(told: dict[str, dict[str, Any]], since_ns: int, until_ns: int) -> float | None:
    """From a moment until every node has something that was sent since; None if not before ``until_ns``."""
    worst = 0.0
    for node in told.values():
        arrived = [at for _, _, sent, at, _ in node["received"] if sent >= since_ns and at < until_ns]
        if not arrived:
            return None
        worst = max(worst, (min(arrived) - since_ns) / NS_PER_S)
    return worst


def quantile(values: list[float], share: float) -> float:
    """Nearest rank above."""
    ordered = sorted(values)
    return ordered[min(int(share * len(ordered)), len(ordered) - 1)]
