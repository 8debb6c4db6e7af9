"""The process of the medium: carries every frame of the lab between the far ends of its veths.

One thread, one loop: empty the ring, ask the medium, send what is due, answer the engine, sleep until the next
departure or event. Delays count from the kernel's stamp of a frame's arrival, so that neither a late wake-up nor a
burst makes them longer, as long as the process is awake when they end. Shared channels live by those stamps and by
their own events; they are told what time it is when all frames that left before have been read. ``select`` sleeps to
the microsecond with the timer slack at 1 ns; ``epoll`` would round up to a whole millisecond.

Ends when the engine's channel closes, however the engine ended.
"""

from __future__ import annotations

import math
import socket
import sys
import time
from collections.abc import Callable
from heapq import heappop, heappush
from typing import TYPE_CHECKING

from netlab.engines.air_messages import (
    AddMonitor,
    AirStats,
    Answer,
    AskStats,
    Done,
    Request,
    SetOutage,
    SetPairs,
    SetRssi,
    Setup,
)
from netlab.engines.air_monitors import Monitors
from netlab.engines.air_ring import SLOTS_MAX, Ring
from netlab.engines.lateness import Lateness
from netlab.engines.medium_loop import MediumLoop, lab_channel
from netlab.ipc import Channel
from netlab.medium.medium import Medium

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from netlab.medium.channel_segment import Sent

_SOL_PACKET = 263
_PACKET_QDISC_BYPASS = 20
_NS_PER_S = 1_000_000_000
# Frames read before departures get their turn: at some 10 us each, the most that a burst makes a departure late.
_BURST = 16
# Bursts that fill the ring.
_RING_BURSTS = SLOTS_MAX // _BURST
# A stamp may be older than this only if somebody set the clock.
_OLDEST_STAMP_NS = _NS_PER_S
_BASE_MTU = 1500


