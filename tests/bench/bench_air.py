"""The air engine measured beside a bare relay in the same run: capacity, delay error, loss, rate.

The bare relay is the least that Python can do: receive on one packet socket, send on another, no medium. Frames come
from a child process; what arrives is counted and stamped by the receiving node's kernel. Runs in namespaces of its own.
"""

from __future__ import annotations

import math
import os
import select
import socket
import struct
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from netlab.engines.air import AirEngine
from netlab.engines.base import LabPlan
from netlab.kernel.namespaces import returning
from netlab.kernel.syscalls import set_timerslack_ns
from netlab.kernel.wiring import VethSpec, Wiring, build, enter
from netlab.medium.impairments import PERFECT, Impairment, RandomLoss
from netlab.medium.segments import Port, Segment, SegmentKind

ETHERTYPE = 0x88B5
FRAME_BYTES = 200
ROUNDS = int(os.environ.get("BENCH_ROUNDS", "3"))
_SO_RCVBUFFORCE = 33
_SO_TIMESTAMPNS = 35
_TIMESPEC = struct.Struct("=qq")
_STAMP = struct.Struct("=q")

PORTS = tuple(Port(i, f"n{i}", "eth0", bytes([2, 0, 0, 0, 0, i]), None) for i in range(2))
HEADER = PORTS[1].mac + PORTS[0].mac + ETHERTYPE.to_bytes(2, "big")


def packet_socket(namespace_fd: int | None, ifname: str, protocol: int) -> socket.socket:
    """A packet socket on an interface, in a node or (None) where we are."""
    with returning():
        if namespace_fd is not None:
            enter(namespace_fd)
        sock = socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(protocol))
        sock.bind((ifname, protocol))
    return sock


def child(work: Callable[[], object]) -> int:
    """Run ``work`` in a forked process; return its pid."""
    pid = os.fork()
    if pid == 0:
        try:
            work()
        finally:
            os._exit(0)
    return pid


# -- the two ways to carry frames -------------------------------------------------------------------------------------


@contextmanager
def bare_relay() -> Iterator[dict[str, int]]:
    """Wiring and a relay from n0 to n1 without any medium."""
    wiring: Wiring = build(
        [port.node for port in PORTS],
        [VethSpec(port.node, port.ifname, port.mac, None, 1500, f"p{port.index}") for port in PORTS],
    )
    near, far = packet_socket(None, "p0", ETHERTYPE), packet_socket(None, "p1", 0)

    def relay() -> None:
        receive, send = near.recv, far.send
        while True:
            send(receive(2048))

    pid = child(relay)
    try:
        yield wiring.namespace_fds
    finally:
        os.kill(pid, 9)
        os.waitpid(pid, 0)
        near.close()
        far.close()
        wiring.close()


@contextmanager
def air(impairment: Impairment) -> Iterator[dict[str, int]]:
    """The air engine with ``impairment`` from n0 to n1."""
    segment = Segment("wire", SegmentKind.WIRE, (0, 1), {(0, 1): impairment, (1, 0): PERFECT})
    engine = AirEngine(LabPlan("bench", 1, ("n0", "n1"), PORTS, (segment,)))
    engine.bring_up()
    try:
        yield engine.namespace_fds
    finally:
        stats = engine.stats()
        engine.close()
        if stats.not_sent or stats.oversized:
            print(f"  (air: {stats.not_sent} not sent, {stats.oversized} oversized)")


# -- measuring --------------------------------------------------------------------------------------------------------


def arrived(namespace_fd: int) -> int:
    """Frames that n1's interface has received so far."""
    with returning():
        enter(namespace_fd)
        line = next(x for x in Path("/proc/thread-self/net/dev").read_text().splitlines() if "eth0:" in x)
    return int(line.split(":")[1].split()[1])


def capacity(fds: dict[str, int], seconds: float = 1.0) -> float:
    """Frames per second that come through while a sender floods."""
    sock = packet_socket(fds["n0"], "eth0", 0)
    sock.setsockopt(263, 20, 1)
    frame = HEADER.ljust(FRAME_BYTES, b".")

    def flood() -> None:
        while True:
            sock.send(frame)

    pid = child(flood)
    try:
        time.sleep(0.3)
        before, start = arrived(fds["n1"]), time.monotonic()
        time.sleep(seconds)
        return (arrived(fds["n1"]) - before) / (time.monotonic() - start)
    finally:
        os.kill(pid, 9)
        os.waitpid(pid, 0)
        sock.close()


def paced(
    fds: dict[str, int], count: int, per_s: float, size: int = FRAME_BYTES, linger_s: float = 0.3
) -> list[tuple[int, int]]:
    """Send ``count`` frames at ``per_s``; return (sent_ns, arrived_ns) of those that came through."""
    out, into = packet_socket(fds["n0"], "eth0", 0), packet_socket(fds["n1"], "eth0", ETHERTYPE)
    into.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE if os.geteuid() == 0 else socket.SO_RCVBUF, 256 << 20)
    into.setsockopt(socket.SOL_SOCKET, _SO_TIMESTAMPNS, 1)

    def send() -> None:
        set_timerslack_ns(1)
        start = time.monotonic()
        for number in range(count):
            if (wait := start + number / per_s - time.monotonic()) > 0:
                select.select([], [], [], wait)
            out.send((HEADER + _STAMP.pack(time.time_ns())).ljust(size, b"."))

    os.waitpid(child(send), 0)
    time.sleep(0.3)
    result = []
    while select.select([into], [], [], 0)[0]:
        frame, ancillary, _flags, _address = into.recvmsg(2048, 64)
        sec, nsec = _TIMESPEC.unpack(ancillary[0][2])
        result.append((_STAMP.unpack_from(frame, 14)[0], sec * 10**9 + nsec))
    out.close()
    into.close()
    return result


