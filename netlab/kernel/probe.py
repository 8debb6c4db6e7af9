"""What this kernel and machine allow, found out by trying, each in a throw-away child process or namespace.

Nothing is assumed from version numbers or module lists, and nothing of the machine is changed.
"""

from __future__ import annotations

import contextlib
import errno
import os
import pickle
import socket
import struct
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TypeVar

from netlab.kernel import batman, messages, syscalls, tc, tun
from netlab.kernel import namespaces as netns
from netlab.kernel.counters import root_qdiscs
from netlab.kernel.netem import tells_seed
from netlab.kernel.netlink import NetlinkError, NetlinkSocket
from netlab.medium.impairments import PERFECT, Impairment

Result = TypeVar("Result")

_LO = messages.LOOPBACK_INDEX
_SOME_MAC = bytes.fromhex("020000000001")
_PROC_SYS = Path("/proc/sys")

# linux/if_packet.h, linux/if_tun.h
_SOL_PACKET = 263
_PACKET_RX_RING = 5
_PACKET_VERSION = 10
_TPACKET_V3 = 2

# A name for the user, the sysctl, the value that forbids, the command that allows.
_USERNS_SWITCHES = (
    ("kernel/unprivileged_userns_clone", "0", "sudo sysctl -w kernel.unprivileged_userns_clone=1"),
    ("user/max_user_namespaces", "0", "sudo sysctl -w user.max_user_namespaces=15000"),
    (
        "kernel/apparmor_restrict_unprivileged_userns",
        "1",
        "sudo sysctl -w kernel.apparmor_restrict_unprivileged_userns=0",
    ),
)


@dataclass(frozen=True, slots=True)
class TcFeatures:
    """What traffic control offers; ``netem_problem`` None means that sch_netem works.

    ``netem_seed``: netem takes a seed. ``netem_duplicates``: it may duplicate frames where it is the only netem of an
    interface, as in the lab; ``netem_duplicates_beside_netem``: also beside another (many kernels since 2025 refuse).
    """

    netem_problem: str | None
    classifiers: tuple[tc.Classifier, ...]
    bpf: bool
    netem_seed: bool = False
    netem_duplicates: bool = False
    netem_duplicates_beside_netem: bool = False


def explain_userns_denied(proc_sys: Path = _PROC_SYS) -> str:
    """Say why an ordinary user gets no user namespace here and what allows it; for the person, several lines."""
    lines = ["an ordinary user may not create a user namespace on this machine, and the lab needs one."]
    for name, forbidding, command in _USERNS_SWITCHES:
        with contextlib.suppress(OSError):
            if (proc_sys / name).read_text().strip() == forbidding:
                lines.append(f"{name.replace('/', '.')} is {forbidding}. To allow it: {command}")
    if len(lines) == 1:
        lines.append(
            "No sysctl forbids it, so a container's seccomp filter or a security module does: "
            "start the container with --privileged or --security-opt seccomp=unconfined."
        )
    lines.append("Or run the same command as root (sudo).")
    return "\n".join(lines)


def in_child(trial: Callable[[], str | None]) -> str | None:
    """Run ``trial`` in a forked child; None if all is well, else its answer, its OSError or how it died."""
    found: list[str | None] = []
    problem = in_child_value(trial, found)
    return problem if problem is not None else found[0]


def in_child_value(trial: Callable[[], Result], found: list[Result]) -> str | None:
    """Run ``trial`` in a forked child and append what it returns (picklable) to ``found``.

    Returns:
        None if all is well, else its OSError or how it died.
    """
    reader, writer = os.pipe()
    pid = os.fork()
    if pid == 0:
        try:
            os.close(reader)
            with os.fdopen(writer, "wb") as stream:
                pickle.dump(_outcome(trial), stream)
        finally:
            os._exit(0)
    os.close(writer)
    with os.fdopen(reader, "rb") as stream:
        answer = stream.read()
    status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    if status or not answer:
        return f"the trial ended with status {status} and no answer"
    problem, value = pickle.loads(answer)
    if problem is None:
        found.append(value)
    return str(problem) if problem is not None else None


def _outcome(trial: Callable[[], Result]) -> tuple[str | None, Result | None]:
    try:
        return None, trial()
    except OSError as error:
        return error.strerror or str(error), None


def become_lab_root(extra: int = 0) -> None:
    """New network namespace (and ``extra`` ones) for the calling process; with a user namespace unless root.

    Raises:
        OSError: The kernel refuses.
    """
    uid, gid = os.geteuid(), os.getegid()
    flags = syscalls.CLONE_NEWNET | extra
    syscalls.unshare(flags if uid == 0 else flags | syscalls.CLONE_NEWUSER)
    if uid != 0:
        for name, text in (("setgroups", "deny"), ("uid_map", f"0 {uid} 1"), ("gid_map", f"0 {gid} 1")):
            Path("/proc/self", name).write_text(text)


def try_namespaces() -> str | None:
    """A network namespace, in a user namespace unless root."""
    become_lab_root()
    return None


