"""Requests that expect an answer, between applications of two nodes.

The asking daemon numbers its questions; the answering one gives applications a number of its own for each, so that an
answer needs no more than that. The first answer counts. What is never answered is forgotten: an asker that waits has
its own time-out.
"""

from __future__ import annotations

import time
from collections import Counter

from udp_mesh import local_features
from udp_mesh.core import envelope as envelopes
from udp_mesh.core import wire
from udp_mesh.core.envelope import Envelope, Status
from udp_mesh.core.events import MessageDelivered, MessageDropped
from udp_mesh.core.mesh import MeshCore, Refused
from udp_mesh.core.settings import Offline, TopicPolicy
from udp_mesh.io.server import Connection, LocalServer
from udp_mesh.local_features import Answer
from udp_mesh.local_wire import Message, Publish

MAX_OPEN = 4096


class Questions:
    """Open questions of this node's applications, and of others to them."""

    def __init__(self, core: MeshCore, server: LocalServer) -> None:
        self.counters: Counter[str] = Counter()
        self._core = core
        self._server = server
        self._asked: dict[int, tuple[Connection, int]] = {}
        self._to_answer: dict[int, tuple[int, str, str, int]] = {}  # question, source, topic, priority
        self._next = 1

    def _number(self) -> int:
        self._next += 1
        return self._next - 1

    def ask(self, connection: Connection, publish: Publish, policy: TopicPolicy) -> None:
        """Send a question; whatever becomes of it, the application gets an answer."""
        question = self._number()
        envelope = envelopes.encode(Envelope(request=question))
        try:
            self._core.publish(
                publish.topic,
                envelope + bytes(publish.payload),
                to=publish.to,
                policy=policy,
                flags=wire.DATA_FLAG_ENVELOPE,
                token=-question,
                now=time.monotonic(),
            )
        except Refused as refusal:
            reason = refusal.reason.value.encode()
            connection.send(local_features.encode_answer(Answer(publish.request, local_features.FAILED, reason)))
            return
        self._asked[question] = (connection, publish.request)
        if len(self._asked) > MAX_OPEN:
            del self._asked[next(iter(self._asked))]

    def on_dropped(self, event: MessageDropped) -> None:
        """Tell an application that its question will not arrive."""
        self._tell(-event.token, local_features.FAILED, event.reason.value.encode())

    def answered(self, envelope: Envelope, body: memoryview) -> None:
        """Take an answer from another node."""
        if envelope.response is not None:
            self._tell(envelope.response, envelope.status, bytes(body))

    def _tell(self, question: int, status: int, payload: bytes) -> None:
        asker = self._asked.pop(question, None)
        if asker is None:
            self.counters["answers_unexpected"] += 1
        elif not asker[0].is_closed:
            asker[0].send(local_features.encode_answer(Answer(asker[1], status, payload)))

    def asked(self, event: MessageDelivered, envelope: Envelope, body: memoryview) -> None:
        """Give a question to the applications that have subscribed to its topic by name."""
        assert envelope.request is not None  # the caller looked
        applications = [c for c in self._server.connections if event.topic in c.topics and not c.is_closed]
        number = self._number()
        self._to_answer[number] = (envelope.request, event.source, event.topic, event.priority)
        if not applications:
            self.answer(number, b"", status=Status.NOBODY)
            return
        if len(self._to_answer) > MAX_OPEN:
            del self._to_answer[next(iter(self._to_answer))]
        message = Message(event.topic, bytes(body), event.source, event.priority, time.time_ns(), reply_to=number)
        frame = local_features.encode_question(message)
        for connection in applications:
            connection.send(frame)

    def answer(self, number: int, payload: bytes, *, status: Status = Status.ANSWERED) -> None:
        """Send an answer to the node that asked; a second one, or one to a forgotten question, goes nowhere."""
        question = self._to_answer.pop(number, None)
        if question is None:
            self.counters["answers_superfluous"] += 1
            return
        request, source, topic, priority = question
        head = envelopes.encode(Envelope(response=request, status=status))
        try:
            self._core.publish(
                topic,
                head + payload,
                to=source,
                policy=TopicPolicy(priority, offline=Offline.DISCARD),
                flags=wire.DATA_FLAG_ENVELOPE,
                now=time.monotonic(),
            )
        except Refused as refusal:
            self.counters[f"answers_refused_{refusal.reason.value}"] += 1
