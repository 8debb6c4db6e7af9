"""Linux calls that Python 3.11 does not offer, by ctypes on libc. Failures are OSErrors that say what was tried.

Thin on purpose: one function per call, no policy. Namespaces belong to threads: ``unshare`` and ``setns`` change the
calling thread only.
"""

from __future__ import annotations

import ctypes
import os
import signal

CLONE_NEWNS = 0x00020000
CLONE_NEWCGROUP = 0x02000000
CLONE_NEWUTS = 0x04000000
CLONE_NEWIPC = 0x08000000
CLONE_NEWUSER = 0x10000000
CLONE_NEWPID = 0x20000000
CLONE_NEWNET = 0x40000000

MS_RDONLY = 1
MS_NOSUID = 2
MS_NODEV = 4
MS_NOEXEC = 8
MS_REMOUNT = 32
MS_BIND = 4096
MS_MOVE = 8192
MS_REC = 16384
MS_PRIVATE = 1 << 18
MS_SLAVE = 1 << 19

MNT_FORCE = 1
MNT_DETACH = 2
UMOUNT_NOFOLLOW = 8

TFD_NONBLOCK = os.O_NONBLOCK
TFD_CLOEXEC = os.O_CLOEXEC
TFD_TIMER_ABSTIME = 1

_PR_SET_PDEATHSIG = 1
_PR_SET_NAME = 15
_PR_SET_TIMERSLACK = 29
_PR_SET_CHILD_SUBREAPER = 36
_PR_SET_NO_NEW_PRIVS = 38

_NS_PER_S = 1_000_000_000

_libc = ctypes.CDLL(None, use_errno=True)


class _Timespec(ctypes.Structure):
    _fields_ = (("tv_sec", ctypes.c_long), ("tv_nsec", ctypes.c_long))


class _Itimerspec(ctypes.Structure):
    _fields_ = (("it_interval", _Timespec), ("it_value", _Timespec))


_libc.unshare.argtypes = (ctypes.c_int,)
_libc.setns.argtypes = (ctypes.c_int, ctypes.c_int)
_libc.mount.argtypes = (ctypes.c_char_p, ctypes.c_char_p, ctypes.c_char_p, ctypes.c_ulong, ctypes.c_char_p)
_libc.umount2.argtypes = (ctypes.c_char_p, ctypes.c_int)
_libc.prctl.argtypes = (ctypes.c_int, ctypes.c_ulong, ctypes.c_ulong, ctypes.c_ulong, ctypes.c_ulong)
_libc.timerfd_create.argtypes = (ctypes.c_int, ctypes.c_int)
_libc.timerfd_settime.argtypes = (
    ctypes.c_int,
    ctypes.c_int,
    ctypes.POINTER(_Itimerspec),
    ctypes.POINTER(_Itimerspec),
)
_libc.sethostname.argtypes = (ctypes.c_char_p, ctypes.c_size_t)


def unshare(flags: int) -> None:
    """Give the calling thread new namespaces (``CLONE_NEW*``).

    Raises:
        OSError: EPERM without the capability, ENOSPC at a limit in /proc/sys/user, EINVAL for ``CLONE_NEWUSER`` in a
            process with several threads.
    """
    _check(_libc.unshare(flags), f"unshare({_names(flags)})")


def setns(fd: int, flags: int = 0) -> None:
    """Move the calling thread into the namespace that ``fd`` refers to; ``flags`` 0 accepts any type.

    Raises:
        OSError: ``fd`` is no namespace of that type, or the capability is missing.
    """
    _check(_libc.setns(fd, flags), f"setns(fd {fd}, {_names(flags)})")


def mount(source: str, target: str, fstype: str | None, flags: int = 0, data: str | None = None) -> None:
    """mount(2). ``fstype`` None for bind mounts and changes of propagation.

    Raises:
        OSError: The kernel refuses; the text names source, target and type.
    """
    result = _libc.mount(os.fsencode(source), os.fsencode(target), _bytes(fstype), flags, _bytes(data))
    _check(result, f"mount({source} on {target}, type {fstype}, flags {flags:#x}, data {data})")


