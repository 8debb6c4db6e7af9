"""What local applications ask of the daemon: publishing, subscribing, questions, settings."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict
from math import inf
from time import monotonic

from udp_mesh import config as configuration
from udp_mesh import local_fates, local_features, local_wire
from udp_mesh.core import envelope as envelopes
from udp_mesh.core import wire
from udp_mesh.core.envelope import Envelope
from udp_mesh.core.events import RefusalReason
from udp_mesh.core.mesh import MeshCore, PeerStatus, Refused
from udp_mesh.core.settings import Offline
from udp_mesh.io import compression
from udp_mesh.io.durable import Durable
from udp_mesh.io.questions import Questions
from udp_mesh.io.server import ALL_TOPICS, Connection, LocalServer
from udp_mesh.io.status import StatusPush
from udp_mesh.local_wire import FrameType, LocalProtocolError, Publish, Verdict


class RequestError(Exception):
    """A question that cannot be answered; the text goes to the application."""


class Requests:
    """Carries out frames. ``on_config`` is told when settings changed."""

    def __init__(
        self,
        core: MeshCore,
        durable: Durable,
        server: LocalServer,
        config: configuration.Config,
        on_config: Callable[[configuration.Config], None],
    ) -> None:
        self._core = core
        self._durable = durable
        self._on_config = on_config
        self.config = config
        self.status = StatusPush(self._state)
        self.questions = Questions(core, server)
        self.io_stats: Callable[[], dict[str, int]] = dict

    def handle(self, connection: Connection, kind: int, body: memoryview) -> None:
        """Carry out one frame; a damaged one closes the connection."""
        try:
            if kind == FrameType.PUBLISH:
                self.publish(connection, local_wire.decode_publish(body))
            elif kind == FrameType.SUBSCRIBE:
                self._subscribe(connection, str(body, "utf-8"))
            elif kind == FrameType.UNSUBSCRIBE:
                connection.topics.discard(str(body, "utf-8"))
                self._durable.inbox.unsubscribe(connection.number, str(body, "utf-8"))
            elif kind == FrameType.IDENTIFY:
                connection.client = local_features.decode_identity(body)
            elif kind == FrameType.TAKEN:
                for durable_id in local_features.decode_taken(body):
                    self._durable.inbox.take(connection.number, durable_id)
            elif kind == FrameType.FOLLOW:
                request, sequence, peer = local_fates.decode_follow(body)
                self._durable.fates.follow(connection, request, sequence, peer, self._durable.custody)
            elif kind == FrameType.WATCH:
                self.status.watch(connection, local_features.decode_watch(body), now=monotonic())
            elif kind == FrameType.ASK:
                question = local_wire.decode_publish(body)
                policy = question.overrides.apply(self._core.settings.policy(question.topic))
                self.questions.ask(connection, question, policy)
            elif kind == FrameType.ANSWER:
                self.questions.answer(*local_features.decode_reply(body))
            elif kind == FrameType.REQUEST:
                self._request(connection, json.loads(bytes(body)))
            else:
                connection.is_closed = True
        except (LocalProtocolError, ValueError):  # json and unicode errors are ValueErrors
            connection.is_closed = True

    def _subscribe(self, connection: Connection, topic: str) -> None:
        connection.topics.add(topic)
        if topic != ALL_TOPICS:
            self._durable.inbox.subscribe(connection.number, topic)

    def publish(self, connection: Connection, publish: Publish) -> None:
        """Publish, or park the connection until there is room, if the application chose to wait."""
        policy = publish.overrides.apply(self._core.settings.policy(publish.topic))
        if policy.offline is Offline.STORE:
            connection.parked = None if self._durable.has_room() else publish
            if connection.parked is None:
                self._durable.publish(connection, publish, policy)
            return
        if connection.parked is publish and not self._core.has_room(publish.topic, len(publish.payload)):
            return
        packed = compression.compress(publish.payload) if policy.compress else None
        head = b"" if packed is None else envelopes.encode(Envelope(original_bytes=len(publish.payload)))
        try:
            message_id = self._core.publish(
                publish.topic,
                publish.payload if packed is None else head + packed,
                to=publish.to,
                policy=policy,
                may_drop=not publish.waits,
                flags=wire.DATA_FLAG_ENVELOPE if head else 0,
                is_tracked=publish.is_tracked,
                now=monotonic(),
            )
        except Refused as refusal:
            if publish.waits and refusal.reason is RefusalReason.QUEUE_FULL:
                connection.parked = publish
                return
            connection.send(local_wire.encode_verdict(Verdict(publish.request, 0, refusal.reason.value)))
        else:
            if publish.is_tracked:
                peers = self._core.destinations(message_id)
                self._durable.fates.track(connection, publish.request, message_id, peers)
            if publish.wants_verdict:
                connection.send(local_wire.encode_verdict(Verdict(publish.request, message_id, "")))
        connection.parked = None

    def welcome(self, connection: Connection) -> None:
        """Greet an application with what it needs to judge its own calls."""
        connection.send(local_wire.json_frame(FrameType.WELCOME, self._about()))
        connection.send(local_wire.json_frame(FrameType.PEERS, self.peers()))

    def _about(self) -> dict[str, object]:
        config = self.config_values()
        return {"name": self._core.settings.name, "epoch": self._core.epoch, "config": config}

    def peers(self) -> list[dict[str, object]]:
        """Return the state of every peer as plain values."""
        known = [asdict(peer) for peer in self._core.peers(now=monotonic())]
        heard = {peer["name"] for peer in known}
        return known + [_not_heard(name) for name in self._durable.known_peers if name not in heard]

    def config_values(self) -> dict[str, object]:
        return configuration.describe(self.config)

    def _request(self, connection: Connection, request: object) -> None:
        if not isinstance(request, dict):
            raise LocalProtocolError("a request has to be an object")
        answer: dict[str, object] = {"id": request.get("id")}
        try:
            answer["result"] = self._answer(request)
        except (RequestError, configuration.ConfigError, ValueError) as error:
            answer["error"] = str(error)
        connection.send(local_wire.json_frame(FrameType.RESPONSE, answer))

    def _answer(self, request: dict[str, object]) -> object:
        method = request.get("method")
        if method == "peers":
            return self.peers()
        if method == "stats":
            counters = {**self._core.stats(), **self.io_stats(), **self._durable.stats(), **self.questions.counters}
            return {**self._about(), "counters": counters, **self._state()}
        if method == "config_get":
            return self.config_values()
        if method == "config_set":
            return self._config_set(str(request.get("key")), str(request.get("value")))
        raise RequestError(f"unknown method {method!r}; known are peers, stats, config_get, config_set")

    def _state(self) -> dict[str, object]:
        """Describe links and queues: what applications want to follow."""
        queues, stored = self._core.queue_depths(), self._durable.custody.depths()
        return {"queues": queues, "stored": stored, "peers": self.peers()}

    def _config_set(self, key: str, value: str) -> object:
        changed = configuration.change(self.config, key, value)
        trace = self._core.settings.trace_fragments
        self._core.reconfigure(changed.settings(trace_fragments=trace), now=monotonic())
        self.config = changed
        self._on_config(changed)
        return self.config_values()


def _not_heard(name: str) -> dict[str, object]:
    """Describe a node that an earlier start of the daemon knew and this one has not heard yet."""
    return asdict(PeerStatus(name, False, 0, "", inf, None, 0.0, 0, 0.0, 0, 0))
