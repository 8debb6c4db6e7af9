"""Two throw-away nodes joined by a veth, and a recorder, for the programs in capture_programs.py."""

from __future__ import annotations

import contextlib
import fcntl
import json
import os
import socket
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

from netlab.capture.handle import Recorder
from netlab.capture.messages import RecorderStats
from netlab.ipc import Channel
from netlab.kernel import syscalls
from netlab.kernel.offloads import disable_offloads

PROGRAMS = Path(__file__).with_name("capture_programs.py")
ADDRESSES = {"a": "10.9.0.1", "b": "10.9.0.2"}


def enter(program: str, *arguments: str, timeout_s: float = 60) -> dict[str, object]:
    """Run one of capture_programs.py in namespaces of its own (a user namespace too unless root); return its answer."""
    user = [] if os.geteuid() == 0 else ["--map-root-user"]
    # A process namespace of its own: whatever the program started ends with it, in whatever way it ends.
    own = ["--net", "--mount", "--pid", "--fork", "--kill-child", "--mount-proc"]
    argv = ["unshare", *own, *user, "--", sys.executable, str(PROGRAMS), program, *arguments]
    path = os.pathsep.join(filter(None, [str(Path(__file__).parents[2]), os.environ.get("PYTHONPATH")]))
    done = subprocess.run(
        argv, capture_output=True, text=True, timeout=timeout_s, check=False, env={**os.environ, "PYTHONPATH": path}
    )
    if done.returncode:
        raise RuntimeError(f"{program} ended with {done.returncode}: {done.stderr}")
    result: dict[str, object] = json.loads(done.stdout.splitlines()[-1])
    return result


@dataclass
class Nodes:
    """Network namespaces by node name."""

    fds: dict[str, int]

    @contextlib.contextmanager
    def inside(self, node: str) -> Iterator[None]:
        """The calling thread visits a node."""
        home = os.open("/proc/thread-self/ns/net", os.O_RDONLY)
        syscalls.setns(self.fds[node], syscalls.CLONE_NEWNET)
        try:
            yield
        finally:
            syscalls.setns(home, syscalls.CLONE_NEWNET)
            os.close(home)

    def udp(self, node: str, port: int = 0) -> socket.socket:
        """A socket of a node."""
        with self.inside(node):
            sock = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        sock.bind((ADDRESSES[node], port))
        return sock

    def start(self, node: str, argv: list[str]) -> subprocess.Popen[str]:
        """A process in a node; its stderr is a pipe."""
        with self.inside(node):
            return subprocess.Popen(argv, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True)


def build() -> Nodes:
    """Make nodes a and b, each with eth0, a loopback and an address; neighbours already known."""
    fds: dict[str, int] = {}
    for node in ADDRESSES:
        in_thread(lambda node=node: fds.__setitem__(node, _new_namespace()))  # type: ignore[misc]
    ends = {node: f"/proc/{os.getpid()}/fd/{fd}" for node, fd in fds.items()}
    nodes = Nodes(fds)
    with nodes.inside("a"):
        run(f"ip link add eth0 type veth peer name eth0 netns {ends['b']}")
    for node, address in ADDRESSES.items():
        with nodes.inside(node):
            run("ip link set lo up")
            run("ip link set eth0 addrgenmode none")
            run(f"ip addr add {address}/24 brd + dev eth0")
            run("ip link set eth0 up")
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:  # frames as on a wire, as the engines do it
                disable_offloads(sock.fileno(), "eth0")
    wait_for_carrier(nodes, "eth0")
    return nodes


def wait_for_carrier(nodes: Nodes, interface: str) -> None:
    """The kernel sees the other end a moment after it came up; what is sent before that goes nowhere."""
    deadline = time.monotonic() + 20
    for node in nodes.fds:
        with nodes.inside(node), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
            while not is_running(sock.fileno(), interface):
                assert time.monotonic() < deadline, f"{interface} of {node} stays down"
                time.sleep(0.002)


def is_running(fd: int, interface: str) -> bool:
    """Whether the interface has a carrier, by the flags that ioctl SIOCGIFFLAGS tells."""
    answer = fcntl.ioctl(fd, 0x8913, struct.pack("16sH22x", interface.encode(), 0))
    return bool(struct.unpack_from("16sH", answer)[1] & 0x40)


def _new_namespace() -> int:
    syscalls.unshare(syscalls.CLONE_NEWNET)
    return os.open("/proc/thread-self/ns/net", os.O_RDONLY | os.O_CLOEXEC)


def in_thread(target: Callable[[], object]) -> None:
    """Call in a thread of its own, whose namespaces go with it."""
    thread = threading.Thread(target=target)
    thread.start()
    thread.join()


def run(command: str) -> None:
    """Run a command, quietly."""
    subprocess.run(command.split(), check=True, stdin=subprocess.DEVNULL)


@dataclass
class Recording:
    """A recorder's process and its handle."""

    recorder: Recorder
    pid: int

    def close(self) -> tuple[RecorderStats, float]:
        """Finish the file; return its statistics and the CPU seconds that it took."""
        stats = self.recorder.close()
        usage = os.wait4(self.pid, 0)[2]
        return stats, usage.ru_utime + usage.ru_stime


def record(nodes: Nodes, path: str, metadata: Mapping[str, str] | None = None) -> Recording:
    """Start a recorder on both nodes."""
    ours, theirs = Channel.pair()
    argv = [sys.executable, "-m", "netlab.capture.recorder", "--channel-fd", str(theirs.fileno())]
    os.set_inheritable(theirs.fileno(), True)
    pid = os.posix_spawn(sys.executable, argv, os.environ)
    theirs.close()
    recorder = Recorder(ours)
    recorder.open(path, {"name": "rig", **(metadata or {})}, {}, nodes=len(nodes.fds))
    for node, fd in nodes.fds.items():
        recorder.add_interfaces(node, fd, ["eth0"])
    recorder.sync()
    recorder.set_t0(time.time_ns())
    return Recording(recorder, pid)
