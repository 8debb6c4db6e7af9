"""Radios with a phy: what a file may say of a shared channel, and what becomes of it in the plan."""

from __future__ import annotations

from typing import Any

import pytest

from netlab.engines.air import AirEngine
from netlab.engines.choose import make_engine
from netlab.engines.netem_radio import NetemRadios
from netlab.engines.plan import compile_plan
from netlab.errors import ScenarioError
from netlab.medium.phy import PHYS
from netlab.medium.segments import ChannelSpec
from netlab.scenario import parse_scenario
from netlab.scenario.radio import PHY_NAMES

RADIO = {"phy": "802.11g-20MHz", "propagation": {"model": "none"}}


def scenario(radio: dict[str, Any], **more: Any) -> dict[str, Any]:
    """Three nodes with this radio."""
    return {"name": "air", "duration": "1s", "radio": radio, "nodes": {"a": {}, "b": {}, "c": {}}, **more}


def spec(radio: dict[str, Any]) -> ChannelSpec | None:
    """The channel that a radio block makes."""
    return compile_plan(parse_scenario(scenario(radio))).segments[0].channel


def problems(radio: dict[str, Any], **more: Any) -> list[str]:
    """What is wrong with it."""
    with pytest.raises(ScenarioError) as caught:
        parse_scenario(scenario(radio, **more))
    return caught.value.problems


def test_a_phy_makes_a_shared_channel_with_its_defaults() -> None:
    assert spec(RADIO) == ChannelSpec("802.11g-20MHz", noise_dbm=-91.0, rate_bps=None, limit_packets=64)
    assert spec({"propagation": {"model": "none"}}) is None


def test_rate_noise_and_queue_belong_to_the_channel_and_other_words_to_the_pairs() -> None:
    radio = RADIO | {"rate": "54mbit", "noise": "-95dBm", "limit": "20kB", "loss": "3%", "rssi": "-70dBm"}
    assert spec(radio) == ChannelSpec(
        "802.11g-20MHz", noise_dbm=-95.0, rate_bps=54e6, limit_packets=None, limit_bytes=20_000
    )
    pairs = compile_plan(parse_scenario(scenario(radio))).segments[0].pairs
    impairment = pairs[0, 1]
    assert (impairment.rate_bps, impairment.limit_packets, impairment.rssi_dbm) == (None, 1000, -70.0)
    assert impairment.loss is not None


def test_a_table_says_who_hears_whom_and_how_strongly() -> None:
    table = {"model": "table", "pairs": [{"between": ["a", "b"], "rssi": "-80dBm"}]}
    pairs = compile_plan(parse_scenario(scenario(RADIO | {"propagation": table}))).segments[0].pairs
    assert {pair: impairment.rssi_dbm for pair, impairment in pairs.items()} == {(0, 1): -80.0, (1, 0): -80.0}


def test_every_radio_of_the_medium_can_be_named() -> None:
    assert set(PHY_NAMES) == set(PHYS)


@pytest.mark.parametrize(
    ("radio", "problem"),
    [
        (RADIO | {"phy": "802.11g"}, "radio.phy: unknown phy '802.11g'; did you mean '802.11g-20MHz'?"),
        (RADIO | {"rate": "7mbit"}, "radio: rate: 802.11g-20MHz has no rate of 7mbit; its rates are 6mbit"),
        (RADIO | {"driver": "hwsim"}, "radio: phy has no meaning with driver: hwsim"),
        ({"noise": "-90dBm", "propagation": {"model": "none"}}, "radio: noise belongs to radios with a phy; add phy"),
        ({"rssi": "-50dBm", "propagation": {"model": "none"}}, "radio: rssi belongs to 802.11 radios"),
        (
            RADIO | {"propagation": {"model": "table", "pairs": [{"between": ["a", "b"], "rate": "1mbit"}]}},
            "radio.propagation.pairs[0].rate: rate of a pair has no meaning where radios share a channel",
        ),
    ],
)
def test_words_that_do_not_belong_there_are_refused(radio: dict[str, Any], problem: str) -> None:
    found = problems(radio)
    assert len(found) == 1
    assert problem in found[0]


def test_events_may_change_words_and_strength_but_no_rate() -> None:
    change = {"at": "0s", "link": {"between": ["a", "b"], "loss": "5%", "rssi": "-85dBm"}}
    parse_scenario(scenario(RADIO, events=[change]))
    change["link"] = {"between": ["a", "b"], "limit": 5}
    (found,) = problems(RADIO, events=[change])
    assert "events[0].link.limit: limit of a pair has no meaning" in found


def test_auto_shares_airtime_and_netem_has_pairs_instead() -> None:
    plan = compile_plan(parse_scenario(scenario(RADIO, engine="netem")))
    assert isinstance(make_engine("auto", plan, ())[1], AirEngine)
    assert isinstance(make_engine("netem", plan, ())[1], NetemRadios)
