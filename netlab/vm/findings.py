"""What this machine offers for a kernel in a box, and what each choice would give: `netlab doctor`. Starts nothing."""

from __future__ import annotations

import json
import os
import platform
import shutil
from pathlib import Path

from netlab.kernel.machine import Finding
from netlab.vm import cache, places, qemu
from netlab.vm.build import missing_tools
from netlab.vm.fitness import INSIDE, explain_no_ptrace, ptrace_problem
from netlab.vm.kernels import DEBIAN_PACKAGE, QEMU
from netlab.vm.request import BoxError, BoxRequest

_UML = "box, --kernel uml: virtual time, netem, batman-adv, 802.11"
_DEBIAN = "box, --kernel debian: real time, netem, batman-adv"
_QEMU = "box, --kernel qemu: real time, Debian's stock kernel"


def examine() -> list[Finding]:
    """The box's findings; one alone inside a box, where there is no other."""
    if os.environ.get(INSIDE):
        return [Finding("box", False, "a box", detail="this is the inside of one; it runs commands as they are")]
    return [_ptrace(), _uml(), _debian(), _qemu(), _kvm(), _room()]


def _ptrace() -> Finding:
    number = ptrace_problem()
    if platform.machine() != "x86_64":
        return Finding("box: ptrace", False, "--kernel uml and debian", detail=f"{platform.machine()}, not x86_64")
    if number:
        detail, _colon, remedy = explain_no_ptrace(number).partition(": ")
        return Finding("box: ptrace", False, "--kernel uml and debian", detail=detail, remedy=remedy)
    return Finding("box: ptrace", True, "--kernel uml and debian")


def _uml() -> Finding:
    built = cache.current_kernel()
    if built is not None:
        return Finding("box: uml", True, _UML, detail=f"built from {built.source_version}")
    older = len(cache.built_kernels())
    detail = f"{older} built of another configuration" if older else "not built"
    lacking = missing_tools()
    first = f"sudo apt-get install {' '.join(lacking)}; then " if lacking else ""
    return Finding("box: uml", False, _UML, detail=detail, remedy=f"{first}netlab vm build (about 10 minutes, once)")


def _debian() -> Finding:
    if kept := _unpacked(f"{DEBIAN_PACKAGE}_*"):
        return Finding("box: debian", True, _DEBIAN, detail=kept.name)
    if shutil.which("apt-get") is None:
        return Finding("box: debian", False, _DEBIAN, detail="no apt here, and not in the cache")
    return Finding("box: debian", True, _DEBIAN, detail="fetched by apt when first used")


def _qemu() -> Finding:
    if shutil.which(QEMU) is None:
        remedy = "sudo apt-get install qemu-system-x86"
        return Finding("box: qemu", False, _QEMU, detail=f"{QEMU} is not installed", remedy=remedy)
    kept = _unpacked("linux-image-*_*")
    return Finding("box: qemu", True, _QEMU, detail=kept.name if kept else "its kernel is fetched when first used")


def _kvm() -> Finding:
    use = "--kernel qemu without emulation"
    if not os.access(qemu.KVM, os.R_OK | os.W_OK):
        what = "not for this user" if qemu.KVM.exists() else "not there"
        remedy = "sudo usermod -aG kvm $USER, then log in again" if qemu.KVM.exists() else ""
        return Finding("box: KVM", False, use, detail=f"{qemu.KVM} is {what}", remedy=remedy)
    known = _probed()
    if known is None:
        return Finding("box: KVM", True, use, detail="a trial boot decides when first used")
    return Finding("box: KVM", known, use, detail=f"a trial boot {'succeeded' if known else 'hung: emulation it is'}")


def _probed() -> bool | None:
    try:
        return bool(json.loads((cache.root() / qemu.PROBE_MEMORY).read_text())["boots"])
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _room() -> Finding:
    size_bytes = BoxRequest(("true",), Path("/")).memory_bytes
    use = f"a box of {size_bytes >> 20} MiB"
    try:
        memory, notes = places.choose(places.candidates(), size_bytes)
    except BoxError as error:
        return Finding("box: memory", False, use, detail=str(error).split(". ")[0], remedy=str(error).split(". ")[-1])
    return Finding("box: memory", True, use, detail="; ".join([f"in {memory}", *notes]))


def _unpacked(pattern: str) -> Path | None:
    return max((cache.root() / "packages").glob(pattern), default=None)
