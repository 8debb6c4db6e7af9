"""Marks by priority in the headers of IPv4 and IPv6, as a host on the wire sees them."""

from __future__ import annotations

import contextlib
import subprocess
import sys
from pathlib import Path

import pytest

from tests.system.udp_mesh_hosts import join, separate_hosts
from udp_mesh.client import Client

SNIFF = """
import json, socket, sys
sniffer = socket.socket(socket.AF_PACKET, socket.SOCK_DGRAM, socket.htons(3))
sniffer.bind(("mesh0", 3))
sniffer.settimeout(20)
print("ready", flush=True)
seen = {}
while len(seen) < 2:
    packet, about = sniffer.recvfrom(65536)
    if about[2] == 4:
        continue
    is_ipv6 = packet[0] >> 4 == 6
    mark = (packet[0] & 15) << 4 | packet[1] >> 4 if is_ipv6 else packet[1]
    for word in (b"urgent message", b"background message"):
        if word in packet:
            seen[word.decode()] = mark
print(json.dumps(seen))
"""


@pytest.mark.parametrize("kind", ["udp", "udp6"])
def test_priorities_are_marked(tmp_path: Path, kind: str) -> None:
    with contextlib.ExitStack() as stack:
        a, b = stack.enter_context(separate_hosts(tmp_path, "alpha", "beta"))
        join(a, b, "mesh0", network="10.9.0")
        for host in (a, b):
            host.start(f'dscp = true\n[[carriers]]\nkind = "{kind}"\n')
        words = [*b.enter, sys.executable, "-c", SNIFF]
        sniffer = stack.enter_context(subprocess.Popen(words, stdout=subprocess.PIPE, text=True))
        assert sniffer.stdout is not None
        assert sniffer.stdout.readline() == "ready\n"
        client = stack.enter_context(Client(a.socket))
        assert client.wait_for_peer("beta", 10.0)
        for priority, text in ((0, b"urgent message"), (9, b"background message")):
            client.publish_wait("t", text, to="beta", priority=priority)
        assert sniffer.stdout.readline() == '{"urgent message": 184, "background message": 32}\n'  # EF, CS1
