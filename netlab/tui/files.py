"""Names of the files that a screen writes, as a person would write them."""

from __future__ import annotations

from pathlib import Path


def short(path: Path) -> str:
    """A path as a person would write it here: relative where that is possible."""
    return str(path.relative_to(Path.cwd())) if path.is_relative_to(Path.cwd()) else str(path)


def unused(folder: Path, stem: str, suffix: str) -> Path:
    """A file in a folder that is not there yet."""
    names = (f"{stem}{suffix}", *(f"{stem}-{number}{suffix}" for number in range(2, 10_000)))
    return next(path for name in names if not (path := folder / name).exists())
