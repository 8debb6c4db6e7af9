"""The goals of wnet beside the other meshes: the same nodes, the same questions. Writes docs/wnet_bench.md.

`python tests/bench/bench_wnet.py PART ... [--mesh NAME ...]` measures parts, each into a file of ``--results``:

* `reroute`: the cases of ``bench_mesh_cuts.py`` (virtual time);
* `multicast`: one source, three receivers by radio, 1000-byte datagrams at constant rates (virtual time);
* `control`: what 20 idle nodes by radio send, as a share of a 6 Mbit/s channel (virtual time);
* `throughput`: TCP over three hops of 50 Mbit/s (real time: on a machine that does nothing else).

`--write FILE` makes the document of what has been measured. Virtual time opens a box by itself.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from bench_mesh_cuts import CASES, address, measure
from mesh_rig_lab import MESHES, NS_PER_S, Mesh, Probes, quantile

from netlab.lab.facade import Lab
from netlab.medium.phy import PHYS, airtime_s
from netlab.vm.fitness import INSIDE

ROOT = Path(__file__).parents[2]
RADIO = "802.11g-20MHz"
RATES_BPS = [kbit * 1000 for kbit in (100, 200, 300, 400, 600, 800, 1000, 1500, 2000)]
STREAM_BYTES, STREAM_S, GROUP = 1000, 10.0, "239.9.9.9"
#: Strengths in dBm: -91 is the noise. The middle receiver hears the source well enough, the others need it.
STRENGTHS = {"s r1": -84, "r1 r2": -84, "r1 r3": -84, "r2 r3": -82, "s r2": -89, "s r3": -89}
CONTROL_S, CONTROL_SETTLE_S = 60.0, 60.0
TRANSFER_S = 10.0

Found = dict[str, Any]


def reroute(mesh: Mesh, options: argparse.Namespace) -> Found:
    found: Found = {}
    for case in CASES:
        if options.case in case.name:
            found[case.name] = measure(case, mesh, options.engine, options.cycles)
            print(mesh.name, case.name, found[case.name], flush=True)
    return found


def multicast(mesh: Mesh, _options: argparse.Namespace) -> Found:
    """By rate in bit/s: goodput as a share of what was sent, and delays in seconds, over the three receivers."""
    nodes = ("s", "r1", "r2", "r3")
    pairs = [{"between": pair.split(), "rssi": f"{dbm}dBm"} for pair, dbm in STRENGTHS.items()]
    scenario = {
        "name": "multicast",
        "duration": "1h",
        "nodes": {name: {} for name in nodes},
        "radio": {"phy": RADIO, "propagation": {"model": "table", "pairs": pairs}},
    }
    found: Found = {}
    with Lab(scenario, overrides=list(mesh.overrides), packets=False) as lab:
        time.sleep(mesh.settle_s)
        for rate_bps in RATES_BPS:
            probes, lasts_s = Probes(lab), STREAM_S + 8.0
            for name in nodes:
                words = ["--group", GROUP, "--address", address(lab, name)]
                if name == "s":
                    pace = str(rate_bps / 8 / STREAM_BYTES)
                    words += ["--to", GROUP, "--rate", pace, "--size", str(STREAM_BYTES)]
                    words += ["--after", "3", "--sends", str(STREAM_S)]
                probes.start(name, *words, lasts_s=lasts_s)
            told = probes.results()
            received = [told[name]["received"] for name in nodes[1:]]
            delays = [(at - sent) / NS_PER_S for rows in received for _, _, sent, at, _ in rows]
            distinct = sum(len({sequence for _, sequence, *_ in rows}) for rows in received)
            found[str(rate_bps)] = {
                "delivered": distinct / (3 * told["s"]["sent"]),
                "duplicates": len(delays) - distinct,
                "p50_s": quantile(delays, 0.5) if delays else None,
                "p95_s": quantile(delays, 0.95) if delays else None,
            }
            print(mesh.name, rate_bps, found[str(rate_bps)], flush=True)
    return found


def control(mesh: Mesh, _options: argparse.Namespace) -> Found:
    """Share of the channel's time, if all 20 nodes share it, and what makes it up."""
    nodes = {f"n{x}{y}": {"position": [150 * x, 150 * y]} for x in range(5) for y in range(4)}
    radio = {"phy": RADIO, "tx_power": "15dBm", "propagation": {"model": "log_distance", "exponent": 3.0}}
    scenario = {"name": "control", "duration": "1h", "nodes": nodes, "radio": radio}
    with Lab(scenario, overrides=list(mesh.overrides), packets=False) as lab:
        time.sleep(CONTROL_SETTLE_S)
        before = _sent(lab, list(nodes))
        time.sleep(CONTROL_S)
        after = _sent(lab, list(nodes))
    frames, size_bytes = (b - a for a, b in zip(before, after, strict=True))
    phy = PHYS[RADIO]
    airtime = frames * airtime_s(phy.rate(6e6), phy.psdu_bytes(round(size_bytes / max(frames, 1))))
    return {"share": airtime / CONTROL_S, "frames_per_s": frames / CONTROL_S, "bytes_per_s": size_bytes / CONTROL_S}


