"""Configuration files: the same in YAML and XML, and every mistake with its line."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rose.changes import changes
from rose.config.model import HostConfig, ServiceConfig, load_host, load_team, team_collisions
from rose.config.tree import Complaints
from rose.config.xml_file import read_xml
from rose.config.yaml_file import read_yaml
from rose.core.addressing import ServiceId
from rose.errors import ConfigError

KEY = "00" * 31 + "01"
YAML = f"""\
host: 10.0.0.114
keys:
  - "{KEY}"
  - {{of: 10.0.0.7/0.1, text: "{"22" * 32}"}}
accept_configuration: true
services:
  - name: laser
    id: 0.10
    run: rose.examples.laser:Laser
    settings: {{rate_hz: 20, beams: 360}}
    priority: 1
  - name: camera
    id: 0.2
    argv: [camera, --fast]
    transport: udp_mesh
    offline: latest
    restart: never
"""
XML = f"""\
<rose host="10.0.0.114" accept_configuration="true">
  <key>{KEY}</key>
  <key of="10.0.0.7/0.1">{"22" * 32}</key>
  <service name="laser" id="0.10" run="rose.examples.laser:Laser" priority="1">
    <setting name="rate_hz">20</setting>
    <setting name="beams">360</setting>
  </service>
  <service name="camera" id="0.2" transport="udp_mesh" offline="latest" restart="never">
    <arg>camera</arg>
    <arg>--fast</arg>
  </service>
</rose>
"""


def written(tmp_path: Path, text: str, name: str = "host.yaml") -> Path:
    path = tmp_path / name
    path.write_text(text)
    return path


def problems(tmp_path: Path, text: str, name: str = "host.yaml") -> list[str]:
    with pytest.raises(ConfigError) as caught:
        load_host(written(tmp_path, text, name))
    return [problem.removeprefix(f"{tmp_path}/") for problem in caught.value.problems]


def test_yaml_and_xml_say_the_same(tmp_path: Path) -> None:
    config = load_host(written(tmp_path, YAML))
    assert config == load_host(written(tmp_path, XML, "host.xml"))
    laser, camera = config.services
    assert (laser.robot, laser.service, laser.settings) == (0, 10, {"rate_hz": 20, "beams": 360})
    assert (camera.argv, camera.transport, camera.restart) == (("camera", "--fast"), "udp_mesh", False)
    assert config.keys.team == [bytes.fromhex(KEY)]
    assert config.keys.of(ServiceId.parse("10.0.0.7/0.1")) == [b"\x22" * 32]


def test_every_mistake_is_told_at_once_with_its_line(tmp_path: Path) -> None:
    text = """\
host: robot1
accept_configuration: true
services:
  - {name: a, id: 0.1, run: nonsense}
  - {name: a, id: 0.1, argv: [x], priority: 256}
  - {name: b, id: 0.0, run: "m:C", setings: {}}
  - {name: c, id: 40.1, run: "m:C", transport: tcp}
  - {name: d, id: one, argv: [x], run: "m:C"}
