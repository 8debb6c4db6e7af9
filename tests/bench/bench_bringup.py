"""Time to bring up a line of nodes: netlab beside `ip -batch` and a bare netlink script that does the same.

Run as root or as an ordinary user who may create user namespaces: ``python tests/bench/bench_bringup.py [--rounds N]
[NODES ...]``. Each trial runs in a process with namespaces of its own, the three ways alternating, and is timed inside
from before the first namespace to the last interface up and addressed.

All three make the same: one namespace per node with loopback up; for each link end a veth whose far end is in the lab's
namespace, MAC, MTU, IPv4 address with broadcast address, both ends up. netlab and the bare script also switch the
transmit offloads of both ends off, keep the far ends free of IPv6 addresses and silence duplicate address detection;
`ip` cannot (ethtool is a program of its own), so its figure is flattered. netlab alone also waits until every near end
is active.
"""

from __future__ import annotations

import argparse
import ctypes
import fcntl
import gc
import os
import shutil
import socket
import statistics
import struct
import subprocess
import sys
import tempfile
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))  # also from a checkout that is not installed

from netlab.kernel import probe, syscalls
from netlab.kernel.wiring import VethSpec, build

End = tuple[int, str, bytes, str, str]  # node, interface, MAC, address, far end
MTU_BYTES = 1500


def line(count: int) -> list[End]:
    """Two ends for each link of a line of ``count`` nodes."""
    ends = []
    for link in range(count - 1):
        for side, node, ifname in ((1, link, "right"), (2, link + 1, "left")):
            mac = bytes([2, 0, 0, side]) + link.to_bytes(2, "big")
            ends.append((node, ifname, mac, f"10.{link >> 8}.{link & 255}.{side}", f"far{link}_{side}"))
    return ends


def netlab_way(count: int) -> float:
    """The product."""
    veths = [VethSpec(f"n{n}", ifname, mac, f"{ip}/24", MTU_BYTES, far) for n, ifname, mac, ip, far in line(count)]
    names = [f"n{n}" for n in range(count)]
    started = time.perf_counter()
    build(names, veths)
    return time.perf_counter() - started


def ip_way(count: int) -> float:
    """One ``ip -batch`` for all names and links, one per namespace for what is inside; named namespaces in a tmpfs."""
    syscalls.unshare(syscalls.CLONE_NEWNS)
    syscalls.mount("none", "/", None, syscalls.MS_REC | syscalls.MS_PRIVATE)
    syscalls.mount("tmpfs", "/run", "tmpfs")
    ip = shutil.which("ip", path="/usr/sbin:/sbin:/usr/bin:/bin")
    if ip is None:
        raise OSError("iproute2 is not installed")
    ends = line(count)
    outside = [f"netns add n{n}" for n in range(count)]
    inside: list[list[str]] = [["link set lo up"] for _ in range(count)]
    for node, ifname, mac, address, far in ends:
        near = f"name {ifname} address {mac.hex(':')} mtu {MTU_BYTES} netns n{node}"
        outside.append(f"link add {far} mtu {MTU_BYTES} type veth peer {near}")
        outside.append(f"link set {far} up")
        inside[node] += [f"addr add {address}/24 broadcast + dev {ifname}", f"link set {ifname} up"]
    with tempfile.TemporaryDirectory(dir="/run") as folder:
        paths = [Path(folder, f"{n}") for n in range(count)]
        for path, orders in zip(paths, inside, strict=True):
            path.write_text("\n".join(orders) + "\n")
        first = Path(folder, "first")
        first.write_text("\n".join(outside) + "\n")
        started = time.perf_counter()
        subprocess.run([ip, "-batch", str(first)], check=True)
        for node, path in enumerate(paths):
            subprocess.run([ip, "-n", f"n{node}", "-batch", str(path)], check=True)
        return time.perf_counter() - started


def bare_way(count: int) -> float:
    """Raw struct packing and sockets, no checks beyond "no error"."""
    ends = line(count)
    per_node: list[list[int]] = [[] for _ in range(count)]
    for position, end in enumerate(ends):
        per_node[end[0]].append(position)
    libc = ctypes.CDLL(None)
    started = time.perf_counter()
    far_fd = os.open("/proc/thread-self/ns/net", os.O_RDONLY)
    far_socket = bare_socket()
    kept = []
    for node in range(count):
        libc.unshare(syscalls.CLONE_NEWNET)
        near = bare_socket()
        kept.append((os.open("/proc/thread-self/ns/net", os.O_RDONLY), near))
        for name in ("accept_dad", "router_solicitations"):
            fd = os.open(f"/proc/sys/net/ipv6/conf/default/{name}", os.O_WRONLY)
            os.write(fd, b"0")
            os.close(fd)
        orders = message(16, 0x5, ifinfo(1, up=True))
        for offset, position in enumerate(per_node[node]):
            orders += bare_interface(100 + offset, ends[position], 10_000 + position, far_fd)
        exchange(near, orders, 1 + 2 * len(per_node[node]))
        for position in per_node[node]:
            bare_offloads(near, ends[position][1])
    libc.setns(far_fd, syscalls.CLONE_NEWNET)
    for start in range(0, len(ends), 50):
        orders, sent = b"", 0
        for position in range(start, min(start + 50, len(ends))):
            bare_offloads(far_socket, ends[position][4])
            no_ipv6 = attribute(26, attribute(10, attribute(8, b"\1")))
            orders += message(16, 0x5, ifinfo(10_000 + position) + no_ipv6)
            orders += message(16, 0x5, ifinfo(10_000 + position, up=True))
            sent += 2
        exchange(far_socket, orders, sent)
    return time.perf_counter() - started


