"""The store's file: what survives, ages across clock jumps and boots, damage, a full disk, a second daemon."""

from __future__ import annotations

import select
import sqlite3
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from udp_mesh.core.envelope import DurableId
from udp_mesh.core.inbox import Kept
from udp_mesh.core.settings import Keep, Offline, TopicPolicy
from udp_mesh.core.stored import Stored
from udp_mesh.io import store_file, store_rows
from udp_mesh.io.outgoing import payload_of
from udp_mesh.io.store import Outcome, StoreThread
from udp_mesh.io.store_rows import Statement

AGE_S = 3600.0


def outgoing(sequence: int, lifetime_s: float = 60.0) -> Stored:
    return Stored(sequence, "b", "t", TopicPolicy(3, keep=Keep.LATEST), 3, 100.0, 100.0 + lifetime_s)


def kept(sequence: int, store: int = 1 << 63 | 5) -> Kept:
    return Kept(DurableId(store, sequence), "a", "t", 2, 3, 42, 0.0)


def run(thread: StoreThread, statements: list[Statement]) -> Outcome:
    found: list[Outcome] = []
    thread.write(statements, found.append)
    return wait(thread, found)


def ask(thread: StoreThread, query: Statement) -> Outcome:
    found: list[Outcome] = []
    thread.read(query, found.append)
    return wait(thread, found)


def wait(thread: StoreThread, found: list[Outcome]) -> Outcome:
    while not found:
        assert select.select([thread], [], [], 10.0)[0], "the store's thread does not answer"
        for done, outcome in thread.outcomes():
            done(outcome)
    return found[0]


@pytest.fixture
def path(tmp_path: Path) -> str:
    return str(tmp_path / "store.db")


@pytest.fixture
def thread(path: str) -> Iterator[StoreThread]:
    opened = StoreThread(path, AGE_S, time.monotonic())
    yield opened
    opened.close()


def test_everything_is_there_after_a_restart(path: str) -> None:
    first = StoreThread(path, AGE_S, time.monotonic())
    identity = first.contents.store_id
    statements = [
        store_rows.put_outgoing(outgoing(1), b"one"),
        store_rows.put_outgoing(outgoing(2), b"two"),
        store_rows.drop_outgoing(2),
        store_rows.put_incoming(kept(7), b"abc", age_s=AGE_S),
        store_rows.put_incoming(kept(8), b"def", age_s=AGE_S),
        store_rows.take_incoming(kept(8).durable_id),
        *store_rows.put_floor(1 << 63 | 5, 4),
        store_rows.put_peer("b"),
        store_rows.put_taken(1 << 63, 12, 1),
    ]
    assert run(first, statements) == Outcome()
    first.close()
    now = time.monotonic()
    second = StoreThread(path, AGE_S, now)
    contents = second.contents
    second.close()
    assert (contents.store_id, contents.next_sequence) == (identity, 3), "a used number is never used again"
    (entry,) = contents.outgoing
    assert (entry.sequence, entry.peer, entry.topic, entry.size_bytes) == (1, "b", "t", 3)
    assert (entry.policy.priority, entry.policy.keep, entry.policy.offline) == (3, Keep.LATEST, Offline.STORE)
    assert 55.0 < entry.deadline_s - now <= 60.0
    assert [message.durable_id for message in contents.kept] == [kept(7).durable_id]
    assert set(contents.ids) == {kept(7).durable_id, kept(8).durable_id}
    assert contents.floors == {1 << 63 | 5: 4}
    assert (contents.peers, contents.requests) == (["b"], {1 << 63: {12: 1}})


@pytest.mark.parametrize(
    ("boot", "wall_s", "mono_s", "left_s"),
    [
        ("same", -1e9, -10.0, 50.0),  # the wall clock jumped: within a boot it does not matter
        ("same", 1e9, -10.0, 50.0),
        ("other", -20.0, 1e6, 40.0),  # after a boot only the wall clock tells
        ("other", 1e9, -10.0, 60.0),  # it went back: the message is as good as new
        ("other", -1e9, 0.0, -1.0),
    ],
)
def test_lifetimes_survive_clock_jumps_and_boots(
    path: str, boot: str, wall_s: float, mono_s: float, left_s: float
) -> None:
    database = store_file.connect(path)
    statement, values = store_rows.put_outgoing(outgoing(1), b"abc")
    database.execute(statement, values)
    database.execute(
        "UPDATE outgoing SET wall_s = wall_s + ?, mono_s = mono_s + ?, boot = ?",
        (wall_s, mono_s, store_rows.boot_id() if boot == "same" else "another"),
    )
    now = time.monotonic()
    (entry,) = store_file.read(database, age_s=AGE_S, now=now).outgoing
    database.close()
    if left_s < 0:
        assert entry.deadline_s < now
    else:
        assert entry.deadline_s - now == pytest.approx(left_s, abs=5.0)


def test_a_full_disk_is_an_outcome_and_what_is_small_still_fits(thread: StoreThread) -> None:
    (pages,) = thread._database.execute("PRAGMA page_count").fetchone()
    thread._database.execute(f"PRAGMA max_page_count = {pages + 4}")
    found: list[Outcome] = []
    thread.write([store_rows.put_outgoing(outgoing(1), bytes(100_000))], found.append)
    outcome = run(thread, [store_rows.put_outgoing(outgoing(2), b"small")])
    assert [failed.reason for failed in found] == ["disk_full"]
    assert outcome == Outcome()
    assert run(thread, [store_rows.drop_outgoing(2)]) == Outcome()