"""
    assert problems(tmp_path, text) == [
        "host.yaml:1: host: 'robot1' is no IP address",
        "host.yaml:1: accept_configuration: needs keys; else anybody could start programs here",
        "host.yaml:4: services[0].run: 'nonsense' is not MODULE:CLASS, such as rose.examples.laser:Laser",
        "host.yaml:5: services[1].priority: 256 is impossible; it is 0 to 255",
        "host.yaml:5: services[1].name: is that of services[0] too",
        "host.yaml:5: services[1].id: is that of services[0] too",
        "host.yaml:6: services[2].id: 0.0 is the Service Manager's own; take another",
        "host.yaml:6: services[2].setings: unknown key; did you mean 'settings'?",
        "host.yaml:7: services[3].transport: 'tcp' is not possible here; use udp, udp_mesh",
        "host.yaml:8: services[4].id: 'one' is not ROBOT.SERVICE, such as 0.1",
        "host.yaml:8: services[4].run: give either run: MODULE:CLASS or argv: [PROGRAM, ...]",
    ]


def test_robots_beyond_the_limit_of_ipv4(tmp_path: Path) -> None:
    text = 'host: 10.0.0.1\nservices:\n  - {id: 40.1, run: "m:C"}\n'
    (problem,) = problems(tmp_path, text)
    assert problem.startswith("host.yaml:3: services[0].id: robot 40 is impossible; it is 0 to 31")
    assert load_host(written(tmp_path, text.replace("10.0.0.1", '"fd00::1"'))).services[0].robot == 40


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("host.yaml", "", "host.yaml:1: the file is empty"),
        ("host.yaml", "host: [", "host.yaml:1: not YAML: "),
        ("host.yaml", "host: 10.0.0.1\nhost: 10.0.0.2\n", "host.yaml:2: host: is given twice (first in line 1)"),
        ("host.yaml", "host: &a 10.0.0.1\nx: *a\n", "host.yaml:2: aliases and deep nesting have no use here"),
        ("host.yaml", "host: " + "[" * 50, "host.yaml:1: aliases and deep nesting have no use here"),
        ("host.yaml", "- 1\n", "host.yaml:1: expected a block of keys, found a list"),
        ("host.xml", "<rose>\n<service>\n</rose>", "host.xml:3: not XML: mismatched tag"),
        ("host.xml", "", "host.xml:1: not XML: no element found"),
        ("host.xml", "<robot/>", "host.xml:1: the outermost element is <robot>; it has to be <rose>"),
        ("host.xml", "<!DOCTYPE a [<!ENTITY b 'c'>]><rose/>", "host.xml:1: document types and deep nesting"),
        ("host.xml", "<a>" * 50, "host.xml:1: document types and deep nesting"),
        (
            "host.xml",
            "<rose>\n<service><setting>1</setting></service></rose>",
            'host.xml:2: setting: has no name="..."',
        ),
        ("host.xml", "<rose host='10.0.0.1'>\n<wheel/><wheel/></rose>", "host.xml:2: wheel: is given twice"),
    ],
)
def test_files_that_are_nothing_are_told_with_their_line(tmp_path: Path, name: str, text: str, told: str) -> None:
    assert problems(tmp_path, text, name)[0].startswith(told)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"nowhere.yaml: cannot be read: No such file"):
        load_host(tmp_path / "nowhere.yaml")
    (tmp_path / "binary.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(ConfigError, match=r"binary.yaml: is not text"):
        load_host(tmp_path / "binary.yaml")


@given(st.text(max_size=300))
def test_no_text_raises_from_a_reader(text: str) -> None:
    for read in (read_yaml, read_xml):
        complaints = Complaints("f")
        assert (read(text, complaints) is None) <= bool(complaints.problems)


def test_a_team_in_one_file(tmp_path: Path) -> None:
    text = f"""\
host: 10.0.0.1
keys: ["{KEY}"]
hosts:
  10.0.0.7:
    services: [{{name: laser, id: 0.1, run: "rose.examples.laser:Laser"}}]
  10.0.1.7:
    services: [{{name: laser, id: 0.1, run: "rose.examples.laser:Laser"}}]
"""
    team = load_team(written(tmp_path, text))
    assert str(team.sid) == "10.0.0.1/0.1023"
    assert [str(host) for host in team.hosts] == ["10.0.0.7", "10.0.1.7"]
    assert len(team_collisions(team)) == 1  # the last bytes of both hosts are the same
    with pytest.raises(ConfigError, match="hosts take their configuration only from who has a key"):
        load_team(written(tmp_path, text.replace(f'keys: ["{KEY}"]', "keys: []")))


def service(number: int, **more: object) -> ServiceConfig:
    return ServiceConfig(name=f"s{number}", robot=0, service=number, run="m:C", **more)  # type: ignore[arg-type]


def test_only_what_differs_is_touched() -> None:
    old = [service(1), service(2), service(3), service(4)]
    new = [service(1), service(2, settings={"a": 1}), service(3, priority=1), service(5)]
    what = changes(old, new)
    assert [config.service for config in what.stop] == [3, 4]
    assert [config.service for config in what.start] == [3, 5]
    assert [config.service for config in what.configure] == [2]


def test_keys_are_not_shown(tmp_path: Path) -> None:
    config = load_host(written(tmp_path, YAML))
    assert isinstance(config, HostConfig)
    assert "\\x01" not in repr(config)
