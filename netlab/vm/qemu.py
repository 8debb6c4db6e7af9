"""QEMU: a stock kernel over the host's root by 9p, under KVM where that is seen to boot, else emulated."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

from netlab.vm import cache, initramfs, modules, packages, uml
from netlab.vm.kernels import QEMU, Kernel
from netlab.vm.request import BoxError

#: KVM may be there and still hang a stock kernel (nested virtualisation): a probe that has not answered by then fails.
PROBE_LIMIT_S = 10.0

PROBE_MEMORY = "qemu.json"  # in the cache
_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")
KVM = Path("/dev/kvm")
_APPEND = "console=ttyS0 loglevel=3 panic=-1 mitigations=off nokaslr no_timer_check tsc=reliable audit=0 apparmor=0"


def prepare(kernel: Kernel, control: Path, *, memory_bytes: int, output: Path | None) -> list[str]:
    """Write the initramfs and return QEMU's argument list.

    Raises:
        BoxError: The kernel lacks the modules for 9p.
    """
    ramdisk = control / "initrd"
    ramdisk.write_bytes(_ramdisk(kernel, control))
    image = cache.root() / PROBE_MEMORY
    machine = machine_options(kvm_boots(kernel, ramdisk, memory=image))
    shares = {"root": Path("/"), "control": control, **({"output": output} if output else {})}
    return [QEMU, *base(kernel, ramdisk, memory_bytes), *machine, "-serial", "stdio", *share_options(shares)]


def base(kernel: Kernel, ramdisk: Path, memory_bytes: int, word: str = "") -> list[str]:
    """What every start has in common; ``word`` is added to the kernel's command line."""
    options = ["-nodefaults", "-no-user-config", "-no-reboot", "-display", "none", "-smp", "2", "-m"]
    files = ["-kernel", str(kernel.path), "-initrd", str(ramdisk)]
    return [*options, f"{memory_bytes >> 20}M", *files, "-append", " ".join([_APPEND, *modules.BOOT_OPTIONS, word])]


def machine_options(kvm: bool) -> list[str]:
    """The machine, with hardware help or without."""
    if kvm:
        return ["-machine", "q35,accel=kvm", "-cpu", "host"]
    return ["-machine", "q35", "-accel", "tcg,thread=multi,tb-size=512", "-cpu", "max"]


def share_options(shares: dict[str, Path]) -> list[str]:
    """One 9p device for each folder; only the root is read-only."""
    options = []
    for tag, path in shares.items():
        readonly = "on" if tag == "root" else "off"
        folder = str(path).replace(",", ",,")
        options += ["-fsdev", f"local,id={tag},path={folder},security_model=none,readonly={readonly},multidevs=remap"]
        options += ["-device", f"virtio-9p-pci,fsdev={tag},mount_tag={tag}"]
    return options


def kvm_boots(kernel: Kernel, ramdisk: Path, *, memory: Path) -> bool:
    """Whether this kernel boots under KVM here; tried once per boot of the host, remembered in ``memory``."""
    if not os.access(KVM, os.R_OK | os.W_OK):
        return False
    key = f"{_BOOT_ID.read_text().strip()} {kernel.label}"
    try:
        known = json.loads(memory.read_text())
        if known["key"] == key:
            return bool(known["boots"])
    except (OSError, ValueError, KeyError, TypeError):
        pass
    boots = _probe([QEMU, *base(kernel, ramdisk, 512 << 20, initramfs.PROBE_WORD), *machine_options(True)])
    memory.write_text(json.dumps({"key": key, "boots": boots}))
    return boots


def _probe(argv: list[str]) -> bool:
    process = subprocess.Popen(
        [*argv, "-serial", "stdio"], stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL
    )
    try:
        answer, _nothing = process.communicate(timeout=PROBE_LIMIT_S)
    except subprocess.TimeoutExpired:
        return False
    finally:
        process.kill()
        process.wait()
        if process.stdout is not None:
            process.stdout.close()
    return initramfs.PROBE_ANSWER.encode() in answer


def _ramdisk(kernel: Kernel, control: Path) -> bytes:
    early = [Path(path) for path, _options in modules.load_order(kernel.modules, initramfs.EARLY_MODULES)]
    if not any(path.name.startswith("9p.") for path in early):
        raise BoxError(
            f"{kernel.label}: no 9p module below {kernel.modules}; the cloud kernels lack it, use the plain one"
        )
    busybox = packages.unpacked("busybox-static") / "bin/busybox"
    init = [f"{control}/python", *uml.init_arguments(control)]
    return initramfs.build(
        busybox.read_bytes(), {path.name.removesuffix(".xz"): modules.content(path) for path in early}, init
    )
