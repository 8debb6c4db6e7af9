"""A robot service: publishes to its own group, listens to those of others, takes and gives commands. For asyncio.

    async with rose.Service("10.0.0.114/0.2") as service:
        scans = service.subscribe("10.0.0.114/0.1", LaserScan)
        async for sample in scans:
            service.publish(obstacle_in(sample.message))

There is no connection: nobody is asked whether they are there, nothing is opened, nothing has to be closed, and a
service that was out of reach is heard again as soon as its datagrams arrive.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Any, TypeVar, cast

from rose.core.addressing import ServiceId
from rose.core.calls import AnswerCache, Running, repeat_at
from rose.core.keys import KeyRing
from rose.core.messages import Done, Refusal
from rose.core.station import Frames, Published, Station, Whole
from rose.core.types import AnyMessage, Message, decode_any, decode_message, info_of, known_type
from rose.core.wire import Fault, Flag, Header, Kind
from rose.errors import CallError, RoseError, TypeMismatchError
from rose.io.transport import Transport
from rose.io.udp import UdpTransport
from rose.subscription import MessageT, Subscription

AnswerT = TypeVar("AnswerT", bound=Message)
Handler = Callable[[Any], Awaitable[Message | None]]
SAMPLES_MAX = 256


@dataclass(frozen=True, slots=True)
class Command:
    """A command as its handler may ask for it: who sent it, and whether from this host."""

    message: Message
    sender: ServiceId
    is_local: bool


class Service:
    """One service from start to close; use it as an asynchronous context manager."""

    def __init__(
        self,
        sid: ServiceId | str,
        *,
        transport: Transport | None = None,
        keys: KeyRing | None = None,
        fresh_s: float = 60.0,
    ) -> None:
        """Prepare a service; nothing is sent before it is started.

        Args:
            sid: Its id; its host part is an address of this host, which need not be up yet.
            transport: UDP if None; :class:`rose.io.mesh.MeshTransport` has everything delivered by udp_mesh.
            keys: Its group's keys and those of whom it hears.
            fresh_s: How far the clocks of hosts that have keys may differ, seconds.

        Raises:
            AddressError: The id is malformed or beyond its limits.
        """
        self.sid = ServiceId.parse(sid) if isinstance(sid, str) else sid
        self.transport = transport if transport is not None else UdpTransport()
        self._station = Station(
            self.sid,
            epoch_ns=time.time_ns(),
            keys=keys,
            datagram_bytes=self.transport.datagram_bytes,
            fresh_s=fresh_s,
        )
        self._subscriptions: dict[ServiceId, Subscription[Any]] = {}
        self._handlers: dict[bytes, tuple[type[Message], Callable[[Command], Awaitable[Message | None]]]] = {}
        self._answers: AnswerCache[Frames] = AnswerCache()
        self._calls: dict[int, asyncio.Future[Whole]] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._timer: asyncio.TimerHandle | None = None
        self._announced: Callable[[Header, bytes], None] = lambda _header, _payload: None

    async def start(self) -> Service:
        """Open the sockets.

        Raises:
            RoseError: Another process is this service already.
        """
        await self.transport.open(self.sid, self._receive)
        return self

    async def close(self) -> None:
        """Close the sockets; what handlers are at is given up."""
        if self._timer is not None:
            self._timer.cancel()
        for task in tuple(self._tasks):
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        await self.transport.close()

    async def __aenter__(self) -> Service:
        return await self.start()

    async def __aexit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        await self.close()

    @property
    def is_sealed(self) -> bool:
        """Whether this service has a key: then it takes commands only from those who have theirs."""
        return self._station.is_sealed

    @property
    def faults(self) -> dict[Fault, int]:
        """Datagrams that were dropped, by reason."""
        return dict(self._station.faults)

    # -- publications ---------------------------------------------------------------------------------------------

    def publish(self, message: Message) -> None:
        """Send a message to whoever listens. Never waits.

        Raises:
            RoseError: It is too long, or its class is no message type.
        """
        self.transport.publish(self._station.publish(message, wall_ns=time.time_ns()))

    def announce(self, message: Message) -> None:
        """Send a message to all who listen to announcements, whoever this service is to them."""
        self.transport.announce(self._station.publish(message, wall_ns=time.time_ns(), kind=Kind.ANNOUNCEMENT))

    def on_announcement(self, handler: Callable[[Header, bytes], None]) -> None:
        """Listen to announcements from now on; they come with their header, not decoded."""
        self._announced = handler
        self.transport.join_announcements()

    def subscribe(
        self,
        sender: ServiceId | str,
        cls: type[MessageT],
        *,
        partial_after_s: float = 0.1,
        samples_max: int = SAMPLES_MAX,
    ) -> Subscription[MessageT]:
        """Listen to a service, which need not be there.

        Args:
            sender: Its id.
            cls: What it publishes.
            partial_after_s: How long parts of a message wait for those that are missing.
            samples_max: How many samples wait for a slow reader.

        Raises:
            RoseError: It has been subscribed to before; an id that is malformed, a class that is no message type.
        """
        sid = ServiceId.parse(sender) if isinstance(sender, str) else sender
        if sid in self._subscriptions:
            raise RoseError(f"{self.sid} listens to {sid} already")
        reception = self._station.subscribe(sid, cls, partial_after_s=partial_after_s)
        subscription: Subscription[MessageT] = Subscription(reception, time.monotonic, samples_max=samples_max)
        self._subscriptions[sid] = subscription
        self.transport.join(sid)
        return subscription

    def unsubscribe(self, sender: ServiceId) -> None:
        """Listen to it no longer; its multicast then no longer comes to this host, unless somebody else listens."""
        if self._subscriptions.pop(sender, None) is not None:
            self._station.unsubscribe(sender)
            self.transport.leave(sender)

    # -- commands -------------------------------------------------------------------------------------------------

    def on_command(self, cls: type[MessageT], handler: Callable[[MessageT], Awaitable[Message | None]]) -> None:
        """Have commands of a type carried out by ``handler``, each once; what it returns is the answer.

        An exception that is a :class:`RoseError` or ValueError goes to the caller as a refusal.
        """

        async def handle(command: Command) -> Message | None:
            return await handler(cast(MessageT, command.message))

        self.on_command_from(cls, handle)

    def on_command_from(self, cls: type[Message], handler: Callable[[Command], Awaitable[Message | None]]) -> None:
        """Like :meth:`on_command`, for handlers that want to know who it is."""
        self._handlers[info_of(cls).type_id] = (cls, handler)

    def command(self, to: ServiceId | str, message: Message) -> None:
        """Send a command once, without waiting for an answer."""
        sid = ServiceId.parse(to) if isinstance(to, str) else to
        self.transport.send(
            sid, self._station.datagrams(self._station.command(message, sid, wall_ns=time.time_ns())[1])
        )

    async def call(
        self,
        to: ServiceId | str,
        message: Message,
        answer: type[AnswerT],
        *,
        timeout_s: float = 2.0,
        local: bool = False,
    ) -> AnswerT:
        """Send a command until it is answered; the receiver carries it out once.

        Args:
            to: The service's id.
            message: The command.
            answer: The type of the answer; :class:`rose.AnyMessage` takes any.
            timeout_s: When to give up.
            local: The service is on this host: ask it over loopback, which works without a network.

        Raises:
            CallError: No answer in time (it may have been carried out all the same), or it was refused.
        """
        sid = ServiceId.parse(to) if isinstance(to, str) else to
        number, frames = self._station.command(message, sid, wall_ns=time.time_ns())
        future = self._calls[number] = asyncio.get_running_loop().create_future()
        try:
            whole = await self._ask(sid, frames, future, timeout_s, local)
        finally:
            del self._calls[number]
        try:
            if whole.header.flags & Flag.REFUSED:
                refusal = cast(Refusal, decode_message(whole.payload, Refusal))
                raise CallError(f"{sid} refuses: {refusal.reason}")
            if answer is AnyMessage:
                return cast(AnswerT, decode_any(whole.payload, whole.header.type_id))
            if whole.header.type_id != info_of(answer).type_id:
                raise CallError(f"{sid} answered with another type than {info_of(answer).name}")
            return cast(AnswerT, decode_message(whole.payload, answer))
        except TypeMismatchError as error:
            raise CallError(f"{sid} answered with {error}") from None

    # -- inside ---------------------------------------------------------------------------------------------------

    async def _ask(
        self, to: ServiceId, frames: Frames, future: asyncio.Future[Whole], timeout_s: float, local: bool
    ) -> Whole:
        started = time.monotonic()
        for at_s in (*repeat_at(timeout_s=timeout_s), timeout_s):
            pause_s = started + at_s - time.monotonic()
            if pause_s > 0:
                await asyncio.wait([future], timeout=pause_s)
            if future.done():
                return future.result()
            if at_s < timeout_s:
                self.transport.send(to, self._station.datagrams(frames), local=local)
        raise CallError(f"{to} did not answer within {timeout_s:g} s; is it running, and on this network?")

    def _receive(self, datagram: bytes, is_local: bool) -> None:
        got = self._station.receive(datagram, now=time.monotonic(), wall_ns=time.time_ns())
        if isinstance(got, Published):
            self._give_out(got)
            self._set_timer()
        elif got is not None and got.header.kind is Kind.COMMAND:
            self._take_command(got, is_local)
        elif got is not None and got.header.kind is Kind.ANSWER:
            future = self._calls.get(got.header.sequence)
            if future is not None and not future.done():
                future.set_result(got)
        elif got is not None:
            self._announced(got.header, got.payload)

    def _give_out(self, published: Published) -> None:
        subscription = self._subscriptions.get(published.reception.sender)
        if subscription is not None and published.samples:
            subscription.put(published.samples)

    def _set_timer(self) -> None:
        due = self._station.next_due()
        if self._timer is not None:
            self._timer.cancel()
            self._timer = None
        if due is not None:
            delay_s = max(0.0, due - time.monotonic())
            self._timer = asyncio.get_running_loop().call_later(delay_s, self._give_up_waiting)

    def _give_up_waiting(self) -> None:
        self._timer = None
        for published in self._station.due(now=time.monotonic(), wall_ns=time.time_ns()):
            self._give_out(published)
        self._set_timer()

    def _take_command(self, whole: Whole, is_local: bool) -> None:
        header = whole.header
        key = (header.sender, header.epoch_ns, header.sequence)
        known = self._answers.begin(key, now=time.monotonic())
        if isinstance(known, Running):
            return
        if known is not None:
            self.transport.send(header.sender, self._station.datagrams(known), local=is_local)
            return
        task = asyncio.get_running_loop().create_task(self._carry_out(whole, is_local))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _carry_out(self, whole: Whole, is_local: bool) -> None:
        header = whole.header
        try:
            answer = await self._handle(whole, is_local)
            refused = False
        except (RoseError, ValueError) as error:
            answer, refused = Refusal(str(error)), True
        frames = self._station.answer(header, answer, wall_ns=time.time_ns(), is_refusal=refused)
        self._answers.finish((header.sender, header.epoch_ns, header.sequence), frames, now=time.monotonic())
        self.transport.send(header.sender, self._station.datagrams(frames), local=is_local)

    async def _handle(self, whole: Whole, is_local: bool) -> Message:
        known = self._handlers.get(whole.header.type_id)
        if known is None:
            info = known_type(whole.header.type_id)
            raise RoseError(f"takes no command of type {info.name if info else whole.header.type_id.hex()}")
        cls, handler = known
        command = Command(decode_message(whole.payload, cls), whole.header.sender, is_local)
        return await handler(command) or Done()