def try_veth() -> str | None:
    """A veth into another new namespace, as the lab wires its nodes."""
    become_lab_root()
    with netns.returning() as origin:
        os.close(netns.enter_new())
        with contextlib.closing(NetlinkSocket()) as sock:
            order = messages.create_veth(
                index=100,
                ifname="t0",
                mac=_SOME_MAC,
                mtu=1500,
                peer_index=200,
                peer_ifname="t1",
                peer_fd=origin,
                group=9,
            )
            sock.request([order])
    return None


def try_mounts() -> str | None:
    """Mounting proc, tmpfs and sysfs inside new mount and PID namespaces; they vanish with the child."""
    become_lab_root(syscalls.CLONE_NEWNS | syscalls.CLONE_NEWPID)
    return in_child(_mount_all)  # the first child is in the new PID namespace


def _mount_all() -> str | None:
    syscalls.mount("none", "/", None, syscalls.MS_REC | syscalls.MS_PRIVATE)
    refused = []
    for fstype, target in (("proc", "/proc"), ("tmpfs", "/tmp"), ("sysfs", "/sys")):
        try:
            syscalls.mount(fstype, target, fstype, syscalls.MS_NOSUID | syscalls.MS_NODEV)
        except OSError as error:
            refused.append(f"{fstype}: {os.strerror(error.errno or 0)}")
    return ", ".join(refused) or None


def try_packet_ring() -> str | None:
    """An AF_PACKET socket with a TPACKET_V3 receive ring."""
    become_lab_root()
    with socket.socket(socket.AF_PACKET, socket.SOCK_RAW, 0) as sock:
        sock.setsockopt(_SOL_PACKET, _PACKET_VERSION, _TPACKET_V3)
        # block size, blocks, frame size, frames, block timeout in ms, private size, feature word
        sock.setsockopt(_SOL_PACKET, _PACKET_RX_RING, struct.pack("=7I", 1 << 16, 1, 1 << 11, 32, 1, 0, 0))
    return None


def try_tun() -> str | None:
    """A TAP interface from /dev/net/tun."""
    become_lab_root()
    os.close(tun.open_tap("tap0"))
    return None


def try_batman() -> str | None:
    """A mesh interface of batman-adv."""
    become_lab_root()
    return batman.problem()


def tc_features() -> TcFeatures:
    """Try qdiscs and classifiers on the loopback of a new network namespace; the thread returns to its own.

    Raises:
        OSError: No network namespace.
    """
    with netns.returning():
        os.close(netns.enter_new())
        with contextlib.closing(NetlinkSocket()) as sock:
            netem = _refusal(sock, tc.add_netem(_LO, PERFECT, seed=1))
            seed = netem is None and tells_seed(root_qdiscs(sock)[_LO].options)
            alone, beside = _duplicates(sock) if netem is None else (False, False)
            ingress = _refusal(sock, tc.add_clsact(_LO))
            works = tuple(c for c in tc.Classifier if ingress is None and _classifies(sock, c))
            bpf = ingress is None and _knows_filter(sock, "bpf")
    problem = None if netem is None else "this kernel has no sch_netem" if netem.errno == errno.ENOENT else str(netem)
    return TcFeatures(
        netem_problem=problem,
        classifiers=works,
        bpf=bpf,
        netem_seed=seed,
        netem_duplicates=alone,
        netem_duplicates_beside_netem=beside,
    )


def _duplicates(sock: NetlinkSocket) -> tuple[bool, bool]:
    """Whether the loopback's netem may duplicate: alone, and with another netem inside it."""
    order = tc.change_netem(_LO, Impairment(duplicate_ratio=0.5), seed=2, replace_table=False)
    alone = _refusal(sock, order) is None
    _refusal(sock, tc.change_netem(_LO, PERFECT, seed=3, replace_table=False))
    beside = _refusal(sock, tc.add_inner_netem(_LO)) is None and _refusal(sock, order) is None
    return alone, beside


def _classifies(sock: NetlinkSocket, classifier: tc.Classifier) -> bool:
    # One priority for each kind of filter: flower and matchall are different ones.
    first = 10 * (1 + list(tc.Classifier).index(classifier))
    trials = (tc.match_mac(_SOME_MAC), tc.ANY)
    orders = [tc.add_filter(_LO, first + n, match, [_LO], classifier=classifier) for n, match in enumerate(trials)]
    return all(_refusal(sock, order) is None for order in orders)


def _knows_filter(sock: NetlinkSocket, kind: str) -> bool:
    """An empty filter is refused either way: ENOENT where the kind is unknown, EINVAL where something is missing."""
    refusal = _refusal(sock, tc.add_empty_filter(_LO, 90, kind))
    return refusal is None or refusal.errno != errno.ENOENT


def _refusal(sock: NetlinkSocket, order: bytes) -> NetlinkError | None:
    try:
        sock.request([order])
    except NetlinkError as error:
        return error
    return None