def _sent(lab: Lab, nodes: list[str]) -> tuple[int, int]:
    """Frames and bytes that all radios have sent so far, by the kernel's count."""
    totals = [0, 0]
    for node in nodes:
        paths = [f"/sys/class/net/radio0/statistics/{name}" for name in ("tx_packets", "tx_bytes")]
        for place, word in enumerate(lab.exec(node, "cat", *paths).stdout.split()):
            totals[place] += int(word)
    return totals[0], totals[1]


_RECEIVE = """
import socket, time
with socket.create_server(("", 6000)) as server:
    connection, _ = server.accept()
    size, begin = 0, None
    while data := connection.recv(1 << 16):
        begin = begin or time.monotonic()
        size += len(data)
    print(8 * size / (time.monotonic() - begin))
"""
_SEND = """
import socket, sys, time
for _ in range(100):
    try:
        sock = socket.create_connection((sys.argv[1], 6000), timeout=2)
        break
    except OSError:
        time.sleep(0.1)
sock.settimeout(None)
end = time.monotonic() + float(sys.argv[2])
while time.monotonic() < end:
    sock.sendall(bytes(1 << 16))
"""


def throughput(mesh: Mesh, _options: argparse.Namespace) -> Found:
    """Bits per second of payload that a TCP connection carries over three hops."""
    hops = (("a", "r1"), ("r1", "r2"), ("r2", "b"))
    links = [{"between": list(hop), "rate": "50mbit", "delay": "1ms"} for hop in hops]
    scenario = {"name": "transfer", "duration": "1h", "nodes": {n: {} for n in ("a", "r1", "r2", "b")}, "links": links}
    told: dict[str, str] = {}
    with Lab(scenario, overrides=list(mesh.overrides), packets=False) as lab:
        time.sleep(mesh.settle_s)

        def receive() -> None:
            told["bps"] = lab.exec("b", sys.executable, "-c", _RECEIVE, timeout_s=TRANSFER_S + 60).stdout

        receiver = threading.Thread(target=receive)
        receiver.start()
        words = (sys.executable, "-c", _SEND, address(lab, "b"), str(TRANSFER_S))
        done = lab.exec("a", *words, timeout_s=TRANSFER_S + 60)
        assert done.returncode == 0, done.stderr
        receiver.join()
    return {"bps": float(told["bps"])}


PARTS: dict[str, Callable[[Mesh, argparse.Namespace], Found]] = {
    "reroute": reroute,
    "multicast": multicast,
    "control": control,
    "throughput": throughput,
}
REAL_TIME = ("throughput",)


def run(part: str, options: argparse.Namespace) -> int:
    """Measure a part, here or in a box; its figures go to a file per mesh, over those of an earlier run."""
    if part in REAL_TIME or INSIDE in os.environ:
        for name in options.mesh:
            found = PARTS[part](MESHES[name], options)
            file = options.results / f"{part}.{name}.json"
            earlier = json.loads(file.read_text()) if file.exists() else {}
            file.write_text(json.dumps({**earlier, **found}))
            print(part, name, json.dumps(found), flush=True)
        return 0
    box = [sys.executable, "-m", "netlab", "vm", "--clock", "virtual", "--timeout", "3400"]
    words = [part, "--mesh", *options.mesh, "--results", str(options.results)]
    words += ["--cycles", str(options.cycles), "--case", options.case]
    command = [*box, "--output", str(options.results), "--", sys.executable, __file__, *words]
    return subprocess.run(command, cwd=ROOT, check=False).returncode


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", nargs="*", choices=[*PARTS, []])
    parser.add_argument("--mesh", nargs="+", default=list(MESHES), choices=list(MESHES))
    parser.add_argument("--cycles", type=int, default=10, help="of every case of reroute")
    parser.add_argument("--case", default="", help="of reroute, only those with this in their name")
    parser.add_argument("--engine", default="air")
    parser.add_argument("--results", type=Path, default=ROOT / "captures" / "wnet_bench")
    parser.add_argument("--write", type=Path, metavar="FILE", help="make the document of what is there")
    options = parser.parse_args()
    options.results = options.results.resolve()
    options.results.mkdir(parents=True, exist_ok=True)
    worst = max([0, *(run(part, options) for part in options.part)])
    if options.write is not None:
        from wnet_bench_page import page

        options.write.write_text(page(options.results))
    return worst


if __name__ == "__main__":
    sys.exit(main())
