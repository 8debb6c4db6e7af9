"""Pushes the state of links and queues to the applications that asked for it, at the pace they asked for."""

from __future__ import annotations

from collections.abc import Callable

from udp_mesh import local_wire
from udp_mesh.io.server import Connection
from udp_mesh.local_wire import FrameType

MIN_INTERVAL_S = 0.02


class StatusPush:
    """Who wants it when. ``describe`` returns the state as plain values; it is called only when somebody gets it."""

    def __init__(self, describe: Callable[[], dict[str, object]]) -> None:
        self._describe = describe
        self._watchers: dict[Connection, tuple[float, float]] = {}  # interval, next time

    def watch(self, connection: Connection, interval_s: float, *, now: float) -> None:
        """Send the state now and at every interval; 0 ends it."""
        if interval_s > 0:
            self._watchers[connection] = (max(interval_s, MIN_INTERVAL_S), now)
        else:
            self._watchers.pop(connection, None)

    def send(self, *, now: float) -> None:
        """Send what is due. An application that has not read the last state is passed over: the newest will do."""
        frame = b""
        for connection, (interval_s, due_s) in list(self._watchers.items()):
            if connection.is_closed:
                del self._watchers[connection]
            elif due_s <= now:
                self._watchers[connection] = (interval_s, now + interval_s)
                if not connection.has_output:
                    frame = frame or local_wire.json_frame(FrameType.STATUS, self._describe())
                    connection.send(frame)

    def next_timer(self) -> float | None:
        """Return when :meth:`send` is due."""
        return min((due_s for _interval_s, due_s in self._watchers.values()), default=None)