class Air(MediumLoop):
    """The data plane of one lab."""

    def __init__(self, channel: Channel) -> None:
        self._medium = Medium((), (), 0)
        super().__init__(channel, self._medium)
        self._ring: Ring | None = None
        self._monitors = Monitors()
        self._port_of: dict[int, int] = {}
        self._send: list[Callable[[bytes], int]] = []
        self._departures: list[tuple[float, int, int, bytes]] = []  # heap of (due_s, order, port, frame)
        self._order = 0
        self._received = 0
        self._not_sent = 0
        self._late = Lateness()

    def run(self) -> None:
        """Carry frames until the channel closes."""
        while self._ring is None and self._open:
            self._answer()
        while self._open:
            until = time.monotonic()
            busy = self._receive()
            if not busy:
                self._advance(until)
                busy = self._inject()
            self._depart()
            self._wait(self._next_s(), busy=busy)
        self._close_verdicts()

    # -- frames ---------------------------------------------------------------------------------------------------

    def _receive(self) -> bool:
        """Take a burst through the medium; True when more may wait."""
        assert self._ring is not None
        arrivals = self._ring.take(_BURST)
        if not arrivals:
            return False
        port_of, transmit, departures, send = self._port_of, self._medium.transmit, self._departures, self._send
        now = time.monotonic()
        real_ns = time.time_ns()
        for ifindex, sec, nsec, frame in arrivals:
            sender = port_of.get(ifindex)
            if sender is None:
                continue
            self._received += 1
            stamp_ns = sec * _NS_PER_S + nsec
            age_ns = min(max(real_ns - stamp_ns, 0), _OLDEST_STAMP_NS)
            arrived = now - age_ns / _NS_PER_S
            outcomes = transmit(sender, frame, now=arrived, tag=stamp_ns)
            for due, port, received, _verdict in outcomes:
                if due > now:
                    self._order += 1
                    heappush(departures, (due, self._order, port, received))
                elif due >= 0:
                    try:
                        send[port](received)
                    except OSError:
                        self._not_sent += 1
            if self._verdicts is not None:
                self._verdicts.add(outcomes, frame, sender, arrived, stamp_ns)
        return len(arrivals) == _BURST

    def _inject(self) -> bool:
        """Queue what radios in monitor mode send; True when more may wait."""
        taken = self._monitors.take()
        now = time.monotonic()
        for port, frame, rate_bps in taken:
            self._received += 1
            stamp_ns = time.time_ns()
            outcomes = self._medium.inject(port, frame, rate_bps=rate_bps, now=now, tag=stamp_ns)
            if outcomes:  # its queue was full
                self._monitors.echo(port, frame, rate_bps)
            if self._verdicts is not None:
                self._verdicts.add(outcomes, frame, port, now, stamp_ns)
        return bool(taken)

    def _sources(self) -> list[int]:
        return self._monitors.descriptors

    def _advance(self, until: float) -> None:
        """Let shared channels work, and schedule what they deliver."""
        for sent in self._medium.advance(now=until):
            if sent.sender in self._monitors:
                self._monitors.echo(sent.sender, sent.frame, sent.rate_bps)
            for due, port, received, _verdict in sent.outcomes:
                if due >= 0:
                    self._order += 1
                    shown = self._shown(sent, port, received) if port in self._monitors else received
                    heappush(self._departures, (due, self._order, port, shown))
            if self._verdicts is not None:
                self._verdicts.add(
                    sent.outcomes,
                    sent.frame,
                    sent.sender,
                    sent.offered_s,
                    sent.tag,
                    attempts=sent.attempts,
                    rssi_dbm=self._medium.signals_dbm(sent),
                )

    def _shown(self, sent: Sent, port: int, frame: bytes) -> bytes:
        return self._monitors.heard(
            frame,
            signal_dbm=self._medium.signals_dbm(sent)[port],
            noise_dbm=self._medium.noise_dbm(port),
            rate_bps=sent.rate_bps,
        )

    def _next_s(self) -> float | None:
        """When there is something to do if nothing arrives."""
        next_s = self._medium.next_event()
        if self._departures and (next_s is None or self._departures[0][0] < next_s):
            return self._departures[0][0]
        return next_s

    def _catch_up(self) -> None:
        """Frames that left their node before a change meet what was in force then, as they do in a kernel's queue."""
        until = time.monotonic()
        for _ in range(_RING_BURSTS if self._ring is not None else 0):
            if not self._receive():
                break
        self._advance(until)

    def _depart(self) -> None:
        """Send what is due; what becomes due meanwhile waits for the next turn."""
        departures, send, late = self._departures, self._send, self._late
        now = time.monotonic()
        while departures and departures[0][0] <= now:
            due, _order, port, frame = heappop(departures)
            late.add(now - due)
            try:
                send[port](frame)
            except OSError:
                self._not_sent += 1

    # -- the engine's requests ------------------------------------------------------------------------------------

    def _obey(self, request: Request, fds: list[int]) -> Answer:
        if isinstance(request, AskStats):
            return self._stats()
        if isinstance(request, Setup):
            self._set_up(request)
            return Done()
        if isinstance(request, AddMonitor):
            self._monitors.add(request.port, fds[0])
            self._send[request.port] = self._monitors.sender(request.port)
            return Done()
        if isinstance(request, SetPairs | SetOutage | SetRssi):
            self._catch_up()
        if isinstance(request, SetRssi):
            self._medium.set_rssi(request.segment, _matrix(request.matrix))
            return Done()
        answer: Answer = super()._obey(request, fds)
        return answer

    def _set_up(self, setup: Setup) -> None:
        plan = setup.plan
        ring = Ring(max((port.mtu for port in plan.ports), default=_BASE_MTU))
        self._medium = Medium(plan.ports, plan.segments, plan.seed)
        self._port_of = {ifindex: port for port, ifindex in enumerate(setup.ifindexes) if ifindex}
        self._send = [_sender(ifindex) if ifindex else _nobody for ifindex in setup.ifindexes]
        self._ring = ring
        self._begin(self._medium, ring.fileno())

    def _stats(self) -> AirStats:
        ring = self._ring
        return AirStats(
            received=self._received,
            verdicts=self._medium.counts,
            ring_losses=ring.losses() if ring is not None else 0,
            oversized=ring.oversized if ring is not None else 0,
            unaddressed=self._medium.unaddressed,
            malformed=self._monitors.malformed,
            not_sent=self._not_sent,
            lost_verdicts=self._lost_verdicts,
            late_max_s=self._late.max_s,
            late_p99_s=self._late.quantile_s(0.99),
            channels=self._medium.channel_stats,
        )


def _matrix(values: bytes) -> NDArray[np.float64]:
    import numpy as np  # for radios only

    flat = np.frombuffer(values, dtype=np.float32).astype(np.float64)
    count = math.isqrt(len(flat))
    return flat.reshape(count, count)


def _nobody(_frame: bytes) -> int:
    return 0


def _sender(ifindex: int) -> Callable[[bytes], int]:
    """A socket that only sends (protocol 0), straight to the device: a veth has no queue to wait in."""
    sock = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0)
    sock.setsockopt(_SOL_PACKET, _PACKET_QDISC_BYPASS, 1)
    sock.bind((socket.if_indextoname(ifindex), 0))
    sock.setblocking(False)
    return sock.send


def main(argv: list[str]) -> int:
    """Carry frames for the engine at the other end of ``--channel-fd``, in the calling process's network namespace."""
    Air(lab_channel("netlab-air", argv)).run()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
