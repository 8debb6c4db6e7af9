"""What the interactive lab takes of a core while 20 nodes move: `python tests/bench/bench_tui.py [seconds]`.

The real command runs on a pseudo-terminal of 120 x 38. Counted is the processor time of its own process: reading the
feed, the model, the screen; the lab's processes are others. Fails above 10 % of a core.
"""

from __future__ import annotations

import os
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from tests.system.terminal_rig import Terminal

MOST_SHARE = 0.10
NODES = 20


def scenario(duration_s: float) -> str:
    """A base and robots that walk about in three tunnels; each reports to the base five times a second."""
    lines = [
        "name: bench",
        f"duration: {duration_s + 60:g}s",
        "engine: air",
        "terrain:",
        "  tunnels:",
        "    - {name: portal, path: [[0, 0], [60, 0]], width: 5m}",
        "    - {name: north, path: [[60, 0], [60, 60], [120, 60]], width: 4m}",
        "    - {name: south, path: [[60, 0], [130, 0], [130, -60]], width: 4m}",
        "radio: {phy: 802.11n-20MHz-2x2, frequency: 2437MHz, propagation: {model: tunnel, corner_loss: 20dB}}",
        "nodes:",
        "  base: {position: [0, 0], processes: [udp_mesh]}",
    ]
    for number in range(1, NODES):
        turn = "[60, 40]" if number % 2 else "[130, -40]"
        way = f"[[{number}, 0], [60, 0], {turn}, [60, 0], [{number}, 0]]"
        lines.append(f"  r{number}: {{waypoints: {way}, speed: 2m/s, processes: [udp_mesh]}}")
    lines.append("traffic:")
    for number in range(1, NODES):
        lines.append(f"  - {{from: r{number}, to: base, topic: telemetry, priority: 1, size: 200B, rate: 5Hz}}")
    return "\n".join(lines) + "\n"


def used_s(pid: int) -> float:
    """Processor time of a process, without its children."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / float(os.sysconf("SC_CLK_TCK"))


def main(seconds: float) -> int:
    """Measure; returns the exit code."""
    with tempfile.TemporaryDirectory(prefix="nl-") as folder:
        file = Path(folder) / "bench.yaml"
        file.write_text(scenario(seconds))
        env = {**os.environ, "NETLAB_RUNTIME_DIR": folder}
        env.pop("SSH_CONNECTION", None)
        terminal = Terminal([sys.executable, "-m", "netlab", "lab", str(file)], cwd=Path(folder), env=env)
        try:
            terminal.until("▶ running", within_s=120)
            begun_s, before_s, written = time.monotonic(), used_s(terminal.pid), len(terminal.raw)
            while time.monotonic() - begun_s < seconds:
                terminal.settle()
            took_s, share = time.monotonic() - begun_s, used_s(terminal.pid) - before_s
        finally:
            terminal.close()
    share /= took_s
    print(
        f"{NODES} nodes, {took_s:.0f} s: {share:.1%} of a core, {(len(terminal.raw) - written) / took_s / 1e3:.1f} kB/s"
    )
    return 0 if share < MOST_SHARE else 1


if __name__ == "__main__":
    sys.exit(main(float(sys.argv[1]) if len(sys.argv) > 1 else 30.0))
