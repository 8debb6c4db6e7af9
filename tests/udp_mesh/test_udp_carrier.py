"""The UDP socket on the loopback: bursts leave and arrive whole, with the kernel's help or without it."""

from __future__ import annotations

import select
import socket
from collections import Counter
from collections.abc import Iterator

import pytest

from udp_mesh.config_carriers import CarrierKind
from udp_mesh.core.mesh import Datagram, Path
from udp_mesh.io.carrier import CarrierFacts
from udp_mesh.io.udp import UdpCarrier

WINDOW_BYTES = 1_000_000


@pytest.fixture
def counters() -> Counter[str]:
    return Counter()


@pytest.fixture
def carrier(counters: Counter[str]) -> Iterator[UdpCarrier]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    loopback = CarrierFacts(1, CarrierKind.UDP, "lo", socket.if_nametoindex("lo"), "127.0.0.1", "127.255.255.255")
    carrier = UdpCarrier(loopback, port, counters)
    yield carrier
    carrier.close()


def to_itself(carrier: UdpCarrier, data: bytes, segment_bytes: int = 0) -> Datagram:
    return Datagram(Path(carrier.facts.index, "127.0.0.1"), data, segment_bytes)


def received(carrier: UdpCarrier, count: int) -> list[bytes]:
    """Return what arrives, datagram by datagram."""
    datagrams: list[bytes] = []
    while len(datagrams) < count and select.select([carrier], [], [], 2.0)[0]:
        for data, size, path, _now in carrier.receive():
            assert path == Path(carrier.facts.index, "127.0.0.1")
            datagrams += [bytes(data[at : at + size]) for at in range(0, len(data), size)]
    return datagrams


def numbered(count: int, size: int) -> list[bytes]:
    return [bytes([number]) * size for number in range(count)]


@pytest.mark.parametrize("has_segmentation", [True, False])
def test_a_burst_and_what_follows_arrive_in_order(
    carrier: UdpCarrier, counters: Counter[str], has_segmentation: bool
) -> None:
    carrier._has_segmentation = has_segmentation  # False is what a device without the offload comes to
    pieces = numbered(44, 1400)
    waiting = [
        to_itself(carrier, b"first" * 3),
        to_itself(carrier, b"".join(pieces), 1400),
        to_itself(carrier, b"short"),
        to_itself(carrier, b"longer than short"),
        to_itself(carrier, b"".join(pieces[:2]), 1400),
    ]
    carrier.send(waiting, window_bytes=WINDOW_BYTES)
    assert carrier.backlog == []
    assert received(carrier, 49) == [b"first" * 3, *pieces, b"short", b"longer than short", *pieces[:2]]
    assert ("without_send_offload" in counters) is not has_segmentation


def test_consecutive_datagrams_of_one_length_share_a_call(carrier: UdpCarrier, monkeypatch: pytest.MonkeyPatch) -> None:
    bursts: list[int] = []
    send_burst = carrier._send_burst

    def counted(burst: list[Datagram]) -> None:
        bursts.append(len(burst))
        send_burst(burst)

    monkeypatch.setattr(carrier, "_send_burst", counted)
    singles = [to_itself(carrier, data) for data in [*numbered(3, 700), b"last", b"one"]]
    carrier.send(singles, window_bytes=WINDOW_BYTES)
    assert bursts == [4, 1]  # a shorter one ends a burst
    assert received(carrier, 5) == [datagram.data for datagram in singles]


def test_a_full_socket_keeps_the_rest_in_order(carrier: UdpCarrier, monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[bytes] = []

    def full_after_two(burst: list[Datagram]) -> None:
        if len(sent) == 2:
            raise BlockingIOError
        sent.extend(datagram.data for datagram in burst)

    monkeypatch.setattr(carrier, "_send_burst", full_after_two)
    datagrams = [to_itself(carrier, bytes([n]) * (n + 1)) for n in range(4)]
    carrier.send(datagrams, window_bytes=0)
    assert sent == [datagram.data for datagram in datagrams[:2]]
    assert carrier.backlog == datagrams[2:]


def test_a_window_larger_than_the_socket_enlarges_it(carrier: UdpCarrier) -> None:
    before = carrier.socket.getsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF)
    assert not carrier._grow(10_000)
    assert carrier._grow(100_000)
    assert carrier.socket.getsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF) > before
    assert not carrier._grow(100_000)


def test_the_ip_header_tells_the_priority_and_a_burst_has_one(carrier: UdpCarrier) -> None:
    carrier.marks = True
    carrier.socket.setsockopt(socket.IPPROTO_IP, socket.IP_RECVTOS, 1)
    priorities = [0, 1, 2, 3, 4, 6, 7, 255, 0]
    carrier.send(
        [to_itself(carrier, bytes([p]) * 50)._replace(priority=p) for p in priorities], window_bytes=WINDOW_BYTES
    )
    marks = []
    while len(marks) < len(priorities) and select.select([carrier], [], [], 2.0)[0]:
        data, ancillary, _flags, _address = carrier.socket.recvmsg(1000, 256)
        (tos,) = [value[0] for _level, kind, value in ancillary if kind == socket.IP_TOS]
        marks += [(data[at], tos >> 2) for at in range(0, len(data), 50)]
    assert marks == [(0, 46), (1, 46), (2, 34), (3, 34), (4, 0), (6, 0), (7, 8), (255, 8), (0, 46)]
