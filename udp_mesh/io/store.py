"""The store's thread: SQLite waits for the disk there, while the daemon's loop goes on.

What the loop submits between two commits goes into one transaction. Outcomes come back in order, through
:meth:`StoreThread.outcomes`, when the descriptor becomes readable.
"""

from __future__ import annotations

import contextlib
import queue
import socket
import sqlite3
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Protocol

from udp_mesh.io import store_file
from udp_mesh.io.store_file import Contents, StoreError
from udp_mesh.io.store_rows import Statement

_BATCH = 512
_CLOSE_WITHIN_S = 5.0

Rows = list[tuple[object, ...]]
Done = Callable[["Outcome"], None]


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a job. ``reason`` is empty, ``disk_full`` or ``store_failed``; ``detail`` is for people."""

    reason: str = ""
    detail: str = ""
    rows: Rows | None = None


@dataclass(frozen=True, slots=True)
class _Job:
    statements: list[Statement]
    query: Statement | None
    done: Done


class Store(Protocol):
    """What the rest of the daemon needs of a store."""

    contents: Contents
    notes: list[str]

    def fileno(self) -> int: ...

    def write(self, statements: list[Statement], done: Done) -> None: ...

    def read(self, query: Statement, done: Done) -> None: ...

    def outcomes(self) -> Iterator[tuple[Done, Outcome]]: ...

    def close(self) -> None: ...


class StoreThread:
    """One file, one thread. ``notes`` are problems that were mended, for people."""

    def __init__(self, path: str, age_s: float, now: float) -> None:
        """Open the file; a damaged one is moved aside and what can be read of it is kept.

        Raises:
            StoreError: There can be no store.
        """
        self.path = path
        self.notes: list[str] = []
        self._jobs: queue.SimpleQueue[_Job | None] = queue.SimpleQueue()
        self._finished: queue.SimpleQueue[tuple[Done, Outcome]] = queue.SimpleQueue()
        self._database, self.contents = self._open(age_s=age_s, now=now)
        self._wake_read, self._wake_write = socket.socketpair()
        self._wake_read.setblocking(False)
        self._wake_write.setblocking(False)
        self._thread = threading.Thread(target=self._serve, name="store", daemon=True)
        self._thread.start()

    def _open(self, *, age_s: float, now: float) -> tuple[sqlite3.Connection, Contents]:
        try:
            database = store_file.connect(self.path)
            return database, store_file.read(database, age_s=age_s, now=now)
        except sqlite3.DatabaseError as error:
            database.close()
            reason = str(error)
        except StoreError as error:
            if not error.is_damaged:
                raise
            reason = str(error)
        database, aside, saved = store_file.rescue(self.path)
        self.notes.append(f"{reason}; moved to {aside}, {saved} rows of it saved")
        return database, store_file.read(database, age_s=age_s, now=now)

    def fileno(self) -> int:
        """Readable when there are outcomes."""
        return self._wake_read.fileno()

    def write(self, statements: list[Statement], done: Done) -> None:
        """Carry out statements in one transaction, all or none."""
        self._jobs.put(_Job(statements, None, done))

    def read(self, query: Statement, done: Done) -> None:
        """Run a query after everything submitted before."""
        self._jobs.put(_Job([], query, done))

    def outcomes(self) -> Iterator[tuple[Done, Outcome]]:
        """Yield what has finished."""
        with contextlib.suppress(BlockingIOError):
            while self._wake_read.recv(4096):
                pass
        with contextlib.suppress(queue.Empty):
            while True:
                yield self._finished.get_nowait()

    def close(self) -> None:
        """Finish what was submitted and close the file."""
        self._jobs.put(None)
        self._thread.join(_CLOSE_WITHIN_S)
        self._wake_read.close()
        self._wake_write.close()

    # -- in the thread

    def _serve(self) -> None:
        is_open = True
        while is_open:
            jobs = [self._jobs.get()]
            with contextlib.suppress(queue.Empty):
                while len(jobs) < _BATCH:
                    jobs.append(self._jobs.get_nowait())
            is_open = None not in jobs
            self._run([job for job in jobs if job is not None])
            with contextlib.suppress(OSError):  # full: the loop will look anyway; closed: nobody will
                self._wake_write.send(b"\0")
        with contextlib.suppress(sqlite3.Error):
            self._database.close()

    def _run(self, jobs: list[_Job]) -> None:
        writes = [job for job in jobs if job.statements]
        outcome = self._transaction(writes) if writes else Outcome()
        # One job that cannot be written, say because the disk is full, must not take the others with it.
        single = len(writes) > 1 and bool(outcome.reason)
        for job in jobs:
            if job.query is not None:
                self._finished.put((job.done, self._query(job.query)))
            else:
                self._finished.put((job.done, self._transaction([job]) if single else outcome))

    def _transaction(self, jobs: list[_Job], *, may_mend: bool = True) -> Outcome:
        try:
            self._database.execute("BEGIN IMMEDIATE")
            for job in jobs:
                for statement, values in job.statements:
                    self._database.execute(statement, values)
            self._database.execute("COMMIT")
        except sqlite3.Error as error:
            with contextlib.suppress(sqlite3.Error):
                self._database.execute("ROLLBACK")
            if not may_mend or not store_file.is_damage(error) or not self._mend(error):
                return _failure(error)
            return self._transaction(jobs, may_mend=False)
        return Outcome()

    def _mend(self, error: sqlite3.Error) -> bool:
        """Replace a file that was damaged while it was in use."""
        with contextlib.suppress(sqlite3.Error):
            self._database.close()
        try:
            self._database, aside, saved = store_file.rescue(self.path)
        except StoreError as failure:
            self.notes.append(str(failure))
            return False
        self.notes.append(f"{self.path}: {error}; moved to {aside}, {saved} rows of it saved")
        return True

    def _query(self, query: Statement, *, may_mend: bool = True) -> Outcome:
        try:
            return Outcome(rows=self._database.execute(*query).fetchall())
        except sqlite3.Error as error:
            if not may_mend or not store_file.is_damage(error) or not self._mend(error):
                return _failure(error)
        return self._query(query, may_mend=False)


def _failure(error: sqlite3.Error) -> Outcome:
    code = getattr(error, "sqlite_errorcode", 0) & 0xFF
    return Outcome("disk_full" if code == sqlite3.SQLITE_FULL else "store_failed", str(error))
