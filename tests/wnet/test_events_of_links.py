"""The daemon's lines about its links: what they hold, and that they come only where something has changed."""

from __future__ import annotations

import dataclasses
import json
import os

import pytest

from wnet.core.snapshot import LinkState
from wnet.io.feed import EventFeed

LINK = LinkState(
    neighbour=b"\x02\0\0\0\0\2",
    member=1,
    peer_mac=b"\x02\0\0\0\0\x12",
    link_id=3,
    is_usable=True,
    is_mpr=False,
    heard_s=0.1,
    loss_in_ratio=0.0,
    loss_out_ratio=0.0196078,
    snr_in_db=None,
    snr_out_db=31.0,
    srtt_s=0.002,
    quality=0.98765,
    cost_out=None,
    rate_bps=54_000_000,
    in_flight=0,
)


class Lines:
    """A feed and what comes out of it."""

    def __init__(self) -> None:
        self._end, write = os.pipe()
        self.feed = EventFeed(write, b"\x02\0\0\0\0\1")

    def told(self) -> list[dict[str, object]]:
        self.feed.flush()
        os.set_blocking(self._end, False)
        try:
            return [json.loads(line) for line in os.read(self._end, 1 << 16).splitlines()]
        except BlockingIOError:
            return []


@pytest.fixture
def lines() -> Lines:
    return Lines()


def test_links_are_told_with_what_the_routing_knows_of_them(lines: Lines) -> None:
    lines.feed.links([LINK, dataclasses.replace(LINK, neighbour=b"\x02\0\0\0\0\3", is_usable=False)])
    [told] = lines.told()
    assert isinstance(told.pop("t_ns"), int)
    row = {
        "neighbour": "02:00:00:00:00:02",
        "member": 1,
        "quality": 0.988,
        "cost": None,
        "loss_ratio": 0.02,
        "snr_db": 31.0,
        "rate_bps": 54_000_000,
    }
    assert told == {"event": "links", "mac": "02:00:00:00:00:01", "links": [row]}


def test_links_are_told_again_only_when_they_changed(lines: Lines) -> None:
    lines.feed.links([])
    assert lines.told() == [], "there never was one"
    lines.feed.links([LINK])
    assert len(lines.told()) == 1
    lines.feed.links([dataclasses.replace(LINK, heard_s=0.7, srtt_s=0.003, in_flight=2)])
    assert lines.told() == [], "nothing that routes depend on"
    lines.feed.links([])
    assert [line["links"] for line in lines.told()] == [[]]
