"""Records of a capture one by one, in each form; nothing is held, so that files of any size can be listed."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator

from netlab.capture.records import JsonRecord, Kind, Record
from netlab.capture.view import View
from netlab.inspect.table import Format, Row, csv_lines

_PACKET = ("t_s", "t_ns", "node", "interface", "direction", "length", "crc32", "info")
_VERDICT = ("t_s", "t_ns", "sender", "receiver", "verdict", "departs_ns", "length", "crc32")
_LOG = ("t_s", "t_ns", "node", "process", "level", "message")
_EVENT = ("t_s", "t_ns", "topic", "node", "event", "details")
_KEYS = {Kind.PACKET: _PACKET, Kind.VERDICT: _VERDICT, Kind.LOG: _LOG}


def record_lines(view: View, records: Iterable[Record], kind: Kind, form: Format) -> Iterator[str]:
    """One line per record, in CSV under a line of keys; without line ends."""
    if form is Format.TEXT:
        yield from (view.text(record) for record in records)
    elif form is Format.JSON:
        yield from (json.dumps(view.json(record)) for record in records)
    else:
        keys = _KEYS.get(kind, _EVENT)
        yield from (line.rstrip("\n") for line in csv_lines(keys, (_flat(view, record) for record in records)))


def _flat(view: View, record: Record) -> Row:
    """A record as a row; what belongs to its event alone goes into ``details``, as JSON."""
    body = view.json(record)
    if not isinstance(record, JsonRecord):
        return body
    event = record.text("event") or record.text("kind") or record.kind.value
    details = {key: value for key, value in record.payload.items() if key not in ("t_ns", "event", "kind")}
    return body | {"event": event, "details": json.dumps(details)}
