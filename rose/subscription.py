"""What a service has subscribed to: an asynchronous iterator of samples, bounded, that never ends by itself."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import AsyncIterator, Callable
from typing import Generic, TypeVar, cast

from rose.core.addressing import ServiceId
from rose.core.reception import Counters, Reception, Sample
from rose.core.types import Message

MessageT = TypeVar("MessageT", bound=Message)


class Subscription(Generic[MessageT]):
    """Samples of one sender. When the reader is slow the oldest are dropped and counted in ``overflowed``."""

    def __init__(self, reception: Reception, clock: Callable[[], float], *, samples_max: int) -> None:
        self.overflowed = 0
        self._reception = reception
        self._clock = clock
        self._samples: deque[Sample] = deque()
        self._samples_max = samples_max
        self._arrived = asyncio.Event()

    @property
    def sender(self) -> ServiceId:
        """Who is listened to."""
        return self._reception.sender

    @property
    def counters(self) -> Counters:
        """What became of everything that the sender has published since this subscription began."""
        return self._reception.counters

    def age_s(self) -> float:
        """Return the seconds since anything of the sender was heard; infinity if nothing ever was."""
        return self._reception.age_s(now=self._clock())

    def take(self) -> Sample | None:
        """Return the next sample if there is one already."""
        return self._samples.popleft() if self._samples else None

    def take_latest(self) -> Sample | None:
        """Return the newest sample and forget those before it."""
        newest = self._samples.pop() if self._samples else None
        self._samples.clear()
        return newest

    async def receive(self, timeout_s: float | None = None) -> Sample | None:
        """Wait for the next sample; None if there was none within ``timeout_s`` (None: wait for ever)."""
        try:
            async with asyncio.timeout(timeout_s):
                while not self._samples:
                    self._arrived.clear()
                    await self._arrived.wait()
        except TimeoutError:
            return None
        return self._samples.popleft()

    async def messages(self) -> AsyncIterator[MessageT]:
        """Iterate over the messages alone, for whoever does not ask what is missing."""
        async for sample in self:
            yield cast(MessageT, sample.message)

    async def __aiter__(self) -> AsyncIterator[Sample]:
        while (sample := await self.receive()) is not None:
            yield sample

    def put(self, samples: list[Sample]) -> None:
        """Take samples from the service."""
        for sample in samples:
            if len(self._samples) >= self._samples_max:
                self._samples.popleft()
                self.overflowed += 1
            self._samples.append(sample)
        self._arrived.set()
