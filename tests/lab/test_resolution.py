"""Which link addresses the kernel knows."""

from __future__ import annotations

import random
import time

from netlab.lab import resolution

TABLE = """IP address       HW type     Flags       HW address            Mask     Device
10.200.0.1       0x1         0x2         02:4e:4c:00:00:00     *        radio0
10.200.0.2       0x1         0x0         00:00:00:00:00:00     *        radio0
10.200.0.3       0x1         0x6         02:4e:4c:00:00:02     *        radio0
"""


def test_only_complete_rows_count() -> None:
    assert resolution.known(TABLE) == {"10.200.0.1", "10.200.0.3"}
    assert resolution.known(TABLE.splitlines()[0]) == set()


def test_it_does_not_wait_beyond_its_deadline_nor_for_nobody() -> None:
    started_s = time.monotonic()
    resolution.resolve(["127.0.0.1"], random.Random(1), deadline_s=started_s)
    resolution.resolve([], random.Random(1), deadline_s=started_s + 0.01)
    assert time.monotonic() - started_s < 1.0
