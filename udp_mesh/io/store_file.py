"""The store's SQLite file: layout, what is read at the start, and the statements that change it. No thread, no policy.

Source: https://sqlite.org/wal.html. Write-ahead log with ``synchronous=FULL``: a committed transaction survives
``kill -9`` and a power cut. Lifetimes survive clock jumps: within one boot the monotonic clock counts, across boots
the wall clock, and never less than nothing.
"""

from __future__ import annotations

import contextlib
import secrets
import sqlite3
import time
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path

from udp_mesh.core.envelope import DurableId
from udp_mesh.core.inbox import Kept
from udp_mesh.core.stored import Stored
from udp_mesh.io import store_rows
from udp_mesh.io.store_rows import policy, unsigned

_LAYOUT = 2
_MAX_SEARCHED = 1_000_000  # row numbers tried between the two ends of a damage
_FORGET_AFTER_S = 60 * 86_400.0  # ids and applications that were not seen for so long
_TABLES = {
    "meta": "key TEXT PRIMARY KEY, value INTEGER",
    "peers": "name TEXT PRIMARY KEY",
    "outgoing": "sequence INTEGER PRIMARY KEY AUTOINCREMENT, peer TEXT, topic TEXT, policy TEXT,"
    " original_bytes INTEGER, wall_s REAL, boot TEXT, mono_s REAL, lifetime_s REAL, payload BLOB, crc INTEGER",
    "taken": "client INTEGER, request INTEGER, sequence INTEGER, wall_s REAL, PRIMARY KEY (client, request)",
    "incoming": "store INTEGER, sequence INTEGER, source TEXT, topic TEXT, priority INTEGER,"
    " received_ns INTEGER, wall_s REAL, boot TEXT, mono_s REAL, lifetime_s REAL, payload BLOB,"
    " crc INTEGER, PRIMARY KEY (store, sequence)",
    "floors": "store INTEGER PRIMARY KEY, floor INTEGER",
}


class StoreError(Exception):
    """The file cannot be used; ``is_damaged`` if what it holds is no database."""

    def __init__(self, text: str, *, is_damaged: bool = False) -> None:
        super().__init__(text)
        self.is_damaged = is_damaged


@dataclass(slots=True)
class Contents:
    """What a file held when it was opened. ``requests``: by application, which publishes it was told are taken."""

    store_id: int
    next_sequence: int
    outgoing: list[Stored] = field(default_factory=list)
    kept: list[Kept] = field(default_factory=list)
    ids: list[DurableId] = field(default_factory=list)
    floors: dict[int, int] = field(default_factory=dict)
    peers: list[str] = field(default_factory=list)
    requests: dict[int, dict[int, int]] = field(default_factory=dict)


def connect(path: str) -> sqlite3.Connection:
    """Open a file, made if need be, and check it.

    Raises:
        StoreError: It cannot be opened, is damaged, or belongs to a later version.
    """
    try:
        database = sqlite3.connect(path, isolation_level=None, timeout=2.0, check_same_thread=False)
    except sqlite3.Error as error:
        raise StoreError(f"{path}: {error}") from error
    try:
        _prepare(database)
        _check(database, path)
    except sqlite3.Error as error:
        database.close()
        raise StoreError(f"{path}: {error}", is_damaged=is_damage(error)) from error
    except StoreError:
        database.close()
        raise
    with contextlib.suppress(OSError):
        Path(path).chmod(0o600)
    return database


def is_damage(error: sqlite3.Error) -> bool:
    """Whether an error says that the file holds no sound database."""
    return getattr(error, "sqlite_errorcode", 0) & 0xFF in (sqlite3.SQLITE_CORRUPT, sqlite3.SQLITE_NOTADB)


def _prepare(database: sqlite3.Connection) -> None:
    database.execute("PRAGMA locking_mode=EXCLUSIVE")  # one daemon per file
    database.execute("PRAGMA journal_mode=WAL")
    database.execute("PRAGMA synchronous=FULL")
    database.execute("BEGIN IMMEDIATE")
    for name, columns in _TABLES.items():
        database.execute(f"CREATE TABLE IF NOT EXISTS {name} ({columns})")
    database.execute("INSERT OR IGNORE INTO meta VALUES ('layout', ?)", (_LAYOUT,))
    database.execute("INSERT OR IGNORE INTO meta VALUES ('store', ?)", (secrets.randbits(63),))
    database.execute("COMMIT")


def _check(database: sqlite3.Connection, path: str) -> None:
    (verdict,) = database.execute("PRAGMA quick_check(1)").fetchone()
    if verdict != "ok":
        raise StoreError(f"{path}: {verdict}", is_damaged=True)
    (layout,) = database.execute("SELECT value FROM meta WHERE key = 'layout'").fetchone()
    if layout == 1:
        for table in ("outgoing", "incoming"):
            database.execute(f"ALTER TABLE {table} ADD COLUMN crc INTEGER")
        database.execute("UPDATE meta SET value = ? WHERE key = 'layout'", (_LAYOUT,))
    elif layout != _LAYOUT:
        raise StoreError(f"{path}: has layout {layout}, this version knows {_LAYOUT}; move the file away")


