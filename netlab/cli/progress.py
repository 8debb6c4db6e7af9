"""Progress of long work on a terminal's stderr; nothing at all elsewhere, so that logs and pipes stay clean."""

from __future__ import annotations

import sys
from types import TracebackType

from rich.console import Console
from rich.progress import BarColumn, Progress, SpinnerColumn, TaskProgressColumn, TextColumn, TimeElapsedColumn


class Steps:
    """A bar of so many steps. Use as a context manager; what is left of it disappears at the end."""

    def __init__(self, total: int | None = None) -> None:
        console = Console(file=sys.stderr)
        columns = (SpinnerColumn(), TextColumn("{task.description}"), BarColumn(), TaskProgressColumn())
        self._progress = Progress(
            *columns, TimeElapsedColumn(), console=console, transient=True, disable=not console.is_terminal
        )
        self._task = self._progress.add_task("", total=total)
        self._begun, self._what = False, ""

    def __enter__(self) -> Steps:
        self._progress.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._progress.stop()

    def begin(self, what: str) -> None:
        """Say what is done next; what was begun before is done."""
        self._progress.update(self._task, description=what, advance=1 if self._begun else 0)
        self._begun, self._what = True, what

    def within(self, done: int, total: int) -> None:
        """Say how much of the present step is done."""
        self._progress.update(self._task, description=f"{self._what}: {done / max(total, 1):.0%}")

    def at(self, done: int, total: int) -> None:
        """Say how much of the whole, whose size is known only now, is done."""
        self._progress.update(self._task, completed=done, total=total)
