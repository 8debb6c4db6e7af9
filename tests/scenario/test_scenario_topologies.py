"""The scenarios that the project ships: they load, compile, explain themselves and expect something."""

from pathlib import Path

import pytest
import yaml

from netlab.engines.plan import compile_plan
from netlab.scenario import load_scenario
from netlab.scenario.schema import json_schema
from netlab.timeline import compile_timeline

TOPOLOGIES = sorted((Path(__file__).parents[2] / "topologies").glob("*.yaml"))


def test_the_promised_ones_are_there() -> None:
    names = {path.stem for path in TOPOLOGIES}
    assert names >= {"pair", "bottleneck", "outage", "flapping", "lossy", "star", "line", "default"}


@pytest.mark.parametrize("path", TOPOLOGIES, ids=lambda path: path.stem)
def test_it_loads_compiles_and_expects(path: Path) -> None:
    scenario = load_scenario(path)
    plan = compile_plan(scenario)
    compile_timeline(scenario, plan)
    assert path.read_text().startswith("# ")
    assert scenario.name == path.stem
    assert scenario.expect
    assert scenario.duration_s <= 60 or path.stem in ("subt_final", "full_maps")


@pytest.mark.parametrize("path", TOPOLOGIES, ids=lambda path: path.stem)
def test_the_schema_for_editors_knows_its_keys(path: Path) -> None:
    properties = json_schema()["properties"]
    assert yaml.safe_load(path.read_text()).keys() <= properties.keys()


def test_the_bottleneck_is_the_one_that_the_project_is_measured_by() -> None:
    scenario = load_scenario(TOPOLOGIES[0].with_name("bottleneck.yaml"))
    [wire] = scenario.wires()
    assert wire.forward.rate_bps == 10e6
    assert wire.forward.delay_s == 0.02
    assert wire.forward.limit is not None
    assert wire.forward.limit.packets == 50
    telemetry, bulk = scenario.traffic
    assert (telemetry.priority, telemetry.rate_hz, bulk.priority) == (1, 10.0, 9)
    assert bulk.size_bytes * 8 * bulk.rate_hz > 1.2 * wire.forward.rate_bps, "the bulk must saturate the link"


def test_priorities_and_probing_can_be_switched_off_from_outside() -> None:
    for name, key in (("bottleneck", "prioritise"), ("outage", "probe")):
        scenario = load_scenario(TOPOLOGIES[0].with_name(f"{name}.yaml"), overrides=[f"udp_mesh.{key}=false"])
        assert scenario.mesh_settings("base") == {key: False}
