"""The daemon's key and carriers in a scenario: the same checks as in its own configuration."""

from __future__ import annotations

import tomllib
from typing import Any

import pytest
import tomli_w

from netlab.errors import ScenarioError
from netlab.lab.programs import daemon_config
from netlab.scenario import parse_scenario
from udp_mesh import config
from udp_mesh.config_carriers import CarrierKind

KEY = "0f" * 32


def scenario(**settings: Any) -> Any:
    nodes = {name: {"processes": ["udp_mesh"]} for name in ("a", "b")}
    return parse_scenario({"duration": "5s", "nodes": nodes, "links": [{"between": ["a", "b"]}], "udp_mesh": settings})


@pytest.mark.parametrize("key", [KEY, [KEY, "00" * 32]])
def test_the_daemon_gets_the_key(key: object) -> None:
    given = daemon_config(scenario(key=key), "a")
    read = config.parse(tomllib.loads(tomli_w.dumps(given)), source="a")
    assert read.key[0] == bytes.fromhex(KEY)
    assert len(read.key) == (1 if isinstance(key, str) else 2)


def test_the_daemon_gets_its_carriers() -> None:
    carriers = [{"kind": "udp6", "interfaces": ["eth0"]}, {"kind": "ethernet"}]
    carriers.append({"kind": "serial", "device": "/dev/ttyUSB0", "baud": 9600, "mtu": "255B", "rate": "5kbit"})
    given = daemon_config(scenario(carriers=carriers), "a")
    first, second, third = config.parse(tomllib.loads(tomli_w.dumps(given)), source="a").carriers
    assert (first.kind, first.interfaces) == (CarrierKind.UDP6, ("eth0",))
    assert (second.kind, second.interfaces) == (CarrierKind.ETHERNET, ())
    assert (third.device, third.baud, third.mtu_bytes, third.rate_bps) == ("/dev/ttyUSB0", 9600, 255, 5000)


@pytest.mark.parametrize(
    ("settings", "problem"),
    [
        ({"key": 5}, r"udp_mesh\.key: expected 64 hexadecimal digits in quotes"),
        ({"key": "0f" * 31}, r"udp_mesh\.key: expected 64 hexadecimal digits in quotes"),
        ({"key": []}, r"udp_mesh\.key: expected .* a list of 1 to 4 such keys"),
        ({"key": [KEY] * 5}, r"udp_mesh\.key: expected .* a list of 1 to 4 such keys"),
        ({"carriers": [{"kind": "lora"}]}, r"udp_mesh\.carriers\[0\]\.kind"),
        ({"carriers": [{"kind": "serial"}]}, r"udp_mesh\.carriers\[0\]: a serial carrier needs device"),
        (
            {"carriers": [{"kind": "udp", "device": "/dev/x"}]},
            r"udp_mesh\.carriers\[0\]: a serial carrier needs device",
        ),
        ({"carriers": [{"kind": "udp", "rate": "5kbit"}]}, r"a carrier of kind udp has no rate_bps"),
        ({"bridge": "sometimes"}, r"udp_mesh\.bridge: "),
    ],
)
def test_mistakes(settings: dict[str, object], problem: str) -> None:
    with pytest.raises(ScenarioError, match=problem):
        scenario(**settings)
