"""Tells applications what became of the messages that they track. Nothing is remembered of others.

A fate is told once, over the connection that is there at that moment. A tracked message is followed until its end; but
of more than ``MAX_FOLLOWED`` plain or stored ones the oldest is no longer followed, and its publisher told so.
"""

from __future__ import annotations

from typing import NamedTuple

from udp_mesh import local_fates
from udp_mesh.core.custody import Custody
from udp_mesh.core.events import DropReason, Event, MessageAcked, MessageConfirmed, MessageDropped, StoredDropped
from udp_mesh.io.server import Connection
from udp_mesh.local_fates import Fate, Outcome, Tracked, unknown

MAX_FOLLOWED = 65_536
_UNKNOWABLE = (DropReason.PEER_RESTARTED, DropReason.PATH_TOO_SMALL)


class _Follower(NamedTuple):
    connection: Connection
    request: int
    peer: str


class Fates:
    """Tracked messages that have not ended."""

    def __init__(self) -> None:
        self._plain: dict[tuple[int, str], _Follower] = {}  # by message id and peer
        self._stored: dict[int, _Follower] = {}  # by sequence

    def __len__(self) -> int:
        """Messages that are followed, counted once for each destination."""
        return len(self._plain) + len(self._stored)

    def track(self, connection: Connection, request: int, message_id: int, peers: list[str]) -> None:
        """Follow a message that the transport has."""
        connection.send(local_fates.encode_tracked(Tracked(request, message_id, tuple(peers))))
        for peer in peers:
            self._plain[message_id, peer] = _Follower(connection, request, peer)
        while len(self._plain) > MAX_FOLLOWED:
            _give_up(self._plain.pop(next(iter(self._plain))))

    def admit(self, connection: Connection, request: int, sequences: list[tuple[int, str]]) -> None:
        """Follow a message that is about to be stored, as (sequence, peer); :meth:`committed` tells its publisher."""
        for sequence, peer in sequences:
            self._stored[sequence] = _Follower(connection, request, peer)
        while len(self._stored) > MAX_FOLLOWED:
            _give_up(self._stored.pop(next(iter(self._stored))))

    def committed(self, askers: list[tuple[Connection, int]], sequences: list[tuple[int, str]]) -> None:
        """Tell the newest connection of a publisher for whom its message is stored."""
        connection, request = askers[-1]
        connection.send(
            local_fates.encode_tracked(Tracked(request, sequences[0][0], tuple(peer for _, peer in sequences)))
        )
        for sequence, peer in sequences:
            if sequence in self._stored:
                self._stored[sequence] = _Follower(connection, request, peer)

    def forget(self, sequences: list[tuple[int, str]]) -> None:
        """Follow messages no longer that could not be stored; their publisher is told by a refusal."""
        for sequence, _peer in sequences:
            self._stored.pop(sequence, None)

    def resume(self, connection: Connection, request: int, sequence: int, peer: str | None, custody: Custody) -> None:
        """Follow a message that was stored over an earlier connection; ``peer`` None: nobody knows for whom."""
        peers = () if peer is None else (peer,)
        connection.send(local_fates.encode_tracked(Tracked(request, sequence, peers)))
        if peer is not None:
            self.follow(connection, request, sequence, peer, custody)

    def follow(self, connection: Connection, request: int, sequence: int, peer: str, custody: Custody) -> None:
        """Follow a stored message over a new connection, or tell at once that its end was missed."""
        follower = _Follower(connection, request, peer)
        if custody.holds(sequence, peer):
            self._stored[sequence] = follower
        else:
            _tell(follower, unknown(peer, "settled_unseen"))

    def on_event(self, event: Event) -> None:
        """Tell whoever follows a message that it has ended."""
        if isinstance(event, MessageAcked | MessageDropped):
            follower = self._plain.pop((event.message_id, event.peer), None)
        elif isinstance(event, MessageConfirmed | StoredDropped):
            follower = self._stored.pop(event.sequence, None)
        else:
            return
        if follower is None:
            return
        if isinstance(event, MessageAcked | MessageConfirmed):
            _tell(follower, Fate(event.peer, Outcome.ACKNOWLEDGED, latency_s=event.latency_s))
        else:
            outcome = Outcome.UNKNOWN if event.reason in _UNKNOWABLE else Outcome.FAILED
            fate = Fate(event.peer, outcome, event.reason.value, may_have_arrived=event.may_have_arrived)
            _tell(follower, fate)


def _give_up(follower: _Follower) -> None:
    _tell(follower, unknown(follower.peer, "not_followed"))


def _tell(follower: _Follower, fate: Fate) -> None:
    if not follower.connection.is_closed:
        follower.connection.send(local_fates.encode_fate(follower.request, fate))
