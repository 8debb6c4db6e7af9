"""A foreign transport in two nodes really uses the network: Zenoh, whose shared memory would pass by any link."""

from __future__ import annotations

import json
import sys
import time

from netlab.pytest_plugin import MakeLab

LINK_BPS = 10e6
SIZE_BYTES = 50_000
SECONDS = 4.0

SUBSCRIBER = f"""
import json, threading, time, zenoh
config = zenoh.Config()
config.insert_json5("listen/endpoints", json.dumps(["tcp/0.0.0.0:7447"]))
config.insert_json5("scouting/multicast/enabled", "false")
seen = []
with zenoh.open(config) as session:
    def keep(sample): seen.append((time.monotonic(), len(bytes(sample.payload))))
    subscriber = session.declare_subscriber("map", keep)
    print("listening", flush=True)
    deadline = time.monotonic() + 30
    while not seen or time.monotonic() - seen[0][0] < {SECONDS}:
        assert time.monotonic() < deadline, "nothing came"
        threading.Event().wait(0.05)
    window = [size for at, size in seen if 0 < at - seen[0][0] <= {SECONDS}]
    print(json.dumps({{"bps": sum(window) * 8 / {SECONDS}, "messages": len(window)}}), flush=True)
"""

PUBLISHER = f"""
import json, os, time, zenoh
config = zenoh.Config()
config.insert_json5("connect/endpoints", json.dumps(["tcp/base:7447"]))
config.insert_json5("scouting/multicast/enabled", "false")
with zenoh.open(config) as session:
    publisher = session.declare_publisher("map", congestion_control=zenoh.CongestionControl.BLOCK)
    payload = os.urandom({SIZE_BYTES})
    end = time.monotonic() + {SECONDS} + 20
    while time.monotonic() < end:
        publisher.put(payload)
"""


def test_zenoh_gets_no_more_than_the_link_carries(make_lab: MakeLab) -> None:
    lab = make_lab(
        {
            "name": "zenoh",
            "duration": "1s",
            "nodes": {
                "base": {"processes": [{"argv": [sys.executable, "-uc", SUBSCRIBER], "name": "subscriber"}]},
                "robot1": {},
            },
            "links": [{"between": ["base", "robot1"], "rate": "10mbit", "limit": 50}],
        },
        packets=False,
    )
    deadline = time.monotonic() + 20
    while "listening" not in lab.log("base", "subscriber"):
        assert time.monotonic() < deadline, lab.log("base", "subscriber")
    publisher = lab.spawn("robot1", sys.executable, "-c", PUBLISHER)
    while "bps" not in lab.log("base", "subscriber"):
        assert time.monotonic() < deadline + 40, lab.log("base", "subscriber")
    publisher.close()
    measured = json.loads(lab.log("base", "subscriber").splitlines()[-1])
    assert 0.5 * LINK_BPS < measured["bps"] <= LINK_BPS, measured
