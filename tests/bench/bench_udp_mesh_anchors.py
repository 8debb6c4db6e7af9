"""udp_mesh beside what teams use today, in the same lab and the same minutes: plain TCP, and Zenoh over TCP.

Run: python tests/bench/bench_udp_mesh_anchors.py. Two nodes; the same program publishes and subscribes over each
transport. Saturated: 10 Mbit/s, 20 ms one way, a queue of 50 packets, telemetry (200 B, 10 Hz, the most urgent) beside
bulk (50 kB, as fast as it is taken, the least urgent). Outage: 15 s of silence on 20 Mbit/s and 10 ms; how long until
telemetry (20 Hz) that was published after its end arrives. In virtual time where the box's kernel is built, else in
real time. TCP gives each topic a connection of its own; Zenoh has its priorities and express messages, and is left out
where the package eclipse-zenoh is missing. Here is nothing to pass or fail: the goals are judged by the other benches.
"""

from __future__ import annotations

import importlib.util
import json
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any, Protocol

from netlab.lab.facade import Lab
from udp_mesh.client import Client, Refused

PORT = 7447
BULK, TELEMETRY = "bulk", "telemetry"
SIZES = {BULK: 50_000, TELEMETRY: 200}
SATURATED_S, OUTAGE_S, SETTLE_S, AFTER_S = 20.0, 15.0, 3.0, 20.0
HEAD = struct.Struct("!Q")  # when it was published, nanoseconds
FRAME = struct.Struct("!I")

Receive = Callable[[str, bytes], None]
Send = Callable[[bytes], None]


class Transport(Protocol):
    """``sink`` hands over what arrives until the process is ended; ``sender`` gives what sends on a topic."""

    def sink(self, receive: Receive) -> None: ...
    def sender(self, topic: str, stack: ExitStack) -> Send: ...


class Tcp:
    """A connection per topic, small messages not delayed."""

    def sink(self, receive: Receive) -> None:
        with socket.create_server(("", PORT)) as server:
            print("listening", flush=True)
            while True:
                connection, _address = server.accept()
                threading.Thread(target=self._read, args=(connection, receive), daemon=True).start()

    @staticmethod
    def _read(connection: socket.socket, receive: Receive) -> None:
        with connection, connection.makefile("rb") as stream:
            topic = stream.readline().decode().strip()
            while len(head := stream.read(FRAME.size)) == FRAME.size:
                receive(topic, stream.read(FRAME.unpack(head)[0]))

    def sender(self, topic: str, stack: ExitStack) -> Send:
        connection = stack.enter_context(socket.create_connection(("base", PORT)))
        connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        connection.sendall(f"{topic}\n".encode())
        return lambda payload: connection.sendall(FRAME.pack(len(payload)) + payload)


class Zenoh:
    """One session, its priorities; bulk waits for room, telemetry is sent at once."""

    def __init__(self) -> None:
        import zenoh  # only where it is installed

        self._zenoh: Any = zenoh
        self._session: Any = None

    def _open(self, key: str, endpoint: str) -> Any:
        config = self._zenoh.Config()
        config.insert_json5(key, json.dumps([endpoint]))
        config.insert_json5("scouting/multicast/enabled", "false")
        return self._zenoh.open(config)

    def sink(self, receive: Receive) -> None:
        session = self._open("listen/endpoints", f"tcp/0.0.0.0:{PORT}")
        for topic in (BULK, TELEMETRY):
            session.declare_subscriber(topic, lambda sample: receive(str(sample.key_expr), bytes(sample.payload)))
        print("listening", flush=True)
        threading.Event().wait()

    def sender(self, topic: str, stack: ExitStack) -> Send:
        zenoh = self._zenoh
        self._session = self._session or stack.enter_context(self._open("connect/endpoints", f"tcp/base:{PORT}"))
        is_bulk = topic == BULK
        publisher = self._session.declare_publisher(
            topic,
            congestion_control=zenoh.CongestionControl.BLOCK if is_bulk else zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.BACKGROUND if is_bulk else zenoh.Priority.REAL_TIME,
            express=not is_bulk,
        )
        put: Send = publisher.put
        return put


class UdpMesh:
    """A client per topic."""

    def sink(self, receive: Receive) -> None:
        with Client() as client:
            client.subscribe(BULK)
            client.subscribe(TELEMETRY)
            print("listening", flush=True)
            for message in client:
                receive(message.topic, message.payload)

    def sender(self, topic: str, stack: ExitStack) -> Send:
        client = stack.enter_context(Client())
        client.wait_for_peer("base", 10.0)
        if topic == BULK:
            return lambda payload: self._publish(client.publish_wait, topic, payload, 9)
        return lambda payload: self._publish(client.publish, topic, payload, 1)

    @staticmethod
    def _publish(publish: Callable[..., object], topic: str, payload: bytes, priority: int) -> None:
        with suppress(Refused):  # the other node is offline: this message is not kept
            publish(topic, payload, to="base", priority=priority)


TRANSPORTS: dict[str, Callable[[], Transport]] = {"udp_mesh": UdpMesh, "tcp": Tcp, "zenoh": Zenoh}


def sink(transport: Transport) -> None:
    """Print a line for each message: topic, when it was published and received (nanoseconds), size."""

    def receive(topic: str, payload: bytes) -> None:
        print(topic, HEAD.unpack_from(payload)[0], time.time_ns(), len(payload), flush=True)

    transport.sink(receive)