def errors_ms(times: list[tuple[int, int]], delay_s: float) -> list[float]:
    """Measured delay minus the set one, ascending."""
    return sorted((b - a) / 1e6 - delay_s * 1e3 for a, b in times)


def shape(values: list[float]) -> str:
    marks = {"p1": 0.01, "p50": 0.5, "p90": 0.9, "p99": 0.99}
    return "  ".join(f"{k} {values[int(q * len(values))]:7.3f}" for k, q in marks.items()) + f"  max {values[-1]:7.3f}"


def median(values: list[float]) -> float:
    return sorted(values)[len(values) // 2]


def say(goal: str, met: bool) -> None:
    print(f"  goal {goal}: {'met' if met else 'MISSED'}")


def bench_capacity() -> None:
    print(f"(a) capacity, frames of {FRAME_BYTES} bytes, median of {ROUNDS} rounds in turn")
    kinds: dict[str, list[float]] = {"bare relay": [], "air, perfect": [], "air, 5 ms and 1 % loss": []}
    impaired = Impairment(delay_s=0.005, loss=RandomLoss(0.01))
    for _ in range(ROUNDS):
        with bare_relay() as fds:
            kinds["bare relay"].append(capacity(fds))
        with air(PERFECT) as fds:
            kinds["air, perfect"].append(capacity(fds))
        with air(impaired) as fds:
            kinds["air, 5 ms and 1 % loss"].append(capacity(fds))
    for name, values in kinds.items():
        print(f"  {name:24} {median(values):9,.0f} frames/s   ({', '.join(f'{v:,.0f}' for v in values)})")
    bare, ours = median(kinds["bare relay"]), median(kinds["air, 5 ms and 1 % loss"])
    say(f">= 20,000 frames/s and >= 0.5 of the bare relay (is {ours / bare:.2f})", ours >= 20_000 and ours >= bare / 2)


def bench_delay() -> None:
    print("(b) delay error at 5,000 frames/s, ms (measured - set)")
    bare_p50, bare_p99, air_p50, air_p99 = [], [], [], []
    for _ in range(ROUNDS):
        with bare_relay() as fds:
            values = errors_ms(paced(fds, 10_000, 5000), 0.0)
        print(f"  bare relay, 0 ms  {shape(values)}")
        bare_p50.append(values[len(values) // 2])
        bare_p99.append(values[int(0.99 * len(values))])
        with air(Impairment(delay_s=0.005)) as fds:
            values = errors_ms(paced(fds, 10_000, 5000), 0.005)
        print(f"  air, 5 ms         {shape(values)}   ({len(values)} of 10000 arrived)")
        air_p50.append(values[len(values) // 2])
        air_p99.append(values[int(0.99 * len(values))])
    p50, p99 = median(air_p50) - median(bare_p50), median(air_p99) - median(bare_p99)
    say(
        f"median <= 0.2 ms (is {median(air_p50):.3f}; {p50:+.3f} against the relay)",
        median(air_p50) <= 0.2 or p50 <= 0.2,
    )
    say(f"p99 <= 1 ms above the relay (is {p99:+.3f})", p99 <= 1)


def bench_loss_and_rate() -> None:
    print("(c) loss and rate")
    count, ratio = 30_000, 0.05
    with air(Impairment(loss=RandomLoss(ratio), delay_s=0.001)) as fds:
        lost = count - len(paced(fds, count, 10_000))
    margin = 2.576 * math.sqrt(count * ratio * (1 - ratio))
    print(f"  loss: {lost} of {count} lost, 5 % asked for, 99 % interval {count * ratio:.0f} +- {margin:.0f}")
    say("inside the interval", abs(lost - count * ratio) <= margin)
    with air(Impairment(rate_bps=10e6, limit_packets=100)) as fds:
        times = sorted(b for _a, b in paced(fds, 3000, 1500, size=1250))
    rate = (len(times) - 1) * 1250 * 8 / ((times[-1] - times[0]) / 1e9)
    print(f"  rate: {rate / 1e6:.4f} Mbit/s of 10 set, 15 offered")
    say("within 1 %", abs(rate / 10e6 - 1) < 0.01)


PARTS = {"capacity": bench_capacity, "delay": bench_delay, "loss": bench_loss_and_rate}

if __name__ == "__main__":
    if os.environ.get("BENCH_AIR_INSIDE") is None:
        user = [] if os.geteuid() == 0 else ["--map-root-user"]
        os.environ["BENCH_AIR_INSIDE"] = "1"
        os.execvp("unshare", ["unshare", "--net", *user, "--", sys.executable, *sys.argv])
    for part in sys.argv[1:] or PARTS:
        PARTS[part]()
