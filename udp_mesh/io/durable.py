"""Messages of topics with ``offline = "store"``: brings file, custody, inbox and transport together.

A publish is answered once the file has it; a received message is confirmed to its sender, and handed to applications,
once the file has it. The file is opened at the start if it exists or a topic wants it, otherwise with the first
message that needs it.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from udp_mesh.config import Config
from udp_mesh.core import envelope as envelopes
from udp_mesh.core.custody import Custody
from udp_mesh.core.envelope import Envelope
from udp_mesh.core.events import (
    Event,
    MessageAcked,
    MessageDelivered,
    MessageDropped,
    PeerUp,
    PeerUpReason,
    RefusalReason,
    StoreProblem,
)
from udp_mesh.core.inbox import Inbox
from udp_mesh.core.mesh import MeshCore
from udp_mesh.core.settings import Offline, TopicPolicy
from udp_mesh.io import store_rows
from udp_mesh.io.fates import Fates
from udp_mesh.io.incoming import Applications, Incoming
from udp_mesh.io.outgoing import Outgoing, answer
from udp_mesh.io.server import Connection
from udp_mesh.local_wire import Publish

if TYPE_CHECKING:
    from udp_mesh.io.store import Outcome, Store

REOPEN_AFTER_S = 5.0
PROBLEM_INTERVAL_S = 1.0
RETRY_TIDY_AFTER_S = 2.0


class Durable:
    """Stored messages of one daemon. ``report`` is given events; they also tell why there is no store."""

    def __init__(
        self,
        core: MeshCore,
        server: Applications,
        config: Config,
        report: Callable[[Event], None],
        *,
        clock: Callable[[], float] = time.monotonic,
        open_store: Callable[[str, float, float], Store] | None = None,
    ) -> None:
        self.custody = Custody(limit_bytes=config.store_bytes, age_s=config.store_age_s)
        self.inbox = Inbox(limit_bytes=config.store_bytes, age_s=config.store_age_s)
        self.fates = Fates()
        self._counters: Counter[str] = Counter()
        self._core = core
        self._server = server
        self._config = config
        self._report = report
        self._clock = clock
        self._open_store = open_store
        self._tidy_at_s = 0.0
        self._thread: Store | None = None
        self._outgoing: Outgoing | None = None
        self._incoming: Incoming | None = None
        self._retry_open_at_s = 0.0
        self._problem_at_s = 0.0

    # -- the file

    def open_if_wanted(self) -> None:
        """Open the file if it exists or a topic is configured to be stored."""
        wanted = any(policy.offline is Offline.STORE for policy in self._config.topics.values())
        if wanted or Path(self._config.store_path()).exists():
            self._open()

    def _open(self) -> tuple[Outgoing, Incoming] | None:
        """Open the file unless it is open. A failure is reported, and tried again later."""
        if self._outgoing is not None and self._incoming is not None:
            return self._outgoing, self._incoming
        now = self._clock()
        if now < self._retry_open_at_s:
            return None
        from udp_mesh.io.store import StoreThread  # a daemon that stores nothing does without SQLite
        from udp_mesh.io.store_file import StoreError

        self._retry_open_at_s = now + REOPEN_AFTER_S
        path = self._config.store_path()
        try:
            Path(path).parent.mkdir(parents=True, exist_ok=True, mode=0o700)
            thread = (self._open_store or StoreThread)(path, self._config.store_age_s, now)
        except (StoreError, OSError) as error:
            self._counters["store_failures"] += 1
            text = f"{error}; stored topics are refused until it can be opened"
            self._report(StoreProblem(now, "store_failed", text))
            return None
        self._thread = thread
        self._outgoing = Outgoing(self._core, self.custody, thread, self._problem, self._clock, self.fates)
        self._incoming = Incoming(self._core, self._server, self.inbox, thread, self._problem)
        heard = [peer.name for peer in self._core.peers(now=now)]
        for name in (*heard, *self._config.team):
            if name != self._config.name:
                self._outgoing.remember(name)
        return self._outgoing, self._incoming

    def fileno(self) -> int | None:
        """Descriptor that is readable when the file has something to tell; None while it is not open."""
        return None if self._thread is None else self._thread.fileno()

    def completed(self) -> None:
        """Take what the file has done."""
        if self._thread is not None:
            for done, outcome in self._thread.outcomes():
                done(outcome)

    def close(self) -> None:
        """Write what is left and close the file."""
        if self._thread is not None:
            self._tidy(self._thread)
            self._thread.close()

    def _problem(self, outcome: Outcome) -> None:
        """Count what could not be written; report it, but not for every message."""
        now = self._clock()
        self._counters[f"{outcome.reason}_failures"] += 1
        if now >= self._problem_at_s:
            self._problem_at_s = now + PROBLEM_INTERVAL_S
            self._report(StoreProblem(now, outcome.reason, f"{self._config.store_path()}: {outcome.detail}"))

    # -- what happens

    @property
    def known_peers(self) -> list[str]:
        """Names of nodes for which messages are taken, also of those not heard since this start."""
        return [] if self._outgoing is None else list(self._outgoing.known_peers)

    def has_room(self) -> bool:
        """Whether the file keeps up with what is published."""
        return self._outgoing is None or self._outgoing.has_room()

    def publish(self, connection: Connection, publish: Publish, policy: TopicPolicy) -> None:
        """Store a message and answer once it is safe; an application that repeats a publish gets the same answer."""
        opened = self._open()
        if opened is None:
            answer([(connection, publish.request)], 0, RefusalReason.STORE_FAILED)
        else:
            opened[0].publish(connection, publish, policy)

    def received(self, event: MessageDelivered, envelope: Envelope, body: memoryview) -> None:
        """Take a stored message from another node; without a file it stays unconfirmed, and its sender keeps it."""
        opened = self._open()
        if opened is not None:
            opened[1].received(event, envelope, body)

    def confirmed(self, source: str, body: memoryview, *, now: float) -> None:
        """Take a receiver's word that messages are safe with it."""
        for store, sequence in envelopes.decode_ids(body):
            if self._outgoing is not None and store == self._outgoing.store_id:
                self.custody.on_confirmed(sequence, source, now=now)

    def on_event(self, event: Event) -> None:
        """Follow what the transport says of our messages and of peers."""
        if isinstance(event, MessageAcked) and event.token > 0:
            self.custody.on_acked(event.token, now=event.now)
        elif isinstance(event, MessageDropped) and event.token > 0:
            self.custody.on_dropped(event.token, event.reason, now=event.now)
        elif isinstance(event, PeerUp):
            if self._outgoing is not None:
                self._outgoing.remember(event.peer)
            if event.reason is PeerUpReason.RESTARTED:
                self.custody.on_peer_restarted(event.peer)

    # -- the turn of the loop

    def turn(self, *, now: float) -> None:
        """Hand on whatever can go: to the transport, to applications, to the file."""
        if self._thread is None or self._outgoing is None or self._incoming is None:
            return
        self.custody.handle_timer(now=now)
        self.inbox.handle_timer(now=now)
        self._outgoing.feed(now=now)
        self._incoming.hand_on(now=now)
        if now >= self._tidy_at_s:
            self._tidy(self._thread)
        while self.custody.events:
            self._report(self.custody.events.popleft())
        while self._thread.notes:
            self._counters["store_failures"] += 1
            self._report(StoreProblem(now, "store_corrupted", self._thread.notes.pop(0)))

    def next_timer(self) -> float | None:
        """Return when :meth:`turn` is due."""
        times = [self.custody.next_timer(), self.inbox.next_timer()]
        if len(self.custody) and self._outgoing is not None:
            times.append(self._outgoing.seek_at_s)
        if self.custody.forgotten or self.inbox.taken:
            times.append(self._tidy_at_s)
        return min((time_s for time_s in times if time_s is not None), default=None)

    def _tidy(self, thread: Store) -> None:
        forgotten, self.custody.forgotten = self.custody.forgotten, []
        taken, self.inbox.taken = self.inbox.taken, []
        statements = [store_rows.drop_outgoing(sequence) for sequence in forgotten]
        statements += [store_rows.take_incoming(durable_id) for durable_id in taken]

        def done(outcome: Outcome) -> None:
            if outcome.reason:  # a full disk may have room again later
                self._tidy_at_s = self._clock() + RETRY_TIDY_AFTER_S
                self.custody.forgotten[:0] = forgotten
                self.inbox.taken[:0] = taken

        if statements:
            thread.write(statements, done)

    def stats(self) -> dict[str, int]:
        """Return the counters of stored messages."""
        counters = self._counters + self.custody.counters + self.inbox.counters
        for part in (self._outgoing, self._incoming):
            counters += part.counters if part is not None else Counter()
        return {
            **counters,
            "stored_messages": len(self.custody),
            "stored_bytes": self.custody.stored_bytes,
            "inbox_messages": len(self.inbox),
            "inbox_bytes": self.inbox.kept_bytes,
        }
