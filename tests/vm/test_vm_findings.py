"""What `netlab doctor` says of the box: each choice, what it would give, and the way to it."""

from __future__ import annotations

from pathlib import Path

import pytest

from netlab.kernel.machine import Finding
from netlab.vm import cache, findings, qemu
from netlab.vm.fitness import INSIDE


def found() -> dict[str, Finding]:
    return {finding.name: finding for finding in findings.examine()}


def test_an_empty_cache_names_the_build_and_its_tools(store: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(findings, "missing_tools", lambda: ["flex", "gcc"])
    uml = found()["box: uml"]
    assert not uml.available
    assert uml.remedy == "sudo apt-get install flex gcc; then netlab vm build (about 10 minutes, once)"
    assert "virtual time" in uml.needed_for


def test_a_built_kernel_is_there(store: Path, tmp_path: Path) -> None:
    for name in ("linux", ".config"):
        (tmp_path / name).touch()
    cache.install(tmp_path / "linux", tmp_path / ".config", "6.1-1")
    assert found()["box: uml"] == Finding("box: uml", True, findings._UML, detail="built from 6.1-1")


def test_refused_ptrace_comes_with_the_way_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(findings, "ptrace_problem", lambda: 1)
    ptrace = found()["box: ptrace"]
    assert not ptrace.available
    assert "ptrace" in ptrace.detail
    assert "--kernel qemu" in ptrace.remedy


@pytest.mark.parametrize(("boots", "detail"), [(True, "a trial boot succeeded"), (False, "a trial boot hung")])
def test_kvm_counts_by_its_trial_boot(
    store: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, boots: bool, detail: str
) -> None:
    monkeypatch.setattr(qemu, "KVM", tmp_path)
    assert found()["box: KVM"].detail == "a trial boot decides when first used"
    store.mkdir(parents=True)
    (store / qemu.PROBE_MEMORY).write_text(f'{{"key": "any", "boots": {str(boots).lower()}}}')
    kvm = found()["box: KVM"]
    assert kvm.available is boots
    assert kvm.detail.startswith(detail)


def test_no_room_for_the_memory_is_told(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(findings.places, "candidates", list)
    memory = found()["box: memory"]
    assert not memory.available
    assert "no room for the box's 2048 MiB" in memory.detail
    assert "TMPDIR" in memory.remedy


def test_inside_a_box_there_is_no_other(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(INSIDE, "1")
    assert list(found()) == ["box"]
