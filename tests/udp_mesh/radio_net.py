"""Cores whose datagrams share a radio channel: the lab's own, with carrier sense, back-off and acknowledgements."""

from __future__ import annotations

import heapq
import math
from typing import TYPE_CHECKING, Any

from netlab.medium.channel import Channel
from netlab.medium.channel_records import Decided
from netlab.medium.phy import PHYS
from netlab.medium.rate_control import FixedRate
from netlab.medium.segments import Port
from netlab.medium.verdicts import Verdict
from udp_mesh.core.mesh import Datagram, Path

if TYPE_CHECKING:
    from tests.udp_mesh.conftest import Net

HEADERS = bytes(42)  # Ethernet, IPv4, UDP
PHY = PHYS["802.11g-20MHz"]
NEAR_DBM, NOISE_DBM = -50.0, -91.0


def shared_channel(names: tuple[str, ...], *, seed: int, rate_bps: float) -> Channel:
    """A channel of 802.11g radios at one rate, all out of range."""
    ports = [Port(place, name, "radio0", bytes((2, 0, 0, 0, 0, place)), None) for place, name in enumerate(names)]
    made = Channel(ports, PHY, noise_dbm=NOISE_DBM, seed=seed, rate_control=FixedRate(PHY.rate(rate_bps)))
    bring_together(made, len(names), near=False)
    return made


def bring_together(channel: Channel, count: int, *, near: bool) -> None:
    """Put all stations next to each other, or out of each other's range."""
    channel.set_rssi([[NEAR_DBM if near else -math.inf] * count for _ in range(count)])


def radio_class(net_class: type[Net]) -> type[Net]:
    """Return the class of networks whose nodes, named beforehand, have one radio each."""

    class RadioNet(net_class):  # type: ignore[valid-type, misc]
        def __init__(self, *names: str, seed: int = 1, rate_bps: float = 6e6) -> None:
            super().__init__(seed=seed)
            self.names = names
            self.channel = shared_channel(names, seed=seed, rate_bps=rate_bps)

        def bring_together(self, *, near: bool) -> None:
            """Put all nodes next to each other, or out of each other's range."""
            self._air()
            bring_together(self.channel, len(self.names), near=near)

        def _send(self, sender: str, datagram: Datagram) -> None:
            if self.keep_datagrams:
                self.sent[sender].append((self.now, datagram))
            self._air()
            to = datagram.path.address
            receiver = self.names.index(to) if to else None
            self.channel.offer(self.names.index(sender), HEADERS + datagram.data, receiver, now=self.now)

        def _air(self) -> None:
            for decided in self.channel.advance(self.now):
                self._arrive(decided)

        def _arrive(self, decided: Decided) -> None:
            path = Path(0, self.names[decided.sender])
            for place, verdict in decided.fates:
                if verdict is Verdict.DELIVERED:
                    self._order += 1
                    frame: Any = (self.now, self._order, self.names[place], decided.frame[len(HEADERS) :], path)
                    heapq.heappush(self._in_air, frame)

        def _next_s(self) -> float:
            next_s = self.channel.next_event()
            return float(min(super()._next_s(), math.inf if next_s is None else max(next_s, self.now)))

        def _step(self) -> None:
            self._air()
            super()._step()

    return RadioNet
