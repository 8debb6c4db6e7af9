"""The daemon's loop: sockets, timers and the core.

Built on select(2): it takes its time-out in microseconds, while epoll rounds up to a whole millisecond, which would
make paced packets late.
"""

from __future__ import annotations

import selectors
import socket
import sys
import time
from collections import Counter
from dataclasses import replace
from typing import cast

from udp_mesh import local_wire
from udp_mesh.config import Config
from udp_mesh.core import envelope as envelopes
from udp_mesh.core import wire
from udp_mesh.core.events import Event, MessageDelivered, MessageDropped, PeerDown, PeerUp, StoreProblem
from udp_mesh.core.mesh import Datagram, MeshCore
from udp_mesh.io import compression
from udp_mesh.io.carrier import CarrierSocket
from udp_mesh.io.carriers import open_carrier
from udp_mesh.io.durable import Durable
from udp_mesh.io.feed import EventFeed
from udp_mesh.io.interfaces import list_carriers
from udp_mesh.io.requests import Requests
from udp_mesh.io.server import Connection, LocalServer
from udp_mesh.local_wire import FrameType

RESCAN_INTERVAL_S = 1.0
BLOCKED_INTERVAL_S = 0.001


class Node:
    """One daemon's sockets around one core."""

    def __init__(self, config: Config, core: MeshCore, server: LocalServer, feed: EventFeed | None) -> None:
        self._config = config
        self._core = core
        self._server = server
        self._feed = feed
        self._counters: Counter[str] = Counter()
        self._carriers: dict[int, CarrierSocket] = {}
        self._full: set[int] = set()  # carriers of which we want to know when they take more
        self._selector = selectors.SelectSelector()
        self._durable = Durable(core, server, config, self._report)
        self._watched_store: int | None = None
        self._requests = Requests(core, self._durable, server, config, self._config_changed)
        self._requests.io_stats = lambda: dict(self._counters)
        self._is_stopping = False
        self._has_news = False
        self._rescan_at_s = 0.0
        self._selector.register(server, selectors.EVENT_READ)
        # A signal handler only runs between bytecodes: the pipe wakes select when one arrives.
        self._wake_read, self.wake_write = socket.socketpair()
        self._wake_read.setblocking(False)
        self.wake_write.setblocking(False)
        self._selector.register(self._wake_read, selectors.EVENT_READ)

    def stop(self) -> None:
        """End :meth:`run` after the current turn; may be called from a signal handler."""
        self._is_stopping = True

    def open_store(self) -> None:
        """Open the file of stored messages if there is one, or a topic needs it; failures are told and not fatal."""
        self._durable.open_if_wanted()

    def open_carriers(self) -> None:
        """Open a socket on every wanted interface that is there, and close those of interfaces that are gone.

        Raises:
            OSError: The port is in use.
        """
        self._rescan_at_s = time.monotonic() + RESCAN_INTERVAL_S
        present = {facts.index: facts for facts in list_carriers(self._config)}
        for index in [i for i, c in self._carriers.items() if c.is_broken or present.get(i) != c.facts]:
            self._close_carrier(index)
        for index, facts in present.items():
            if index not in self._carriers:
                carrier = open_carrier(facts, self._config, self._counters)
                self._carriers[index] = carrier
                self._selector.register(carrier, selectors.EVENT_READ)
                self._core.add_carrier(
                    index, mtu_bytes=facts.mtu_bytes, rate_bps=facts.rate_bps, neighbours=facts.neighbours
                )

    def _close_carrier(self, index: int) -> None:
        self._core.remove_carrier(index)
        carrier = self._carriers.pop(index)
        self._full.discard(index)
        self._selector.unregister(carrier)
        carrier.close()

    def _rescan(self) -> None:
        try:
            self.open_carriers()
        except OSError:  # it vanished again, or somebody took the port: the next scan tries anew
            self._counters["interface_failures"] += 1

    def run(self) -> None:
        """Serve until :meth:`stop`."""
        while not self._is_stopping:
            self._exhaust()
            due_s = self._next_timer()
            wait_s = max(0.0, due_s - time.monotonic())
            if self._is_blocked():
                wait_s = max(wait_s, BLOCKED_INTERVAL_S)  # what is due to be sent cannot be: wait for the socket
            for key, events in self._selector.select(wait_s):
                self._ready(key.fileobj, events)
            now = time.monotonic()
            if due_s <= now:
                self._core.handle_timer(now=now)
            if now >= self._rescan_at_s:
                self._rescan()

    def _next_timer(self) -> float:
        if self._has_news and self._durable.fileno() is not None:
            return time.monotonic()
        times = [self._core.next_timer(), self._rescan_at_s]
        for time_s in (self._durable.next_timer(), self._requests.status.next_timer()):
            if time_s is not None:
                times.append(time_s)
        return min(times)

    def _ready(self, source: object, events: int) -> None:
        if isinstance(source, LocalServer):
            connection = source.accept()
            if connection is not None:
                self._requests.welcome(connection)
        elif isinstance(source, Connection):
            if events & selectors.EVENT_READ:
                source.read()
                self._serve(source)
        elif source is self._wake_read:
            self._wake_read.recv(64)
        elif source == self._watched_store:
            self._durable.completed()
        elif events & selectors.EVENT_READ:
            self._receive(cast(CarrierSocket, source))

    def _receive(self, carrier: CarrierSocket) -> None:
        for data, segment_bytes, path, now in carrier.receive():
            self._core.receive_burst(data, segment_bytes, path, now=now)
        if carrier.is_broken:
            self._close_carrier(carrier.facts.index)  # the next scan opens it again if it can

    def _serve(self, connection: Connection) -> None:
        while (frame := connection.next_frame()) is not None:
            self._requests.handle(connection, *frame)

    def _exhaust(self) -> None:
        """Bring everything that the core has to where it belongs."""
        self._retry_parked()
        self._events()
        self._durable.turn(now=time.monotonic())
        self._watch_store()
        self._dispatch([] if self._is_blocked() else self._core.datagrams_to_send(now=time.monotonic()))
        self._requests.status.send(now=time.monotonic())
        self._has_news = self._events()  # what came of sending: the store looks at it in the next turn, at once
        for connection in list(self._server.connections):
            if connection.has_output:
                connection.flush()
            self._watch(connection)
        if self._feed is not None:
            self._feed.flush()

    def _retry_parked(self) -> None:
        for connection in self._server.connections:
            if connection.parked is not None:
                self._requests.publish(connection, connection.parked)
                self._serve(connection)

    def _is_blocked(self) -> bool:
        return any(carrier.is_blocked for carrier in self._carriers.values())

    def _dispatch(self, datagrams: list[Datagram]) -> None:
        for index, carrier in self._carriers.items():
            mine = [datagram for datagram in datagrams if datagram.path.carrier == index]
            if not mine and not carrier.wants_write:
                continue
            carrier.send(mine, window_bytes=self._core.window_bytes(index))
            if carrier.wants_write != (index in self._full):
                self._full ^= {index}
                wanted = selectors.EVENT_READ | (selectors.EVENT_WRITE if index in self._full else 0)
                self._selector.modify(carrier, wanted)

    def _watch_store(self) -> None:
        descriptor = self._durable.fileno()
        if descriptor is not None and self._watched_store is None:
            self._selector.register(descriptor, selectors.EVENT_READ)
            self._watched_store = descriptor

    def _report(self, event: Event) -> None:
        if self._feed is not None:
            self._feed.add(event)
        if self._durable.fates:
            self._durable.fates.on_event(event)
        if isinstance(event, StoreProblem):
            print(f"udp-mesh: {event.reason}: {event.detail}", file=sys.stderr, flush=True)

    def _deliver(self, event: MessageDelivered) -> None:
        if not event.flags & wire.DATA_FLAG_ENVELOPE:
            message = local_wire.Message(event.topic, event.payload, event.source, event.priority, time.time_ns())
            self._server.deliver(message)
            return
        decoded = envelopes.decode(event.payload)
        if decoded is None:
            self._counters["bad_envelope"] += 1
            return
        envelope, body = decoded
        if envelope.confirms:
            self._durable.confirmed(event.source, body, now=event.now)
        elif envelope.stored is not None:
            self._durable.received(event, envelope, body)
        elif envelope.request is not None:
            self._requests.questions.asked(event, envelope, body)
        elif envelope.response is not None:
            self._requests.questions.answered(envelope, body)
        elif envelope.original_bytes is not None:
            self._unpack(event, body, envelope.original_bytes)

    def _unpack(self, event: MessageDelivered, body: memoryview, original_bytes: int) -> None:
        payload = compression.decompress(body, original_bytes)
        if payload is None:
            self._counters["bad_compression"] += 1  # damaged, or this node lacks zstandard
        else:
            self._deliver(replace(event, payload=payload, flags=0))

    def _events(self) -> bool:
        """Carry the core's events to whom they concern; whether there were any."""
        presence_changed, count = False, 0
        while (event := self._core.next_event()) is not None:
            count += 1
            self._report(event)
            self._durable.on_event(event)
            if isinstance(event, MessageDelivered):
                self._deliver(event)
            elif isinstance(event, MessageDropped):
                if event.token < 0:
                    self._requests.questions.on_dropped(event)
            elif isinstance(event, PeerUp | PeerDown):
                presence_changed = True
        if presence_changed:
            self._server.tell_all(FrameType.PEERS, self._requests.peers())
        return count > 0

    def _watch(self, connection: Connection) -> None:
        wanted = selectors.EVENT_READ if connection.is_readable else 0
        if connection.has_output:
            wanted |= selectors.EVENT_WRITE
        if connection.is_closed:
            wanted = 0
        if wanted != connection.watched:
            if connection.watched == 0:
                self._selector.register(connection, wanted)
            elif wanted == 0:
                self._selector.unregister(connection)
            else:
                self._selector.modify(connection, wanted)
            connection.watched = wanted
        if connection.is_closed:
            self._server.remove(connection)
            self._durable.inbox.leave(connection.number)

    def _config_changed(self, config: Config) -> None:
        self._config = config
        about = {"name": config.name, "epoch": self._core.epoch, "config": self._requests.config_values()}
        self._server.tell_all(FrameType.WELCOME, about)

    def close(self) -> None:
        """Close all sockets and the store."""
        self._durable.close()
        for carrier in self._carriers.values():
            carrier.close()
        self._server.close()
        self._selector.close()
        self._wake_read.close()
        self.wake_write.close()
