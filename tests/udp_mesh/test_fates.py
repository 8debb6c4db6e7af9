"""What applications are told of the messages that they track: frames, the daemon's side, the client's side."""

from __future__ import annotations

import contextlib
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from udp_mesh import local_fates, local_wire
from udp_mesh.client_fates import TrackedMessage
from udp_mesh.client_state import ClientState
from udp_mesh.core.custody import Custody
from udp_mesh.core.events import DropReason, MessageAcked, MessageConfirmed, MessageDropped, StoredDropped
from udp_mesh.core.settings import Offline, TopicPolicy
from udp_mesh.frame_reader import FrameReader
from udp_mesh.io import fates as daemon_side
from udp_mesh.io.fates import Fates
from udp_mesh.local_fates import Fate, Outcome, Tracked
from udp_mesh.local_wire import FrameType, LocalProtocolError, Overrides, Verdict

names = st.text(min_size=1, max_size=60)


def frames(data: bytes) -> list[tuple[int, memoryview]]:
    reader, found, rest = FrameReader(), [], memoryview(data)
    while rest:
        buffer = reader.buffer()
        size = min(len(rest), len(buffer))
        buffer[:size] = rest[:size]
        found += reader.filled(size)
        rest = rest[size:]
    return found


class Wire:
    """The daemon's end of a connection, and the client's state at the other."""

    def __init__(self, state: ClientState) -> None:
        self.state, self.is_closed, self.told = state, False, 0

    def send(self, data: bytes) -> None:
        self.told += 1
        for kind, body in frames(data):
            self.state._frame(kind, body)


class Application:
    """A client's state, and how it publishes."""

    def __init__(self) -> None:
        self.state = ClientState()
        self.wire: Any = Wire(self.state)

    def publish(self, to: str, offline: Offline = Offline.DISCARD) -> tuple[int, TrackedMessage]:
        message = TrackedMessage(to)
        request, _frame = self.state.encode_publish("t", b"x", to, Overrides(offline=offline), tracked=message)
        return request, message

    def verdict(self, request: int, message_id: int = 0, reason: str = "") -> None:
        self.wire.send(local_wire.encode_verdict(Verdict(request, message_id, reason)))


def acked(message_id: int, peer: str, latency_s: float = 0.25) -> MessageAcked:
    return MessageAcked(1.0, message_id, "t", 5, peer, latency_s)


def dropped(message_id: int, peer: str, reason: DropReason, *, may_have_arrived: bool = False) -> MessageDropped:
    return MessageDropped(1.0, message_id, "t", 5, 1, peer, reason, may_have_arrived=may_have_arrived)


@given(
    st.integers(0, 0xFFFFFFFF),
    st.integers(0, (1 << 64) - 1),
    st.lists(names, max_size=5),
    st.builds(
        Fate, names, st.sampled_from(Outcome), st.text(max_size=20), st.none() | st.floats(0, 1e6), st.booleans()
    ),
)
def test_frames_come_back(request: int, number: int, peers: list[str], fate: Fate) -> None:
    tracked = Tracked(request, number, tuple(peers))
    data = local_fates.encode_tracked(tracked) + local_fates.encode_fate(request, fate)
    data += local_fates.encode_follow(request, number, fate.peer)
    (one, first), (two, second), (three, third) = frames(data)
    assert (one, two, three) == (FrameType.TRACKED, FrameType.FATE, FrameType.FOLLOW)
    assert local_fates.decode_tracked(first) == tracked
    assert local_fates.decode_fate(second) == (request, fate)
    assert local_fates.decode_follow(third) == (request, number, fate.peer)


@given(st.binary(max_size=40))
def test_garbage_from_an_application_is_a_protocol_or_a_value_error(data: bytes) -> None:
    with contextlib.suppress(LocalProtocolError, ValueError):
        local_fates.decode_follow(memoryview(data))


def test_each_destination_has_its_own_fate() -> None:
    app, daemon = Application(), Fates()
    request, message = app.publish("all")
    assert (message.peers, message.is_complete) == ((), False)
    daemon.track(app.wire, request, 7, ["b", "c", "d", "e"])
    assert message.peers == ("b", "c", "d", "e")
    daemon.on_event(acked(7, "b"))
    daemon.on_event(acked(8, "c"))  # of another message
    daemon.on_event(dropped(7, "c", DropReason.EXPIRED, may_have_arrived=True))
    daemon.on_event(dropped(7, "d", DropReason.PEER_RESTARTED, may_have_arrived=True))
    assert not message.is_complete
    daemon.on_event(acked(7, "e", 0.5))
    daemon.on_event(dropped(7, "e", DropReason.LOST))  # the first word counts
    assert message.fates == {
        "b": Fate("b", Outcome.ACKNOWLEDGED, latency_s=0.25),
        "c": Fate("c", Outcome.FAILED, "expired", may_have_arrived=True),
        "d": Fate("d", Outcome.UNKNOWN, "peer_restarted", may_have_arrived=True),
        "e": Fate("e", Outcome.ACKNOWLEDGED, latency_s=0.5),
    }
    assert (message.is_complete, message.is_acknowledged) == (True, False)
    assert (len(daemon), len(app.state.tracked)) == (0, 0)


