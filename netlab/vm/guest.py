"""The init process inside the box: mounts, starts the one command, hands its output and exit code out, powers off.

It is copied into the box's control folder and run by ``python3 -I -S`` as PID 1, so it imports the standard library
only, and nothing of netlab. It must not sleep or poll: in virtual time every timer that it sets would move the clock.

Output and exit code leave through files in the control folder, which is shared with the host. A chunk is on the host
when the file is closed (hostfs and uncached 9p write through then), so each write opens and closes: no terminal, no
line discipline, and in virtual time no time passes.
"""

from __future__ import annotations

import contextlib
import ctypes
import errno
import fcntl
import json
import os
import resource
import select
import signal
import socket
import struct
import sys
import time
from pathlib import Path

MS_NOSUID, MS_NODEV, MS_NOEXEC, MS_BIND, MS_MOVE, MS_REC, MS_PRIVATE = 2, 4, 8, 4096, 8192, 16384, 1 << 18
MNT_DETACH = 2
SYS_PIVOT_ROOT, SYS_FINIT_MODULE = 155, 313  # x86-64
RB_POWER_OFF = 0x4321FEDC
SIOCGIFFLAGS, SIOCSIFFLAGS, IFF_UP = 0x8913, 0x8914, 1
DRAIN_S = 1.0  # a daemon left behind may hold the pipes open for ever
CHUNK_BYTES = 1 << 16
OPEN_FILES = 1 << 20

#: Fresh and empty in every box; a path below one of them that the command needs is bound back in.
FRESH = ("/tmp", "/run", "/dev/shm")

CONTROL = "/run/netlab-vm"  # the control folder as the box sees it
STAGE = "/tmp"  # exists on every Linux, and is about to be covered anyway
libc = ctypes.CDLL(None, use_errno=True)


class Job:
    """What the host left in ``job.json``; see ``netlab.vm.control``."""

    def __init__(self, folder: str) -> None:
        raw = json.loads((Path(folder) / "job.json").read_text())
        self.folder = folder
        self.argv: list[str] = raw["argv"]
        self.env: dict[str, str] = raw["env"]
        self.cwd: str = raw["cwd"]
        self.output: str | None = raw["output"]
        self.visible: list[str] = raw["visible"]
        self.shares: str = raw["shares"]  # "hostfs" or "9p"
        self.modules: str | None = raw["modules"]
        self.load_first: list[list[str]] = raw["load_first"]
        self.load: list[list[str]] = raw["load"]
        self.soft_files: int = raw["soft_files"]


def check(result: int, what: str) -> None:
    if result < 0:
        number = ctypes.get_errno()
        raise OSError(number, f"{what}: {os.strerror(number)}")


def mount(source: str, target: str, fstype: str | None, flags: int = 0, data: str | None = None) -> None:
    encoded = [None if text is None else os.fsencode(text) for text in (source, target, fstype)]
    options = None if data is None else os.fsencode(data)
    check(libc.mount(*encoded, ctypes.c_ulong(flags), options), f"mount {fstype or source} on {target}")


def share(job: Job, tag: str, path: str, target: str) -> None:
    """Mount the host's folder ``path`` on ``target``, writes going through."""
    if job.shares == "hostfs":
        mount("none", target, "hostfs", 0, path)
    else:
        mount(tag, target, "9p", 0, "trans=virtio,version=9p2000.L,cache=none,msize=512000")


def load_modules(modules: list[list[str]]) -> None:
    """Insert modules, in this order; one that the kernel has already or cannot take is passed over and told."""
    for path, options in modules:
        fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
        if libc.syscall(SYS_FINIT_MODULE, fd, options.encode(), 0) < 0 and ctypes.get_errno() != errno.EEXIST:
            print(f"module {path}: {os.strerror(ctypes.get_errno())}")
        os.close(fd)