def rescue(path: str) -> tuple[sqlite3.Connection, str, int]:
    """Move a damaged file aside and begin a new one with what can still be read of it.

    Returns:
        The new database, the damaged file's new path, and how many rows were saved.

    Raises:
        StoreError: The new file cannot be made either.
    """
    aside = f"{path}.damaged-{time.time_ns()}"
    try:
        Path(path).rename(aside)
        for suffix in ("-wal", "-shm"):
            if Path(path + suffix).exists():
                Path(path + suffix).rename(aside + suffix)
    except OSError as error:
        raise StoreError(f"{path}: is damaged and cannot be moved aside: {error.strerror}") from error
    database = connect(path)
    saved = 0
    with contextlib.suppress(sqlite3.Error):
        old = sqlite3.connect(aside)
        saved = sum(_copy(old, database, name) for name in _TABLES)
        if not _copy(old, database, "sqlite_sequence"):
            # Which sequences were used is not known any more, and none may be used twice: begin with another identity.
            database.execute("UPDATE meta SET value = ? WHERE key = 'store'", (secrets.randbits(63),))
        old.close()
    return database, aside, saved


def _copy(old: sqlite3.Connection, new: sqlite3.Connection, table: str) -> int:
    """Copy rows from both ends until one cannot be read, then one by one what lies between; return how many."""
    width = len(new.execute(f"PRAGMA table_info({table})").fetchall())

    def put(row: Sequence[object]) -> int:
        values = (*row, *[None] * (width - len(row)))  # an earlier layout had fewer columns
        return new.execute(f"INSERT OR REPLACE INTO {table} VALUES ({','.join('?' * width)})", values).rowcount

    count, ends = 0, [0, 0]
    for end, order in enumerate(("ASC", "DESC")):
        try:
            for rowid, *row in old.execute(f"SELECT rowid, * FROM {table} ORDER BY rowid {order}"):
                count += put(row)
                ends[end] = rowid
        except sqlite3.Error:
            continue
        return count
    for rowid in range(ends[0] + 1, min(ends[1], ends[0] + _MAX_SEARCHED)):
        with contextlib.suppress(sqlite3.Error):
            count += sum(put(row) for row in old.execute(f"SELECT * FROM {table} WHERE rowid = ?", (rowid,)))
    return count


# -- reading


def read(database: sqlite3.Connection, *, age_s: float, now: float) -> Contents:
    """Return what the file holds, payloads excepted.

    Args:
        database: From :func:`connect`.
        age_s: No received message is kept for longer.
        now: Monotonic seconds; deadlines are counted from it.

    Raises:
        sqlite3.Error: It is damaged.
    """
    _forget_old(database)
    meta = dict(database.execute("SELECT key, value FROM meta"))
    (newest,) = database.execute("SELECT COALESCE(MAX(seq), 0) FROM sqlite_sequence WHERE name = 'outgoing'").fetchone()
    contents = Contents(unsigned(meta["store"]), newest + 1)
    clock = _Clock(now)
    for sequence, peer, topic, policy_text, original, size, *age in database.execute(
        "SELECT sequence, peer, topic, policy, original_bytes, LENGTH(payload), wall_s, boot, mono_s, lifetime_s"
        " FROM outgoing ORDER BY sequence"
    ):
        deadline_s = clock.deadline_s(*age)
        contents.outgoing.append(
            Stored(sequence, peer, topic, policy(policy_text), size or 0, now, deadline_s, original_bytes=original)
        )
    for store, sequence, source, topic, priority, received_ns, size, *age in database.execute(
        "SELECT store, sequence, source, topic, priority, received_ns, LENGTH(payload),"
        " wall_s, boot, mono_s, lifetime_s FROM incoming ORDER BY rowid"
    ):
        durable_id = DurableId(unsigned(store), unsigned(sequence))
        contents.ids.append(durable_id)
        if size is not None:
            deadline_s = clock.deadline_s(*age)
            contents.kept.append(
                Kept(durable_id, source, topic, priority, size, received_ns, min(deadline_s, now + age_s))
            )
    contents.floors = {unsigned(s): unsigned(f) for s, f in database.execute("SELECT store, floor FROM floors")}
    contents.peers = [name for (name,) in database.execute("SELECT name FROM peers")]
    for client, request, sequence in database.execute("SELECT client, request, sequence FROM taken ORDER BY rowid"):
        contents.requests.setdefault(unsigned(client), {})[request] = sequence
    return contents


def _forget_old(database: sqlite3.Connection) -> None:
    before_s = time.time() - _FORGET_AFTER_S
    database.execute("DELETE FROM taken WHERE wall_s < ?", (before_s,))
    database.execute("DELETE FROM incoming WHERE payload IS NULL AND wall_s < ?", (before_s,))


class _Clock:
    """Turns stored ages into deadlines on this boot's monotonic clock."""

    def __init__(self, now: float) -> None:
        self._now = now
        self._wall_s = time.time()
        self._boot = store_rows.boot_id()

    def deadline_s(self, wall_s: float, boot: str, mono_s: float, lifetime_s: float) -> float:
        """Return when a message ends; a wall clock that went back makes nothing younger than new."""
        age_s = self._now - mono_s if boot == self._boot else self._wall_s - wall_s
        return self._now + lifetime_s - max(0.0, age_s)
