"""Rows of the store's file: the statements that change them, and how values are written. No connection here."""

from __future__ import annotations

import json
import time
import zlib
from pathlib import Path

from udp_mesh.core.envelope import DurableId
from udp_mesh.core.inbox import Kept
from udp_mesh.core.settings import Keep, Offline, TopicPolicy
from udp_mesh.core.stored import Stored

Statement = tuple[str, tuple[object, ...]]

REMEMBERED_REQUESTS = 1024  # of one application; it never has more publishes undecided
_REMEMBERED = ("priority", "keep", "redundancy", "rate_limit_hz", "rate_limit_bps")  # of a policy, in the file
_BOOT_ID = Path("/proc/sys/kernel/random/boot_id")


def outgoing_payload(sequence: int) -> Statement:
    """Return the query for the payload of a message of this node, and its checksum."""
    return "SELECT payload, crc FROM outgoing WHERE sequence = ?", (sequence,)


def incoming_payload(durable_id: DurableId) -> Statement:
    """Return the query for the payload of a received message, and its checksum."""
    return "SELECT payload, crc FROM incoming WHERE store = ? AND sequence = ?", signed_id(durable_id)


def put_outgoing(entry: Stored, payload: bytes) -> Statement:
    """Return what stores a message of this node."""
    values = (entry.sequence, entry.peer, entry.topic, policy_text(entry.policy), entry.original_bytes)
    age = moment(entry.deadline_s - entry.queued_at_s)
    return f"INSERT INTO outgoing VALUES ({_marks(11)})", (*values, *age, payload, zlib.crc32(payload))


def drop_outgoing(sequence: int) -> Statement:
    """Return what removes a message of this node."""
    return "DELETE FROM outgoing WHERE sequence = ?", (sequence,)


def put_taken(client: int, request: int, sequence: int) -> Statement:
    """Return what remembers that a publish was taken."""
    values = (signed(client), request, sequence, time.time())
    return "INSERT OR REPLACE INTO taken VALUES (?, ?, ?, ?)", values


def drop_taken(client: int, request: int) -> Statement:
    """Return what forgets a publish of which the application has long had the verdict."""
    return "DELETE FROM taken WHERE client = ? AND request = ?", (signed(client), request)


def put_incoming(message: Kept, payload: bytes, *, age_s: float) -> Statement:
    """Return what stores a received message and its id."""
    values = (*signed_id(message.durable_id), message.source, message.topic, message.priority)
    return (
        f"INSERT OR REPLACE INTO incoming VALUES ({_marks(12)})",
        (*values, message.received_ns, *moment(age_s), payload, zlib.crc32(payload)),
    )


def take_incoming(durable_id: DurableId) -> Statement:
    """Return what removes a received message but remembers its id."""
    return "UPDATE incoming SET payload = NULL WHERE store = ? AND sequence = ?", signed_id(durable_id)


def put_floor(store: int, floor: int) -> list[Statement]:
    """Return what forgets the ids of a store that are settled. Sequences are below 2**63: they are row numbers."""
    values = (signed(store), signed(floor))
    return [
        ("INSERT OR REPLACE INTO floors VALUES (?, ?)", values),
        ("DELETE FROM incoming WHERE store = ? AND sequence < ? AND payload IS NULL", values),
    ]


def put_peer(name: str) -> Statement:
    """Return what remembers a node's name."""
    return "INSERT OR IGNORE INTO peers VALUES (?)", (name,)


def is_sound(payload: bytes, crc: object) -> bool:
    """Whether a payload is what was written; SQLite itself does not notice every damage. ``crc`` None: not known."""
    return crc is None or zlib.crc32(payload) == crc


def _marks(count: int) -> str:
    return ", ".join("?" * count)


def boot_id() -> str:
    """Return what differs after every boot, empty where the system does not tell."""
    try:
        return _BOOT_ID.read_text().strip()
    except OSError:
        return ""


def moment(lifetime_s: float) -> tuple[object, ...]:
    """Return the columns from which a later start derives a message's age."""
    return (time.time(), boot_id(), time.monotonic(), lifetime_s)


def policy_text(policy: TopicPolicy) -> str:
    """Return what has to be remembered of a policy; its lifetime is in columns of its own."""
    values = {name: getattr(policy, name) for name in _REMEMBERED}
    return json.dumps(values)


def policy(text: str) -> TopicPolicy:
    """Return the policy of a stored message."""
    values = json.loads(text)
    return TopicPolicy(**{**values, "keep": Keep(values["keep"])}, offline=Offline.STORE)


def signed(number: int) -> int:
    """Return an unsigned 64-bit number as SQLite holds it."""
    return number - (1 << 64) if number >= 1 << 63 else number


def unsigned(number: int) -> int:
    """Return the number that :func:`signed` was given."""
    return number + (1 << 64) if number < 0 else number


def signed_id(durable_id: DurableId) -> tuple[int, int]:
    """Return the columns of a durable id."""
    return signed(durable_id.store), signed(durable_id.sequence)
