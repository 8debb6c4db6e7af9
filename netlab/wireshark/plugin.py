"""Puts the Lua dissectors where Wireshark and tshark look for them, and takes them away again."""

from __future__ import annotations

import re
import shutil
import subprocess
from pathlib import Path

from netlab.errors import MachineError

LUA = Path(__file__).parent / "lua"
FOLDER = "netlab"
MANIFEST = "installed"  # names what was installed, so that nothing else is ever removed
_DEFAULT = Path(".local/lib/wireshark/plugins")
_TOLD = re.compile(r"^Personal Lua Plugins:\s*(\S.*)$", re.MULTILINE)


def dissectors() -> list[Path]:
    """Return the files that belong together, in the order of their names."""
    return sorted(LUA.glob("*.lua"))


def plugin_folder() -> Path:
    """Return this user's folder of Lua plugins, as tshark tells it; where there is no tshark, Wireshark's default."""
    tshark = shutil.which("tshark")
    if tshark is not None:
        said = subprocess.run([tshark, "-G", "folders"], capture_output=True, text=True, check=False, timeout=60).stdout
        if found := _TOLD.search(said):
            return Path(found[1])
    return Path.home() / _DEFAULT


def install(plugins: Path) -> tuple[Path, bool]:
    """Copy the dissectors into a folder of their own below ``plugins``; return it and whether anything changed.

    Raises:
        MachineError: The folder cannot be written.
    """
    target = plugins / FOLDER
    texts = {path.name: path.read_text() for path in dissectors()}
    former = _installed(target)
    if former == set(texts) and all(_text(target / name) == text for name, text in texts.items()):
        return target, False
    try:
        target.mkdir(parents=True, exist_ok=True)
        (target / MANIFEST).write_text("".join(f"{name}\n" for name in sorted(former | set(texts))))
        for name, text in texts.items():
            (target / name).write_text(text)
        for name in former - set(texts):  # an earlier version's
            (target / name).unlink(missing_ok=True)
        (target / MANIFEST).write_text("".join(f"{name}\n" for name in sorted(texts)))
    except OSError as error:
        raise _unwritable(target, error) from None
    return target, True


def uninstall(plugins: Path) -> tuple[Path, bool]:
    """Remove what :func:`install` put below ``plugins``; return the folder and whether there was anything.

    Raises:
        MachineError: The folder cannot be written.
    """
    target = plugins / FOLDER
    names = _installed(target)
    try:
        for name in names:
            (target / name).unlink(missing_ok=True)
        (target / MANIFEST).unlink(missing_ok=True)
        if target.is_dir() and not any(target.iterdir()):
            target.rmdir()
    except OSError as error:
        raise _unwritable(target, error) from None
    return target, bool(names)


def _installed(target: Path) -> set[str]:
    names = (_text(target / MANIFEST) or "").split()
    return {name for name in names if Path(name).name == name}


def _text(path: Path) -> str | None:
    try:
        return path.read_text()
    except (OSError, UnicodeDecodeError):
        return None


def _unwritable(target: Path, error: OSError) -> MachineError:
    return MachineError(f"{target}: {error.strerror}; name another plugin folder of Wireshark's with --dir")
