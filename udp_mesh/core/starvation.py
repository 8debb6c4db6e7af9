"""The share of what leaves that is kept for less urgent messages while more urgent ones would take everything."""

from __future__ import annotations

from collections.abc import Callable

from udp_mesh.core.messages import Transfer
from udp_mesh.core.scheduler import Scheduler

_PAYMENT_BYTES = 1400


class StarvationFloor:
    """Counts what the less urgent are owed, in packets; pays it to the one that has waited longest."""

    def __init__(self, scheduler: Scheduler) -> None:
        self._scheduler = scheduler
        self._owed_bytes = 0.0

    def due(self, urgent: Transfer, can_send: Callable[[Transfer], bool], *, ratio: float) -> Transfer | None:
        """Return the less urgent message whose turn it is instead of ``urgent``; None if it is nobody's."""
        if not ratio or self._owed_bytes < _PAYMENT_BYTES:
            return None
        self._owed_bytes -= _PAYMENT_BYTES  # also if nobody claims it: nothing is saved up
        return self._scheduler.longest_waiting(urgent.message.policy.priority, can_send)

    def on_sent(self, size_bytes: int, *, ratio: float) -> None:
        """Count what left for the most urgent; of all bytes ``ratio`` is owed, but never more than two packets."""
        self._owed_bytes = min(self._owed_bytes + ratio / (1 - ratio) * size_bytes, 2 * _PAYMENT_BYTES)
