"""Copies that `redundancy` asks for are no retransmissions, in a lab with real daemons as in its report.

In virtual time: on a machine that stands still for a moment acknowledgements are late, and retransmissions true.
"""

from __future__ import annotations

import pytest

from netlab.pytest_plugin import MakeLab
from netlab.traces.retransmissions import retransmissions

pytestmark = pytest.mark.lab_clock("virtual")


def test_redundant_telemetry_on_a_clean_wire_retransmits_nothing(make_lab: MakeLab) -> None:
    result = make_lab(
        {
            "name": "twice",
            "duration": "1s",
            "nodes": {"a": {"processes": ["udp_mesh"]}, "b": {"processes": ["udp_mesh"]}},
            "links": [{"between": ["a", "b"], "delay": "30ms"}],
            "traffic": [
                {
                    "from": "a",
                    "to": "b",
                    "topic": "pose",
                    "priority": 1,
                    "size": "100B",
                    "rate": "20Hz",
                    "redundancy": 2,
                }
            ],
            "expect": [{"retransmissions": {"at": "a"}, "max": 0}, {"delivered": {"topic": "pose"}, "min": "100%"}],
        }
    ).run()
    assert result.passed, result.report()
    trace = result.trace
    pose = [fragment for fragment in trace.fragments["a"] if fragment.message is not None]
    assert sum(fragment.is_copy for fragment in pose) == len(pose) // 2 == 20
    assert retransmissions(trace, "a") == []
