"""Every propagation model against numbers of its source."""

from __future__ import annotations

import math
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from netlab.world.geometry import Geometry
from netlab.world.propagation.free_space import FreeSpace
from netlab.world.propagation.log_distance import LogDistance
from netlab.world.propagation.model import SPEED_OF_LIGHT_MPS, PropagationModel
from netlab.world.propagation.registry import MODELS, model_class
from netlab.world.propagation.subt import Subt
from netlab.world.propagation.tunnel import Tunnel
from netlab.world.walls import MATERIALS, Section, Walls

WIFI_HZ = 2.437e9


def way(
    distance_m: float,
    *,
    corners: float = 0.0,
    width_m: float = 4.0,
    height_m: float | None = None,
    sections: dict[Section, float] | None = None,
) -> Geometry:
    """Two radios and the way between them, by default all in one kind of tunnel without known walls."""
    height_m = width_m if height_m is None else height_m
    parts = sections or {Section(width_m, height_m): 1.0}

    def both(value: float) -> np.ndarray:
        return np.array([[0.0, value], [value, 0.0]])

    return Geometry(
        distance_m=both(distance_m),
        corners=both(corners),
        line_of_sight=np.full((2, 2), corners == 0),
        width_m=np.full((2, 2), width_m),
        height_m=np.full((2, 2), height_m),
        bearing_deg=np.zeros((2, 2)),
        sections=tuple(parts),
        shares=np.array([both(share) for share in parts.values()]),
    )


def loss_db(model: PropagationModel, geometry: Geometry, frequency_hz: float = WIFI_HZ) -> float:
    losses = model.path_loss_db(geometry, frequency_hz)
    assert losses[0, 1] == losses[1, 0]
    return float(losses[0, 1])


@pytest.mark.parametrize(
    ("frequency_mhz", "distance_km", "expected_db"),
    [(1000, 1.0, 92.4), (2400, 0.1, 80.0), (2400, 0.001, 40.0), (5800, 0.1, 87.7)],
)
def test_free_space_is_itu_r_p_525(frequency_mhz: float, distance_km: float, expected_db: float) -> None:
    """ITU-R P.525-4, equation 4: 32.4 + 20 log10(f in MHz) + 20 log10(d in km)."""
    formula = 32.4 + 20 * math.log10(frequency_mhz) + 20 * math.log10(distance_km)
    got = loss_db(FreeSpace(), way(distance_km * 1e3), frequency_mhz * 1e6)
    assert got == pytest.approx(formula, abs=0.06)
    assert got == pytest.approx(expected_db, abs=0.1)


def test_nearer_than_a_metre_nothing_gets_stronger() -> None:
    assert loss_db(FreeSpace(), way(0.0)) == loss_db(FreeSpace(), way(1.0))


def test_log_distance_is_rappaports_formula() -> None:
    """Rappaport, example 4.9's kind: 0 dBm at 100 m, exponent 4.4: 10 times the distance costs 44 dB."""
    model = LogDistance.model_validate({"exponent": 4.4, "reference_distance": "100m", "reference_loss": "60dB"})
    assert loss_db(model, way(100.0)) == pytest.approx(60.0)
    assert loss_db(model, way(1000.0)) == pytest.approx(104.0)
    assert loss_db(model, way(10.0)) == pytest.approx(60.0)


def test_log_distance_starts_from_free_space_and_counts_corners() -> None:
    model = LogDistance.model_validate({"exponent": 2, "corner_loss": "15dB"})
    assert loss_db(model, way(50.0)) == pytest.approx(loss_db(FreeSpace(), way(50.0)))
    assert loss_db(model, way(50.0, corners=1.5)) == pytest.approx(loss_db(FreeSpace(), way(50.0)) + 22.5)


@pytest.mark.parametrize(("frequency_mhz", "per_100_m_db"), [(455, 9.5), (900, 6.0), (2400, 10.8), (5800, 25.0)])
def test_the_walls_attenuate_as_emslies_table(frequency_mhz: float, per_100_m_db: float) -> None:
    """Emslie, Lagace and Strong 1975, for a tunnel of 5 m by 3 m: least near 900 MHz."""
    decay = MATERIALS["coal"].attenuation_db_per_m(5.0, 3.0, wavelength_m=SPEED_OF_LIGHT_MPS / frequency_mhz / 1e6)
    assert decay * 100 == pytest.approx(per_100_m_db, rel=0.03)


