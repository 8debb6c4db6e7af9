"""A fake network with several carriers, on which a bridge joins nodes that do not hear each other."""

from __future__ import annotations

import heapq
from typing import Any

from udp_mesh.core.mesh import Datagram, Path

FACTS: dict[int, dict[str, Any]] = {0: {}, 1: {"mtu_bytes": 244, "rate_bps": 5000.0}, 2: {}}


def places_class(net: type[Any]) -> type[Any]:
    """Return a subclass of the network that ``make_net`` hands out."""

    class Places(net):  # type: ignore[misc]
        """A node hears only those who share a carrier with it; who has carrier 1 shares a slow line."""

        serial, serial_bps, framing_bytes = 1, 5000.0, 11
        facts = FACTS

        def __init__(self, where: dict[str, tuple[int, ...]], **link: float) -> None:
            super().__init__(**{"delay_s": 0.005, **link})
            self.where = where
            self.keep_datagrams = True
            self.deaf: set[tuple[str, int]] = set()
            self._line_free_at_s = 0.0

        def add(self, name: str, **settings: Any) -> Any:
            core = super().add(name, **settings)
            core.remove_carrier(0)
            for index in self.where[name]:
                core.add_carrier(index, **self.facts[index])
            return core

        def start(self, *bridges: str, **settings: object) -> None:
            """Start every node, these as bridges."""
            for name in self.where:
                self.add(name, bridge=name in bridges, **settings)

        def meet(self, timeout_s: float = 20.0) -> None:
            super().meet(timeout_s)

        def _send(self, sender: str, datagram: Datagram) -> None:
            index = datagram.path.carrier
            assert index in self.where[sender]
            assert len(datagram.data) <= self.facts[index].get("mtu_bytes", 1400)
            self.sent[sender].append((self.now, datagram))
            if index == self.serial:
                airtime_s = 8 * (len(datagram.data) + self.framing_bytes) / self.serial_bps
                self._line_free_at_s = max(self._line_free_at_s, self.now) + airtime_s
            for name in self.cores:
                if name == sender or index not in self.where[name] or datagram.path.address not in ("", name):
                    continue
                if not {(name, index), (sender, index)} & self.deaf:
                    self._transmit_by(index, sender, name, datagram.data)

        def _transmit_by(self, index: int, sender: str, receiver: str, data: bytes) -> None:
            link = self.links[sender, receiver]
            if self.rng.random() < link.loss_ratio:
                return
            starts_s = self._line_free_at_s if index == self.serial else self.now
            for _ in range(2 if self.rng.random() < link.duplicate_ratio else 1):
                self._order += 1
                at_s = starts_s + link.delay_s + self.rng.random() * link.jitter_s
                heapq.heappush(self._in_air, (at_s, self._order, receiver, data, Path(index, sender)))

    return Places
