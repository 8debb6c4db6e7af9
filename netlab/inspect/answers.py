"""The answers to questions of a capture as tables: the keys of JSON and CSV, the columns of the text."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

from netlab.capture.view import Filter
from netlab.inspect.table import Column, Table
from netlab.traces.conversations import Conversation, Flow
from netlab.traces.drops import Drops, Where
from netlab.traces.explain import milliseconds
from netlab.traces.messages import MessageLife
from netlab.traces.model import Trace
from netlab.traces.queues_at import Queues
from netlab.traces.routes import Route
from netlab.traces.waiting import size_text

_MOST_LINKS = 3  # of one sender, each with a row of its own


def conversations_table(trace: Trace, found: Iterable[Conversation]) -> Table:
    """Who talked to whom."""
    rows = [
        {
            "a": talk.a,
            "b": talk.b,
            "protocol": talk.protocol,
            "frames_ab": talk.there.frames,
            "bytes_ab": talk.there.size_bytes,
            "arrived_ab": talk.there.arrived,
            "frames_ba": talk.back.frames,
            "bytes_ba": talk.back.size_bytes,
            "arrived_ba": talk.back.arrived,
            "first_s": trace.seconds(talk.first_ns),
            "last_s": trace.seconds(talk.last_ns),
            "missing_ab": _missing(talk.there),
            "missing_ba": _missing(talk.back),
        }
        for talk in found
    ]
    shown = (
        Column("a", "a", is_left=True),
        Column("b", "b", is_left=True),
        Column("protocol", "protocol", is_left=True),
        Column("frames_ab", "frames a>b"),
        Column("bytes_ab", "size", _size),
        Column("missing_ab", "missing", _optional),
        Column("frames_ba", "frames b>a"),
        Column("bytes_ba", "size", _size),
        Column("missing_ba", "missing", _optional),
        Column("first_s", "from", _second),
        Column("last_s", "to", _second),
        Column("arrived_ab"),
        Column("arrived_ba"),
    )
    return Table("conversations", shown, rows, "no packets")


def _missing(flow: Flow) -> int | None:
    return None if flow.arrived is None else max(0, flow.frames - flow.arrived)


def drops_table(trace: Trace, found: Iterable[Drops], *, is_for_people: bool) -> Table:
    """What was dropped, by place and reason; for people the links of one sender are summed up where they are many."""
    if is_for_people:
        found = _summed(found)
    rows = [
        {
            "where": entry.where.value,
            "reason": entry.reason,
            "node": entry.node,
            "peer": entry.peer,
            "topic": entry.topic,
            "priority": entry.priority,
            "count": entry.count,
            "size_bytes": entry.size_bytes,
            "first_s": None if entry.first_ns is None else trace.seconds(entry.first_ns),
            "last_s": None if entry.last_ns is None else trace.seconds(entry.last_ns),
        }
        for entry in found
    ]
    shown = (
        Column("where", "where", is_left=True),
        Column("reason", "reason", is_left=True),
        Column("node", "from", is_left=True),
        Column("peer", "to", is_left=True),
        Column("topic", "topic", is_left=True),
        Column("count", "count"),
        Column("size_bytes", "size", _size),
        Column("first_s", "first", _second),
        Column("last_s", "last", _second),
        Column("priority"),
    )
    return Table("drops", shown, rows, "nothing was dropped")


def _summed(found: Iterable[Drops]) -> list[Drops]:
    alike: dict[tuple[str, ...], list[Drops]] = {}
    for entry in found:
        peer = "" if entry.where is Where.LINK else entry.peer
        alike.setdefault((entry.where, entry.reason, entry.node, peer, entry.topic), []).append(entry)
    rows: list[Drops] = []
    for entries in alike.values():
        rows += entries if len(entries) <= _MOST_LINKS else [_sum(entries)]
    return rows


def _sum(entries: list[Drops]) -> Drops:
    first, count = entries[0], sum(entry.count for entry in entries)
    size_bytes = sum(entry.size_bytes for entry in entries)
    first_ns = min((entry.first_ns for entry in entries if entry.first_ns is not None), default=None)
    last_ns = max((entry.last_ns for entry in entries if entry.last_ns is not None), default=None)
    peer = f"{len(entries)} interfaces"
    return replace(first, peer=peer, count=count, size_bytes=size_bytes, first_ns=first_ns, last_ns=last_ns)


def of_chosen(queues: Queues, chosen: Filter) -> Queues:
    """What the filters leave of the queues: topic and priority choose messages, node and peer everything."""
    names = [name for name in (chosen.node, chosen.peer) if name is not None]
    return replace(
        queues,
        waiting=tuple(
            entry
            for entry in queues.waiting
            if all(name in (entry.node, entry.peer) for name in names)
            and chosen.topic in (None, entry.topic)
            and chosen.priority in (None, entry.priority)
        ),
        in_links=tuple(e for e in queues.in_links if all(name in (e.sender[0], e.receiver[0]) for name in names)),
        windows={pair: window for pair, window in queues.windows.items() if all(name in pair for name in names)},
    )


def queues_tables(trace: Trace, queues: Queues, *, has_verdicts: bool) -> list[Table]:
    """What the queues held: of daemons, of links, and the windows."""
    at = f"at {trace.seconds(queues.t_ns):.3f} s"
    waiting = [
        {
            "node": entry.node,
            "peer": entry.peer,
            "priority": entry.priority,
            "topic": entry.topic,
            "messages": entry.messages,
            "size_bytes": entry.size_bytes,
            "held": entry.held,
            "oldest_s": entry.oldest_s,
        }
        for entry in queues.waiting
    ]
    in_links = [
        {
            "from": "/".join(entry.sender),
            "to": "/".join(entry.receiver),
            "frames": entry.frames,
            "size_bytes": entry.size_bytes,
        }
        for entry in queues.in_links
    ]
    windows = [
        {
            "node": node,
            "peer": peer,
            "cwnd_bytes": window.cwnd_bytes,
            "in_flight_bytes": window.in_flight_bytes,
            "told_s": trace.seconds(window.t_ns),
        }
        for (node, peer), window in sorted(queues.windows.items())
    ]
    empty = "empty" if has_verdicts else "unknown: this engine tells no verdicts"
    return [
        Table(f"queues of the nodes {at}", _WAITING, waiting, "empty"),
        Table(f"in the links {at}", _IN_LINKS, in_links, empty),
        Table("windows, as told last", _WINDOWS, windows, "nobody told"),
    ]


def routes_table(trace: Trace, found: Iterable[Route]) -> Table:
    """Which relays carried the data."""
    rows = [
        {
            "source": route.source,
            "destination": route.destination,
            "relays": None if route.relays is None else " ".join(route.relays),
            "datagrams": route.datagrams,
            "ratio": route.ratio,
            "first_s": trace.seconds(route.first_ns),
            "last_s": trace.seconds(route.last_ns),
            "way": str(route),
        }
        for route in found
    ]
    shown = (
        Column("source", "from", is_left=True),
        Column("destination", "to", is_left=True),
        Column("way", "way", is_left=True),
        Column("datagrams", "datagrams"),
        Column("ratio", "share", lambda value: f"{100 * _number(value):.1f} %"),
        Column("first_s", "first", _second),
        Column("last_s", "last", _second),
        Column("relays"),
    )
    return Table("routes of datagrams with data", shown, rows, "no udp_mesh datagram with data can be read")


MESSAGE_KEYS = (
    "t_s", "kind", "source", "destination", "topic", "priority", "seq", "size_bytes", "accepted", "reason", "latency_s",
    "receipts", "fragments", "retransmissions", "copies",
)  # fmt: skip


def message_row(trace: Trace, life: MessageLife) -> dict[str, object]:
    """One message as plain values."""
    return {
        "t_s": trace.seconds(life.published.t_ns),
        "kind": "message",
        "source": life.stream.source,
        "destination": life.stream.destination,
        "topic": life.stream.topic,
        "priority": life.stream.priority,
        "seq": life.published.seq,
        "size_bytes": life.published.size_bytes,
        "accepted": life.published.accepted,
        "reason": life.published.reason,
        "latency_s": life.delivery.latency_s if life.delivery else None,
        "receipts": life.receipts,
        "fragments": life.fragments,
        "retransmissions": life.retransmissions,
        "copies": life.copies,
    }


def message_text(trace: Trace, life: MessageLife) -> str:
    """One message in a line."""
    if not life.published.accepted:
        fate = f"refused ({life.published.reason})"
    elif life.delivery is None:
        fate = "not delivered"
    else:
        fate = f"delivered after {milliseconds(life.delivery.latency_s)}"
        fate += f", {life.receipts} times" if life.receipts > 1 else ""
    again = f" +{life.retransmissions} again" if life.retransmissions else ""
    name = f"{life.stream} #{life.published.seq}"
    at = f"{trace.seconds(life.published.t_ns):12.6f}  p{life.stream.priority:<3}"
    return f"{at} {name:<36} {life.published.size_bytes:>8} B  {f'{life.fragments} fragments{again}':<16} {fate}"


def _number(value: object) -> float:
    return float(value) if isinstance(value, int | float) else 0.0


def _size(value: object) -> str:
    return size_text(round(_number(value)))


def _second(value: object) -> str:
    return "" if value is None else f"{_number(value):.3f} s"


def _optional(value: object) -> str:
    return "-" if value is None else str(value)


_WAITING = (
    Column("node", "node", is_left=True),
    Column("peer", "to", is_left=True),
    Column("topic", "topic", is_left=True),
    Column("priority", "pri"),
    Column("messages", "messages"),
    Column("size_bytes", "size", _size),
    Column("held", "rate-limited"),
    Column("oldest_s", "oldest", lambda value: milliseconds(_number(value))),
)
_IN_LINKS = (
    Column("from", "from", is_left=True),
    Column("to", "to", is_left=True),
    Column("frames", "frames"),
    Column("size_bytes", "size", _size),
)
_WINDOWS = (
    Column("node", "node", is_left=True),
    Column("peer", "to", is_left=True),
    Column("in_flight_bytes", "in flight", _size),
    Column("cwnd_bytes", "window", _size),
    Column("told_s", "told", _second),
)
