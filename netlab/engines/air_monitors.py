"""The radios in monitor mode of the air process: what programs send through them, and what they are told of a frame.

As a card does, a radio shows its sender each frame once more when it is through with it (a header with TX flags): a
sender that waits for that keeps its queue to itself, and knows what is urgent in it.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from functools import partial

from wnet.io import dot11, radiotap

_FRAME_BYTES_MAX = 4096
_HEADERS_LIMIT = 4096

#: (port, Ethernet frame, rate that its sender asks for)
Injected = tuple[int, bytes, float | None]


class Monitors:
    """All of one lab, by their ports."""

    def __init__(self) -> None:
        self._fds: dict[int, int] = {}
        self._headers: dict[tuple[int, float, float], bytes] = {}
        self.malformed = 0

    def __contains__(self, port: int) -> bool:
        return port in self._fds

    def add(self, port: int, fd: int) -> None:
        """Serve a radio by the other end of its interface, which this object owns from now on."""
        self._fds[port] = fd

    @property
    def descriptors(self) -> list[int]:
        """Readable when a radio is to send."""
        return list(self._fds.values())

    def take(self) -> list[Injected]:
        """Return at most one frame of each radio."""
        taken: list[Injected] = []
        for port, fd in self._fds.items():
            with contextlib.suppress(BlockingIOError):
                self._add(port, os.read(fd, _FRAME_BYTES_MAX), taken)
        return taken

    def echo(self, port: int, frame: bytes, rate_bps: float | None) -> None:
        """Show a sender that its radio is through with an Ethernet frame of its."""
        with contextlib.suppress(OSError):
            os.write(self._fds[port], radiotap.encode_transmit(rate_bps) + dot11.encode(frame))

    def sender(self, port: int) -> Callable[[bytes], int]:
        """What hands a radio's interface the bytes of :meth:`heard`."""
        return partial(os.write, self._fds[port])

    def heard(self, frame: bytes, *, signal_dbm: int, noise_dbm: float, rate_bps: float) -> bytes:
        """An Ethernet frame as a radio shows it that heard it like this."""
        key = (signal_dbm, noise_dbm, rate_bps)
        head = self._headers.get(key)
        if head is None:
            if len(self._headers) >= _HEADERS_LIMIT:
                self._headers.clear()
            head = radiotap.encode_received(signal_dbm=signal_dbm, noise_dbm=noise_dbm, rate_bps=rate_bps)
            self._headers[key] = head
        return head + dot11.encode(frame)

    def _add(self, port: int, data: bytes, taken: list[Injected]) -> None:
        header = radiotap.decode(data)
        frame = None if header is None else dot11.decode(data, header.length_bytes)
        if header is None or frame is None:
            self.malformed += 1
        else:
            taken.append((port, frame, header.rate_bps))
