"""The process of the medium: carries every frame of the lab between the far ends of its veths.

One thread, one loop: empty the ring, ask the medium, send what is due, answer the engine, sleep until the next
departure or event. Delays count from the kernel's stamp of a frame's arrival, so that neither a late wake-up nor a
burst makes them longer, as long as the process is awake when they end. ``select`` sleeps to the microsecond with the
timer slack at 1 ns; ``epoll`` would round up to a whole millisecond.

Ends when the engine's channel closes, however the engine ended.
"""

from __future__ import annotations

import argparse
import gc
import select
import socket
import sys
import time
from collections.abc import Callable
from heapq import heappop, heappush

from netlab.engines.air_messages import (
    AirStats,
    Answer,
    AskStats,
    Close,
    Done,
    Failed,
    RecordVerdicts,
    Request,
    SetOutage,
    SetPairs,
    Setup,
)
from netlab.engines.air_ring import SLOTS_MAX, Ring
from netlab.engines.air_verdicts import VerdictStream
from netlab.engines.priority import prefer_this_process
from netlab.ipc import Channel
from netlab.kernel import syscalls
from netlab.medium.medium import Medium

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


class Air:
    """The data plane of one lab."""

    def __init__(self, channel: Channel) -> None:
        self._channel = channel
        self._channel_fd = channel.fileno()
        self._readers = [self._channel_fd]
        self._open = True
        self._ring: Ring | None = None
        self._medium = Medium((), (), 0)
        self._port_of: dict[int, int] = {}
        self._send: list[Callable[[bytes], int]] = []
        self._departures: list[tuple[float, int, int, bytes]] = []  # heap of (due_s, order, port, frame)
        self._order = 0
        self._verdicts: VerdictStream | None = None
        self._received = 0
        self._not_sent = 0
        self._lost_verdicts = 0  # of earlier streams
        self._late_max_s = 0.0

    def run(self) -> None:
        """Carry frames until the channel closes."""
        while self._ring is None and self._open:
            self._answer()
        while self._open:
            busy = self._receive()
            self._depart()
            self._wait(0.0 if busy else None)
        if self._verdicts is not None:
            self._verdicts.close()

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
            outcomes = transmit(sender, frame, now=arrived)
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

    def _catch_up(self) -> None:
        """Frames that left their node before a change meet what was in force then, as they do in a kernel's queue."""
        for _ in range(_RING_BURSTS if self._ring is not None else 0):
            if not self._receive():
                break

    def _depart(self) -> None:
        """Send what is due; what becomes due meanwhile waits for the next turn."""
        departures, send = self._departures, self._send
        now = time.monotonic()
        if departures and (late_s := now - departures[0][0]) > self._late_max_s:
            self._late_max_s = late_s
        while departures and departures[0][0] <= now:
            _due, _order, port, frame = heappop(departures)
            try:
                send[port](frame)
            except OSError:
                self._not_sent += 1

    def _wait(self, most_s: float | None) -> None:
        """Sleep until a departure is due, a frame is there or the engine speaks; at most ``most_s``."""
        verdicts = self._verdicts
        writing: list[int] = []
        if verdicts is not None and verdicts.pending:
            verdicts.flush()
            writing = [verdicts.fileno()] if verdicts.pending else []
        if most_s is None and self._departures:
            most_s = max(0.0, self._departures[0][0] - time.monotonic())
        readable = select.select(self._readers, writing, [], most_s)[0]
        if self._channel_fd in readable:
            self._answer()

    # -- the engine's requests ------------------------------------------------------------------------------------

    def _answer(self) -> None:
        try:
            request, fds = self._channel.recv()
            try:
                answer = self._obey(request, fds)
            except (OSError, ValueError) as error:
                answer = Failed(str(error))
            self._channel.send(answer)
        except (EOFError, BrokenPipeError, ConnectionResetError):
            self._open = False

    def _obey(self, request: Request, fds: list[int]) -> Answer:
        if isinstance(request, AskStats):
            return self._stats()
        if isinstance(request, Setup):
            self._set_up(request)
        elif isinstance(request, SetPairs):
            self._catch_up()
            self._medium.set_pairs(request.changes)
        elif isinstance(request, SetOutage):
            self._catch_up()
            self._medium.set_outage(request.pairs, active=request.active)
        elif isinstance(request, RecordVerdicts):
            self._record(fds[0])
        else:
            assert isinstance(request, Close)
            self._open = False
        return Done()

    def _set_up(self, setup: Setup) -> None:
        plan = setup.plan
        ring = Ring(max((port.mtu for port in plan.ports), default=_BASE_MTU))
        self._medium = Medium(plan.ports, plan.segments, plan.seed)
        self._port_of = {ifindex: port for port, ifindex in enumerate(setup.ifindexes)}
        self._send = [_sender(ifindex) for ifindex in setup.ifindexes]
        self._ring = ring
        self._readers = [self._channel_fd, ring.fileno()]
        # What lives now lives on, and frames make no cycles: no collection ever needs to stop the loop.
        gc.collect()
        gc.freeze()
        gc.disable()

    def _record(self, fd: int) -> None:
        if self._verdicts is not None:
            self._verdicts.close()
            self._lost_verdicts += self._verdicts.lost
        self._verdicts = VerdictStream(fd)

    def _stats(self) -> AirStats:
        ring, verdicts = self._ring, self._verdicts
        return AirStats(
            received=self._received,
            verdicts=self._medium.counts,
            ring_losses=ring.losses() if ring is not None else 0,
            oversized=ring.oversized if ring is not None else 0,
            unaddressed=self._medium.unaddressed,
            not_sent=self._not_sent,
            lost_verdicts=self._lost_verdicts + (verdicts.lost if verdicts is not None else 0),
            late_max_s=self._late_max_s,
        )


def _sender(ifindex: int) -> Callable[[bytes], int]:
    """A socket that only sends (protocol 0), straight to the device: a veth has no queue to wait in."""
    sock = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0)
    sock.setsockopt(_SOL_PACKET, _PACKET_QDISC_BYPASS, 1)
    sock.bind((socket.if_indextoname(ifindex), 0))
    sock.setblocking(False)
    return sock.send


def main(argv: list[str]) -> int:
    """Carry frames for the engine at the other end of ``--channel-fd``, in the calling process's network namespace."""
    parser = argparse.ArgumentParser(prog="netlab-air")
    parser.add_argument("--channel-fd", type=int, required=True)
    options = parser.parse_args(argv)
    syscalls.set_name("netlab-air")
    prefer_this_process()
    Air(Channel.from_fd(options.channel_fd)).run()
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
