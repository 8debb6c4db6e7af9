"""Keeps back messages that nobody needs to see one by one, before they are decoded: most of a large capture."""

from __future__ import annotations

from collections import Counter
from collections.abc import Container, Iterator

from netlab.capture.scan import Message
from netlab.capture.schemas import is_inbound, verdict_shape


class Sieve:
    """Lets messages pass or not, by their channel.

    Args:
        counted: Channels of verdicts that are only to be counted.
        outbound: Channels of packets of which those that came in are not wanted.

    Attributes:
        shapes: Of the counted verdicts; see :func:`netlab.capture.schemas.verdict_shape`. By channel.
    """

    def __init__(self, counted: Container[int] = (), outbound: Container[int] = ()) -> None:
        self._counted, self._outbound = counted, outbound
        self.shapes: Counter[tuple[int, bytes]] = Counter()

    def sift(self, messages: Iterator[Message]) -> Iterator[Message]:
        """Yield the messages that pass."""
        for message in messages:
            _, channel, data = message
            if channel in self._counted:
                self.shapes[channel, verdict_shape(data)] += 1
            elif channel not in self._outbound or not is_inbound(data):
                yield message
