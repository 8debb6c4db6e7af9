"""The one command that installs the dissectors."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from click.testing import CliRunner

from netlab.cli.wireshark import wireshark
from netlab.errors import MachineError
from netlab.scapy_layers.udp_mesh import Ping
from netlab.wireshark import plugin
from tests.wireshark.tshark_rig import Tape, Tshark, datagram

FILES = {path.name for path in plugin.dissectors()}


def run(*words: str) -> str:
    result = CliRunner().invoke(wireshark, list(words))
    assert result.exit_code == 0, result.output
    return result.output


def test_installing_twice_changes_nothing(tmp_path: Path) -> None:
    target = tmp_path / "plugins" / "netlab"
    assert "installed" in run("install", "--dir", str(tmp_path / "plugins"))
    assert {path.name for path in target.iterdir()} == FILES | {plugin.MANIFEST}
    assert {"udp_mesh.lua", "flood.lua"} <= FILES
    assert "up to date" in run("install", "--dir", str(tmp_path / "plugins"))


def test_installing_renews_and_removes_what_an_older_version_left(tmp_path: Path) -> None:
    plugin.install(tmp_path)
    target = tmp_path / "netlab"
    (target / "flood.lua").write_text("-- old")
    (target / "gone.lua").write_text("-- not shipped any more")
    with (target / plugin.MANIFEST).open("a") as manifest:
        manifest.write("gone.lua\n../../escaped.lua\n")
    (tmp_path / "escaped.lua").write_text("-- somebody else's")
    (target / "mine.lua").write_text("-- a person's own")
    assert "installed" in run("install", "--dir", str(tmp_path))
    assert (target / "flood.lua").read_text() == (plugin.LUA / "flood.lua").read_text()
    assert not (target / "gone.lua").exists()
    assert "removed" in run("uninstall", "--dir", str(tmp_path))
    assert [path.name for path in target.iterdir()] == ["mine.lua"]
    assert (tmp_path / "escaped.lua").exists()


def test_uninstalling_leaves_nothing(tmp_path: Path) -> None:
    plugin.install(tmp_path)
    assert "removed" in run("uninstall", "--dir", str(tmp_path))
    assert list(tmp_path.iterdir()) == []
    assert "nothing was installed" in run("uninstall", "--dir", str(tmp_path))


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "netlab").write_text("in the way")
    with pytest.raises(MachineError, match=f"{tmp_path}/netlab: .*--dir"):
        plugin.install(tmp_path)
    words = [sys.executable, "-m", "netlab", "wireshark", "install", "--dir", str(tmp_path)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert done.stderr.startswith(f"{tmp_path}/netlab: ")
    assert "Traceback" not in done.stderr


def test_tshark_finds_what_was_installed_for_it(tshark: Tshark) -> None:
    words = [tshark.program, "-G", "protocols"]
    said = subprocess.run(words, capture_output=True, text=True, env=tshark.env, check=True).stdout
    known = {line.split("\t")[2] for line in said.splitlines() if line.count("\t") >= 2}
    assert {"udp_mesh", "udp_mesh_ethernet", "udp_mesh_serial", "netlab_flood", "netlab_traffic"} <= known


def test_without_tshark_the_usual_folder_is_taken(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    monkeypatch.setenv("HOME", str(tmp_path))
    assert plugin.plugin_folder() == tmp_path / ".local/lib/wireshark/plugins"


def test_the_dissectors_run_from_where_they_lie(tmp_path: Path, tshark: Tshark, tape: Tape) -> None:
    """As docs/wireshark.md says, for who does not want to install anything."""
    elsewhere = Tshark(tshark.program, tmp_path)
    tape.add(datagram("base", "", 0, Ping()))
    assert "PING" not in elsewhere(tape.path)
    script = Path(run("path").strip()) / "udp_mesh.lua"
    assert "PING" in elsewhere(tape.path, "-X", f"lua_script:{script}")
