"""The air engine in real namespaces: what the nodes see of delay, loss, outage and carrier."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

RIG = Path(__file__).with_name("air_rig.py")


@pytest.mark.parametrize(
    "case",
    [
        "delay",
        "broadcast",
        "unicast_privacy",
        "outage",
        "out_of_range",
        "carrier",
        "verdicts",
        "shared_channel",
        "vlan_tag",
        "ends_with_channel",
        "reports_a_dead_process",
        "refuses_strange_pairs",
    ],
)
def test_air(case: str) -> None:
    """Each case runs in throw-away namespaces of its own and leaves nothing behind."""
    user = [] if os.geteuid() == 0 else ["--map-root-user"]
    argv = ["unshare", "--net", "--mount", *user, "--", sys.executable, str(RIG), case]
    path = os.pathsep.join(filter(None, [str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH")]))
    done = subprocess.run(
        argv, capture_output=True, text=True, timeout=60, check=False, env={**os.environ, "PYTHONPATH": path}
    )
    assert done.returncode == 0, done.stderr