def umount2(target: str, flags: int = 0) -> None:
    """umount2(2) with ``MNT_DETACH``, ``MNT_FORCE`` or ``UMOUNT_NOFOLLOW``.

    Raises:
        OSError: Not a mount point, busy, or not permitted.
    """
    _check(_libc.umount2(os.fsencode(target), flags), f"umount2({target}, {flags})")


def sethostname(name: str) -> None:
    """Name the machine in the calling thread's UTS namespace; at most 64 bytes.

    Raises:
        OSError: Too long or not permitted.
    """
    encoded = name.encode()
    _check(_libc.sethostname(encoded, len(encoded)), f"sethostname({name!r})")


def set_pdeathsig(sig: signal.Signals | int) -> None:
    """Have the kernel send ``sig`` to this process when the *thread* that started it ends; 0 clears.

    Not inherited by fork. A parent that ended before this call is missed: compare ``os.getppid()`` afterwards.
    """
    _prctl(_PR_SET_PDEATHSIG, int(sig), "PR_SET_PDEATHSIG")


def set_timerslack_ns(slack_ns: int) -> None:
    """How late the kernel may fire the calling thread's timers, in nanoseconds; inherited by fork. 0 restores."""
    _prctl(_PR_SET_TIMERSLACK, slack_ns, "PR_SET_TIMERSLACK")


def set_child_subreaper() -> None:
    """Adopt orphaned descendants, as an init process does."""
    _prctl(_PR_SET_CHILD_SUBREAPER, 1, "PR_SET_CHILD_SUBREAPER")


def set_no_new_privs() -> None:
    """Programs that this process executes gain no privileges by setuid bits, for ever."""
    _prctl(_PR_SET_NO_NEW_PRIVS, 1, "PR_SET_NO_NEW_PRIVS")


def set_name(name: str) -> None:
    """Name the calling thread for ps and top; the kernel keeps 15 bytes."""
    buffer = ctypes.create_string_buffer(name.encode()[:15])
    _prctl(_PR_SET_NAME, ctypes.addressof(buffer), "PR_SET_NAME")


def timerfd_create(clock_id: int, flags: int = TFD_NONBLOCK | TFD_CLOEXEC) -> int:
    """Return a timer descriptor on ``clock_id`` (``time.CLOCK_MONOTONIC``); it becomes readable when it expires."""
    fd: int = _libc.timerfd_create(clock_id, flags)
    _check(fd, f"timerfd_create(clock {clock_id})")
    return fd


def timerfd_settime(fd: int, value_ns: int, *, absolute: bool = True, interval_ns: int = 0) -> None:
    """Arm the timer for ``value_ns`` (on its clock if ``absolute``, else from now); 0 disarms.

    Args:
        fd: From :func:`timerfd_create`.
        value_ns: Nanoseconds, >= 0. In the past and absolute: fires at once.
        absolute: Whether ``value_ns`` is a reading of the clock.
        interval_ns: Period after the first expiry; 0 fires once.

    Raises:
        OSError: ``fd`` is no timer, or a time is negative.
    """
    spec = _Itimerspec(_timespec(interval_ns), _timespec(value_ns))
    result = _libc.timerfd_settime(fd, TFD_TIMER_ABSTIME if absolute else 0, ctypes.byref(spec), None)
    _check(result, f"timerfd_settime(fd {fd}, {value_ns} ns)")


def _timespec(time_ns: int) -> _Timespec:
    return _Timespec(*divmod(time_ns, _NS_PER_S))


def _prctl(option: int, value: int, name: str) -> None:
    _check(_libc.prctl(option, value, 0, 0, 0), f"prctl({name}, {value})")


def _check(result: int, what: str) -> None:
    if result < 0:
        number = ctypes.get_errno()
        raise OSError(number, f"{os.strerror(number)}: {what}")


def _bytes(text: str | None) -> bytes | None:
    return None if text is None else os.fsencode(text)


def _names(flags: int) -> str:
    names = [name for name, bit in _CLONE_NAMES.items() if flags & bit]
    return "|".join(names) or hex(flags)


_CLONE_NAMES = {name: value for name, value in globals().items() if name.startswith("CLONE_NEW")}
