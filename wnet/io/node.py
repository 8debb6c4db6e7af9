"""The daemon's loop: members, mesh interface, control socket and timers around one :class:`~wnet.core.mesh.Mesh`.

One thread. ``select`` sleeps to the microsecond where ``epoll`` rounds up to a whole millisecond. Frames are taken in
bursts, and what they lead to is sent once per burst.
"""

from __future__ import annotations

import select
import socket
import time
from collections.abc import Sequence

from wnet.core.mesh import Mesh
from wnet.io.addresses import addresses_of
from wnet.io.control import ControlServer
from wnet.io.feed import EventFeed
from wnet.io.members import Port
from wnet.io.mesh_interface import MeshInterface

# Frames taken from one descriptor before the others get their turn.
_BURST_FRAMES = 32
_REPORT_S = 1.0
_RETRY_S = 0.001


class Node:
    """One node; :meth:`run` until :meth:`stop`."""

    def __init__(
        self,
        mesh: Mesh,
        ports: Sequence[Port],
        interface: MeshInterface,
        ifname: str,
        control: ControlServer,
        feed: EventFeed | None,
    ) -> None:
        """``ports`` are in the order of the mesh's members; ``ifname`` is the mesh interface's name."""
        self._mesh = mesh
        self._ports = ports
        self._interface = interface
        self._ifname = ifname
        self._control = control
        self._feed = feed
        self._stopping = False
        self._due_s = 0.0  # when the mesh's timer has come
        self._wake, self.wake_write = socket.socketpair()
        self.wake_write.setblocking(False)
        # By descriptor: ``select`` asks every object for its own otherwise, each time.
        self._place_of = {port.fileno(): place for place, port in enumerate(ports)}
        self._watched = [self._wake.fileno(), interface.fileno(), control.fileno(), *self._place_of]

    def stop(self) -> None:
        """Have the loop end; to be called from a signal handler whose number ``wake_write`` was sent."""
        self._stopping = True

    def run(self) -> None:
        """Route frames until :meth:`stop`, or until the mesh interface is deleted.

        Raises:
            InterfaceDeleted: It was.
        """
        report_at_s = 0.0
        while not self._stopping:
            now = time.monotonic()
            if now >= report_at_s:
                self._report(now)
                report_at_s = now + _REPORT_S
            self._settle(now)
            self._take(self._wait(report_at_s, now))
        self._report(time.monotonic())

    def close(self) -> None:
        """Close everything."""
        for port in self._ports:
            port.close()
        self._interface.close()
        self._control.close()
        self._wake.close()
        self.wake_write.close()

    def _wait(self, report_at_s: float, now: float) -> list[int]:
        """Sleep until there is something to do; returns the descriptors that are readable.

        ``now`` is when everything was done that could be. To ask again at once would burn the processor, and where time
        is virtual keep it from passing.
        """
        timer = self._mesh.next_timer()
        if timer is not None and timer <= now:  # it was due already, and found no room on a radio
            timer = now + _RETRY_S
        self._due_s = until_s = report_at_s if timer is None else min(timer, report_at_s)
        for port in self._ports:
            frees_at_s = port.frees_at()
            if frees_at_s is not None and frees_at_s < until_s:
                until_s = frees_at_s
        asking = self._control.asking
        watched = [*self._watched, *(one.fileno() for one in asking)] if asking else self._watched
        return select.select(watched, [], [], max(0.0, until_s - time.monotonic()))[0]

    def _take(self, readable: list[int]) -> None:
        mesh = self._mesh
        for descriptor in readable:
            place = self._place_of.get(descriptor)
            if place is not None:
                self._receive(place)
            elif descriptor == self._watched[1]:
                for _ in range(_BURST_FRAMES):
                    inner = self._interface.read()
                    if inner is None:
                        break
                    mesh.originate(inner, now=time.monotonic())
            elif descriptor == self._watched[2]:
                self._control.accept()
            else:
                self._control.answer(descriptor)

    def _receive(self, place: int) -> None:
        receive, take = self._ports[place].receive, self._mesh.receive
        for _ in range(_BURST_FRAMES):
            arrival = receive()
            if arrival is None:
                return
            take(place, arrival[0], now=time.monotonic(), reception=arrival[1])

    def _settle(self, now: float) -> None:
        """Do what is due, send and deliver what there is, and tell of it."""
        mesh = self._mesh
        if self._due_s <= now:
            mesh.handle_timer(now=now)
        while self._send(now):
            pass
        for inner in mesh.take_delivered():
            self._interface.write(inner)
        feed = self._feed
        while (event := mesh.next_event()) is not None:
            if feed is not None:
                feed.add(event)
        if feed is not None:
            feed.flush()

    def _send(self, now: float) -> bool:
        """Send as much as there is room for; True where that was everywhere less than there is."""
        ports = self._ports
        room = [port.room(now=now) for port in ports]
        for out in self._mesh.frames_to_send(now=now, room=room):
            room[out.member] -= 1
            problem = ports[out.member].transmit(out.frame, out.rate_bps, now=now)
            if problem is not None:
                self._mesh.count(problem)
        return any(left <= 0 < port.room(now=now) for left, port in zip(room, ports, strict=True))

    def _report(self, now: float) -> None:
        """Once a second: the interface's addresses may have changed, links too, and counters have."""
        self._mesh.set_addresses(addresses_of(self._ifname), now=now)
        if self._feed is not None:
            self._feed.links(self._mesh.links(now=now))
            self._feed.stats(self._mesh.counts)
