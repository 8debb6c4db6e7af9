"""The daemon's file: what is read, and that every mistake is told at once."""

from __future__ import annotations

from pathlib import Path

import pytest

from wnet.config import ConfigError, MeshConfig
from wnet.daemon_config import DaemonConfig, MemberConfig, load, parse_file

FILE = """
interface = "mesh0"
address = "10.9.0.1/16"
members = [{interface = "eth0"}, {interface = "mon0", radio = true, rates_bps = [12000000, 6000000]}]
[mesh]
tries = 2
"""


def test_a_file_is_read(tmp_path: Path) -> None:
    file = tmp_path / "wnet.toml"
    file.write_text(FILE)
    members = (MemberConfig("eth0"), MemberConfig("mon0", True, (6_000_000, 12_000_000)))
    expected = DaemonConfig(members, "mesh0", "10.9.0.1/16", mesh=MeshConfig(tries=2))
    assert load(str(file)) == expected


def test_all_mistakes_are_told_at_once() -> None:
    table = {
        "interface": "a-name-that-is-too-long",
        "adress": "10.0.0.1",
        "address": "here",
        "mtu_bytes": 20,
        "members": [{"interface": "eth0", "signal": 1}],
        "mesh": {"tries": 0, "key": "abc"},
    }
    with pytest.raises(ConfigError) as caught:
        parse_file(table, source="f.toml")
    problems = caught.value.problems
    assert len(problems) == 7
    assert all(problem.startswith("f.toml: ") for problem in problems)
    text = "\n".join(problems)
    assert "f.toml: adress: unknown key; known are members, interface, address, mtu_bytes, socket, mesh" in text
    assert "unknown key 'signal' of a member" in text
    assert "f.toml: mesh: tries: " in text
    assert "abc" not in text, "a secret stays out of messages"


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", 'members: missing; name the interfaces, as members = [{interface = "wlan0"}]'),
        ("members = 1", "has to be a list of members"),
        ('members = [{interface = "a"}, {interface = "a"}]', "names an interface twice"),
        ('members = [{interface = "a", radio = 1}]', "radio has to be true or false"),
        ("members =", "f.toml: "),
    ],
)
def test_a_mistake(tmp_path: Path, text: str, problem: str) -> None:
    file = tmp_path / "f.toml"
    file.write_text(text)
    with pytest.raises(ConfigError) as caught:
        load(str(file))
    assert problem in str(caught.value)


def test_a_file_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="No such file"):
        load(str(tmp_path / "none.toml"))
