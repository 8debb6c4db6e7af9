"""Programs for nodes of a wnet mesh that know nothing of it, and one that forges its frames."""

from __future__ import annotations

import random
import socket
import sys
import time
import urllib.error
import urllib.request

PORT = 5400


def fetch(url: str) -> int:
    """Print what is at ``url``; its server may yet have to start."""
    for _ in range(100):
        try:
            with urllib.request.urlopen(url, timeout=20) as answer:
                sys.stdout.write(answer.read().decode())
            return 0
        except urllib.error.URLError:
            time.sleep(0.1)
    return 1


def listen(group: str, own: str, count: str) -> int:
    """End well when exactly ``count`` different datagrams have come within ten seconds."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind(("", PORT))
        sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(group) + socket.inet_aton(own))
        sock.settimeout(10.0)
        seen = [sock.recv(100) for _ in range(int(count))]
    return 0 if len(set(seen)) == len(seen) else 1


def send(group: str, own: str, count: str) -> int:
    time.sleep(2.0)  # until the listener's membership is known
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(own))
        sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 8)
        for number in range(int(count)):
            sock.sendto(b"%d" % number, (group, PORT))
            time.sleep(0.05)
    return 0


def forge(ifname: str, rate_hz: str) -> int:
    """Send HELLOs of invented nodes, unsealed and sealed with nonsense, until ended."""
    rng = random.Random(1)
    with socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0) as sock:
        sock.bind((ifname, 0))
        while True:
            source = b"\x02" + rng.randbytes(5)
            kind = rng.choice((b"\x11", b"\x1a"))
            sock.send(b"\xff" * 6 + source + b"\x88\xb6" + kind + rng.randbytes(rng.randint(10, 200)))
            time.sleep(1 / float(rate_hz))


if __name__ == "__main__":
    programs = {"fetch": fetch, "listen": listen, "send": send, "forge": forge}
    sys.exit(programs[sys.argv[1]](*sys.argv[2:]))