def bare_interface(index: int, end: End, far_index: int, far_fd: int) -> bytes:
    """Creation and address of one veth."""
    _, ifname, mac, address, far = end
    mtu = attribute(4, struct.pack("=I", MTU_BYTES))
    peer = ifinfo(far_index) + attribute(3, far.encode() + b"\0") + mtu + attribute(28, struct.pack("=I", far_fd))
    info = attribute(18, attribute(1, b"veth\0") + attribute(2, attribute(1, peer)))
    link = ifinfo(index, up=True) + attribute(3, ifname.encode() + b"\0") + attribute(1, mac) + mtu + info
    ip = socket.inet_aton(address)
    header = struct.pack("=BBBBI", socket.AF_INET, 24, 0, 0, index)
    addresses = attribute(2, ip) + attribute(1, ip) + attribute(4, ip[:3] + b"\xff")
    return message(16, 0x605, link) + message(20, 0x605, header + addresses)


def bare_socket() -> socket.socket:
    sock = socket.socket(socket.AF_NETLINK, socket.SOCK_RAW | socket.SOCK_CLOEXEC, socket.NETLINK_ROUTE)
    sock.setsockopt(270, 10, 1)
    return sock


def message(kind: int, flags: int, body: bytes) -> bytes:
    return struct.pack("=IHHII", 16 + len(body), kind, flags, 0, 0) + body


def ifinfo(index: int, *, up: bool = False) -> bytes:
    return struct.pack("=BxHiII", 0, 0, index, int(up), int(up))


def attribute(kind: int, payload: bytes) -> bytes:
    return struct.pack("=HH", 4 + len(payload), kind) + payload + bytes(-len(payload) % 4)


def exchange(sock: socket.socket, orders: bytes, count: int) -> None:
    sock.sendto(orders, (0, 0))
    while count:
        data = sock.recv(1 << 16)
        for start in range(0, len(data), 36):
            error = struct.unpack_from("=i", data, start + 16)[0]
            if error:
                raise OSError(-error, os.strerror(-error))
            count -= 1


def bare_offloads(sock: socket.socket, ifname: str) -> None:
    for command in (0x17, 0x19, 0x24):  # ETHTOOL_STXCSUM, SSG, SGSO
        value = ctypes.create_string_buffer(struct.pack("=II", command, 0))
        fcntl.ioctl(sock, 0x8946, struct.pack("16sP16x", ifname.encode(), ctypes.addressof(value)))


def trial(name: str, count: int) -> float:
    """Seconds that one way takes in a fresh process; then waits until its namespaces are gone from the kernel."""
    order = [sys.executable, __file__, "--one", name, str(count)]
    answer = subprocess.run(order, check=True, stdout=subprocess.PIPE, text=True).stdout
    settle()
    return float(answer)


def one(name: str, count: int) -> None:
    """The fresh process: print the seconds."""
    probe.become_lab_root()
    gc.disable()
    print(WAYS[name](count))


def settle() -> None:
    """Let the kernel dismantle the namespaces of the trial before, or the next one pays for it."""
    previous = -1.0
    while (busy := kernel_cpu_s()) - previous > 0.01:
        previous = busy
        time.sleep(0.25)


def kernel_cpu_s() -> float:
    """CPU time that the machine has spent in the kernel."""
    fields = Path("/proc/stat").read_text().split("\n", 1)[0].split()
    return float(fields[3]) / os.sysconf("SC_CLK_TCK")


WAYS = {"netlab": netlab_way, "ip -batch": ip_way, "bare netlink": bare_way}


def main() -> None:
    """Print the medians."""
    parser = argparse.ArgumentParser(description="time to bring up a line of nodes")
    parser.add_argument("nodes", nargs="*", type=int, default=[10, 100, 300])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--one", choices=WAYS, help="one trial of one way, as the benchmark starts them itself")
    arguments = parser.parse_args()
    if arguments.one:
        one(arguments.one, arguments.nodes[0])
        return
    print(f"{'nodes':>6} {'veths':>6}" + "".join(f"{name + ' s':>16}" for name in WAYS) + "   netlab / bare")
    for count in arguments.nodes:
        times: dict[str, list[float]] = {name: [] for name in WAYS}
        for _ in range(arguments.rounds):
            for name in WAYS:
                times[name].append(trial(name, count))
        medians = {name: statistics.median(values) for name, values in times.items()}
        cells = "".join(f"{value:16.3f}" for value in medians.values())
        print(f"{count:6} {2 * count - 2:6}{cells}   {medians['netlab'] / medians['bare netlink']:.2f}")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