def test_refraction_alone_falls_with_the_square_of_the_frequency() -> None:
    smooth = Walls(10.0, roughness_m=0.0, tilt_deg=0.0)
    low, high = (smooth.attenuation_db_per_m(4.0, 3.0, wavelength_m=length_m) for length_m in (0.3, 0.15))
    assert low / high == pytest.approx(4.0)
    # 4.343 wavelength^2 (K / (w^3 sqrt(K - 1)) + 1 / (h^3 sqrt(K - 1))), K = 10
    assert low == pytest.approx(4.343 * 0.3**2 * (10 / (64 * 3) + 1 / (27 * 3)), rel=1e-3)


def test_a_tunnel_is_free_space_up_to_its_breakpoint_and_slow_beyond() -> None:
    breakpoint_m = 16.0 * WIFI_HZ / SPEED_OF_LIGHT_MPS  # 4 m wide: 130 m
    model = Tunnel()
    assert loss_db(model, way(100.0)) == pytest.approx(loss_db(FreeSpace(), way(100.0)))
    at_breakpoint = loss_db(FreeSpace(), way(breakpoint_m))
    assert loss_db(model, way(breakpoint_m)) == pytest.approx(at_breakpoint)
    assert loss_db(model, way(10 * breakpoint_m)) == pytest.approx(at_breakpoint + 12.5)


def test_the_breakpoint_goes_by_the_larger_side_or_is_given() -> None:
    assert loss_db(Tunnel(), way(300.0, width_m=2.0, height_m=4.0)) == loss_db(Tunnel(), way(300.0, width_m=4.0))
    given_m = Tunnel.model_validate({"breakpoint": "10m"})
    assert loss_db(given_m, way(100.0)) == pytest.approx(loss_db(FreeSpace(), way(10.0)) + 12.5)


def test_a_tunnel_with_walls_decays_by_the_metre() -> None:
    model = Tunnel.model_validate({"walls": {}, "breakpoint": "50m"})
    decay = Walls().attenuation_db_per_m(5.0, 3.0, wavelength_m=SPEED_OF_LIGHT_MPS / WIFI_HZ)
    got = loss_db(model, way(150.0, width_m=5.0, height_m=3.0))
    assert got == pytest.approx(loss_db(FreeSpace(), way(50.0)) + 100 * decay)


def test_each_tunnel_on_the_way_attenuates_its_own_part() -> None:
    """50 m of 150 m are free space; a third of the other 100 m is a coal mine, two thirds a lined passage."""
    coal, lined = Section(5.0, 3.0, MATERIALS["coal"]), Section(3.0, 3.0, MATERIALS["concrete"])
    per_m = [
        kind.walls.attenuation_db_per_m(kind.width_m, kind.height_m, wavelength_m=SPEED_OF_LIGHT_MPS / WIFI_HZ)
        for kind in (coal, lined)
        if kind.walls
    ]
    got = loss_db(Tunnel.model_validate({"breakpoint": "50m"}), way(150.0, sections={coal: 1 / 3, lined: 2 / 3}))
    assert got == pytest.approx(loss_db(FreeSpace(), way(50.0)) + 100 / 3 * per_m[0] + 200 / 3 * per_m[1])


def test_tunnels_without_a_material_keep_the_slope_or_get_the_models_walls() -> None:
    plain, coal = Section(4.0, 4.0), Section(4.0, 4.0, MATERIALS["coal"])
    mixed = way(450.0, sections={plain: 0.5, coal: 0.5})
    decay = MATERIALS["coal"].attenuation_db_per_m(4.0, 4.0, wavelength_m=SPEED_OF_LIGHT_MPS / WIFI_HZ)
    slope = Tunnel.model_validate({"breakpoint": "50m"})
    near = loss_db(FreeSpace(), way(50.0))
    assert loss_db(slope, mixed) == pytest.approx(near + 12.5 * math.log10(1 + 200 / 50) + 200 * decay)
    walled = Tunnel.model_validate({"breakpoint": "50m", "walls": "brick"})
    lined = MATERIALS["brick"].attenuation_db_per_m(4.0, 4.0, wavelength_m=SPEED_OF_LIGHT_MPS / WIFI_HZ)
    assert loss_db(walled, mixed) == pytest.approx(near + 200 * lined + 200 * decay)
    assert loss_db(walled, way(450.0)) == pytest.approx(near + 400 * lined)


