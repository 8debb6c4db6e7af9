"""For applications: publish, subscribe, ask. No dependencies; the daemon does the networking.

    with Client() as mesh:
        mesh.subscribe("telemetry")
        mesh.publish("command", b"go", to="robot1", priority=1)
        for message in mesh:
            print(message.source, message.payload)

:class:`Client` is for ordinary programs, :class:`AsyncClient` for asyncio. Both reconnect to a restarted daemon by
themselves and subscribe again.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator
from types import TracebackType
from typing import Unpack

from udp_mesh import local_features, local_wire
from udp_mesh.client_async import AsyncClient
from udp_mesh.client_fates import AsyncDelivery, Delivery
from udp_mesh.client_link import Link
from udp_mesh.client_questions import Questions
from udp_mesh.client_state import ClientState
from udp_mesh.client_types import (
    ClientError,
    PeerInfo,
    PublishOptions,
    Refused,
    RequestFailed,
    Status,
    WouldBlock,
    overrides_of,
    result_of,
)
from udp_mesh.config import default_socket
from udp_mesh.local_fates import Fate, Outcome
from udp_mesh.local_wire import FrameType, Message

__all__ = [
    "AsyncClient",
    "AsyncDelivery",
    "Client",
    "ClientError",
    "Delivery",
    "Fate",
    "Message",
    "Outcome",
    "PeerInfo",
    "PublishOptions",
    "Refused",
    "RequestFailed",
    "Status",
    "WouldBlock",
]

_ANSWER_WITHIN_S = 5.0
_STORE_WITHIN_S = 1.0


class Client(Questions):
    """A connection to this node's daemon. Not for use by several threads at once."""

    def __init__(self, socket_path: str | None = None, *, connect_timeout_s: float = 5.0) -> None:
        """Connect.

        Raises:
            ClientError: No daemon answered within ``connect_timeout_s``.
        """
        self.path = socket_path or default_socket()
        self._state = ClientState()
        self._link = Link(self.path, self._state)
        if not self._link.wait(lambda: self._state.is_greeted, connect_timeout_s):
            raise ClientError(f"no udp-mesh daemon answers at {self.path}; is it running?")

    # -- messages

    def publish(
        self,
        topic: str,
        payload: bytes,
        *,
        to: str,
        **options: Unpack[PublishOptions],
    ) -> None:
        """Hand a message to the daemon, for the node named ``to`` or ``all``. Does not wait.

        What ``options`` leave out comes from the topic's settings. A message of a topic with ``offline = "store"`` is
        repeated by this client until the daemon has it safe, also across a restart of the daemon. Refusals that only
        the daemon can judge (a full queue, a peer lost this instant) arrive later and are counted in :attr:`refusals`.

        Raises:
            Refused: It was not taken; ``reason`` says why.
            WouldBlock: The daemon does not keep up.
            ValueError: An argument is none of its choices.
        """
        self._publish(topic, payload, to, options, None)

    def publish_tracked(self, topic: str, payload: bytes, *, to: str, **options: Unpack[PublishOptions]) -> Delivery:
        """Like :meth:`publish`, and follow what becomes of the message.

            delivery = mesh.publish_tracked("command", b"go", to="robot1", lifetime_s=2.0)
            if not delivery.wait(timeout_s=3.0) or not delivery.is_acknowledged:
                print(delivery.fates)

        A message for ``all`` is sent to each node that is online instead of being broadcast, and has a fate at each.
        Of what was on its way when the connection to the daemon was lost the fate is unknown, unless it is stored.

        Raises:
            As :meth:`publish`.
        """
        delivery = Delivery(to, self._link.wait)
        self._publish(topic, payload, to, options, delivery)
        return delivery

    def _publish(self, topic: str, payload: bytes, to: str, options: PublishOptions, tracked: Delivery | None) -> None:
        overrides = overrides_of(options)
        self._link.pump(0.0)
        request, frame = self._state.encode_publish(topic, payload, to, overrides, tracked=tracked)
        try:
            self._link.send(frame)
        except WouldBlock:
            self._state.forget(request)
            raise
        except Refused:
            if request not in self._state.stored.undecided:  # a stored one goes out with the next connection
                self._state.forget(request)
                raise

    def publish_wait(
        self,
        topic: str,
        payload: bytes,
        *,
        to: str,
        timeout_s: float | None = None,
        **options: Unpack[PublishOptions],
    ) -> int:
        """Hand a message to the daemon and wait until it has taken it: with back-pressure. Return its message id.

        Raises:
            Refused: It was not taken; ``reason`` says why.
            WouldBlock: The queue had no room within ``timeout_s``; the message may still be taken.
            ValueError: An argument is none of its choices.
        """
        overrides = overrides_of(options)
        self._link.pump(0.0)
        request, frame = self._state.encode_publish(topic, payload, to, overrides, waits=True)
        connection = self._link.connections
        if not self._link.wait(lambda: self._is_sent(request, frame, connection), timeout_s):
            self._state.forget(request)
            raise WouldBlock("the daemon does not keep up")
        connection = self._link.connections

        def is_decided() -> bool:
            is_same = self._link.is_connected and self._link.connections == connection
            return self._state.is_decided(request, is_same_connection=is_same)

        if not self._link.wait(is_decided, timeout_s):
            self._state.stop_waiting(request)
            raise WouldBlock("the queue had no room in time")
        return self._state.take_message_id(request)

    def request(
        self, topic: str, payload: bytes, *, to: str, timeout_s: float = 5.0, **options: Unpack[PublishOptions]
    ) -> bytes:
        """Ask the applications of one node and return the first answer; see :meth:`reply`.

        Raises:
            Refused: The question was not taken; ``reason`` says why.
            RequestFailed: No answer within ``timeout_s``, nobody there has subscribed to the topic, or it was lost.
        """
        overrides = overrides_of({"lifetime_s": timeout_s, **options, "offline": "discard"})
        self._link.pump(0.0)
        request, frame = self._state.encode_ask(topic, payload, to, overrides)
        self._link.wait(lambda: self._link.try_send(frame), timeout_s)
        self._link.wait(lambda: self._state.is_answered(request), timeout_s)
        return self._state.take_reply(request)

    def reply(self, question: Message, payload: bytes) -> None:
        """Answer a received message whose ``reply_to`` is not 0; only the first answer to it counts.

        Raises:
            ValueError: The message is no question.
            WouldBlock: The daemon does not keep up.
            Refused: There is no daemon.
        """
        if not question.reply_to:
            raise ValueError("this message expects no answer")
        self._link.send(local_features.encode_reply(question.reply_to, payload))

    def subscribe(self, topic: str) -> None:
        """Receive messages of this topic from now on; ``*`` is every topic."""
        if topic not in self._state.topics:
            self._state.topics.append(topic)
            self._command(local_wire.frame(FrameType.SUBSCRIBE, topic.encode()))

    def unsubscribe(self, topic: str) -> None:
        """Receive no more messages of this topic."""
        if topic in self._state.topics:
            self._state.topics.remove(topic)
            self._command(local_wire.frame(FrameType.UNSUBSCRIBE, topic.encode()))

    def receive(self, timeout_s: float | None = None) -> Message | None:
        """Return the next message, waiting for it if need be; None when ``timeout_s`` is over. 0 does not wait."""
        self._link.wait(lambda: bool(self._state.inbox), timeout_s)
        message = self._state.next_message()
        taken = self._state.stored.taken_frame()
        if taken and self._link.try_send(taken):
            self._state.stored.told_taken()
        return message

    def __iter__(self) -> Iterator[Message]:
        """Yield messages for ever."""
        while True:
            message = self.receive()
            if message is not None:
                yield message

    @property
    def missed(self) -> int:
        """Messages lost because this application read too slowly."""
        return self._state.missed

    @property
    def refusals(self) -> Counter[str]:
        """Refused messages by reason, those included that the daemon refused after ``publish`` returned."""
        return self._state.refusals

    # -- connection

    def fileno(self) -> int:
        """Descriptor to wait on for reading; then call ``receive(timeout_s=0)`` until it returns None.

        It changes with every reconnection.

        Raises:
            ClientError: There is no connection now.
        """
        return self._link.fileno()

    def close(self) -> None:
        """Disconnect; messages not yet taken by the daemon get a moment to leave, stored ones a second."""
        if self._state.stored.undecided:
            self._link.wait(lambda: not self._state.stored.undecided, _STORE_WITHIN_S)
        self._link.close()

    def __enter__(self) -> Client:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _is_sent(self, request: int, frame: bytes, connection: int) -> bool:
        """Send a publish; a stored one was sent by itself if there is another connection than ``connection`` now."""
        if request in self._state.stored.undecided and self._link.connections != connection:
            return True
        try:
            return self._link.try_send(frame)
        except Refused:
            if request not in self._state.stored.undecided:
                raise
            return False

    def _ask(self, method: str, **arguments: str) -> object:
        request, frame = self._state.encode_request(method, **arguments)
        answers: list[dict[str, object]] = []

        def is_answered() -> bool:
            answer = self._state.take_answer(request)
            if answer is not None:
                answers.append(answer)
            return bool(answers)

        if not self._link.wait(lambda: self._link.try_send(frame), _ANSWER_WITHIN_S) or not self._link.wait(
            is_answered, _ANSWER_WITHIN_S
        ):
            raise RequestFailed(f"the daemon did not answer within {_ANSWER_WITHIN_S:g} s")
        return result_of(answers[0])

    def _wait(self, is_done: Callable[[], bool], timeout_s: float | None) -> bool:
        return self._link.wait(is_done, timeout_s)

    def _command(self, frame: bytes) -> None:
        """Send a frame that a reconnection would repeat anyway."""
        if self._link.is_connected:
            self._link.wait(lambda: not self._link.is_connected or self._link.try_send(frame), _ANSWER_WITHIN_S)
