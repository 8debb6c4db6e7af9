"""A tiny initramfs for a stock kernel: busybox, the modules for virtio and 9p, and a script. Pure."""

from __future__ import annotations

import shlex
import stat
from dataclasses import dataclass

#: What a stock kernel needs before it can see the host's files.
EARLY_MODULES = ["virtio_pci", "9pnet_virtio", "9p", "overlay"]

PROBE_WORD = "netlabprobe"
PROBE_ANSWER = "NETLAB-PROBE-OK"

_SCRIPT = """#!/bin/busybox sh
B=/bin/busybox
$B mount -t proc proc /proc
$B mount -t devtmpfs dev /dev
if $B grep -q {word} /proc/cmdline; then echo {answer} >/dev/ttyS0; $B poweroff -f; fi
for module in {modules}; do $B insmod /modules/$module || echo "no $module"; done
$B mount -t 9p -o ro,trans=virtio,version=9p2000.L,cache=loose,msize=512000 root /root || $B poweroff -f
exec $B switch_root -c /dev/console /root {init}
"""


@dataclass(frozen=True, slots=True)
class Entry:
    """One member of the archive."""

    name: str
    mode: int
    data: bytes = b""


def script(modules: list[str], init: list[str]) -> bytes:
    """The init script: load, mount the host's root, hand over to the box's own init."""
    text = _SCRIPT.format(word=PROBE_WORD, answer=PROBE_ANSWER, modules=shlex.join(modules), init=shlex.join(init))
    return text.encode()


def build(busybox: bytes, modules: dict[str, bytes], init: list[str]) -> bytes:
    """The archive: ``modules`` by file name, in the order in which they are loaded."""
    entries = [Entry(name, stat.S_IFDIR | 0o755) for name in ("bin", "dev", "proc", "root", "modules")]
    entries.append(Entry("bin/busybox", stat.S_IFREG | 0o755, busybox))
    entries += [Entry(f"modules/{name}", stat.S_IFREG | 0o644, data) for name, data in modules.items()]
    entries.append(Entry("init", stat.S_IFREG | 0o755, script(list(modules), init)))
    return cpio(entries)


def cpio(entries: list[Entry]) -> bytes:
    """The ``newc`` format of cpio(5): hexadecimal headers, names and data padded to four bytes."""
    archive = bytearray()
    for number, entry in enumerate([*entries, Entry("TRAILER!!!", 0)], 1):
        name = entry.name.encode() + b"\0"
        fields = [number, entry.mode, 0, 0, 1, 0, len(entry.data), 0, 0, 0, 0, len(name), 0]
        archive += b"070701" + b"".join(b"%08X" % value for value in fields) + name
        archive += b"\0" * (-len(archive) % 4) + entry.data
        archive += b"\0" * (-len(archive) % 4)
    return bytes(archive)
