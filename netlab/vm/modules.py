"""Which module files to load, in which order: read from the modules themselves, so that no depmod is needed."""

from __future__ import annotations

import lzma
from pathlib import Path

#: A box begins with no interface but the loopback; who wants one makes it.
OPTIONS = {"dummy": "numdummies=0", "ifb": "numifbs=0", "mac80211_hwsim": "radios=0"}

#: The same for the tunnels that would appear in every new network namespace.
BOOT_OPTIONS = ("fb_tunnels=none",)

_DEPENDS = b"\0depends="
_SUFFIXES = (".ko", ".ko.xz")


def load_order(tree: Path | None, names: list[str]) -> list[tuple[str, str]]:
    """These modules and all that they depend on, each after what it needs: path and options.

    Args:
        tree: ``/lib/modules/<release>`` or its like; None for a kernel that has everything built in.
        names: Module names; one that the tree lacks is passed over (it may be built in).
    """
    if tree is None:
        return []
    index = module_files(tree)
    order: dict[str, None] = {}
    for name in names:
        _add(name, index, order)
    return [(path, OPTIONS.get(_plain(Path(path).name.split(".ko")[0]), "")) for path in order]


def boot_options() -> list[str]:
    """The same options for a kernel that has the modules built in, as words of its command line."""
    return [*(f"{name}.{option}" for name, option in OPTIONS.items()), *BOOT_OPTIONS]


def module_files(tree: Path) -> dict[str, Path]:
    """Module name (with underscores) -> file."""
    found = {}
    for path in tree.rglob("*.ko*"):
        if path.name.endswith(_SUFFIXES):
            found[_plain(path.name.split(".ko")[0])] = path
    return found


def content(path: Path) -> bytes:
    """The module itself, decompressed."""
    data = path.read_bytes()
    return lzma.decompress(data) if path.suffix == ".xz" else data


def depends(module: bytes) -> list[str]:
    """Names in the module's ``depends=`` note (section .modinfo)."""
    start = module.find(_DEPENDS)
    if start < 0:
        return []
    end = module.index(b"\0", start + len(_DEPENDS))
    text = module[start + len(_DEPENDS) : end].decode()
    return [name for name in text.split(",") if name]


def _add(name: str, index: dict[str, Path], order: dict[str, None]) -> None:
    path = index.get(_plain(name))
    if path is None or str(path) in order:
        return
    for needed in depends(content(path)):
        _add(needed, index, order)
    order[str(path)] = None


def _plain(name: str) -> str:
    return name.replace("-", "_")
