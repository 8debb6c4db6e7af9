from __future__ import annotations

import zlib
from itertools import count

import pytest

from netlab.capture.records import PacketRecord
from netlab.capture.schemas import Direction
from netlab.medium.verdicts import Verdict
from netlab.traces.links import PacketLinks

MACS = {node: bytes([2, 0, 0, 0, 0, number]) for number, node in enumerate("abc", start=1)}
SERIAL = count()


class Air:
    """Frames cross where told."""

    def __init__(self) -> None:
        self.links = PacketLinks({mac: (node, "eth0") for node, mac in MACS.items()})

    def send(self, sender: str, target: str, *receivers: str, copies: int = 1) -> None:
        destination = MACS.get(target, b"\xff" * 6)
        frame = destination + MACS[sender] + b"\x08\x00" + b"%040d" % next(SERIAL)
        self.see(sender, frame, Direction.OUTBOUND)
        for receiver in receivers:
            for _ in range(copies):
                self.see(receiver, frame, Direction.INBOUND)

    def see(self, node: str, frame: bytes, direction: Direction) -> None:
        self.links.packet(PacketRecord(0, node, "eth0", direction, 1, len(frame), zlib.crc32(frame), frame))

    def told(self) -> dict[str, tuple[int, dict[Verdict, int]]]:
        return {
            f"{sender[0]}{receiver[0]}": (counts.frames, counts.verdicts)
            for (sender, receiver), counts in self.links.counts().items()
        }


@pytest.fixture
def air() -> Air:
    return Air()


def test_unicast_frames_count_for_their_addressee_only(air: Air) -> None:
    air.send("a", "b", "b", "c")  # c overhears it
    air.send("a", "b")
    assert air.told() == {"ab": (2, {Verdict.DELIVERED: 1, Verdict.LOST: 1})}


def test_group_frames_count_for_everybody_who_ever_heard_the_sender(air: Air) -> None:
    air.send("a", "all", "b", "c")
    air.send("a", "all", "b")
    air.send("b", "all")
    assert air.told() == {"ab": (2, {Verdict.DELIVERED: 2}), "ac": (2, {Verdict.DELIVERED: 1, Verdict.LOST: 1})}


def test_a_peer_that_never_answers_shows_as_all_lost(air: Air) -> None:
    air.send("a", "b")
    assert air.told() == {"ab": (1, {Verdict.LOST: 1})}


def test_copies_do_not_make_up_for_losses_of_others(air: Air) -> None:
    air.send("a", "b", "b", copies=3)
    air.send("a", "b")
    assert air.told() == {"ab": (2, {Verdict.DELIVERED: 1, Verdict.LOST: 1})}


def test_equal_frames_count_each_time(air: Air) -> None:
    frame = MACS["b"] + MACS["a"] + bytes(50)
    for _ in range(3):
        air.see("a", frame, Direction.OUTBOUND)
        air.see("b", frame, Direction.INBOUND)
    assert air.told() == {"ab": (3, {Verdict.DELIVERED: 3})}


def test_frames_to_strangers_and_empty_ones_are_left_out(air: Air) -> None:
    air.links = PacketLinks({})
    air.send("a", "b", "b")
    air.send("a", "all")
    air.see("a", b"", Direction.OUTBOUND)
    assert air.told() == {}
