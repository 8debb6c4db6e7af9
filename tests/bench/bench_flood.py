"""What `mesh: flood` costs: the CPU time of a relay per frame, and what it adds to a round trip, in real time.

`python tests/bench/bench_flood.py`. Three nodes in a line of perfect wires; the first floods the last with UDP.
"""

from __future__ import annotations

import os
import re
from pathlib import Path

from netlab.lab.facade import Lab

LINE = {
    "duration": "1s",
    "mesh": "flood",
    "nodes": {"a": {}, "r": {}, "b": {}},
    "links": [{"between": ["a", "r"]}, {"between": ["r", "b"]}],
}
RATES_HZ = (500, 2000, 8000)
SECONDS = 2
_SEND = """
import socket, time
sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
begin = time.monotonic()
for number in range({count}):
    while time.monotonic() < begin + number / {rate_hz}:
        time.sleep(0.0005)
    sock.sendto(bytes({size}), ("b", 9))
"""


def main() -> None:
    """Print both tables."""
    print("| offered, frames/s | size, bytes | passed | CPU of the relay's flood per frame, us |\n|---|---|---|---|")
    for rate_hz in RATES_HZ:
        for size in (100, 1400):
            print(_relay_cost(rate_hz, size))
    with Lab(LINE, packets=False) as lab:
        print(f"round trip over two hops, ms: {_round_trip_ms(lab)}")


def _relay_cost(rate_hz: int, size_bytes: int) -> str:
    with Lab(LINE, packets=False) as lab:
        [pid] = [row["pid"] for row in lab.status()["processes"] if row["node"] == "r"]
        lab.exec("a", "ping", "-c1", "-W2", "b")
        before_s, passed = _cpu_s(lab, pid), _received(lab)
        script = _SEND.format(count=rate_hz * SECONDS, rate_hz=rate_hz, size=size_bytes)
        lab.exec("a", "python3", "-c", script, timeout_s=60)
        passed = _received(lab) - passed
        per_frame_us = (_cpu_s(lab, pid) - before_s) / max(passed, 1) * 1e6
        return f"| {rate_hz} | {size_bytes} | {passed / (rate_hz * SECONDS):.0%} | {per_frame_us:.0f} |"


def _cpu_s(lab: Lab, pid: int) -> float:
    fields = lab.exec("r", "cat", f"/proc/{pid}/stat").stdout.rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _received(lab: Lab) -> int:
    lines = lab.exec("b", "cat", "/proc/net/dev").stdout.splitlines()
    [line] = [line for line in lines if line.strip().startswith("flood0:")]
    return int(line.split(":")[1].split()[1])


def _round_trip_ms(lab: Lab) -> str:
    told = lab.exec("a", "ping", "-c50", "-i0.02", "b").stdout
    found = re.search(r"= ([\d.]+)/([\d.]+)/([\d.]+)", told)
    return "lost" if found is None else f"least {found[1]}, mean {found[2]}"


if __name__ == "__main__":
    os.chdir(Path(__file__).parents[2])
    main()
