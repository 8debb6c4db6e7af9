"""The cache of kernels, carrying them about, and which one a request gets."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tarfile
from pathlib import Path

import pytest
from box_rig import PREAMBLE

from netlab.vm import cache, kernels, packages, recipe, transfer
from netlab.vm.cache import BuiltKernel
from netlab.vm.request import BoxError, Clock, KernelChoice

pytestmark = pytest.mark.usefixtures("store")

#: A kernel in which any command prints the second word of the job, as `echo WORD` would.
ECHO = """
echo up >"$control/up"
sed 's/.*"echo", "\\([0-9a-f]*\\)".*/\\1/' "$control/job.json" >"$control/stdout"
printf '{"exit_code": 0, "guest_s": 0.0}\\n' >"$control/status"
"""


def put(tmp_path: Path, script: str = "exit 0", version: str = "6.1-1") -> BuiltKernel:
    kernel, config = tmp_path / "linux", tmp_path / ".config"
    kernel.write_text(PREAMBLE + script)
    config.write_text("CONFIG_X=y\n")
    return cache.install(kernel, config, version)


def test_an_installed_kernel_is_found_and_current(tmp_path: Path) -> None:
    assert cache.current_kernel() is None
    built = put(tmp_path)
    assert built.current
    assert cache.current_kernel() == built
    assert os.access(built.path, os.X_OK)
    assert built.sha256 == cache.file_hash(built.path)


def test_a_kernel_of_another_fragment_is_not_current(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    put(tmp_path)
    monkeypatch.setattr(cache, "fragment", lambda: "CONFIG_OTHER=y\n")
    assert cache.current_kernel() is None
    assert len(cache.built_kernels()) == 1


def test_a_newer_source_does_not_make_a_kernel_old(tmp_path: Path) -> None:
    old, new = put(tmp_path, version="6.1-1"), put(tmp_path, version="6.1-2")
    assert old.key != new.key
    os.utime(old.path.parent, (1, 1))
    assert cache.current_kernel() == new


@pytest.mark.parametrize("damage", ["", "{", '{"key": 1}', "[]"])
def test_a_damaged_entry_is_no_kernel(tmp_path: Path, damage: str) -> None:
    built = put(tmp_path)
    (built.path.parent / cache.METADATA).write_text(damage)
    assert cache.built_kernels() == []


def test_an_entry_appears_whole_or_not_at_all(store: Path) -> None:
    target = store / "uml" / "k"
    with pytest.raises(FileNotFoundError), cache.entering(target) as folder:
        (folder / "half").write_text((folder / "none").read_text())
    assert list(target.parent.iterdir()) == []
    for content in ("first", "second"):
        with cache.entering(target) as folder:
            (folder / "whole").write_text(content)
    assert (target / "whole").read_text() == "second"
    assert list(target.parent.iterdir()) == [target]


def test_two_builders_do_not_collide() -> None:
    program = "from netlab.vm import cache\nwith cache.locked('build'): print('got it')"
    with cache.locked("build"):
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=False)
        assert done.returncode != 0
        assert f"process {os.getpid()} is busy" in done.stderr
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout == "got it\n"


def test_a_kernel_travels(tmp_path: Path, memory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    built = put(tmp_path, ECHO)
    transfer.export_kernel(tmp_path / "kernel.tgz")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "elsewhere"))
    assert cache.current_kernel() is None
    entered = transfer.import_kernel(tmp_path / "kernel.tgz")
    assert (entered.key, entered.sha256) == (built.key, built.sha256)
    assert cache.current_kernel() == entered


def test_a_kernel_that_does_not_boot_does_not_enter(
    tmp_path: Path, memory: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    put(tmp_path, "exit 9")
    transfer.export_kernel(tmp_path / "kernel.tgz")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "elsewhere"))
    with pytest.raises(BoxError, match=r"does not boot here.*exit code 9"):
        transfer.import_kernel(tmp_path / "kernel.tgz")
    assert cache.built_kernels() == []


def repack(source: Path, target: Path, **changed: bytes) -> None:
    folder = target.parent / "repacked"
    with tarfile.open(source) as archive:
        archive.extractall(folder, filter="data")
    for name, data in changed.items():
        (folder / name.replace("_json", ".json")).write_bytes(data)
    with tarfile.open(target, "w:gz") as archive:
        for path in folder.iterdir():
            archive.add(path, path.name)


def test_files_that_are_not_ours_are_refused_with_the_reason(tmp_path: Path) -> None:
    built = put(tmp_path)
    transfer.export_kernel(tmp_path / "good.tgz")
    (tmp_path / "text.tgz").write_text("no tar")
    (tmp_path / "cut.tgz").write_bytes((tmp_path / "good.tgz").read_bytes()[:200])
    repack(tmp_path / "good.tgz", tmp_path / "damaged.tgz", linux=b"#!/bin/sh\nexit 1\n")
    raw = json.loads((built.path.parent / cache.METADATA).read_text())
    raw["key"] = "0" * 16
    repack(
        tmp_path / "good.tgz",
        tmp_path / "other.tgz",
        linux=built.path.read_bytes(),
        kernel_json=json.dumps(raw).encode(),
    )
    reasons = {
        "missing": "no such file",
        "text": "not a file that",
        "cut": "not a file that|has no",
        "damaged": "hash is not the one",
        "other": "another configuration",
    }
    for name, reason in reasons.items():
        with pytest.raises(BoxError, match=reason):
            transfer.import_kernel(tmp_path / f"{name}.tgz")
    assert cache.built_kernels() == [built]


def test_nothing_to_export() -> None:
    with pytest.raises(BoxError, match="netlab vm build"):
        transfer.export_kernel(Path("/nowhere"))


def test_virtual_time_without_a_kernel_names_the_command() -> None:
    with pytest.raises(BoxError, match=r"no kernel is built yet: run `netlab vm build` first \(about 10 minutes"):
        kernels.select(KernelChoice.AUTO, Clock.VIRTUAL)
    for choice in (KernelChoice.QEMU, KernelChoice.DEBIAN):
        with pytest.raises(BoxError, match="no virtual time"):
            kernels.select(choice, Clock.VIRTUAL)


def test_the_built_kernel_serves_both_clocks(tmp_path: Path) -> None:
    built = put(tmp_path)
    for clock in Clock:
        assert kernels.select(KernelChoice.AUTO, clock).path == built.path


def debian_package(store: Path, *, with_modules: bool) -> None:
    folder = store / "packages" / "user-mode-linux_1"
    overlay = folder / "usr/lib/uml/modules/6.1/kernel/fs/overlayfs"
    overlay.mkdir(parents=True)
    (folder / "usr/bin").mkdir()
    (folder / "usr/bin/linux.uml").touch()
    if with_modules:
        (overlay / "overlay.ko").touch()


def test_in_real_time_debians_kernel_fills_in(store: Path) -> None:
    debian_package(store, with_modules=True)
    kernel = kernels.select(KernelChoice.AUTO, Clock.REAL)
    assert kernel.path.name == "linux.uml"
    assert kernel.modules is not None
    assert not kernel.guests_die
    assert "real time only" in kernel.notes[0]


def test_a_kernel_without_modules_is_refused(store: Path) -> None:
    debian_package(store, with_modules=False)
    with pytest.raises(BoxError, match=r"without modules[^$]*netlab vm build"):
        kernels.select(KernelChoice.AUTO, Clock.REAL)


def test_qemu_that_is_not_installed_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "/nowhere")
    with pytest.raises(BoxError, match="apt-get install qemu-system-x86"):
        kernels.select(KernelChoice.QEMU, Clock.REAL)


def test_a_machine_without_apt_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", "/nowhere")
    with pytest.raises(BoxError, match="no apt"):
        packages.candidate_version(recipe.SOURCE_PACKAGE)
