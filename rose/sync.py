"""The same service for programs that do not use asyncio: every call returns when it is done, from any thread.

    with rose.sync.Service("10.0.0.114/0.2") as service:
        scans = service.subscribe("10.0.0.114/0.1", LaserScan)
        while (sample := scans.receive(timeout_s=1.0)) is not None:
            service.publish(obstacle_in(sample.message))

A thread of the service's own runs its event loop. Handlers of commands are called on further threads.
"""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable, Coroutine
from types import TracebackType
from typing import Any, Generic, TypeVar

from rose import service as asynchronous
from rose import subscription as asynchronous_subscription
from rose.core.addressing import ServiceId
from rose.core.keys import KeyRing
from rose.core.reception import Counters, Sample
from rose.core.types import Message
from rose.io.transport import Transport
from rose.subscription import MessageT

_Result = TypeVar("_Result")
AnswerT = TypeVar("AnswerT", bound=Message)
_Run = Callable[[Coroutine[Any, Any, Any]], Any]


class Subscription(Generic[MessageT]):
    """Samples of one sender; see :class:`rose.Subscription`."""

    def __init__(self, inner: asynchronous_subscription.Subscription[MessageT], run: _Run) -> None:
        self._inner, self._run = inner, run

    @property
    def counters(self) -> Counters:
        """What became of everything that the sender has published since this subscription began."""
        return self._inner.counters

    def age_s(self) -> float:
        """Return the seconds since anything of the sender was heard; infinity if nothing ever was."""
        return self._inner.age_s()

    def receive(self, timeout_s: float | None = None) -> Sample | None:
        """Wait for the next sample; None if there was none within ``timeout_s``."""
        sample: Sample | None = self._run(self._inner.receive(timeout_s))
        return sample

    def take_latest(self) -> Sample | None:
        """Return the newest sample that has come already, and forget those before it."""
        sample: Sample | None = self._run(_called(self._inner.take_latest))
        return sample


class Service:
    """One service from start to close; use it as a context manager. Arguments as of :class:`rose.Service`."""

    def __init__(
        self,
        sid: ServiceId | str,
        *,
        transport: Transport | None = None,
        keys: KeyRing | None = None,
        fresh_s: float = 60.0,
    ) -> None:
        self._inner = asynchronous.Service(sid, transport=transport, keys=keys, fresh_s=fresh_s)
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._loop.run_forever, name=f"rose {sid}", daemon=True)

    @property
    def sid(self) -> ServiceId:
        """The service's id."""
        return self._inner.sid

    def start(self) -> Service:
        """Open the sockets.

        Raises:
            RoseError: Another process is this service already.
        """
        self._thread.start()
        try:
            self._run(self._inner.start())
        except BaseException:
            self._end_thread()
            raise
        return self

    def close(self) -> None:
        """Close the sockets and end the thread."""
        self._run(self._inner.close())
        self._run(self._loop.shutdown_default_executor())
        self._end_thread()

    def __enter__(self) -> Service:
        return self.start()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def publish(self, message: Message) -> None:
        """See :meth:`rose.Service.publish`."""
        self._run(_called(lambda: self._inner.publish(message)))

    def subscribe(self, sender: ServiceId | str, cls: type[MessageT], **options: Any) -> Subscription[MessageT]:
        """See :meth:`rose.Service.subscribe`."""
        return Subscription(self._run(_called(lambda: self._inner.subscribe(sender, cls, **options))), self._run)

    def on_command(self, cls: type[MessageT], handler: Callable[[MessageT], Message | None]) -> None:
        """See :meth:`rose.Service.on_command`; ``handler`` is an ordinary function, called on a thread of its own."""

        async def handle(message: MessageT) -> Message | None:
            return await asyncio.to_thread(handler, message)

        self._run(_called(lambda: self._inner.on_command(cls, handle)))

    def command(self, to: ServiceId | str, message: Message) -> None:
        """See :meth:`rose.Service.command`."""
        self._run(_called(lambda: self._inner.command(to, message)))

    def call(self, to: ServiceId | str, message: Message, answer: type[AnswerT], *, timeout_s: float = 2.0) -> AnswerT:
        """See :meth:`rose.Service.call`."""
        answered: AnswerT = self._run(self._inner.call(to, message, answer, timeout_s=timeout_s))
        return answered

    def _run(self, work: Coroutine[Any, Any, _Result]) -> _Result:
        return asyncio.run_coroutine_threadsafe(work, self._loop).result()

    def _end_thread(self) -> None:
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()


async def _called(function: Callable[[], _Result]) -> _Result:
    return function()
