"""The process `rose` in a scenario: what its file says then, and mistakes with their lines."""

from __future__ import annotations

from pathlib import Path

import pytest

from netlab.engines.plan import compile_plan
from netlab.errors import ScenarioError
from netlab.lab.programs import node_processes
from netlab.scenario import parse_scenario
from rose.config.model import load_host

KEY = "ab" * 32
TEXT = f"""\
name: services
duration: 1s
mesh: wnet
rose: {{key: "{KEY}"}}
nodes:
  husky:
    processes: [rose]
    rose:
      services:
        - {{name: laser, service: 10, run: "rose.examples.laser:Laser", settings: {{rate_hz: 20}}, priority: 1}}
  base:
    processes: [rose]
    rose:
      accept_configuration: true
      services:
        - {{name: map, service: 1, robot: 2, run: "rose.examples.mapping:Mapping", settings: {{laser: husky/0.10}}}}
links:
  - {{between: [husky, base]}}
"""


def test_each_host_gets_a_file_that_rose_itself_accepts(tmp_path: Path) -> None:
    scenario = parse_scenario(TEXT)
    (husky,) = node_processes(scenario, "husky", tmp_path, compile_plan(scenario))
    (base,) = node_processes(scenario, "base", tmp_path, compile_plan(scenario))
    assert husky.argv[:2] == base.argv[:2] == ("rose", "run")
    assert husky.waits_for_ready
    laser, mapping = load_host(Path(husky.argv[2])), load_host(Path(base.argv[2]))
    assert str(laser.host) == "10.240.0.1"
    assert (laser.services[0].service, laser.services[0].priority) == (10, 1)  # not 1, as a number 0.10 would be
    assert laser.services[0].settings == {"rate_hz": 20}
    assert laser.keys.team == [bytes.fromhex(KEY)]
    assert (laser.accepts, mapping.accepts) == (False, True)
    assert mapping.services[0].settings == {"laser": "10.240.0.1/0.10"}  # a node's name is its address
    assert Path(husky.argv[2]).stat().st_mode & 0o077 == 0, "it holds a key"


RUNS_IT = "processes: [rose]\n    rose:\n      services:\n        - {name: laser"


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        (RUNS_IT, RUNS_IT.removeprefix("processes: [rose]\n    "), "'husky' does not run it; add processes: [rose]"),
        ("husky/0.10", "huskey/0.10", "services[0].settings: node 'huskey' is not defined; did you mean 'husky'?"),
        ("service: 10", "service: 1024", "services[0].service: '1024' is impossible; it must be below 1024"),
        ("service: 10", "service: 0", "service 0 of robot 0 is the host's Service Manager; take another number"),
        ('run: "rose.examples.laser:Laser", ', "", "give either run: MODULE:CLASS or argv: [PROGRAM, ...]"),
        ("settings: {rate_hz: 20}", "setings: {}", "unknown key 'setings'; did you mean 'settings'?"),
        (KEY, "short", "expected 64 hexadecimal digits in quotes"),
    ],
)
def test_mistakes_are_told(old: str, new: str, told: str) -> None:
    assert old in TEXT
    with pytest.raises(ScenarioError) as caught:
        parse_scenario(TEXT.replace(old, new, 1))
    assert any(told in problem for problem in caught.value.problems), caught.value.problems
