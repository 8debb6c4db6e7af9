"""What the capture's system tests and benchmark run inside namespaces of its own (see `enter` in capture_rig.py).

Each program gets a folder, does its work and prints one JSON object, which the caller judges.
"""

from __future__ import annotations

import json
import os
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

from capture_rig import ADDRESSES, Nodes, Recording, build, record, run, wait_for_carrier

from udp_mesh.client import Client

#: Broadcast frames of an experimental EtherType, one with the tag of VLAN 7.
UNTAGGED = bytes.fromhex("ffffffffffff02000000000188b5") + b"payload".ljust(46, b".")
TAGGED = UNTAGGED[:12] + bytes.fromhex("81000007") + UNTAGGED[12:]
SENTINEL = b"the last datagram"


def beside_tcpdump(folder: str) -> dict[str, object]:
    """Send datagrams of all sizes both ways and through lo while the recorder and tcpdump look on in node a."""
    nodes = build()
    options = "-i eth0 -Z root -U --immediate-mode -s 2048 -B 16384 -w"
    tcpdump = nodes.start("a", ["tcpdump", *options.split(), f"{folder}/a.pcap"])
    assert tcpdump.stderr is not None
    while "listening on" not in (line := tcpdump.stderr.readline()):
        if not line:
            return {"tcpdump": tcpdump.wait()}
    recording = record(nodes, f"{folder}/run.mcap")
    a, b = nodes.udp("a", 5000), nodes.udp("b", 5000)
    local = nodes.udp("a", 5001)
    received = 0
    for number in range(600):
        a.sendto(os.urandom(1 + number * 7 % 1400), (ADDRESSES["b"], 5000))
        b.sendto(os.urandom(1 + number * 13 % 1400), (ADDRESSES["a"], 5000))
        a.sendto(b"over lo", (ADDRESSES["a"], 5001))
        received += len(a.recv(2000)) > 0
        b.recv(2000)
        local.recv(2000)
    a.sendto(os.urandom(6000), (ADDRESSES["b"], 5000))  # leaves as IP fragments
    b.recv(9000)
    a.close()
    b.sendto(b"nobody", (ADDRESSES["a"], 5000))  # answered by an ICMP error
    b.sendto(SENTINEL, (ADDRESSES["a"], 5000))  # and so is this
    stats, _ = recording.close()
    _wait_for(f"{folder}/a.pcap", SENTINEL, times=2)
    tcpdump.terminate()
    tcpdump.wait()
    return {"tcpdump": 0, "packets": stats.packets, "drops": stats.kernel_drops, "received": received}


def _wait_for(path: str, what: bytes, *, times: int) -> None:
    """tcpdump ends at once when told to, whatever it still has to read: wait until it wrote the last packet."""
    deadline = time.monotonic() + 20
    while Path(path).read_bytes().count(what) < times and time.monotonic() < deadline:
        time.sleep(0.02)


def new_interface(folder: str) -> dict[str, object]:
    """An interface that appears while the recorder runs, and a frame with a VLAN tag on the old one."""
    nodes = build()
    recording = record(nodes, f"{folder}/run.mcap")
    with nodes.inside("a"):
        run(f"ip link add late0 type veth peer name late0 netns /proc/{os.getpid()}/fd/{nodes.fds['b']}")
        run("ip link set late0 addrgenmode none up")
        old, late = (socket.socket(socket.AF_PACKET, socket.SOCK_RAW) for _ in range(2))
        old.bind(("eth0", 0))
    with nodes.inside("b"):
        run("ip link set late0 addrgenmode none up")
    wait_for_carrier(nodes, "late0")
    with nodes.inside("a"):
        late.bind(("late0", 0))
    old.send(TAGGED)
    late.send(UNTAGGED)
    stats, _ = recording.close()
    return {"packets": stats.packets}


def full_disk(folder: str) -> dict[str, object]:
    """Record onto a file system of 2 MB that fills up in the middle, and read back from outside."""
    run(f"mount -t tmpfs -o size=2m none {folder}")
    nodes = build()
    recording = record(nodes, f"{folder}/run.mcap")
    a, b = nodes.udp("a"), nodes.udp("b", 5000)
    sent = 0
    notices: list[str] = []
    deadline = time.monotonic() + 20
    while not notices and time.monotonic() < deadline:
        for _ in range(200):
            a.sendto(os.urandom(1400), (ADDRESSES["b"], 5000))
            b.recv(2000)
            sent += 1
        notices += recording.recorder.notices()
    a.sendto(b"the run goes on", (ADDRESSES["b"], 5000))
    alive = b.recv(2000) == b"the run goes on"
    stats, _ = recording.close()
    data = Path(f"{folder}/run.mcap").read_bytes()
    run(f"umount {folder}")
    Path(f"{folder}/copy.mcap").write_bytes(data)
    return {
        "sent": sent,
        "alive": alive,
        "notices": notices,
        "written": stats.messages,
        "lost": stats.messages_lost,
        "packets": stats.packets,
        "size": len(data),
    }