def test_corners_cost_their_loss() -> None:
    straight = loss_db(Tunnel(), way(80.0))
    assert loss_db(Tunnel(), way(80.0, corners=1.0)) == pytest.approx(straight + 20.0)
    assert loss_db(Tunnel.model_validate({"corner_loss": "30dB"}), way(80.0, corners=2.5)) == pytest.approx(
        straight + 75
    )


@pytest.mark.parametrize(
    ("distance_m", "corners", "expected_db"),
    [
        # osrf/subt: 40 + 10 (2.5 + 0.2 C) log10(d)
        (10.0, 0.0, 40 + 10 * 2.5 * 1.0),  # one tile
        (100.0, 0.0, 40 + 10 * (2.5 + 0.2 * 5) * 2.0),  # five tiles
        (100.0, 1.0, 40 + 10 * (2.5 + 0.2 * 9) * 2.0),  # and a turn of 3 + 3 - 2
    ],
)
def test_subt_is_its_simulators_formula(distance_m: float, corners: float, expected_db: float) -> None:
    for frequency_hz in (1e9, WIFI_HZ):
        assert loss_db(Subt(), way(distance_m, corners=corners), frequency_hz) == pytest.approx(expected_db)


def test_subt_ends_at_its_limits() -> None:
    assert loss_db(Subt(), way(315.0)) < 200  # cost 15
    assert loss_db(Subt(), way(325.0)) >= 1000  # cost 16
    assert loss_db(Subt(), way(200.0, corners=2.0)) >= 1000
    far = Subt.model_validate({"most_cost": 1000})
    assert loss_db(far, way(500.0)) < 1000 <= loss_db(far, way(501.0))


@pytest.mark.parametrize("name", MODELS)
@given(
    distance_m=st.floats(0, 2000) | st.just(math.inf),
    corners=st.floats(0, 9),
    width_m=st.floats(0.5, 30) | st.just(math.nan),
)
def test_no_geometry_yields_nan_and_farther_is_never_louder(
    name: str, distance_m: float, corners: float, width_m: float
) -> None:
    model = MODELS[name]()
    near = loss_db(model, way(distance_m, corners=corners, width_m=width_m))
    far = loss_db(model, way(distance_m * 1.1 + 1, corners=corners, width_m=width_m))
    assert not math.isnan(near)
    assert near <= far + 1e-9


def test_words_have_units_and_bounds() -> None:
    with pytest.raises(ValidationError, match="has no unit"):
        Tunnel.model_validate({"corner_loss": 20})
    with pytest.raises(ValidationError, match="did you mean 'corner_loss'"):
        Tunnel.model_validate({"corner_los": "20dB"})
    settings = Tunnel.model_validate({"shadowing": "4dB", "fading": False}).fading_settings
    assert (settings.shadowing_db, settings.rice_k_db) == (4.0, None)
    assert Tunnel().fading_settings.rice_k_db == 6.0
    assert FreeSpace().fading_settings.rice_k_db is None


def test_a_model_is_found_by_its_name() -> None:
    assert model_class("tunnel") is Tunnel
    with pytest.raises(ValueError, match="unknown propagation model 'tunel'; did you mean 'tunnel'"):
        model_class("tunel")


def test_a_users_own_model_is_found_by_its_path(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "salt_mine_model.py").write_text(
        "import numpy as np\n"
        "from netlab.world.propagation.model import PropagationModel\n"
        "class Salt(PropagationModel):\n"
        "    per_metre: float = 1.0\n"
        "    def path_loss_db(self, geometry, frequency_hz):\n"
        "        return self.per_metre * geometry.distance_m\n"
        "class Other: pass\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    salt = model_class("salt_mine_model:Salt").model_validate({"per_metre": 2.0})
    assert loss_db(salt, way(30.0)) == 60.0
    for path, complaint in [
        ("salt_mine_model:Pepper", "has no class Pepper"),
        ("salt_mine_model:Other", "must be a class derived from"),
        ("no_such_module_here:Salt", "must be importable"),
    ]:
        with pytest.raises(ValueError, match=complaint):
            model_class(path)
    sys.modules.pop("salt_mine_model", None)
