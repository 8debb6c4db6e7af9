"""Which kernel a box runs: the built one, Debian's ready one, or the stock one in QEMU."""

from __future__ import annotations

import shutil
from dataclasses import dataclass
from enum import Enum
from pathlib import Path

from netlab.vm import cache, packages
from netlab.vm.request import BoxError, Clock, KernelChoice

QEMU = "qemu-system-x86_64"
DEBIAN_PACKAGE = "user-mode-linux"
BUILD_HINT = "run `netlab vm build` first (about 10 minutes, once for this machine), or `netlab vm import FILE`"

#: What the lab's engines may need; loaded where the kernel has modules.
LAB_MODULES = [
    "veth",
    "bridge",
    "dummy",
    "ifb",
    "tun",
    "vxlan",
    "sch_netem",
    "sch_ingress",
    "sch_prio",
    "sch_tbf",
    "sch_htb",
    "sch_fq",
    "sch_fq_codel",
    "cls_matchall",
    "cls_flower",
    "cls_u32",
    "cls_bpf",
    "act_mirred",
    "act_gact",
    "nf_tables",
    "nft_ct",
    "nft_limit",
    "nft_numgen",
    "batman_adv",
    "mac80211_hwsim",
    "af_packet",
]


class Emulator(Enum):
    """What carries the kernel."""

    UML = "uml"
    QEMU = "qemu"


@dataclass(frozen=True, slots=True)
class Kernel:
    """A kernel that is ready to boot.

    Attributes:
        emulator: How it is booted.
        path: User-Mode Linux's executable, or QEMU's kernel image.
        label: For people.
        modules: Folder of its modules; None if all is built in.
        guests_die: Whether its guest processes die with it; else a PID namespace has to see to that.
        notes: What the person should know about the choice.
    """

    emulator: Emulator
    path: Path
    label: str
    modules: Path | None = None
    guests_die: bool = True
    notes: tuple[str, ...] = ()


def select(choice: KernelChoice, clock: Clock) -> Kernel:
    """The kernel for a request, fetched if it is a package.

    Raises:
        BoxError: Virtual time on a kernel that has none, nothing built, or nothing to be fetched.
    """
    if clock is Clock.VIRTUAL:
        return _virtual(choice)
    if choice is KernelChoice.QEMU:
        return stock()
    built = None if choice is KernelChoice.DEBIAN else cache.current_kernel()
    if built is not None:
        return _built(built)
    try:
        return debian()
    except BoxError as error:
        raise BoxError(f"no kernel for the box: {error}\nTo build one instead, {BUILD_HINT}.") from error


def _virtual(choice: KernelChoice) -> Kernel:
    if choice in (KernelChoice.QEMU, KernelChoice.DEBIAN):
        raise BoxError(f"--kernel {choice.value} has no virtual time; use --kernel uml, or --clock real")
    built = cache.current_kernel()
    if built is None:
        older = cache.built_kernels()
        state = "the kernel in the cache is of another configuration" if older else "no kernel is built yet"
        raise BoxError(f"virtual time needs a kernel with time travel, and {state}: {BUILD_HINT}.")
    return _built(built)


def _built(built: cache.BuiltKernel) -> Kernel:
    return Kernel(Emulator.UML, built.path, f"uml {built.source_version}, built {built.key}")


def debian() -> Kernel:
    """Debian's user-mode-linux package.

    Raises:
        BoxError: It cannot be fetched, or has no modules.
    """
    folder = packages.unpacked(DEBIAN_PACKAGE)
    path = folder / "usr/bin/linux.uml"
    if not path.exists():
        raise BoxError(f"{folder}: the package {DEBIAN_PACKAGE} has no usr/bin/linux.uml")
    modules = find_modules(folder, "usr/lib/uml/modules")
    note = f"{folder.name} runs: real time only, no mac80211_hwsim"
    return Kernel(Emulator.UML, path, folder.name, modules, guests_die=False, notes=(note,))


def stock() -> Kernel:
    """Debian's stock kernel, for QEMU.

    Raises:
        BoxError: No QEMU, or the kernel cannot be fetched, or has no modules.
    """
    if shutil.which(QEMU) is None:
        raise BoxError(f"{QEMU} is not installed: sudo apt-get install qemu-system-x86; or use --kernel uml")
    package = packages.dependency("linux-image-amd64", "linux-image-")
    folder = packages.unpacked(package)
    release = package.removeprefix("linux-image-")
    modules = find_modules(folder, "lib/modules", "usr/lib/modules")
    return Kernel(Emulator.QEMU, folder / f"boot/vmlinuz-{release}", package, modules)


def find_modules(package: Path, *places: str) -> Path:
    """The one module tree in an unpacked package, below one of ``places``.

    Raises:
        BoxError: None that has an overlay file system, which the box cannot do without.
    """
    for place in places:
        for folder in sorted((package / place).glob("*/"), reverse=True):
            if any(folder.glob("kernel/fs/overlayfs/overlay.ko*")):
                return folder
    looked = " or ".join(places)
    raise BoxError(
        f"this kernel comes without modules (no overlay.ko below {looked}), and a box needs overlayfs. "
        f"Remove {package} so that it is fetched again."
    )
