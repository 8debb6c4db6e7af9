"""How many packets per second the recorder keeps up with while a sender shares the machine with it.

Run: python tests/bench/bench_capture.py [packets per second] [seconds]. Needs namespaces (root, or user namespaces).
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path.insert(0, str(Path(__file__).parents[1] / "system"))
from capture_rig import enter


def main(rate_pps: int = 20_000, duration_s: float = 4.0) -> int:
    """Print one line of figures; fail if a packet is missing at either end."""
    with TemporaryDirectory() as folder:
        result = enter("throughput", folder, str(rate_pps), str(duration_s), timeout_s=60 + 3 * duration_s)
    sent, elapsed_s = int(str(result["sent"])), float(str(result["elapsed_s"]))
    drops = sum(dict(result["kernel_drops"]).values())  # type: ignore[call-overload]
    captured = int(str(result["captured"]))
    cpu = float(str(result["recorder_cpu_s"])) / elapsed_s
    print(
        f"capture: {sent} packets of 1400 B in {elapsed_s:.2f} s ({sent / elapsed_s:.0f}/s), each seen at both ends; "
        f"{captured} captured, {drops} lost; recorder {100 * cpu:.0f} % of a core"
    )
    print(json.dumps(result))
    return 0 if captured >= 2 * sent and not drops else 1


if __name__ == "__main__":
    sys.exit(main(*(kind(text) for kind, text in zip((int, float), sys.argv[1:], strict=False))))