def build_root(job: Job) -> str:
    """The host's root below, memory above; returns where it is mounted."""
    mount("stage", STAGE, "tmpfs", 0, "mode=700,size=75%")
    for name in ("upper", "work", "root", "keep"):
        Path(STAGE, name).mkdir(mode=0o755)
    root = f"{STAGE}/root"
    layers = f"lowerdir=/,upperdir={STAGE}/upper,workdir={STAGE}/work"
    mount("overlay", root, "overlay", 0, layers)
    return root


def mount_all(job: Job, root: str) -> None:
    """Everything below the new root."""
    kept = keep_visible(job, root)
    mount("proc", f"{root}/proc", "proc")
    mount("sysfs", f"{root}/sys", "sysfs")
    mount("devtmpfs", f"{root}/dev", "devtmpfs", MS_NOSUID, "mode=755")
    for path in ("/dev/pts", "/dev/shm", "/dev/mqueue"):
        make(root + path)
    mount("devpts", f"{root}/dev/pts", "devpts", MS_NOSUID | MS_NOEXEC, "mode=620,ptmxmode=666")
    for path in FRESH:
        mode = "755" if path == "/run" else "1777"
        mount("tmpfs", root + path, "tmpfs", MS_NOSUID | MS_NODEV, f"mode={mode}")
    for name, number in (("fd", ""), ("stdin", "/0"), ("stdout", "/1"), ("stderr", "/2")):
        if not os.path.lexists(f"{root}/dev/{name}"):
            Path(f"{root}/dev/{name}").symlink_to(f"/proc/self/fd{number}")
    optional("cgroup2", f"{root}/sys/fs/cgroup")
    optional("mqueue", f"{root}/dev/mqueue")
    for path, place in kept:
        make(root + path)
        mount(place, root + path, None, MS_MOVE)
    make(root + CONTROL)
    share(job, "control", job.folder, root + CONTROL)
    if job.output is not None:
        make(root + job.output)
        share(job, "output", job.output, root + job.output)
    if job.modules is not None:
        target = f"{root}/usr/lib/modules/{os.uname().release}"
        make(target)
        mount(root + job.modules, target, None, MS_BIND)


def keep_visible(job: Job, root: str) -> list[tuple[str, str]]:
    """Hold the needed paths below the fresh folders, before those are covered."""
    kept = []
    for number, path in enumerate(job.visible):
        place = f"{STAGE}/keep/{number}"
        if Path(root + path).is_dir():
            make(place)
            mount(root + path, place, None, MS_BIND)
            kept.append((path, place))
    return kept


def make(path: str) -> None:
    Path(path).mkdir(parents=True, exist_ok=True)


def optional(fstype: str, target: str) -> None:
    """Mount what not every kernel has."""
    try:
        mount(fstype, target, fstype)
    except OSError as error:
        print(f"not mounted: {error}")


def enter(root: str) -> None:
    """Make ``root`` the root of the mount namespace: in a mere chroot the kernel forbids user namespaces."""
    os.chdir(root)
    check(libc.syscall(SYS_PIVOT_ROOT, b".", b"."), "pivot_root")
    check(libc.umount2(b".", MNT_DETACH), "umount of the old root")
    os.chdir("/")


def raise_loopback() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        request = struct.pack("16sh22x", b"lo", 0)
        flags: int = struct.unpack("16sh22x", fcntl.ioctl(sock, SIOCGIFFLAGS, request))[1]
        fcntl.ioctl(sock, SIOCSIFFLAGS, struct.pack("16sh22x", b"lo", flags | IFF_UP))


def name_machine(name: str) -> None:
    check(libc.sethostname(name.encode(), len(name)), "sethostname")
    with Path("/etc/hosts").open("a") as hosts:
        hosts.write(f"\n127.0.1.1 {name}\n")


def tell(name: str, data: bytes) -> None:
    """Append to a file in the control folder; the host has it when this returns."""
    with Path(CONTROL, name).open("ab") as stream:
        stream.write(data)


