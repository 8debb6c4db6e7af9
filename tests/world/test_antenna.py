"""Antenna patterns and the gains of pairs."""

from __future__ import annotations

import numpy as np
import pytest

from netlab.world.antenna import Antenna, Antennas, omni, sector, table


def gain(antenna: Antenna, angle_deg: float, *, heading_deg: float = 0.0) -> float:
    """Towards ``angle_deg``, against an isotropic antenna."""
    bearing = np.array([[0.0, angle_deg], [angle_deg + 180.0, 0.0]])
    both = Antennas([antenna, omni()]).gain_dbi(np.array([heading_deg, 0.0]), bearing)
    assert both[0, 1] == both[1, 0]
    return float(both[0, 1])


def test_omni_is_the_same_all_around() -> None:
    assert {gain(omni(2.0), angle) for angle in (0, 33.3, 180, 359.9, -700)} == {2.0}


def test_a_sector_is_three_db_down_at_the_edges_of_its_beam() -> None:
    """3GPP TR 36.814: 12 (angle / beamwidth)^2 dB, at most the front-to-back ratio."""
    antenna = sector(9.0, beamwidth_deg=60, front_to_back_db=25.0)
    assert gain(antenna, 0) == pytest.approx(9.0)
    assert gain(antenna, 30) == pytest.approx(6.0)
    assert gain(antenna, -30) == pytest.approx(6.0)
    assert gain(antenna, 60) == pytest.approx(9.0 - 12.0)
    assert gain(antenna, 180) == pytest.approx(9.0 - 25.0)


def test_a_sector_turns_with_its_robot() -> None:
    antenna = sector(9.0, beamwidth_deg=60)
    assert gain(antenna, 90, heading_deg=90) == pytest.approx(9.0)
    assert gain(antenna, 350, heading_deg=-10) == pytest.approx(9.0)
    assert gain(antenna, 0, heading_deg=90) == pytest.approx(-11.0)


def test_fore_and_aft_sectors_leave_the_sides_weak() -> None:
    antenna = sector(6.0, beamwidth_deg=70, facing_deg=(0.0, 180.0))
    assert gain(antenna, 0) == gain(antenna, 180) == pytest.approx(6.0)
    assert gain(antenna, 90) == pytest.approx(6.0 - 12 * (90 / 70) ** 2)


def test_a_measured_pattern_is_linear_between_its_points_and_around_the_circle() -> None:
    antenna = table([(0, 10.0), (90, 0.0), (270, 4.0)])
    assert gain(antenna, 45) == pytest.approx(5.0)
    assert gain(antenna, 44.1) == pytest.approx(5.1)
    assert gain(antenna, 180) == pytest.approx(2.0)
    assert gain(antenna, 315) == pytest.approx(7.0)
    assert gain(antenna, -45) == pytest.approx(7.0)
    assert gain(table([(-90, 3.0)]), 12.0) == 3.0


def test_both_ends_count() -> None:
    bearing = np.array([[0.0, 0.0], [180.0, 0.0]])
    facing = [sector(9.0, beamwidth_deg=60), sector(5.0, beamwidth_deg=60)]
    away = Antennas(facing).gain_dbi(np.array([0.0, 0.0]), bearing)[0, 1]
    towards = Antennas(facing).gain_dbi(np.array([0.0, 180.0]), bearing)[0, 1]
    assert (away, towards) == (pytest.approx(9 + 5 - 20), pytest.approx(14.0))


def test_impossible_patterns_are_refused() -> None:
    for make in (
        lambda: table([]),
        lambda: table([(10, 1.0), (370, 2.0)]),
        lambda: sector(5, beamwidth_deg=0),
        lambda: sector(5, beamwidth_deg=60, facing_deg=()),
        lambda: Antenna((1.0,)),
        lambda: omni(float("nan")),
    ):
        with pytest.raises(ValueError, match=r"point|sector|angle|finite"):
            make()
