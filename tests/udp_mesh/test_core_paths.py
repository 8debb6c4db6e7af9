"""Several carriers: the better path is used, another takes over, nothing arrives twice, nothing is too long."""

from __future__ import annotations

from typing import Any

import pytest

from udp_mesh.core import wire
from udp_mesh.core.carriers import Carrier, Path
from udp_mesh.core.delay_control import DelayControl
from udp_mesh.core.events import DropReason, FragmentRetransmitted, MessageDropped, PathChanged, PeerDown
from udp_mesh.core.paths import LOSS_GAIN, Paths

KEY = bytes(range(32))
FAST, OTHER, SERIAL = 0, 1, 2
SERIAL_MTU_BYTES = 255


@pytest.fixture
def radios(make_net: type[Any]) -> type[Any]:
    """A network class in which every node has two radios, 0 and 1; links of radio 1 are in ``second``."""

    class Radios(make_net):  # type: ignore[misc]
        def __init__(self, *, carriers: dict[int, dict[str, float]], **link: float) -> None:
            super().__init__(**link)
            self.carriers = carriers
            self.by_carrier: dict[int, dict[tuple[str, str], Any]] = {index: {} for index in carriers}
            self._sending_on = 0

        def add(self, name: str, **settings: object) -> Any:
            core = super().add(name, **settings)
            core.remove_carrier(0)
            for index, facts in self.carriers.items():
                core.add_carrier(index, **facts)
                for pair in self.links:
                    self.by_carrier[index].setdefault(pair, type(self.links[pair])(**self.default_link))
            return core

        def cut(self, carrier: int, *, is_cut: bool = True) -> None:
            for link in self.by_carrier[carrier].values():
                link.is_cut = is_cut

        def _send(self, sender: str, datagram: Any) -> None:
            self._sending_on = datagram.path.carrier
            self.links = self.by_carrier[datagram.path.carrier]
            super()._send(sender, datagram)

        def _transmit(self, link: Any, sender: str, receiver: str, data: bytes) -> None:
            before = self._order
            super()._transmit(link, sender, receiver, data)
            self._in_air[:] = [
                (at, order, to, what, Path(self._sending_on, path.address) if order > before else path)
                for at, order, to, what, path in self._in_air
            ]

    return Radios


def carrier_to(net: Any, sender: str) -> int:
    (status,) = net.cores[sender].peers(now=net.now)
    return int(status.carrier)


def test_two_radios_deliver_once_and_one_is_used(radios: type[Any]) -> None:
    net = radios(carriers={FAST: {}, OTHER: {}}, delay_s=0.005)
    net.keep_datagrams = True
    net.add("a")
    net.add("b")
    net.meet()
    for size in (10, 100_000):
        net.publish("a", "t", bytes(size), to="b")
        net.publish("a", "t", bytes(size), to="all")
    net.run(3.0)
    assert sorted(len(event.payload) for event in net.delivered("b")) == [10, 10, 100_000, 100_000]
    unicasts = {d.path.carrier for _at, d in net.sent["a"] if d.path.address}
    assert len(unicasts) == 1


def test_failover_takes_one_probe(radios: type[Any]) -> None:
    net = radios(carriers={FAST: {}, OTHER: {}}, delay_s=0.005)
    net.add("a")
    net.add("b")
    net.meet()
    net.run(3.0)
    net.every(0.05, lambda: net.publish("a", "t", b"x", to="b"), until_s=net.now + 4.0)
    net.run(2.0)
    used = carrier_to(net, "a")
    cut_at_s = net.now
    net.cut(used)
    net.run(1.9)
    (change,) = net.of("a", PathChanged)
    assert change.now - cut_at_s < 0.05 + 0.1  # the next message, and its probe timeout
    assert net.of("a", PeerDown) == net.of("b", PeerDown) == []
    assert len(net.delivered("b")) == len({event.message_id for event in net.delivered("b")}) >= 76
    late = [e for e in net.of("a", FragmentRetransmitted) if e.now > cut_at_s]
    assert len(late) <= 5


def test_a_radio_that_loses_much_is_left_and_an_equal_one_is_kept(radios: type[Any]) -> None:
    net = radios(carriers={FAST: {}, OTHER: {}}, delay_s=0.005)
    net.add("a")
    net.add("b")
    net.meet()
    net.run(20.0)
    assert net.of("a", PathChanged) == []
    used = carrier_to(net, "a")
    for link in net.by_carrier[used].values():
        link.loss_ratio = 0.6
    net.run(30.0)
    assert carrier_to(net, "a") == 1 - used


def test_datagrams_fit_the_smallest_carrier_of_a_broadcast_and_that_of_a_path(radios: type[Any]) -> None:
    for keys in ((), (KEY,)):
        net = radios(carriers={FAST: {}, SERIAL: {"mtu_bytes": SERIAL_MTU_BYTES, "rate_bps": 5000.0}}, delay_s=0.005)
        net.keep_datagrams = True
        net.add("a", keys=keys)
        net.add("b", keys=keys)
        net.meet(6.0)
        assert net.run(10.0, until=lambda net=net: carrier_to(net, "a") == FAST)  # the fast one is preferred
        net.publish("a", "t", bytes(3000), to="b")
        net.publish("a", "t", bytes(100), to="all")
        net.publish("a", "t", bytes(500), to="all")
        net.run(2.0)
        assert sorted(len(event.payload) for event in net.delivered("b")) == [100, 500, 3000]
        longest = {
            carrier: max(len(d.data) for _at, d in net.sent["a"] if d.path.carrier == carrier)
            for carrier in (FAST, SERIAL)
        }
        assert longest[SERIAL] <= SERIAL_MTU_BYTES
        assert longest[FAST] == 1400


