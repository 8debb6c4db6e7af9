"""Who answers knows us."""

from __future__ import annotations

import random
import time

import pytest

from netlab.lab import resolution


def test_it_ends_with_the_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    slept: list[float] = []
    monkeypatch.setattr(time, "sleep", slept.append)
    started_s = time.monotonic()
    resolution.resolve(["127.0.0.1", "127.0.0.2"], random.Random(1), spread_s=0.25, deadline_s=started_s + 60.0)
    assert time.monotonic() - started_s < 4.0, "loopback refuses at once"
    assert len(slept) == 1
    assert 0.0 < slept[0] < 0.25


def test_it_does_not_wait_beyond_its_deadline_nor_for_nobody() -> None:
    started_s = time.monotonic()
    resolution.resolve(["127.0.0.1"], random.Random(1), spread_s=0.25, deadline_s=started_s)
    resolution.resolve([], random.Random(1), spread_s=0.0, deadline_s=started_s + 60.0)
    resolution.resolve(["no address"], random.Random(1), spread_s=0.0, deadline_s=started_s + 60.0)
    assert time.monotonic() - started_s < 1.0