def source(transport: Transport, interval_s: float, *, with_bulk: bool) -> None:
    """Publish telemetry, and bulk in a thread of its own, until the process is ended."""
    with ExitStack() as stack:
        if with_bulk:
            send_bulk = transport.sender(BULK, stack)
            threading.Thread(target=_endless, args=(send_bulk,), daemon=True).start()
        send = transport.sender(TELEMETRY, stack)
        due_s = time.monotonic()
        while True:
            send(_payload(TELEMETRY))
            due_s += interval_s
            time.sleep(max(0.0, due_s - time.monotonic()))


def _endless(send: Send) -> None:
    while True:
        send(_payload(BULK))


def _payload(topic: str) -> bytes:
    return HEAD.pack(time.time_ns()) + bytes(SIZES[topic] - HEAD.size)


# -- the lab


@contextmanager
def running(name: str, link: dict[str, Any], interval_s: float, *, with_bulk: bool) -> Iterator[Lab]:
    """Yield a lab in which the source publishes over a transport."""
    here = [sys.executable, str(Path(__file__).resolve())]
    daemon = ["udp_mesh"] if name == "udp_mesh" else []
    scenario = {
        "name": f"anchor-{name}",
        "duration": "1s",
        "engine": "air",
        "nodes": {
            "base": {"processes": [*daemon, {"argv": [*here, "sink", name], "name": "sink"}]},
            "robot1": {"processes": daemon},
        },
        "links": [{"between": ["base", "robot1"], **link}],
    }
    with Lab(scenario, packets=False) as lab:
        limit_s = time.monotonic() + 30.0
        while "listening" not in lab.log("base", "sink"):
            if time.monotonic() > limit_s:
                raise SystemExit(f"{name}: the sink did not start: {lab.log('base', 'sink')}")
            time.sleep(0.1)
        publisher = lab.spawn("robot1", *here, "source", name, str(interval_s), str(int(with_bulk)))
        yield lab
        publisher.close()


def arrivals(lab: Lab, topic: str) -> list[tuple[int, int, int]]:
    """Return (published, received, bytes) of a topic's messages; the last line may be incomplete."""
    lines = [line.split() for line in lab.log("base", "sink").split("\n")[:-1]]
    return [(int(row[1]), int(row[2]), int(row[3])) for row in lines if len(row) == 4 and row[0] == topic]


def saturated(name: str) -> str:
    """Return the row of a saturated link: latency of telemetry, and what bulk got."""
    with running(name, {"rate": "10mbit", "delay": "20ms", "limit": 50}, 0.1, with_bulk=True) as lab:
        time.sleep(SETTLE_S)
        begin_ns = time.time_ns()
        time.sleep(SATURATED_S)
        end_ns = time.time_ns()
        time.sleep(SETTLE_S)  # what was published by then may be late
        sent = [row for row in arrivals(lab, TELEMETRY) if begin_ns <= row[0] < end_ns]
        size_bytes = sum(size for _at, at, size in arrivals(lab, BULK) if begin_ns <= at < end_ns)
    latencies = sorted((received - published) / 1e6 for published, received, _size in sent)
    if not latencies:
        return "no telemetry came"
    p50, p99 = latencies[len(latencies) // 2], latencies[int(0.99 * len(latencies))]
    count = f"{len(latencies)} of {SATURATED_S / 0.1:.0f}"
    return (
        f"telemetry p50 {p50:7.1f} ms, p99 {p99:7.1f} ms ({count}); bulk {8e-6 * size_bytes / SATURATED_S:5.2f} Mbit/s"
    )


def outage(name: str) -> str:
    """Return the row of an outage: when the first message arrived that was published after it."""
    with running(name, {"rate": "20mbit", "delay": "10ms"}, 0.05, with_bulk=False) as lab:
        time.sleep(SETTLE_S)
        lab.outage("base", "robot1", active=True)
        time.sleep(OUTAGE_S)
        lab.outage("base", "robot1", active=False)
        restored_ns = time.time_ns()
        time.sleep(AFTER_S)
        fresh = [received for published, received, _size in arrivals(lab, TELEMETRY) if published >= restored_ns]
    first = f"{(min(fresh) - restored_ns) / 1e6:7.0f} ms" if fresh else f"not within {AFTER_S:g} s"
    return f"fresh telemetry {first} after an outage of {OUTAGE_S:g} s"


def main() -> None:
    """Print two lines for each transport."""
    print(f"TCP's congestion control here: {Path('/proc/sys/net/ipv4/tcp_congestion_control').read_text().strip()}")
    for name in TRANSPORTS:
        if name == "zenoh" and importlib.util.find_spec("zenoh") is None:
            print("zenoh     left out: the package eclipse-zenoh is not installed")
            continue
        print(f"{name:9} {saturated(name)}", flush=True)
        print(f"{name:9} {outage(name)}", flush=True)


def in_box() -> int:
    """Run this program in virtual time; if that is not to be had, here."""
    vm = [sys.executable, "-m", "netlab", "vm", "--clock", "virtual", "--"]
    if subprocess.run([*vm, "true"], capture_output=True, check=False).returncode:
        print("real time")
        main()
        return 0
    print("virtual time", flush=True)
    return subprocess.run([*vm, sys.executable, __file__, "here"], check=False).returncode


if __name__ == "__main__":
    if sys.argv[1:2] == ["sink"]:
        sink(TRANSPORTS[sys.argv[2]]())
    elif sys.argv[1:2] == ["source"]:
        source(TRANSPORTS[sys.argv[2]](), float(sys.argv[3]), with_bulk=sys.argv[4] == "1")
    elif sys.argv[1:2] == ["here"]:
        main()
    else:
        sys.exit(in_box())
