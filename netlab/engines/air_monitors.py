"""The radios in monitor mode of the air process: what programs send through them, and what they are told of a frame.

A radio takes a frame from its interface only while few wait in the station, as a card does whose ring is short: the
queue is then the sender's, who knows what is urgent.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable
from functools import partial

from wnet.io import dot11, radiotap

#: Frames of one station, the one under way included, beyond which its interface is left alone.
_RING_FRAMES = 2
_FRAME_BYTES_MAX = 4096
_HEADERS_LIMIT = 4096

#: (port, Ethernet frame, rate that its sender asks for)
Injected = tuple[int, bytes, float | None]


class Monitors:
    """All of one lab, by their ports."""

    def __init__(self, queued: Callable[[int], int]) -> None:
        """``queued`` tells how many frames wait at a port's station."""
        self._queued = queued
        self._fds: dict[int, int] = {}
        self._headers: dict[tuple[int, float, float], bytes] = {}
        self.malformed = 0

    def __contains__(self, port: int) -> bool:
        return port in self._fds

    def add(self, port: int, fd: int) -> None:
        """Serve a radio by the other end of its interface, which this object owns from now on."""
        self._fds[port] = fd

    def waiting(self) -> list[int]:
        """Descriptors of those that would take a frame."""
        return [fd for port, fd in self._fds.items() if self._queued(port) < _RING_FRAMES]

    def take(self) -> list[Injected]:
        """Return at most one frame of each radio that would take one."""
        taken: list[Injected] = []
        for port, fd in self._fds.items():
            if self._queued(port) < _RING_FRAMES:
                with contextlib.suppress(OSError):
                    self._add(port, os.read(fd, _FRAME_BYTES_MAX), taken)
        return taken

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
