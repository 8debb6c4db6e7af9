"""What a client remembers of stored messages: publishes that the daemon has not made safe, messages already had."""

from __future__ import annotations

from udp_mesh import local_features
from udp_mesh.core.envelope import DurableId

MAX_UNDECIDED = 512  # stored publishes without a verdict; the daemon remembers twice as many
MAX_UNDECIDED_BYTES = 32 * 1024 * 1024
_REMEMBERED_IDS = 65_536


class StoredState:
    """Survives reconnections. ``undecided``: frames of stored publishes by request, until there is a verdict."""

    def __init__(self) -> None:
        self.undecided: dict[int, bytes] = {}
        self._undecided_bytes = 0
        self._seen: dict[DurableId, bool] = {}  # whether the application has it, or it still waits in the client
        self._taken: list[DurableId] = []

    @property
    def is_full(self) -> bool:
        """Whether so much waits for the daemon that the application has to wait, too."""
        return len(self.undecided) >= MAX_UNDECIDED or self._undecided_bytes >= MAX_UNDECIDED_BYTES

    def remember(self, request: int, frame: bytes) -> None:
        """Repeat a publish after each reconnection, until :meth:`forget`."""
        self.undecided[request] = frame
        self._undecided_bytes += len(frame)

    def forget(self, request: int) -> None:
        """Note that there is a verdict, or that the publish was never sent."""
        self._undecided_bytes -= len(self.undecided.pop(request, b""))

    def receive(self, durable_id: DurableId) -> bool:
        """Note a message from the daemon; whether it is a new one. A repeated one is answered once more."""
        if durable_id in self._seen:
            if self._seen[durable_id]:
                self._taken.append(durable_id)
            return False
        self._seen[durable_id] = False
        if len(self._seen) > _REMEMBERED_IDS:
            del self._seen[next(iter(self._seen))]
        return True

    def take(self, durable_id: DurableId) -> None:
        """Note that the application has a message now."""
        self._seen[durable_id] = True
        self._taken.append(durable_id)

    def taken_frame(self) -> bytes:
        """Return what tells the daemon which messages the application has; empty if there is nothing to tell."""
        return local_features.encode_taken(self._taken) if self._taken else b""

    def told_taken(self) -> None:
        """Note that the frame was sent. Should it be lost, the daemon repeats the messages and we the answer."""
        self._taken.clear()