def test_a_message_that_nobody_tracks_costs_no_word() -> None:
    app, daemon = Application(), Fates()
    daemon.on_event(acked(7, "b"))
    assert (len(daemon), app.wire.told) == (0, 0)


def test_a_refusal_is_a_failure_with_its_reason() -> None:
    app = Application()
    request, message = app.publish("b")
    app.verdict(request, reason="queue_full")
    assert message.fates == {"b": Fate("b", Outcome.FAILED, "queue_full")}
    assert message.is_complete
    assert not message.is_acknowledged


def test_what_was_on_its_way_at_a_lost_connection_is_unknown() -> None:
    app, daemon = Application(), Fates()
    _request, unheard = app.publish("b")
    request, known = app.publish("all")
    daemon.track(app.wire, request, 7, ["b", "c"])
    daemon.on_event(acked(7, "b"))
    app.state.disconnected()
    assert unheard.fates == {"b": Fate("b", Outcome.UNKNOWN, "daemon_unreachable", may_have_arrived=True)}
    assert [fate.outcome for fate in known.fates.values()] == [Outcome.ACKNOWLEDGED, Outcome.UNKNOWN]
    assert known.is_complete
    app.wire.is_closed = True
    daemon.on_event(acked(7, "c"))
    assert len(daemon) == 0


def test_a_stored_message_is_followed_over_a_new_connection() -> None:
    app, daemon = Application(), Fates()
    custody = Custody(limit_bytes=1000, age_s=60.0)
    first, second = custody.admit("t", 1, ["b", "c"], TopicPolicy(), now=0.0)
    sequences = [(entry.sequence, entry.peer) for entry in (first, second)]
    request, message = app.publish("all", Offline.STORE)
    daemon.admit(app.wire, request, sequences)
    daemon.committed([(app.wire, request)], sequences)
    app.verdict(request, first.sequence)
    app.state.disconnected()
    assert not message.fates
    daemon = Fates()  # a new life, in which the first is settled already
    custody.committed(first, now=0.0)
    custody.committed(second, now=0.0)
    assert custody.on_confirmed(first.sequence, "b", now=1.0)
    follows = [body for kind, body in frames(app.state.connected()) if kind == FrameType.FOLLOW]
    for body in follows:
        daemon.follow(app.wire, *local_fates.decode_follow(body), custody)
    assert message.fates == {"b": Fate("b", Outcome.UNKNOWN, "settled_unseen", may_have_arrived=True)}
    daemon.on_event(MessageConfirmed(2.0, second.sequence, "t", 5, "c", 1.5))
    assert message.fates["c"] == Fate("c", Outcome.ACKNOWLEDGED, latency_s=1.5)
    assert message.is_complete
    assert [kind for kind, _body in frames(app.state.connected())] == [FrameType.IDENTIFY]


def test_a_stored_message_can_end_before_it_is_known_for_whom() -> None:
    app, daemon = Application(), Fates()
    request, message = app.publish("b", Offline.STORE)
    daemon.admit(app.wire, request, [(3, "b")])
    daemon.on_event(StoredDropped(1.0, 3, "t", 5, 1, "b", DropReason.SUPERSEDED))
    assert not message.is_complete
    daemon.committed([(app.wire, request)], [(3, "b")])
    assert message.fates == {"b": Fate("b", Outcome.FAILED, "superseded")}
    assert message.is_complete


@pytest.mark.parametrize("peer", ["b", None])
def test_a_publish_that_is_repeated_after_it_was_settled_is_unknown(peer: str | None) -> None:
    app, daemon = Application(), Fates()
    request, message = app.publish("b" if peer else "all", Offline.STORE)
    daemon.resume(app.wire, request, 3, peer, Custody(limit_bytes=1000, age_s=60.0))
    name = peer or "all"
    assert message.fates == {name: Fate(name, Outcome.UNKNOWN, "settled_unseen", may_have_arrived=True)}
    assert message.is_complete


def test_memory_is_bounded_and_the_oldest_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(daemon_side, "MAX_FOLLOWED", 10)
    app, daemon = Application(), Fates()
    messages = []
    for number in range(15):
        request, message = app.publish("b")
        daemon.track(app.wire, request, number, ["b"])
        daemon.admit(app.wire, request, [(number, "b")])
        messages.append(message)
    assert len(daemon) == 20
    assert [m.is_complete for m in messages] == [True] * 5 + [False] * 10
    assert messages[0].fates["b"].reason == "not_followed"
    monkeypatch.setattr("udp_mesh.client_fates.MAX_OPEN", 3)
    app = Application()
    messages = [app.publish("b")[1] for _ in range(5)]
    assert [len(m.fates) for m in messages] == [1, 1, 0, 0, 0]
