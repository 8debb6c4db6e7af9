"""The link budget: what every radio hears of every other."""

from __future__ import annotations

import math

import numpy as np
import pytest

from netlab.world.antenna import sector
from netlab.world.budget import LinkBudget, RadioUnit
from netlab.world.geometry import Geometry, Moment
from netlab.world.propagation.free_space import FreeSpace
from netlab.world.propagation.model import PropagationModel
from netlab.world.propagation.tunnel import Tunnel


def moment(positions: list[tuple[float, float]], *, active: list[bool] | None = None) -> Moment:
    count = len(positions)
    return Moment(
        positions_m=np.array([(x, y, 0.0) for x, y in positions]),
        headings_deg=np.zeros(count),
        speeds_mps=np.zeros(count),
        travelled_m=np.zeros(count),
        active=np.array(active if active is not None else [True] * count),
    )


def open_ground(now: Moment, node_of_radio: np.ndarray, *, corners: float = 0.0, width_m: float = math.nan) -> Geometry:
    at = now.positions_m[node_of_radio]
    apart = at[None, :, :] - at[:, None, :]
    shape = apart.shape[:2]
    return Geometry(
        distance_m=np.linalg.norm(apart, axis=2),
        corners=np.full(shape, corners),
        line_of_sight=np.full(shape, corners == 0),
        width_m=np.full(shape, width_m),
        height_m=np.full(shape, width_m),
        bearing_deg=np.degrees(np.arctan2(apart[:, :, 1], apart[:, :, 0])),
    )


def rssi(budget: LinkBudget, now: Moment, at_s: float = 0.0) -> np.ndarray:
    return budget.rssi_dbm(now, open_ground(now, budget.node_of_radio), at_s)


def units(count: int, **settings: float) -> list[RadioUnit]:
    return [RadioUnit(f"n{k}-radio0", k, **settings) for k in range(count)]


def test_power_less_path_loss_is_what_is_heard() -> None:
    """20 dBm over 100 m at 2437 MHz: 20 - 80.2."""
    heard = rssi(LinkBudget(units(2), FreeSpace(), seed=1), moment([(0, 0), (100, 0)]))
    assert heard[0, 1] == heard[1, 0] == pytest.approx(-60.2, abs=0.05)
    assert heard[0, 0] == heard[1, 1] == -math.inf


def test_the_stronger_sender_is_heard_stronger() -> None:
    """Beacons of 2 W, robots of 1 W."""
    radios = [RadioUnit("beacon", 0, tx_power_dbm=33.0), RadioUnit("robot", 1, tx_power_dbm=30.0)]
    heard = rssi(LinkBudget(radios, Tunnel(), seed=1), moment([(0, 0), (100, 0)]))
    assert heard[0, 1] - heard[1, 0] == pytest.approx(3.0)


def test_other_frequencies_carried_nodes_and_rock_are_silent() -> None:
    radios = [*units(3), RadioUnit("n0-radio1", 0, frequency_hz=5.18e9), RadioUnit("n1-radio1", 1, frequency_hz=5.18e9)]
    budget = LinkBudget(radios, FreeSpace(), seed=1)
    now = moment([(0, 0), (10, 0), (20, 0)], active=[True, True, False])
    audible = np.isfinite(rssi(budget, now))
    assert np.argwhere(audible).tolist() == [[0, 1], [1, 0], [3, 4], [4, 3]]
    geometry = open_ground(now, budget.node_of_radio)
    geometry.distance_m[0, 1] = geometry.distance_m[1, 0] = math.inf
    assert np.argwhere(np.isfinite(budget.rssi_dbm(now, geometry, 0.0))).tolist() == [[3, 4], [4, 3]]


def test_each_frequency_has_its_own_loss() -> None:
    radios = [*units(2, frequency_hz=2.4e9), *(RadioUnit(f"n{k}-radio1", k, frequency_hz=4.8e9) for k in range(2))]
    heard = rssi(LinkBudget(radios, FreeSpace(), seed=1), moment([(0, 0), (10, 0)]))
    assert heard[0, 1] - heard[2, 3] == pytest.approx(20 * math.log10(2))


def test_antennas_point_where_the_robot_heads() -> None:
    radios = [RadioUnit("a", 0, antenna=sector(9.0, beamwidth_deg=60)), RadioUnit("b", 1), RadioUnit("c", 2)]
    now = moment([(0, 0), (10, 0), (-10, 0)])
    heard = rssi(LinkBudget(radios, FreeSpace(), seed=1), now)
    assert heard[0, 1] - heard[0, 2] == pytest.approx(20.0)
    assert heard[1, 0] - heard[2, 0] == pytest.approx(20.0)


@pytest.mark.parametrize("model", [FreeSpace(), Tunnel()])
def test_the_same_seed_place_and_time_are_heard_the_same(model: PropagationModel) -> None:
    now = moment([(0, 0), (60, 0), (90, 0)])
    budgets = [LinkBudget(units(3), model, seed=seed) for seed in (5, 5, 6)]
    first, again, other = (rssi(budget, now, at_s=3.0) for budget in budgets)
    assert np.array_equal(first, again)
    assert np.array_equal(first, other) == (not isinstance(model, Tunnel))


def test_fading_behind_a_corner_keeps_the_mean_and_goes_deep() -> None:
    model = Tunnel.model_validate({"shadowing": "0dB"})
    budget = LinkBudget(units(2), model, seed=9)
    heard = []
    for step in range(4000):
        now = moment([(0, 0), (60 + 0.05 * step, 0)])
        geometry = open_ground(now, budget.node_of_radio, corners=1.0, width_m=4.0)
        heard.append(budget.rssi_dbm(now, geometry, 0.0)[0, 1] + model.path_loss_db(geometry, 2.437e9)[0, 1] - 20.0)
    power = 10 ** (np.array(heard) / 10)
    assert power.mean() == pytest.approx(1.0, abs=0.1)
    assert np.percentile(heard, 1) < -15  # Rayleigh: 1 % of the time 20 dB down
