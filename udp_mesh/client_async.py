"""The client for asyncio; same words as :class:`udp_mesh.client.Client`. asyncio is imported only when it is used."""

from __future__ import annotations

from collections import Counter
from collections.abc import AsyncIterator, Callable
from types import TracebackType
from typing import TYPE_CHECKING, Unpack

from udp_mesh import local_features, local_wire
from udp_mesh.client_fates import AsyncDelivery
from udp_mesh.client_questions import AsyncQuestions
from udp_mesh.client_state import ClientState
from udp_mesh.client_types import (
    ClientError,
    PublishOptions,
    Refused,
    RequestFailed,
    WouldBlock,
    overrides_of,
    result_of,
)
from udp_mesh.config import default_socket
from udp_mesh.local_wire import FrameType, Message

if TYPE_CHECKING:
    import asyncio

    from udp_mesh.client_stream import Stream

_RECONNECT_INTERVAL_S = 0.05
_ANSWER_WITHIN_S = 5.0
_STORE_WITHIN_S = 1.0
_MAX_UNSENT_BYTES = 4 * 1024 * 1024


class AsyncClient(AsyncQuestions):
    """A connection to this node's daemon: ``async with AsyncClient() as mesh: ...``."""

    def __init__(self, socket_path: str | None = None, *, connect_timeout_s: float = 5.0) -> None:
        self.path = socket_path or default_socket()
        self._connect_timeout_s = connect_timeout_s
        self._state = ClientState()
        self._stream: Stream | None = None
        self._task: asyncio.Task[None] | None = None
        self._changed: asyncio.Event | None = None

    async def __aenter__(self) -> AsyncClient:
        import asyncio

        self._changed = asyncio.Event()
        self._task = asyncio.create_task(self._serve())
        if not await self._wait(lambda: self._state.is_greeted, self._connect_timeout_s):
            await self.close()
            raise ClientError(f"no udp-mesh daemon answers at {self.path}; is it running?")
        return self

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    async def close(self) -> None:
        """Disconnect; stored messages get a second to become safe."""
        import asyncio

        if self._state.stored.undecided and self._task is not None:
            await self._wait(lambda: not self._state.stored.undecided, _STORE_WITHIN_S)
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)
            self._task = None
        stream, self._stream = self._stream, None
        if stream is not None:
            stream.close()
            await asyncio.gather(stream.wait_closed(), return_exceptions=True)

    def publish(
        self,
        topic: str,
        payload: bytes,
        *,
        to: str,
        **options: Unpack[PublishOptions],
    ) -> None:
        """Hand a message to the daemon without waiting; see :meth:`udp_mesh.client.Client.publish`.

        Raises:
            Refused: It was not taken; ``reason`` says why.
            WouldBlock: The daemon does not keep up.
        """
        self._publish(topic, payload, to, options, None)

    def publish_tracked(
        self, topic: str, payload: bytes, *, to: str, **options: Unpack[PublishOptions]
    ) -> AsyncDelivery:
        """Like :meth:`publish`, and follow what becomes of the message: ``fates = await mesh.publish_tracked(...)``.

        See :meth:`udp_mesh.client.Client.publish_tracked`.
        """
        delivery = AsyncDelivery(to, self._wait)
        self._publish(topic, payload, to, options, delivery)
        return delivery

    def _publish(
        self, topic: str, payload: bytes, to: str, options: PublishOptions, tracked: AsyncDelivery | None
    ) -> None:
        overrides = overrides_of(options)
        stream = self._open_stream()
        if stream is not None and stream.unsent_bytes > _MAX_UNSENT_BYTES:
            raise WouldBlock("the daemon does not keep up")
        request, frame = self._state.encode_publish(topic, payload, to, overrides, tracked=tracked)
        self._write_publish(stream, request, frame)

    def _write_publish(self, stream: Stream | None, request: int, frame: bytes) -> None:
        if stream is not None:
            stream.write(frame)
        elif request not in self._state.stored.undecided:  # a stored one goes out with the next connection
            self._state.forget(request)
            raise Refused("daemon_unreachable")

    async def publish_wait(
        self,
        topic: str,
        payload: bytes,
        *,
        to: str,
        timeout_s: float | None = None,
        **options: Unpack[PublishOptions],
    ) -> int:
        """Hand a message to the daemon and wait until it has taken it. Return its message id.

        Raises:
            Refused: It was not taken; ``reason`` says why.
            WouldBlock: The queue had no room within ``timeout_s``; the message may still be taken.
        """
        overrides = overrides_of(options)
        stream = self._open_stream()
        request, frame = self._state.encode_publish(topic, payload, to, overrides, waits=True)
        self._write_publish(stream, request, frame)

        def is_decided() -> bool:
            return self._state.is_decided(request, is_same_connection=self._stream is stream)

        if not await self._wait(is_decided, timeout_s):
            self._state.stop_waiting(request)
            raise WouldBlock("the queue had no room in time")
        return self._state.take_message_id(request)

    async def request(
        self, topic: str, payload: bytes, *, to: str, timeout_s: float = 5.0, **options: Unpack[PublishOptions]
    ) -> bytes:
        """Ask the applications of one node; see :meth:`udp_mesh.client.Client.request`.

        Raises:
            Refused: The question was not taken; ``reason`` says why.
            RequestFailed: No answer within ``timeout_s``, nobody there has subscribed to the topic, or it was lost.
        """
        overrides = overrides_of({"lifetime_s": timeout_s, **options, "offline": "discard"})
        stream = self._connected()
        request, frame = self._state.encode_ask(topic, payload, to, overrides)
        stream.write(frame)
        await self._wait(lambda: self._state.is_answered(request), timeout_s)
        return self._state.take_reply(request)

    def reply(self, question: Message, payload: bytes) -> None:
        """Answer a received message whose ``reply_to`` is not 0; only the first answer to it counts.

        Raises:
            ValueError: The message is no question.
            Refused: There is no daemon.
        """
        if not question.reply_to:
            raise ValueError("this message expects no answer")
        self._connected().write(local_features.encode_reply(question.reply_to, payload))

    async def subscribe(self, topic: str) -> None:
        """Receive messages of this topic from now on; ``*`` is every topic."""
        if topic not in self._state.topics:
            self._state.topics.append(topic)
            if self._stream is not None:
                self._stream.write(local_wire.frame(FrameType.SUBSCRIBE, topic.encode()))

    async def receive(self, timeout_s: float | None = None) -> Message | None:
        """Return the next message; None when ``timeout_s`` is over."""
        await self._wait(lambda: bool(self._state.inbox), timeout_s)
        message = self._state.next_message()
        taken, stream = self._state.stored.taken_frame(), self._open_stream()
        if taken and stream is not None:
            stream.write(taken)
            self._state.stored.told_taken()
        return message

    async def __aiter__(self) -> AsyncIterator[Message]:
        """Yield messages for ever."""
        while True:
            message = await self.receive()
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

    def _open_stream(self) -> Stream | None:
        return self._stream if self._stream is not None and self._stream.is_open else None

    def _connected(self) -> Stream:
        stream = self._open_stream()
        if stream is None:
            raise Refused("daemon_unreachable")
        return stream

    def _command(self, frame: bytes) -> None:
        stream = self._open_stream()
        if stream is not None:
            stream.write(frame)

    async def _ask(self, method: str, **arguments: str) -> object:
        request, frame = self._state.encode_request(method, **arguments)
        self._connected().write(frame)
        answers: list[dict[str, object]] = []

        def is_answered() -> bool:
            answer = self._state.take_answer(request)
            if answer is not None:
                answers.append(answer)
            return bool(answers)

        if not await self._wait(is_answered, _ANSWER_WITHIN_S):
            raise RequestFailed(f"the daemon did not answer within {_ANSWER_WITHIN_S:g} s")
        return result_of(answers[0])

    async def _wait(self, is_done: Callable[[], bool], timeout_s: float | None) -> bool:
        import asyncio

        if self._changed is None:
            raise ClientError("use the client in: async with AsyncClient() as mesh")
        try:
            async with asyncio.timeout(timeout_s):
                while not is_done():
                    self._changed.clear()
                    await self._changed.wait()
        except TimeoutError:
            return False
        return True

    async def _serve(self) -> None:
        """Be connected for ever: connect again whenever the daemon is gone."""
        import asyncio

        from udp_mesh.client_stream import Stream

        while True:
            try:
                stream = await Stream.connect(self.path, self._state, self._notify)
            except OSError:
                await asyncio.sleep(_RECONNECT_INTERVAL_S)
                continue
            self._stream = stream
            stream.write(self._state.connected())
            await stream.wait_closed()
            self._stream = None
            self._state.disconnected()
            self._notify()

    def _notify(self) -> None:
        if self._changed is not None:
            self._changed.set()
