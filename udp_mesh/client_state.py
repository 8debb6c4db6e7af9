"""What both clients know of their daemon: peers, policies, answers, received messages. No sockets."""

from __future__ import annotations

import json
import secrets
from collections import Counter, deque

from udp_mesh import local_fates, local_features, local_wire
from udp_mesh.client_fates import OpenMessages, TrackedMessage
from udp_mesh.client_stored import StoredState
from udp_mesh.client_types import PeerInfo, Refused, RequestFailed, Status, WouldBlock, peers_of
from udp_mesh.core.envelope import DurableId
from udp_mesh.core.envelope import Status as AnswerStatus
from udp_mesh.core.settings import BROADCAST_NAME, MAX_MESSAGE_BYTES, Offline
from udp_mesh.frame_reader import FrameReader
from udp_mesh.local_features import Answer
from udp_mesh.local_wire import FrameType, Message, Overrides, Publish, Verdict

MAX_INBOX_MESSAGES = 65_536


class ClientState:
    """Takes the daemon's bytes; survives a reconnection, except for what was asked and not answered."""

    def __init__(self) -> None:
        self.client = secrets.randbits(64) or 1
        self.stored = StoredState()
        self.tracked = OpenMessages()
        self.inbox: deque[tuple[DurableId | None, Message]] = deque()
        self.missed = 0
        self.refusals: Counter[str] = Counter()
        self.topics: list[str] = []
        self.status: Status | None = None
        self.status_interval_s = 0.0
        self.is_greeted = False
        self.name = ""
        self._peers: dict[str, PeerInfo] = {}
        self._offline: dict[str, Offline] = {}
        self._verdicts: dict[int, Verdict | None] = {}
        self._answered: dict[int, Answer | None] = {}
        self._answers: dict[int, dict[str, object]] = {}
        self._next_request = 0
        self._reader = FrameReader()

    def connected(self) -> bytes:
        """Begin with a new connection; return what to send first.

        That is who we are, the subscriptions, and the stored publishes on which there is no verdict: the daemon knows
        those that it has.
        """
        self._reader = FrameReader()
        subscriptions = [local_wire.frame(FrameType.SUBSCRIBE, topic.encode()) for topic in self.topics]
        if self.status_interval_s:
            subscriptions.append(local_features.encode_watch(self.status_interval_s))
        repeated = (*self.stored.undecided.values(), *self.tracked.follow_frames())
        return b"".join((local_features.encode_identity(self.client), *subscriptions, *repeated))

    def disconnected(self) -> None:
        """Forget what only held for the lost connection."""
        for request in [number for number in self._verdicts if number not in self.stored.undecided]:
            del self._verdicts[request]
        self.tracked.on_disconnected(self.stored.undecided)
        self._answers.clear()
        for request in self._answered:
            self._answered[request] = Answer(request, local_features.FAILED, b"daemon_unreachable")
        self._peers.clear()
        self.is_greeted = False

    def buffer(self) -> memoryview:
        """Return where the daemon's next bytes belong."""
        return self._reader.buffer()

    def filled(self, size_bytes: int) -> bool:
        """Take so many bytes of what :meth:`buffer` returned; whether they completed anything."""
        frames = self._reader.filled(size_bytes)
        for kind, body in frames:
            self._frame(kind, body)
        return bool(frames)

    def _frame(self, kind: int, body: memoryview) -> None:
        if kind == FrameType.MESSAGE:
            self._keep(None, local_wire.decode_message(body))
        elif kind == FrameType.STORED_MESSAGE:
            durable_id, message = local_features.decode_stored_message(body)
            if self.stored.receive(durable_id):
                self._keep(durable_id, message)
        elif kind == FrameType.QUESTION:
            self._keep(None, local_features.decode_question(body))
        elif kind == FrameType.ANSWERED:
            answer_to_question = local_features.decode_answer(body)
            if answer_to_question.request in self._answered:
                self._answered[answer_to_question.request] = answer_to_question
        elif kind == FrameType.VERDICT:
            self._verdict(local_wire.decode_verdict(body))
        elif kind == FrameType.TRACKED:
            tracked = local_fates.decode_tracked(body)
            self.tracked.on_tracked(tracked, is_stored=tracked.request in self.stored.undecided)
        elif kind == FrameType.FATE:
            self.tracked.on_fate(*local_fates.decode_fate(body))
        elif kind == FrameType.LOST:
            self.missed += local_wire.decode_lost(body)
        elif kind == FrameType.PEERS:
            self._peers = {entry["name"]: PeerInfo(**entry) for entry in json.loads(bytes(body))}
            self.is_greeted = True
        elif kind == FrameType.STATUS:
            state = json.loads(bytes(body))
            self.status = Status(tuple(peers_of(state["peers"])), state["queues"], state["stored"])
        elif kind == FrameType.RESPONSE:
            answer = json.loads(bytes(body))
            self._answers[answer["id"]] = answer
        elif kind == FrameType.WELCOME:
            about = json.loads(bytes(body))
            self.name = about["name"]
            topics = about["config"]["topics"]
            self._offline = {topic: Offline(policy["offline"]) for topic, policy in topics.items()}

    def _keep(self, durable_id: DurableId | None, message: Message) -> None:
        if len(self.inbox) >= MAX_INBOX_MESSAGES:
            oldest = next((n for n, (stored, _) in enumerate(self.inbox) if stored is None), 0)
            del self.inbox[oldest]
            self.missed += 1
        self.inbox.append((durable_id, message))

    def next_message(self) -> Message | None:
        """Return the next message for the application, which has it from now on."""
        if not self.inbox:
            return None
        durable_id, message = self.inbox.popleft()
        if durable_id is not None:
            self.stored.take(durable_id)
        return message

    def _verdict(self, verdict: Verdict) -> None:
        self.stored.forget(verdict.request)
        if verdict.reason:
            self.refusals[verdict.reason] += 1
            self.tracked.on_refused(verdict.request, verdict.reason)
        if verdict.request in self._verdicts:
            self._verdicts[verdict.request] = verdict

    def is_online(self, name: str) -> bool:
        """Whether a peer is online, as far as the daemon has told."""
        peer = self._peers.get(name)
        return peer is not None and peer.online

    def encode_publish(
        self,
        topic: str,
        payload: bytes,
        to: str,
        overrides: Overrides,
        *,
        waits: bool = False,
        tracked: TrackedMessage | None = None,
    ) -> tuple[int, bytes]:
        """Return a request number and the frame. ``tracked`` learns what becomes of the message.

        Raises:
            Refused: It is clear already that the daemon would not take the message.
            WouldBlock: Too many stored messages wait for the daemon's word that they are safe.
        """
        self._check(topic, payload, to, overrides)
        is_stored = (overrides.offline or self._offline.get(topic)) is Offline.STORE
        if is_stored and self.stored.is_full:
            raise WouldBlock("the daemon's store does not keep up")
        self._next_request = (self._next_request + 1) & 0xFFFFFFFF
        wants_verdict = waits or is_stored
        publish = Publish(self._next_request, topic, payload, to, overrides, wants_verdict, waits, tracked is not None)
        frame = local_wire.encode_publish(publish)
        if tracked is not None:
            self.tracked.add(publish.request, tracked)
        if waits:
            self._verdicts[publish.request] = None
        if is_stored:
            self.stored.remember(publish.request, frame)
        return publish.request, frame

    def _check(self, topic: str, payload: bytes, to: str, overrides: Overrides) -> None:
        reason = ""
        if not 0 < len(topic.encode()) <= 255:
            reason = "bad_topic"
        elif overrides.priority is not None and not 0 <= overrides.priority <= 255:
            reason = "bad_policy"
        elif len(payload) > MAX_MESSAGE_BYTES:
            reason = "too_large"
        elif self.is_greeted and to != BROADCAST_NAME:
            peer = self._peers.get(to)
            offline = overrides.offline or self._offline.get(topic, Offline.DISCARD)
            if peer is None:
                reason = "own_name" if to == self.name else "unknown_peer"
            elif not peer.online and offline is Offline.DISCARD:
                reason = "peer_offline"
        if reason:
            self.refusals[reason] += 1
            raise Refused(reason)

    def encode_ask(self, topic: str, payload: bytes, to: str, overrides: Overrides) -> tuple[int, bytes]:
        """Return a request number and the frame of a question to another node's applications.

        Raises:
            Refused: It is clear already that the daemon would not take it.
        """
        self._check(topic, payload, to, overrides)
        self._next_request = (self._next_request + 1) & 0xFFFFFFFF
        question = Publish(self._next_request, topic, payload, to, overrides, wants_verdict=False, waits=False)
        self._answered[question.request] = None
        return question.request, local_features.encode_ask(question)

    def is_answered(self, request: int) -> bool:
        """Whether there is an answer to a question, or the word that there will be none."""
        return self._answered.get(request) is not None

    def take_reply(self, request: int) -> bytes:
        """Return the answer to a question, and forget the question.

        Raises:
            RequestFailed: There is none; the text says why.
        """
        answer = self._answered.pop(request, None)
        if answer is None:
            raise RequestFailed("no answer in time")
        if answer.status == AnswerStatus.NOBODY:
            raise RequestFailed("nobody there has subscribed to the topic")
        if answer.status != AnswerStatus.ANSWERED:
            raise RequestFailed(answer.payload.decode("utf-8", "replace"))
        return answer.payload

    def encode_request(self, method: str, **arguments: str) -> tuple[int, bytes]:
        """Return a request number and the frame of a question."""
        self._next_request = (self._next_request + 1) & 0xFFFFFFFF
        question = {"id": self._next_request, "method": method, **arguments}
        return self._next_request, local_wire.json_frame(FrameType.REQUEST, question)

    def take_answer(self, request: int) -> dict[str, object] | None:
        """Return the answer to a question once it is there."""
        return self._answers.pop(request, None)

    def is_decided(self, request: int, *, is_same_connection: bool) -> bool:
        """Whether there is a verdict on a waiting publish, or can be none: a stored one outlives its connection."""
        has_verdict = self._verdicts.get(request) is not None
        return has_verdict or not (is_same_connection or request in self.stored.undecided)

    def take_message_id(self, request: int) -> int:
        """Return the message id of a waiting publish that :meth:`is_decided`, and forget it.

        Raises:
            Refused: It was not taken.
        """
        verdict = self._verdicts.pop(request, None)
        if verdict is None or verdict.reason:
            raise Refused("daemon_unreachable" if verdict is None else verdict.reason)
        return verdict.message_id

    def forget(self, request: int) -> None:
        """Forget a publish that did not leave this client."""
        self.stored.forget(request)
        self.tracked.forget(request)
        self._verdicts.pop(request, None)

    def stop_waiting(self, request: int) -> None:
        """Note that nobody waits for the verdict on a publish any more."""
        self._verdicts.pop(request, None)