def start(job: Job, stdout: int, stderr: int) -> int:
    """Fork the command; returns its process id."""
    pid = os.fork()
    if pid:
        return pid
    try:
        os.setsid()
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.dup2(stdout, 1)
        os.dup2(stderr, 2)
        os.closerange(3, 64)
        signal.pthread_sigmask(signal.SIG_SETMASK, ())
        signal.signal(signal.SIGPIPE, signal.SIG_DFL)  # Python ignores it, and children inherit that
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        resource.setrlimit(resource.RLIMIT_NOFILE, (job.soft_files, OPEN_FILES))
        os.chdir(job.cwd)
        os.execvpe(job.argv[0], job.argv, job.env)
    except OSError as error:
        what = job.argv[0] if error.filename is None else error.filename
        os.write(2, f"netlab vm: {os.fsdecode(what)}: {error.strerror}\n".encode())
        os._exit(127 if error.errno == errno.ENOENT else 126)
    finally:
        os._exit(126)


def pump(pid: int, sources: dict[int, str]) -> int:
    """Carry output out until the command has ended and its pipes are empty; returns its exit code, reaping orphans."""
    woken, wake = os.pipe2(os.O_NONBLOCK | os.O_CLOEXEC)
    signal.set_wakeup_fd(wake, warn_on_full_buffer=False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    code: int | None = reap(pid)
    deadline = 0.0 if code is None else time.monotonic() + DRAIN_S
    poll = select.poll()
    for fd in (woken, *sources):
        poll.register(fd, select.POLLIN)
    while sources and (code is None or time.monotonic() < deadline):
        for fd, _events in poll.poll(None if code is None else DRAIN_S * 1000):
            if fd != woken and not carry(fd, sources[fd]):
                poll.unregister(fd)
                os.close(fd)
                del sources[fd]
        code = drain_children(woken, pid, code)
        deadline = deadline or (0.0 if code is None else time.monotonic() + DRAIN_S)
    while code is None:
        select.select([woken], [], [])
        code = drain_children(woken, pid, code)
    return code


def carry(fd: int, name: str) -> bool:
    data = os.read(fd, CHUNK_BYTES)
    if data:
        tell(name, data)
    return bool(data)


def drain_children(woken: int, pid: int, code: int | None) -> int | None:
    with contextlib.suppress(BlockingIOError):
        os.read(woken, 512)
    found = reap(pid)
    return code if found is None else found


def reap(pid: int) -> int | None:
    """Collect every ended child; the exit code of ``pid`` if it is among them."""
    code = None
    while True:
        try:
            ended, status = os.waitpid(-1, os.WNOHANG)
        except ChildProcessError:
            return code
        if ended == 0:
            return code
        if ended == pid:
            ending = os.waitstatus_to_exitcode(status)
            code = ending if ending >= 0 else 128 - ending


def serve(job: Job) -> None:
    """Run the command and tell the host how it ended."""
    pipes = {name: os.pipe2(os.O_CLOEXEC) for name in ("stdout", "stderr")}
    began_s = time.monotonic()
    pid = start(job, pipes["stdout"][1], pipes["stderr"][1])
    for _reader, writer in pipes.values():
        os.close(writer)
    code = pump(pid, {reader: name for name, (reader, _writer) in pipes.items()})
    tell("status", json.dumps({"exit_code": code, "guest_s": time.monotonic() - began_s}).encode() + b"\n")


def power_off() -> None:
    os.sync()
    libc.reboot(ctypes.c_int(RB_POWER_OFF))


def main() -> None:
    job = Job(sys.argv[1])
    try:
        mount("none", "/", None, MS_REC | MS_PRIVATE)
        load_modules(job.load_first)
        root = build_root(job)
        mount_all(job, root)
        enter(root)
        load_modules(job.load)
        raise_loopback()
        name_machine("box")
        tell("up", b"up\n")
        serve(job)
    except OSError as error:
        print(f"netlab box: {error}", flush=True)  # the console, which the host keeps
    finally:
        power_off()


if __name__ == "__main__":
    main()
