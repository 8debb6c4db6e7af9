"""Words for propagation and antennas: what they become, and what is refused."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from netlab.errors import ScenarioError
from netlab.scenario import parse_scenario
from netlab.scenario.radio_physics import (
    MODEL_NAMES,
    AntennaWords,
    RadioEnds,
    is_physical,
    propagation_model,
)
from netlab.scenario.schema import json_schema
from netlab.world.antenna import omni, sector, table
from netlab.world.propagation.registry import MODELS
from netlab.world.propagation.tunnel import Tunnel
from netlab.world.walls import MATERIALS, Walls


def complaint(value: object) -> str:
    with pytest.raises(ValidationError) as caught:
        AntennaWords.model_validate(value)
    return caught.value.errors()[0]["msg"]


def test_the_names_are_those_of_the_registry() -> None:
    assert tuple(MODELS) == MODEL_NAMES


def test_physical_models_are_told_from_those_that_need_no_positions() -> None:
    assert is_physical("tunnel")
    assert is_physical("salt_mine:Salt")
    assert not is_physical("none")
    assert not is_physical("table")
    assert not is_physical(["tunnel"])


def test_a_block_becomes_its_model() -> None:
    model = propagation_model({"model": "tunnel", "corner_loss": "17dB", "walls": {"tilt": "0.5deg"}})
    assert isinstance(model, Tunnel)
    assert (model.corner_loss_db, model.walls and model.walls.tilt_deg) == (17.0, 0.5)
    with pytest.raises(ValidationError):
        propagation_model({"model": "free_space", "corner_loss": "17dB"})


TUNNELS = "terrain: {tunnels: [{name: a, path: [[0, 0], [90, 0]], width: 4m, material: limestone}]}\n"


def test_a_tunnel_has_a_material_by_name_or_by_its_properties() -> None:
    text = "duration: 1s\nnodes: {a: }\n" + TUNNELS
    assert parse_scenario(text).terrain.tunnel_map.tunnels[0].walls == MATERIALS["limestone"]
    block = text.replace("limestone", "{permittivity: 7, roughness: 20cm, tilt: 0deg}")
    assert parse_scenario(block).terrain.tunnel_map.tunnels[0].walls == Walls(7.0, 0.2, 0.0)
    radio = "radio: {phy: subt, propagation: {model: tunnel, walls: concrete}}\n"
    assert parse_scenario(text + radio).radio.propagation.physics.walls.walls == MATERIALS["concrete"]


def test_a_material_that_the_model_does_not_know_is_refused() -> None:
    text = "duration: 1s\nnodes: {a: }\nradio: {phy: subt, propagation: {model: subt}}\n" + TUNNELS
    with pytest.raises(ScenarioError) as caught:
        parse_scenario(text, name="s.yaml")
    [problem] = caught.value.problems
    assert problem == (
        "s.yaml:4: terrain.tunnels[0].material: propagation model subt does not know what tunnels are made of; "
        "use model: tunnel, or remove material"
    )


def test_the_schema_has_every_model_with_its_words() -> None:
    schema = json_schema()
    blocks = schema["$defs"]["Propagation"]["anyOf"]
    words = {block["properties"]["model"].get("const"): block["properties"] for block in blocks}
    assert set(MODEL_NAMES) <= set(words)
    assert "corner_loss" in words["tunnel"]
    assert "$defs/WallWords" in str(words["tunnel"]["walls"])
    assert "WallWords" in schema["$defs"]


@pytest.mark.parametrize(
    ("words", "antenna"),
    [
        ("omni", omni()),
        ({"gain": "5dBi"}, omni(5.0)),
        ({"gain": "9dB", "beamwidth": "60deg"}, sector(9.0, beamwidth_deg=60)),
        (
            {"gain": "9dB", "beamwidth": "60deg", "facing": "both", "front_to_back": "25dB"},
            sector(9.0, beamwidth_deg=60, front_to_back_db=25, facing_deg=(0, 180)),
        ),
        ({"gain": "9dB", "beamwidth": "60deg", "facing": "back"}, sector(9.0, beamwidth_deg=60, facing_deg=(180,))),
        ({"beamwidth": "60deg", "facing": ["front", "-90deg"]}, sector(0.0, beamwidth_deg=60, facing_deg=(0, -90))),
        ({"pattern": [["0deg", "9dB"], ["180deg", "-6dB"]]}, table([(0, 9.0), (180, -6.0)])),
    ],
)
def test_antennas(words: object, antenna: object) -> None:
    assert AntennaWords.model_validate(words).antenna() == antenna


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ("dish", "'dish' is no antenna; write omni"),
        ({"facing": "back"}, "facing belongs to a sector; add beamwidth"),
        ({"front_to_back": "20dB"}, "front_to_back belongs to a sector"),
        ({"beamwidth": "60deg", "facing": "frond"}, "did you mean 'front'"),
        ({"beamwidth": "60deg", "facing": "90"}, "has no unit"),
        ({"beamwidth": "60deg", "facing": []}, "faces somewhere"),
        ({"pattern": []}, "expected a list of"),
        ({"pattern": [["0deg"]]}, "expected [angle, gain]"),
        ({"pattern": [["0deg", "1dB"], ["360deg", "2dB"]]}, "two gains at the same angle"),
        ({"pattern": [["0deg", "1dB"]], "gain": "3dB"}, "remove the other words"),
        ({"gain": 3}, "has no unit"),
    ],
)
def test_antennas_that_are_none(words: object, expected: str) -> None:
    assert expected in complaint(words)


def test_a_nodes_own_radio_says_only_what_differs() -> None:
    own = RadioEnds.model_validate({"tx_power": "33dBm", "frequency": "5.18GHz", "antenna": "omni"})
    assert (own.tx_power_dbm, own.frequency_hz) == (33.0, 5.18e9)
    assert RadioEnds().tx_power_dbm is None
