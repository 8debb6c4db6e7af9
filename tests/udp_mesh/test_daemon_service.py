"""The daemon as a service: its manager is told, its state has a place, its unit file says so."""

from __future__ import annotations

import configparser
import socket
from pathlib import Path

import pytest

import udp_mesh
from udp_mesh.config import Config
from udp_mesh.daemon import tell_systemd


@pytest.mark.parametrize("is_abstract", [False, True])
def test_the_service_manager_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, is_abstract: bool) -> None:
    path = f"@udp-mesh-test-{tmp_path.name}" if is_abstract else str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind("\0" + path[1:] if is_abstract else path)
        manager.settimeout(2.0)
        monkeypatch.setenv("NOTIFY_SOCKET", path)
        tell_systemd("READY=1")
        assert manager.recv(100) == b"READY=1"


def test_no_manager_is_no_fault(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    tell_systemd("READY=1")
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "nobody"))
    tell_systemd("READY=1")


def test_the_store_lies_where_the_service_keeps_its_state(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("STATE_DIRECTORY", f"{tmp_path}:/elsewhere")
    assert Config(name="a/b").store_path() == str(tmp_path / "a_b.db")
    assert Config(name="a", store="/x/y.db").store_path() == "/x/y.db"


def test_the_unit_waits_for_readiness_and_keeps_state() -> None:
    unit = configparser.RawConfigParser(strict=False)
    unit.optionxform = str  # type: ignore[assignment,method-assign]
    unit.read(Path(udp_mesh.__file__).parent / "systemd" / "udp-mesh.service")
    service = unit["Service"]
    assert (service["Type"], service["StateDirectory"], service["Restart"]) == ("notify", "udp_mesh", "always")
    assert "udp-mesh daemon" in service["ExecStart"]