def test_a_file_that_is_no_database_is_moved_aside(path: str) -> None:
    Path(path).write_bytes(b"not a database" * 100)
    thread = StoreThread(path, AGE_S, time.monotonic())
    assert run(thread, [store_rows.put_outgoing(outgoing(1), b"one")]) == Outcome()
    thread.close()
    (note,) = thread.notes
    assert "moved to" in note
    (aside,) = Path(path).parent.glob("store.db.damaged-*[0-9]")
    assert aside.read_bytes().startswith(b"not a database")


def test_what_can_be_read_of_a_damaged_file_is_saved(path: str) -> None:
    thread = StoreThread(path, AGE_S, time.monotonic())
    identity = thread.contents.store_id
    count = 300
    statements = [store_rows.put_outgoing(outgoing(number), bytes(2000)) for number in range(1, count + 1)]
    assert run(thread, statements) == Outcome()
    thread.close()
    data = bytearray(Path(path).read_bytes())
    for part in (0.25, 0.75):
        page = int(len(data) * part) // 4096 * 4096
        data[page : page + 4096] = b"\xff" * 4096
    Path(path).write_bytes(data)
    again = StoreThread(path, AGE_S, time.monotonic())
    contents = again.contents
    again.close()
    assert again.notes
    assert 0.9 * count < len(contents.outgoing) < count, "also what lies between two damages"
    assert contents.store_id == identity
    assert contents.next_sequence > count, "the numbers of lost messages are not used again"


def test_a_payload_that_is_not_what_was_written_is_recognised(path: str, thread: StoreThread) -> None:
    statements = [store_rows.put_outgoing(outgoing(1), b"as it was"), store_rows.put_incoming(kept(7), b"x", age_s=9.0)]
    assert run(thread, statements) == Outcome()
    queries = [store_rows.outgoing_payload(1), store_rows.incoming_payload(kept(7).durable_id)]
    assert [payload_of(ask(thread, query)) for query in queries] == [b"as it was", b"x"]
    for table in ("outgoing", "incoming"):
        assert run(thread, [(f"UPDATE {table} SET payload = ?", (b"as it wAs",))]) == Outcome()
    assert [payload_of(ask(thread, query)) for query in queries] == [None, None]


def test_a_file_of_the_first_layout_is_brought_up_to_date(path: str) -> None:
    database = store_file.connect(path)
    for table in ("outgoing", "incoming"):
        database.execute(f"ALTER TABLE {table} DROP COLUMN crc")
    database.execute("UPDATE meta SET value = 1 WHERE key = 'layout'")
    statement, values = store_rows.put_outgoing(outgoing(1), b"old")
    database.execute(statement.replace(", ?)", ")"), values[:-1])
    database.close()
    for _ in range(2):
        thread = StoreThread(path, AGE_S, time.monotonic())
        assert [entry.sequence for entry in thread.contents.outgoing] == [1]
        assert payload_of(ask(thread, store_rows.outgoing_payload(1))) == b"old"
        thread.close()
        assert not thread.notes


def test_damage_that_a_query_meets_is_mended(path: str) -> None:
    thread = StoreThread(path, AGE_S, time.monotonic())
    count = 400  # more than SQLite keeps in memory
    statements = [store_rows.put_outgoing(outgoing(number), bytes(20_000)) for number in range(1, count + 1)]
    assert run(thread, statements) == Outcome()
    thread._database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
    with Path(path).open("r+b") as file:
        file.seek(3_000_000)
        file.write(b"\xff" * 500_000)
    found = [payload_of(ask(thread, store_rows.outgoing_payload(number))) for number in range(1, count + 1)]
    thread.close()
    assert found.count(bytes(20_000)) + found.count(None) == count
    assert 20 <= found.count(None) <= 40
    assert thread.notes


def test_one_file_serves_one_daemon(path: str, thread: StoreThread, monkeypatch: pytest.MonkeyPatch) -> None:
    connect = sqlite3.connect
    monkeypatch.setattr(sqlite3, "connect", lambda name, **options: connect(name, **{**options, "timeout": 0.05}))
    with pytest.raises(store_file.StoreError, match="locked"):
        StoreThread(path, AGE_S, time.monotonic())
    assert run(thread, [store_rows.put_peer("still here")]) == Outcome()


def test_a_folder_that_cannot_hold_a_file_is_an_error_that_names_it(tmp_path: Path) -> None:
    with pytest.raises(store_file.StoreError, match="nowhere"):
        StoreThread(str(tmp_path / "nowhere" / "store.db"), AGE_S, time.monotonic())


def test_a_later_layout_is_left_alone(path: str) -> None:
    database = store_file.connect(path)
    database.execute("UPDATE meta SET value = 99 WHERE key = 'layout'")
    database.close()
    with pytest.raises(store_file.StoreError, match="layout 99"):
        StoreThread(path, AGE_S, time.monotonic())
    assert Path(path).exists()


def test_what_was_submitted_is_written_before_the_end(path: str) -> None:
    thread = StoreThread(path, AGE_S, time.monotonic())
    for number in range(1, 50):
        thread.write([store_rows.put_outgoing(outgoing(number), b"x")], lambda _outcome: None)
    thread.close()
    again = StoreThread(path, AGE_S, time.monotonic())
    again.close()
    assert len(again.contents.outgoing) == 49
    assert Path(path).stat().st_mode & 0o777 == 0o600
