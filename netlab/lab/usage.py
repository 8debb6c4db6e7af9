"""What a process costs: processor time and memory, read from the kernel. Values; who asks, and when, is elsewhere."""

from __future__ import annotations

import os
import resource
from dataclasses import dataclass
from pathlib import Path

_TICKS_PER_S = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True, slots=True)
class Usage:
    """Of one process, or of several runs of it.

    Attributes:
        cpu_s: Processor time in user and kernel mode, in seconds; not that of its children.
        max_rss_bytes: The most memory that was resident at once; pages shared with other processes count in full.
    """

    cpu_s: float = 0.0
    max_rss_bytes: int = 0

    def then(self, later: Usage) -> Usage:
        """Return the sum with a later run of the same program."""
        return Usage(self.cpu_s + later.cpu_s, max(self.max_rss_bytes, later.max_rss_bytes))


def usage_at_end(used: resource.struct_rusage) -> Usage:
    """Return what ``wait4`` tells of a process that has ended."""
    return Usage(used.ru_utime + used.ru_stime, used.ru_maxrss * 1024)


def usage_now(pid: int, proc: Path = Path("/proc")) -> Usage:
    """Return what a process has used so far; nothing if there is none of that id (proc(5): stat, status)."""
    try:
        fields = (proc / str(pid) / "stat").read_text().rsplit(")", 1)[1].split()
        status = (proc / str(pid) / "status").read_text()
    except (FileNotFoundError, ProcessLookupError):
        return Usage()
    peak = next((line.split()[1] for line in status.splitlines() if line.startswith("VmHWM:")), "0")
    return Usage((int(fields[11]) + int(fields[12])) / _TICKS_PER_S, int(peak) * 1024)
