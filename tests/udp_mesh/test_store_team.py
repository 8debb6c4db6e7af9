"""Messages stored for a node of the team that was never heard: a ferry's backlog before the first meeting."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any

import pytest

from tests.udp_mesh.store_stations import TURN_S, Station
from udp_mesh import config
from udp_mesh.local_fates import Outcome


@pytest.fixture
def ferry(make_net: Any, tmp_path: Path) -> Iterator[tuple[Any, Station, Station]]:
    """A robot that is alone; the base has not started yet. Both know the team's names."""
    net = make_net(seed=5)
    robot, base = Station(net, "robot", tmp_path), Station(net, "base", tmp_path, topics=("map",))
    for station in (robot, base):
        station.config = replace(station.config, team=("base", "robot"))
    robot.start()

    def turn() -> None:
        for station in (robot, base):
            station.turn()

    net.every(TURN_S, turn, until_s=net.now + 1e6)
    yield net, robot, base
    for station in (robot, base):
        if station.durable is not None and station.durable._thread is not None:
            station.durable._thread.close()


def test_what_was_stored_before_the_first_meeting_is_passed_on_then(ferry: tuple[Any, Station, Station]) -> None:
    net, robot, base = ferry
    assert robot.durable is not None
    assert robot.durable.known_peers == ["base"], "itself is no destination"
    kept = [robot.publish("map", bytes([number]) * 2000, "base") for number in range(3)]
    net.run(5.0)
    assert len(robot.durable.custody) == 3
    robot.kill(Random(1))
    net.run(1.0)
    robot.start()
    kept.append(robot.publish("map", b"\3" * 2000, "base"))
    net.run(1.0)
    base.start()
    assert net.run(5.0, until=lambda: len(base.received) == 4)
    assert [payload[0] for payload in base.received] == [0, 1, 2, 3]
    assert net.run(5.0, until=lambda: all("base" in tracked.fates for tracked in kept))
    assert {tracked.fates["base"].outcome for tracked in kept} == {Outcome.ACKNOWLEDGED}


def test_to_all_is_to_the_whole_team(ferry: tuple[Any, Station, Station]) -> None:
    net, robot, base = ferry
    robot.publish("map", b"for all", "all")
    net.run(2.0)
    base.start()
    assert net.run(5.0, until=lambda: base.received == [b"for all"])


def test_a_name_outside_the_team_is_refused(ferry: tuple[Any, Station, Station]) -> None:
    net, robot, _base = ferry
    tracked = robot.publish("map", b"x", "bass")
    net.run(1.0)
    assert robot.durable is not None
    assert len(robot.durable.custody) == 0
    assert robot.durable.stats()["refused_unknown_peer"] == 1
    assert [fate.reason for fate in tracked.fates.values()] == ["unknown_peer"]


@pytest.mark.parametrize("value", ["base", [""], ["all"], [5]])
def test_a_team_is_a_list_of_names(value: object) -> None:
    with pytest.raises(config.ConfigError, match=r"f: team: has to be|f: team: cannot be"):
        config.parse({"team": value}, source="f")