def test_messages_are_cut_anew_for_a_smaller_path(radios: type[Any]) -> None:
    net = radios(carriers={FAST: {}, SERIAL: {"mtu_bytes": SERIAL_MTU_BYTES, "rate_bps": 40_000.0}}, delay_s=0.005)
    net.add("a")
    net.add("b")
    net.meet(6.0)
    assert net.run(10.0, until=lambda: carrier_to(net, "a") == carrier_to(net, "b") == FAST)
    net.cut(FAST)
    net.publish("a", "lost", bytes(1000), to="b")  # leaves whole: nobody knows whether it arrives
    net.run(0.01)
    for _ in range(3):
        net.publish("a", "bulk", bytes(60_000), to="b", priority=9)
    net.run(60.0)
    assert carrier_to(net, "a") == SERIAL
    dropped = [(event.topic, event.reason) for event in net.of("a", MessageDropped)]
    assert dropped == [("lost", DropReason.PATH_TOO_SMALL)]
    assert [len(event.payload) for event in net.delivered("b", "bulk")] == [60_000] * 3


def test_a_carrier_of_known_rate_is_given_no_more_than_it_carries(radios: type[Any]) -> None:
    net = radios(carriers={SERIAL: {"mtu_bytes": SERIAL_MTU_BYTES, "rate_bps": 5000.0}}, delay_s=0.01)
    for name in ("a", "b"):
        net.add(name)
    for link in net.by_carrier[SERIAL].values():
        link.rate_bps = 5000 * (255 + 42) / 255  # the fake link counts Ethernet's headers
    net.meet(10.0)
    net.run(5.0)
    net.keep_datagrams = True
    net.publish("a", "bulk", bytes(5000), to="b", priority=9)
    net.run(1.0)
    urgent_at_s = net.now
    net.publish("a", "urgent", b"stop", to="b", priority=0)
    net.run(30.0)
    (bulk,) = net.delivered("b", "bulk")
    (urgent,) = net.delivered("b", "urgent")
    # One full datagram takes 0.41 s, and one may be on its way; then the own 0.1 s, perhaps behind an acknowledgement.
    assert urgent.now - urgent_at_s < 1.2
    assert bulk.now - urgent_at_s > 5.0
    sent_bytes = sum(len(d.data) for at, d in net.sent["a"] if at < bulk.now)
    assert 8 * sent_bytes / (bulk.now - urgent_at_s + 1.0) < 1.1 * 5000
    assert 8 * 5000 / (bulk.now - urgent_at_s + 1.0) > 0.7 * 5000


def test_beacons_take_a_tenth_of_a_slow_carrier(radios: type[Any]) -> None:
    net = radios(carriers={SERIAL: {"mtu_bytes": SERIAL_MTU_BYTES, "rate_bps": 2000.0}}, delay_s=0.01)
    net.add("a")
    net.add("b")
    net.meet(10.0)
    net.keep_datagrams = True
    net.run(120.0)
    sent_bytes = sum(len(d.data) for _at, d in net.sent["a"])
    assert 8 * sent_bytes / 120 < 0.11 * 2000
    assert net.of("a", PeerDown) == []


def test_the_best_path_by_its_parts() -> None:
    carriers = {0: Carrier(0), 1: Carrier(1), 2: Carrier(2, rate_bps=5000.0)}
    first, second, slow = Path(0, "x"), Path(1, "y"), Path(2, "")
    paths = Paths()
    assert paths.best(first, carriers, stale_s=1.0, now=0.0) == first
    paths.heard(slow, now=0.0)
    assert paths.best(first, carriers, stale_s=1.0, now=0.0) == slow  # nothing else was heard
    paths.heard(first, now=0.0)
    paths.heard(second, now=0.0)
    assert paths.best(first, carriers, stale_s=1.0, now=0.0) == first
    assert paths.best(slow, carriers, stale_s=1.0, now=0.0) in (first, second)
    assert paths.alternative(first, carriers, stale_s=1.0, now=0.0) == second  # never the slow one for one late answer
    assert paths.alternative(second, carriers, stale_s=1.0, now=1.0) is None  # the first one rests
    paths.heard(second, now=9.0)
    assert paths.best(first, carriers, stale_s=1.0, now=9.5) == second  # the first one is silent
    del carriers[1]
    assert paths.best(second, carriers, stale_s=100.0, now=9.5) in (first, slow)


def test_missing_numbers_are_losses() -> None:
    state = Paths().heard(Path(0, "x"), now=0.0)
    for number in (5, 6, 7):
        state.on_broadcast(number)
    assert state.loss_ratio == 0
    state.on_broadcast(9)
    assert state.loss_ratio == pytest.approx(LOSS_GAIN * (1 - LOSS_GAIN))
    state.on_broadcast(8)  # late, not lost: counts as heard no more and no less
    state.on_broadcast(wire.MAX_NUMBER)
    assert 0.8 < state.loss_ratio < 1


def test_a_window_begins_with_what_its_carrier_is_known_to_carry() -> None:
    assert DelayControl(datagram_bytes=244, rate_bps=5000.0, now=0.0).cwnd_bytes == 2 * 244
    assert DelayControl(datagram_bytes=1000, rate_bps=1e6, now=0.0).cwnd_bytes == 12_500  # a tenth of a second
    assert DelayControl(datagram_bytes=1000, now=0.0).cwnd_bytes == 8000
