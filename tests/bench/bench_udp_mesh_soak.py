"""A day's messages through two real daemons as fast as they go, with outages: what becomes of their memory.

Run: python tests/bench/bench_udp_mesh_soak.py [messages] [outages]. By default 950,400 messages, which is 24 h of 10 Hz
telemetry (200 B) and 1 Hz video (14 kB), and 100 silent outages of 1.2 s, each long enough for both to hold the other
offline. All messages are reliable; what is refused while the peer is offline is published again at its return. The
queue holds 1 MB, so that every outage fills it: then how much was queued at most, which the memory shows
for ever, does not hang on how busy the machine was in which outage. Real time, about 10 minutes. Goal: each daemon's
resident memory after the first tenth and at the end within 5 %, and every message delivered once; else it ends with
exit code 1.
"""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
from udp_mesh_rig import Host, cpu_s, cut, hosts, resident_bytes

from udp_mesh.client import Client, Refused

DAY_MESSAGES = 24 * 3600 * 11
TELEMETRY_PER_VIDEO = 10
TELEMETRY, VIDEO = b"\1" * 192, b"\2" * 14_000
NUMBER_BYTES = 8
OUTAGE_S = 1.2
CONFIG = "queue_bytes = 1000000\n"
GOAL_RATIO = 0.05
PATIENCE_S = 60.0


def publish(socket_path: str, to: str, messages: int, steps: int) -> None:
    """Publish numbered messages; print a line after every ``messages / steps`` of them."""
    step = messages // steps
    with Client(socket_path) as client:
        assert client.wait_for_peer(to, PATIENCE_S)
        for number in range(messages):
            is_video = number % (TELEMETRY_PER_VIDEO + 1) == TELEMETRY_PER_VIDEO
            topic, filling, priority = ("video", VIDEO, 9) if is_video else ("telemetry", TELEMETRY, 1)
            payload = number.to_bytes(NUMBER_BYTES, "big") + filling
            while True:
                try:
                    client.publish_wait(topic, payload, to=to, priority=priority, timeout_s=PATIENCE_S)
                    break
                except Refused as refused:
                    if refused.reason != "peer_offline":
                        raise
                    client.wait_for_peer(to, PATIENCE_S)
            if (number + 1) % step == 0:
                print(number + 1, flush=True)


def subscribe(socket_path: str, messages: int) -> None:
    """Print ``ready``; at the end how many messages never came, how many came again, how many were missed here."""
    seen, again = bytearray(messages), 0
    with Client(socket_path) as client:
        client.subscribe("telemetry")
        client.subscribe("video")
        client.stats()
        print("ready", flush=True)
        left = messages
        while left > 0 and (message := client.receive(timeout_s=PATIENCE_S)) is not None:
            number = int.from_bytes(message.payload[:NUMBER_BYTES], "big")
            again += seen[number]
            left -= not seen[number]
            seen[number] = 1
        print(left, again, client.missed, flush=True)


def application(role: str, *arguments: object) -> subprocess.Popen[str]:
    """Start :func:`publish` or :func:`subscribe` as a process."""
    words = [sys.executable, __file__, role, *map(str, arguments)]
    return subprocess.Popen(words, stdout=subprocess.PIPE, text=True)


def outage(made: list[Host]) -> None:
    """Let the second host be silent for a while."""
    cut(made, 2, active=True)
    time.sleep(OUTAGE_S)
    cut(made, 2, active=False)


def soak(made: list[Host], messages: int, outages: int) -> bool:
    """Print memory at every twentieth of the messages, and the verdict."""
    a, b = made[:2]
    steps = max(20, 2 * outages)
    receiver = application("subscribe", b.socket_path, messages)
    assert receiver.stdout is not None
    assert receiver.stdout.readline() == "ready\n"
    began_s = time.monotonic()
    sender = application("publish", a.socket_path, b.name, messages, steps)
    assert sender.stdout is not None
    rows: list[tuple[int, int]] = []
    for index, line in enumerate(sender.stdout, start=1):
        rows.append((resident_bytes(a.pid), resident_bytes(b.pid)))
        if index % (steps // 20) == 0:
            at_s, (out, into) = time.monotonic() - began_s, rows[-1]
            print(f"{int(line):>9} messages, {at_s:6.1f} s: {out / 1e6:7.2f} {into / 1e6:7.2f} MB", flush=True)
        if index % 2 and index // 2 < outages:
            outage(made)
    missing, again, missed = map(int, receiver.stdout.readline().split())
    assert (sender.wait(), receiver.wait()) == (0, 0)
    first, last = rows[steps // 10 - 1], rows[-1]
    growth = [after / before - 1 for before, after in zip(first, last, strict=True)]
    is_met = all(abs(ratio) <= GOAL_RATIO for ratio in growth) and (missing, again, missed) == (0, 0, 0)
    print(f"{missing} missing, {again} twice, {missed} read too slowly; CPU {cpu_s(a.pid):.0f} s, {cpu_s(b.pid):.0f} s")
    print(
        f"memory, the end against the first tenth: sender {growth[0]:+.1%}, receiver {growth[1]:+.1%}"
        f" (goal: within {GOAL_RATIO:.0%}): {'met' if is_met else 'NOT met'}"
    )
    return is_met


def main(messages: int = DAY_MESSAGES, outages: int = 100) -> int:
    """Run it between two of three hosts on a bridge, which is where they can be parted silently."""
    print(f"{messages} messages, {outages} outages; resident memory of the sending and the receiving daemon")
    with hosts(3, CONFIG) as made:
        for host in made[:2]:
            host.start()
        return 0 if soak(made, messages, outages) else 1


if __name__ == "__main__":
    if sys.argv[1:2] == ["publish"]:
        publish(sys.argv[2], sys.argv[3], int(sys.argv[4]), int(sys.argv[5]))
    elif sys.argv[1:2] == ["subscribe"]:
        subscribe(sys.argv[2], int(sys.argv[3]))
    else:
        sys.exit(main(*map(int, sys.argv[1:])))
