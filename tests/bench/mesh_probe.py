"""Runs in a node: sends numbered datagrams at a constant rate, and tells of each that it gets when it was sent.

Below any transport, so that what a mesh does is seen and nothing else: no acknowledgement, no retry, no discovery.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import select
import socket
import struct
import sys
import time

PORT = 5300
_HEAD = struct.Struct("!IIQ")  # sender, sequence number, CLOCK_REALTIME in ns
_BUFFER_BYTES = 1 << 22


def main() -> int:
    options = _arguments()
    sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    sock.setblocking(False)
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _BUFFER_BYTES)
    sock.bind(("", PORT))
    if options.group:
        own = socket.inet_aton(options.address)
        sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, own)
        sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 8)
        sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_LOOP, 0)
        if not options.to:
            sock.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(options.group) + own)
    print(json.dumps(_run(sock, options)))
    return 0


def _run(sock: socket.socket, options: argparse.Namespace) -> dict[str, object]:
    received: list[tuple[int, int, int, int, int]] = []
    sent = refused = 0
    end_s = time.monotonic() + options.lasts
    next_s = time.monotonic() + options.after if options.to else end_s
    stop_s = min(end_s, next_s + options.sends)
    while (now := time.monotonic()) < end_s:
        if next_s <= now < stop_s:
            data = _HEAD.pack(options.number, sent, time.time_ns()).ljust(options.size, b"\0")
            for address in options.to:
                with contextlib.suppress(OSError):
                    sock.sendto(data, (address, PORT))
                    refused -= 1
                refused += 1
            sent += 1
            next_s += 1 / options.rate
        until_s = next_s if max(now, next_s) < stop_s else end_s
        if select.select([sock], [], [], max(0.0, until_s - time.monotonic()))[0]:
            with contextlib.suppress(OSError):
                while True:
                    data = sock.recv(2048)
                    received.append((*_HEAD.unpack_from(data), time.time_ns(), len(data)))
    return {"sent": sent, "refused": refused, "received": received}


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--number", type=int, default=0, help="of this sender")
    parser.add_argument("--to", type=lambda text: text.split(","), default=[])
    parser.add_argument("--rate", type=float, default=50.0, help="datagrams per second")
    parser.add_argument("--size", type=int, default=100, help="bytes of payload")
    parser.add_argument("--after", type=float, default=0.0, help="seconds before the first is sent")
    parser.add_argument("--sends", type=float, default=1e9, help="seconds for which it sends")
    parser.add_argument("--lasts", type=float, required=True, help="seconds until it ends")
    parser.add_argument("--group", default="", help="multicast group of the senders and receivers")
    parser.add_argument("--address", default="", help="own address, for a group")
    return parser.parse_args()


if __name__ == "__main__":
    sys.exit(main())