def throughput(folder: str, rate_pps: str, duration_s: str) -> dict[str, object]:
    """A paced sender of 1400-byte datagrams; the recorder sees each one twice, at a and at b."""
    nodes = build()
    recording = record(nodes, f"{folder}/run.mcap")
    a, b = nodes.udp("a"), nodes.udp("b", 5000)
    a.connect((ADDRESSES["b"], 5000))
    rate, count = int(rate_pps), round(int(rate_pps) * float(duration_s))
    payloads = [os.urandom(1400) for _ in range(4096)]  # enough variety that nothing compresses
    started, before = time.monotonic(), os.times()
    for number in range(count):
        a.send(payloads[number % 4096])
        if number % 10 == 0:
            left = started + number / rate - time.monotonic()
            if left > 0:
                time.sleep(left)
    elapsed_s, after = time.monotonic() - started, os.times()
    stats, cpu_s = recording.close()
    del b
    return {
        "sent": count,
        "elapsed_s": elapsed_s,
        "captured": stats.packets,
        "written": stats.messages,
        "kernel_drops": stats.kernel_drops,
        "recorder_cpu_s": cpu_s,
        "sender_cpu_s": after.user + after.system - before.user - before.system,
        "file_bytes": Path(f"{folder}/run.mcap").stat().st_size,
    }


def daemons(folder: str) -> dict[str, object]:
    """A udp_mesh daemon in each node; a publishes 20 messages of 200 kB and 40 of 200 B to b."""
    nodes = build()
    streams = [
        {"stream": number, "source": "a", "destination": "b", "topic": topic, "priority": priority}
        for number, (topic, priority) in enumerate((("telemetry", 1), ("map", 9)))
    ]
    recording = record(nodes, f"{folder}/run.mcap", {"streams": json.dumps(streams), "duration_s": "5"})
    processes = [_daemon(nodes, recording, node, folder) for node in ADDRESSES]
    published = _feed(recording, "/a/traffic/published", "a")
    received = _feed(recording, "/b/traffic/received", "b")
    with Client(f"{folder}/a.sock") as source, Client(f"{folder}/b.sock") as sink:
        for topic in ("telemetry", "map"):
            sink.subscribe(topic)
        assert source.wait_for_peer("b", timeout_s=15)
        for seq in range(40):
            sizes = [200, 200_000] if seq % 2 else [200]
            for stream, size_bytes in reversed(list(enumerate(sizes))):
                t_ns = time.time_ns()
                payload = struct.pack("<4sHIQ", b"NLT1", stream, seq, t_ns).ljust(size_bytes, b"x")
                topic, priority = str(streams[stream]["topic"]), int(str(streams[stream]["priority"]))
                source.publish(topic, payload, to="b", priority=priority)
                told = {"event": "published", "stream": stream, "seq": seq, "t_ns": t_ns, "size_bytes": size_bytes}
                os.write(published, json.dumps({**told, "accepted": True, "reason": None}).encode() + b"\n")
        count = 0
        while count < 60 and (message := sink.receive(timeout_s=10)) is not None:
            _, stream, seq, t_ns = struct.unpack_from("<4sHIQ", message.payload)
            told = {"event": "received", "stream": stream, "seq": seq, "published_ns": t_ns, "t_ns": time.time_ns()}
            os.write(received, json.dumps({**told, "size_bytes": len(message.payload)}).encode() + b"\n")
            count += 1
    for process in processes:
        process.terminate()
        process.wait()
    for fd in (published, received):
        os.close(fd)
    stats, _ = recording.close()
    return {"received": count, "lines_dropped": stats.feed_lines_dropped, "drops": stats.kernel_drops}


def _daemon(nodes: Nodes, recording: Recording, node: str, folder: str) -> subprocess.Popen[bytes]:
    Path(f"{folder}/{node}.toml").write_text(f'name = "{node}"\nsocket = "{folder}/{node}.sock"\n')
    events, ready = _feed(recording, f"/{node}/udp_mesh/events", node), os.pipe()
    code = "import sys; from udp_mesh.daemon import main; sys.exit(main(sys.argv[1:]))"
    options = ["--config", f"{folder}/{node}.toml", "--events-fd", str(events), "--ready-fd", str(ready[1])]
    with nodes.inside(node):
        process = subprocess.Popen([sys.executable, "-c", code, *options], pass_fds=[events, ready[1]])
    os.close(events)
    os.close(ready[1])
    assert os.read(ready[0], 100) == b"READY=1\n"
    os.close(ready[0])
    return process


def _feed(recording: Recording, topic: str, node: str) -> int:
    theirs, ours = socket.socketpair()
    recording.recorder.add_feed("events", topic, node, topic.split("/")[2], theirs.fileno())
    theirs.close()
    return ours.detach()


PROGRAMS: dict[str, Callable[..., dict[str, object]]] = {
    "beside_tcpdump": beside_tcpdump,
    "new_interface": new_interface,
    "full_disk": full_disk,
    "throughput": throughput,
    "daemons": daemons,
}

if __name__ == "__main__":
    print(json.dumps(PROGRAMS[sys.argv[1]](*sys.argv[2:])))
