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

Watched = socket.socket | MeshInterface | ControlServer | Port


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
        self._wake, self.wake_write = socket.socketpair()
        self.wake_write.setblocking(False)

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
            self._take(self._wait(report_at_s))
        self._report(time.monotonic())

    def close(self) -> None:
        """Close everything."""
        for port in self._ports:
            port.close()
        self._interface.close()
        self._control.close()
        self._wake.close()
        self.wake_write.close()

    def _wait(self, report_at_s: float) -> set[Watched]:
        due = [report_at_s, self._mesh.next_timer(), *(port.frees_at() for port in self._ports)]
        until_s = min(at_s for at_s in due if at_s is not None)
        watched: list[Watched] = [self._wake, self._interface, self._control, *self._ports, *self._control.asking]
        return set(select.select(watched, [], [], max(0.0, until_s - time.monotonic()))[0])

    def _take(self, readable: set[Watched]) -> None:
        mesh = self._mesh
        for place, port in enumerate(self._ports):
            if port in readable:
                for _ in range(_BURST_FRAMES):
                    arrival = port.receive()
                    if arrival is None:
                        break
                    mesh.receive(place, arrival[0], now=time.monotonic(), reception=arrival[1])
        if self._interface in readable:
            for _ in range(_BURST_FRAMES):
                inner = self._interface.read()
                if inner is None:
                    break
                mesh.originate(inner, now=time.monotonic())
        if self._control in readable:
            self._control.accept()
        for asking in [one for one in self._control.asking if one in readable]:
            self._control.answer(asking)

    def _settle(self, now: float) -> None:
        """Do what is due, send and deliver what there is, and tell of it."""
        mesh, ports = self._mesh, self._ports
        timer = mesh.next_timer()
        if timer is not None and timer <= now:
            mesh.handle_timer(now=now)
        while frames := mesh.frames_to_send(now=now, room=[port.room(now=now) for port in ports]):
            for out in frames:
                problem = ports[out.member].transmit(out.frame, out.rate_bps, now=now)
                if problem is not None:
                    mesh.count(problem)
        for inner in mesh.take_delivered():
            self._interface.write(inner)
        while (event := mesh.next_event()) is not None:
            if self._feed is not None:
                self._feed.add(event)
        if self._feed is not None:
            self._feed.flush()

    def _report(self, now: float) -> None:
        """Once a second: the interface's addresses may have changed, and counters have."""
        self._mesh.set_addresses(addresses_of(self._ifname), now=now)
        if self._feed is not None:
            self._feed.stats(self._mesh.counts)
