"""The document of what ``bench_wnet.py`` has measured."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from bench_mesh_cuts import CASES
from mesh_rig_lab import MESHES, quantile

_HEAD = """# wnet beside other meshes

Every table is of `python tests/bench/bench_wnet.py PART`, and this page of its `--write docs/wnet_bench.md`. The
same nodes, links and questions for every mesh; babeld is Debian's, batman-adv the kernel's in the [box](vm.md). All but
the transfer is in virtual time: exact, and blind to what a computation costs.
"""
_REROUTE = """
## Another way, and back again

Silent cuts; datagrams of 100 bytes at 50 Hz between `a` and `b`, both ways, below any transport. From the cut (or the
restoration) until both ends have got one that was sent since, in seconds, p50 / p90; five nodes as in
`topologies/relay_diamond.yaml`, and a line of three hops. `-`: not in time
(wnet and flood 4 s, batman-adv 15 s, babeld 20 s and more). Goal of wnet: 0.3 s at p90 where
a relay falls silent and another way exists, and where three hops come back after 15 s. Empty: not measured.
"""
_MULTICAST = """
## The paper's multicast test

One source, three receivers by radio (802.11g, noise -91 dBm), one of which hears the source well enough and
relays to the others; 1000-byte datagrams at a constant rate to a group. Share of datagrams that arrive at a receiver,
and the delay of those in ms, p50 / p95. Goal: never fewer than the flood, more wherever it loses over 1 %, and sooner
there; no congestion up to 600 kbit/s. What a mesh loses is in no delay: a high p95 beside a higher share is what others
have lost.
"""
_CONTROL = """
## What an idle mesh costs

20 nodes by radio in a grid of 4 by 5, nothing but the mesh's own frames (and the kernels' few): what all of them send
in a minute, as a share of the time of one 6 Mbit/s channel that they would all share. Goal: 2 %.
"""
_TRANSFER = """
## A transfer over three hops

TCP over three links of 50 Mbit/s and 1 ms, in real time on {machine}. Goal: 20 Mbit/s of payload.
"""


def page(results: Path) -> str:
    """The whole text; parts that were not measured are left out."""
    parts = [_HEAD]
    for text, part, table in (
        (_REROUTE, "reroute", _reroute),
        (_MULTICAST, "multicast", _multicast),
        (_CONTROL, "control", _control),
        (_TRANSFER.format(machine="two shared cores"), "throughput", _throughput),
    ):
        found = {
            name: json.loads(file.read_text()) for name in MESHES if (file := results / f"{part}.{name}.json").exists()
        }
        if found:
            parts += [text, _rows(table(found))]
    return "\n".join(parts)


def _rows(rows: Sequence[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join([lines[0], "|" + "---|" * len(rows[0]), *lines[1:], ""])


def _reroute(found: dict[str, Any]) -> list[list[str]]:
    cycles = {name: max(len(delays) for delays in mesh.values()) for name, mesh in found.items()}
    rows = [["s, p50 / p90 (cycles)", *(f"{name} ({cycles[name]})" for name in found)]]
    rows += [[case.name, *(_delays(found[name].get(case.name)) for name in found)] for case in CASES]
    return rows


def _delays(delays: list[float | None] | None) -> str:
    if not delays:
        return ""
    known = [math.inf if delay is None else delay for delay in delays]
    return " / ".join(
        "-" if value == math.inf else f"{value:.2f}" for value in (quantile(known, 0.5), quantile(known, 0.9))
    )


def _multicast(found: dict[str, Any]) -> list[list[str]]:
    rates = sorted({int(rate) for mesh in found.values() for rate in mesh})
    return [
        ["kbit/s", *found],
        *([f"{rate // 1000}", *(_stream(found[name][str(rate)]) for name in found)] for rate in rates),
    ]


def _stream(figures: dict[str, Any]) -> str:
    if figures["p50_s"] is None:
        return "0 %"
    return f"{figures['delivered']:.1%}, {figures['p50_s'] * 1e3:.1f} / {figures['p95_s'] * 1e3:.1f}"


def _control(found: dict[str, Any]) -> list[list[str]]:
    rows = [["mesh", "share of the channel", "frames/s", "bytes/s"]]
    for name, figures in found.items():
        rows.append(
            [name, f"{figures['share']:.2%}", f"{figures['frames_per_s']:.1f}", f"{figures['bytes_per_s']:.0f}"]
        )
    return rows


def _throughput(found: dict[str, Any]) -> list[list[str]]:
    return [["mesh", "Mbit/s"], *([name, f"{figures['bps'] / 1e6:.1f}"] for name, figures in found.items())]
