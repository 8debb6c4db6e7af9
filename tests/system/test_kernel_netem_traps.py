"""What netem does otherwise than one would think, and how the engine deals with it; on a kernel that has it."""

from __future__ import annotations

import contextlib
import socket
import statistics
import threading
from pathlib import Path

import pytest

from netlab.kernel.netlink import NetlinkSocket
from netlab.medium.impairments import PERFECT, Distribution, Impairment, RandomLoss
from netlab.medium.segments import SegmentKind
from tests.system.kernel_rig import BROADCAST, SO_RCVBUFFORCE, in_lab, plan, running, tc_features, visiting, who_gets

pytestmark = pytest.mark.usefixtures("netem_kernel")

IN_TIME_S = 0.001  # in virtual time delays are exact; a real, busy machine needs the tests of virtual time


@in_lab
def test_every_pair_may_duplicate_though_some_kernels_allow_one_netem_per_interface_only() -> None:
    with running(plan(SegmentKind.RADIO, 3, Impairment(duplicate_ratio=1.0))) as (engine, nodes):
        assert who_gets(nodes, 0, BROADCAST) == [1, 1, 2, 2]
        engine.set_pairs({(0, 1): PERFECT})
        assert who_gets(nodes, 0, BROADCAST) == [1, 2, 2]


def test_the_probe_tells_what_this_kernel_refuses() -> None:
    """In the box: no seed (Linux 6.1), no duplication beside another netem (refused since 2025, also in old series)."""
    found = tc_features()
    assert found.netem_duplicates
    if Path("/proc/sys/kernel/osrelease").read_text().startswith("6.1."):
        assert not found.netem_seed


@in_lab
def test_a_link_that_changes_often_loses_what_was_set() -> None:
    """A seed that is repeated at each change would restart the same numbers, and lose the same few frames again."""
    frames, every, arrived = 3000, 5, 0
    with running(plan(SegmentKind.WIRE, 2, Impairment(loss=RandomLoss(0.3)))) as (engine, nodes):
        for tick in range(frames // every):
            engine.set_pairs({(0, 1): Impairment(loss=RandomLoss(0.3), delay_s=1e-4 * (tick % 7))})
            nodes[0].burst(BROADCAST, every)
            arrived += len(nodes[1].received(0.002))
    assert 800 <= frames - arrived <= 1000  # binomial, beyond its 99.99 % interval (3.9 standard deviations of 25)


@in_lab
def test_a_tick_that_changes_nothing_is_not_told_to_the_kernel(monkeypatch: pytest.MonkeyPatch) -> None:
    moving = Impairment(loss=RandomLoss(0.3), delay_s=0.01)
    with running(plan(SegmentKind.WIRE, 2, moving)) as (engine, _):
        sent: list[int] = []
        with monkeypatch.context() as patched:
            patched.setattr(NetlinkSocket, "_send", lambda self, batch, sequence: sent.append(len(batch)))
            for _ in range(10):
                engine.set_pairs({(0, 1): moving, (1, 0): moving})
        assert sent == []


@in_lab
def test_the_shape_of_the_delay_can_be_taken_away_again() -> None:
    """netem keeps the table of a former distribution when a change names none."""

    def delays() -> list[float]:
        nodes[0].burst(BROADCAST, 600, every_s=0.001)
        return [delay_s for _, delay_s, _ in nodes[1].arrivals()]

    def beyond(found: list[float]) -> float:
        return sum(abs(delay_s - 0.05) > 0.005 + IN_TIME_S for delay_s in found) / len(found)

    jittery = Impairment(delay_s=0.05, jitter_s=0.005)
    normal = Impairment(delay_s=0.05, jitter_s=0.005, distribution=Distribution.NORMAL)
    with running(plan(SegmentKind.WIRE, 2, normal)) as (engine, nodes):
        shaped = delays()
        assert beyond(shaped) > 0.15  # 0.23 of a normal distribution lie beyond 1.2 sigma
        assert statistics.stdev(shaped) == pytest.approx(0.005, rel=0.15)
        engine.set_pairs({(0, 1): jittery})
        uniform = delays()
        assert beyond(uniform) == 0
        assert statistics.stdev(uniform) == pytest.approx(0.005 / 3**0.5, rel=0.15)
        engine.set_pairs({(0, 1): PERFECT})
        engine.set_pairs({(0, 1): jittery})
        assert beyond(delays()) == 0  # nor does it come back


@in_lab
def test_a_limit_below_rate_times_delay_throttles_and_is_warned_of(caplog: pytest.LogCaptureFixture) -> None:
    """4 Mbit/s with 100 ms hold 50 frames of 1000 bytes: with room for 25 half of them go through."""
    fast = Impairment(rate_bps=4e6, delay_s=0.1, limit_packets=200)
    narrow = Impairment(rate_bps=4e6, delay_s=0.1, limit_packets=20)
    for impairment, share in ((fast, 1.0), (narrow, 20 / 52)):
        with running(plan(SegmentKind.WIRE, 2)) as (engine, nodes):
            engine.set_pairs({(0, 1): impairment})
            nodes[0].burst(BROADCAST, 1000, size_bytes=986, every_s=0.002)
            found = nodes[1].arrivals(0.5)
            arrived = [arrived_s for _, _, arrived_s in found]
            rate_bps = 8000 * (len(found) - 1) / (arrived[-1] - arrived[0])
            assert rate_bps == pytest.approx(4e6 * share, rel=0.05)
    assert "n0 radio0 -> n1 radio0: limit 20 packets is less than rate x delay" in caplog.text


@in_lab
def test_tcp_crosses_in_frames_of_the_interface_not_in_segments_of_64_kb() -> None:
    """netem counts a super-frame as one packet, and it takes the air of one: so nobody may hand one over."""
    payload = bytes(range(256)) * 2000
    with running(plan(SegmentKind.RADIO, 3, Impairment(rate_bps=20e6))) as (engine, _):
        with visiting(engine.namespace_fds["n1"]):
            server = socket.create_server(("10.0.0.2", 5000))
            sniffer = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(0x0800))
        sniffer.setsockopt(socket.SOL_SOCKET, SO_RCVBUFFORCE, 1 << 24)
        with visiting(engine.namespace_fds["n0"]):
            client = socket.create_connection(("10.0.0.2", 5000))
        connection = server.accept()[0]
        sending = threading.Thread(target=client.sendall, args=(payload,))
        sending.start()
        received = bytearray()
        while len(received) < len(payload):
            received += connection.recv(1 << 16)
        sending.join()
        sniffer.setblocking(False)
        sizes = []
        with contextlib.suppress(BlockingIOError):
            while True:
                sizes.append(len(sniffer.recv(1 << 17)))
        for sock in (server, client, connection, sniffer):
            sock.close()
    assert received == payload  # and so every checksum was right
    assert max(sizes) == 1514
    assert len(sizes) > len(payload) / 1514
