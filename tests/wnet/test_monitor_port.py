"""A member in monitor mode over a fake packet socket: what it takes for its own, for others' and for a report."""

from __future__ import annotations

from collections import deque

import pytest

from wnet.core.wire import ETHERTYPE
from wnet.io import dot11, members, radiotap
from wnet.io.members import MonitorPort

OWN, PEER, GROUP = (bytes.fromhex(text) for text in ("024e4c000001", "024e4c000002", "03574e657400"))
FRAME = GROUP + PEER + ETHERTYPE + b"payload"


class FakeSocket:
    """What a driver shows, and what was given to it."""

    mac = b""
    mtu_bytes = 1760

    def __init__(self, _ifname: str, _ethertype: int) -> None:
        self.shown: deque[bytes] = deque()
        self.sent: list[bytes] = []

    def receive(self) -> bytes | None:
        return self.shown.popleft() if self.shown else None

    def send(self, data: bytes) -> int:
        self.sent.append(data)
        return len(data)

    def attach_filter(self, program: bytes) -> None:
        assert len(program) % 8 == 0

    def close(self) -> None:
        pass


@pytest.fixture
def port(monkeypatch: pytest.MonkeyPatch) -> MonitorPort:
    monkeypatch.setattr(members, "PacketSocket", FakeSocket)
    return MonitorPort("mon0", (6_000_000,), OWN)


def driver(port: MonitorPort) -> FakeSocket:
    found: FakeSocket = port.__dict__["_socket"]
    return found


def heard(frame: bytes, *, fcs: bool = False) -> bytes:
    head = bytearray(radiotap.encode_received(signal_dbm=-70, noise_dbm=-91, rate_bps=12_000_000))
    if fcs:
        head[8] |= 0x10
    return bytes(head) + dot11.encode(frame) + (b"sum!" if fcs else b"")


def echo(frame: bytes) -> bytes:
    return radiotap.encode_transmit(6_000_000) + dot11.encode(frame)


@pytest.mark.parametrize("fcs", [False, True])
def test_a_frame_comes_with_how_it_was_heard(port: MonitorPort, fcs: bool) -> None:
    driver(port).shown.append(heard(FRAME, fcs=fcs))
    arrival = port.receive()
    assert arrival is not None
    frame, reception = arrival
    assert frame == FRAME
    assert reception is not None
    assert (reception.signal_dbm, reception.noise_dbm, reception.rate_bps) == (-70.0, -91.0, 12_000_000)
    assert port.receive() is None


def test_what_is_no_frame_of_a_peer_is_passed_over(port: MonitorPort) -> None:
    own = GROUP + OWN + ETHERTYPE + b"payload"
    other = GROUP + PEER + b"\x08\x00" + b"payload"
    shown = [heard(own), heard(other), b"", b"\0\0\xff\xff", heard(FRAME)[:20], heard(FRAME)]
    driver(port).shown.extend(shown)
    arrival = port.receive()
    assert arrival is not None
    assert arrival[0] == FRAME
    assert port.receive() is None


def test_few_frames_are_given_to_a_radio_before_it_reports_them(port: MonitorPort) -> None:
    now = 5.0
    assert port.frees_at() is None
    while port.room(now=now):
        assert port.transmit(FRAME, 6_000_000, now=now) is None
    assert len(driver(port).sent) == 2
    assert port.frees_at() == pytest.approx(now + 0.25)
    driver(port).shown.append(echo(FRAME))
    assert port.receive() is None
    assert port.room(now=now) == 1
    assert port.frees_at() is None


def test_a_radio_that_reports_nothing_gets_all_until_it_does(port: MonitorPort) -> None:
    while port.room(now=0.0):
        port.transmit(FRAME, None, now=0.0)
    assert port.room(now=0.2) == 0
    assert port.room(now=0.3) > 2
    port.transmit(FRAME, None, now=0.3)
    driver(port).shown.append(echo(FRAME))
    assert port.receive() is None
    assert port.room(now=0.4) == 2


def test_a_radio_without_an_address_needs_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(members, "PacketSocket", FakeSocket)
    with pytest.raises(OSError, match="give its member a mac"):
        MonitorPort("mon0", (), b"")
