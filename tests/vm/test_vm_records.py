"""The records that a session in a box leaves, as they are read while they are written."""

from __future__ import annotations

from pathlib import Path

from netlab.pytest_virtual.records import RECORDS, Records, append


def test_half_a_line_is_read_when_it_is_whole(tmp_path: Path) -> None:
    records = Records(tmp_path)
    records.refresh()  # nothing there yet
    append(tmp_path, {"event": "start", "test": "a"})
    with (tmp_path / RECORDS).open("ab") as stream:
        stream.write(b'{"event": "report", "test": "a", ')
        stream.flush()
        records.refresh()
        assert (records.running, dict(records.reports)) == ("a", {})
        stream.write(b'"report": {"when": "setup"}}\n')
    records.refresh()
    assert records.reports["a"] == {"setup": {"when": "setup"}}
    append(tmp_path, {"event": "finish", "test": "a"})
    records.refresh()
    assert records.settled("a")
    assert records.running is None


def test_a_lost_test_is_settled_with_its_first_reason(tmp_path: Path) -> None:
    records = Records(tmp_path)
    for why in ("the box broke down", "again"):
        append(tmp_path, {"event": "lost", "test": "a", "why": why})
    records.refresh()
    assert records.settled("a")
    assert records.lost == {"a": "the box broke down"}
