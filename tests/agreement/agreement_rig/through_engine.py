"""The cells through an engine in real namespaces, all side by side in one lab, in virtual time.

One process sends and receives: in virtual time computing costs nothing, so that reading late changes no stamp. A frame
was sent at its tick; it arrived at the stamp that the receiving node's kernel gave it. The process outranks the air
engine's, so that all frames of a tick leave together instead of taking turns with it: a third of the real time.
"""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from agreement_rig.burst import Burst
from agreement_rig.cells import RECEIVERS, TICK_S, Cell
from agreement_rig.lab import SENDER, Place, build, number_of, receiver_name
from agreement_rig.through_medium import Sending, settings
from agreement_rig.tracks import Tracks, empty
from netlab.engines.air import AirEngine
from netlab.engines.air_ring import Ring
from netlab.engines.base import LabPlan
from netlab.engines.netem import NetemEngine
from netlab.kernel.namespaces import returning
from netlab.kernel.syscalls import set_timerslack_ns
from netlab.kernel.wiring import enter

ENGINES: dict[str, type[AirEngine] | type[NetemEngine]] = {"netem": NetemEngine, "air": AirEngine}
_NS_PER_S = 1_000_000_000
_QUIET_S = 2.0  # the kernel's last words about IPv6 groups come within a second
_DRAIN_S = 2.0
_READ_EVERY = 32  # ticks; a ring holds 4096 frames
_MTU = 1500
_PRIORITY = 2  # the air process takes 1


@dataclass(frozen=True, slots=True)
class Run:
    """What an engine did with all cells, and how they were sent, for the pure medium to do the same."""

    tracks: list[Tracks]
    sending: Sending


def run(engine_name: str, cells: Sequence[Cell], seed: int) -> Run:
    """Send all frames of all cells through an engine; the caller is root of the box, in the lab's own namespace.

    Raises:
        MachineError: This kernel cannot run the engine.
        RuntimeError: Frames got lost on the way to the judge: the rig, not the engine, is at fault.
    """
    plan, places = build(cells, seed)
    engine = ENGINES[engine_name](plan)
    engine.bring_up()
    try:
        rig = _Rig(engine, plan, places)
        try:
            result = rig.run()
        finally:
            rig.close()
        _check_kept_up(engine)
    finally:
        engine.close()
    return result


def _check_kept_up(engine: AirEngine | NetemEngine) -> None:
    if isinstance(engine, AirEngine):
        stats = engine.stats()
        if stats.ring_losses or stats.oversized or stats.not_sent:
            raise RuntimeError(f"the air process did not keep up: {stats}")


class _Rig:
    """A sender in its node, a ring of frames in each receiver's."""

    def __init__(self, engine: AirEngine | NetemEngine, plan: LabPlan, places: Sequence[Place]) -> None:
        self._engine = engine
        self._ports = plan.ports
        self._fds = engine.namespace_fds
        # Longest first: at any tick those that still send are the first ones.
        self._order = sorted(range(len(places)), key=lambda index: -places[index].cell.ticks)
        self._places = places
        self._tracks = [empty(place.cell) for place in places]
        self._ticks_s: list[float] = []
        self._ticks_ns: list[int] = []
        for node in self._fds:
            self._silence(node)
        time.sleep(_QUIET_S)
        self._noise = self._already_sent()
        self._burst = self._open_burst()
        self._where: list[dict[int, tuple[int, int]]] = []  # per receiver: interface index -> (cell, receiver)
        self._rings = [self._open_ring(receiver) for receiver in range(RECEIVERS)]

    def run(self) -> Run:
        """Send at every tick, read now and then."""
        set_timerslack_ns(1)
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(_PRIORITY))
        try:
            self._send_all()
        finally:
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        losses = sum(ring.losses() for ring in self._rings)
        if losses:
            raise RuntimeError(f"the receivers' rings overflowed: {losses} frames lost")
        return Run(self._tracks, Sending(self._ticks_s, self._noise))

    def close(self) -> None:
        """Close sender and receivers."""
        self._burst.close()
        for ring in self._rings:
            ring.close()

    # -- sending --------------------------------------------------------------------------------------------------

    def _send_all(self) -> None:
        active = len(self._order)
        start_s = time.monotonic() + TICK_S
        for tick in range(self._places[self._order[0]].cell.ticks):
            while self._places[self._order[active - 1]].cell.ticks <= tick:
                active -= 1
            self._set(tick)
            time.sleep(max(0.0, start_s + tick * TICK_S - time.monotonic()))
            self._ticks_s.append(time.monotonic())
            self._ticks_ns.append(time.time_ns())
            self._burst.send(tick, active)
            if tick % _READ_EVERY == 0:
                self._read()
        time.sleep(_DRAIN_S)
        self._read()

    def _set(self, tick: int) -> None:
        changes = {}
        for place in self._places:
            wanted = settings(place.cell, tick)
            if wanted is not None:
                changes.update(place.pairs(wanted))
        if changes:
            self._engine.set_pairs(dict(changes))

    # -- receiving ------------------------------------------------------------------------------------------------

    def _read(self) -> None:
        for ring, where in zip(self._rings, self._where, strict=True):
            while arrivals := ring.take(1024):
                for ifindex, sec, nsec, frame in arrivals:
                    self._note(*where[ifindex], sec * _NS_PER_S + nsec, frame)

    def _note(self, cell: int, receiver: int, arrived_ns: int, frame: bytes) -> None:
        place = self._places[cell]
        tick = number_of(frame)
        phase, number = divmod(tick, place.cell.frames)
        delay_s = (arrived_ns - self._ticks_ns[tick]) / _NS_PER_S
        corrupted = frame != place.frame(tick)
        self._tracks[cell][phase][receiver].add(number, self._ticks_s[tick], delay_s, corrupted)

    # -- setting up -----------------------------------------------------------------------------------------------

    def _silence(self, node: str) -> None:
        """Only our frames from here on: no IPv6 group reports or solicitations."""
        with returning():
            enter(self._fds[node])
            switch = Path("/proc/sys/net/ipv6/conf/all/disable_ipv6")
            if switch.exists():
                switch.write_text("1")

    def _already_sent(self) -> list[int]:
        """Frames that each cell's sender has sent so far; they have used up random numbers."""
        with returning():
            enter(self._fds[SENDER])
            lines = Path("/proc/thread-self/net/dev").read_text().splitlines()
        sent = {name.strip(): int(rest.split()[9]) for name, _, rest in (line.partition(":") for line in lines) if rest}
        return [sent[self._ports[place.sender].ifname] for place in self._places]

    def _open_burst(self) -> Burst:
        chosen = [self._places[index] for index in self._order]
        with returning():
            enter(self._fds[SENDER])
            return Burst([place.frame(0) for place in chosen], [self._ports[place.sender].ifname for place in chosen])

    def _open_ring(self, receiver: int) -> Ring:
        with returning():
            enter(self._fds[receiver_name(receiver)])
            self._where.append(
                {
                    socket.if_nametoindex(self._ports[place.receivers[receiver]].ifname): (cell, receiver)
                    for cell, place in enumerate(self._places)
                    if receiver < place.cell.receivers
                }
            )
            return Ring(_MTU)
