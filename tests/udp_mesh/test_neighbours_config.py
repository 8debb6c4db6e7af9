"""Fixed neighbours in a configuration, and which carrier reaches which."""

from __future__ import annotations

import pytest

from udp_mesh import config
from udp_mesh.config import ConfigError
from udp_mesh.config_carriers import CarrierKind
from udp_mesh.config_neighbours import Neighbour
from udp_mesh.io.carrier import CarrierFacts
from udp_mesh.io.neighbours import with_neighbours


def test_addresses_of_every_kind_are_read_and_shown() -> None:
    listed = ["10.0.0.2", "FE80::0:5%wlan0", "fd00::1", "02:00:00:00:00:0A%eth0"]
    read = config.parse({"neighbours": listed}, source="f")
    assert read.neighbours == (
        Neighbour(CarrierKind.UDP, "10.0.0.2"),
        Neighbour(CarrierKind.UDP6, "fe80::5", "wlan0"),
        Neighbour(CarrierKind.UDP6, "fd00::1"),
        Neighbour(CarrierKind.ETHERNET, "02:00:00:00:00:0a", "eth0"),
    )
    assert config.describe(read)["neighbours"] == ["10.0.0.2", "fe80::5%wlan0", "fd00::1", "02:00:00:00:00:0a%eth0"]
    assert config.parse({}, source="f").neighbours is None
    assert config.parse({"neighbours": []}, source="f").neighbours == ()


@pytest.mark.parametrize("value", ["10.0.0.2", ["base"], ["10.0.0.2:8700"], [5], ["10.0.0.1"] * 257])
def test_mistakes_say_what_is_expected(value: object) -> None:
    with pytest.raises(ConfigError, match=r"f: neighbours: (has to be a list of|holds .* is no IPv4, IPv6 or MAC)"):
        config.parse({"neighbours": value}, source="f")


def test_a_neighbour_is_on_the_carrier_that_leads_to_it() -> None:
    carriers = [
        CarrierFacts(1, CarrierKind.UDP, "lo", address="127.0.0.1"),
        CarrierFacts(2, CarrierKind.UDP, "other", address="192.0.2.1"),
        CarrierFacts(3, CarrierKind.UDP6, "wlan0"),
        CarrierFacts(4, CarrierKind.UDP6, "wlan1"),
        CarrierFacts(5, CarrierKind.SERIAL, "/dev/x"),
    ]
    listed = config.parse(
        {"neighbours": ["127.0.0.1", "192.0.2.77%other", "fe80::1%wlan1", "fd00::1"]}, source="f"
    ).neighbours
    assert listed is not None
    found = [facts.neighbours for facts in with_neighbours(carriers, listed)]
    assert found == [("127.0.0.1",), ("192.0.2.77",), ("fd00::1",), ("fe80::1", "fd00::1"), None]
