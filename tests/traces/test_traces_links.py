from __future__ import annotations

import zlib
from itertools import count

import pytest

from netlab.capture.records import PacketRecord
from netlab.capture.schemas import Direction
from netlab.medium.verdicts import Verdict
from netlab.traces.links import KernelCounts, PacketLinks

MACS = {node: bytes([2, 0, 0, 0, 0, number]) for number, node in enumerate("abc", start=1)}
SERIAL = count()


class Air:
    """Frames cross where told."""

    def __init__(self) -> None:
        self.links = PacketLinks({mac: (node, "eth0") for node, mac in MACS.items()})

    def send(self, sender: str, target: str, *receivers: str, copies: int = 1, t_ns: int = 0) -> None:
        destination = MACS.get(target, b"\xff" * 6)
        frame = destination + MACS[sender] + b"\x08\x00" + b"%040d" % next(SERIAL)
        self.see(sender, frame, Direction.OUTBOUND, t_ns)
        for receiver in receivers:
            for _ in range(copies):
                self.see(receiver, frame, Direction.INBOUND, t_ns)

    def see(self, node: str, frame: bytes, direction: Direction, t_ns: int = 0) -> None:
        self.links.packet(PacketRecord(t_ns, node, "eth0", direction, 1, len(frame), zlib.crc32(frame), frame))

    def state(self, pair: str, state: str, counts: KernelCounts | None = None, *, corrupts: bool = False) -> None:
        ends = (pair[0], "eth0"), (pair[1], "eth0")
        self.links.state(ends, state, corrupts=corrupts, counts=counts)

    def told(self) -> dict[str, tuple[int, dict[Verdict, int], int]]:
        """By pair: frames, verdicts, and what may be lost or queue full."""
        return {
            f"{sender[0]}{receiver[0]}": (counts.frames, counts.verdicts, counts.lost_or_queue_full)
            for (sender, receiver), counts in self.links.counts().items()
        }


NOTHING_YET = KernelCounts(queue_full=0, waiting=0, reordered=0)


@pytest.fixture
def air() -> Air:
    return Air()


def test_unicast_frames_count_for_their_addressee_only(air: Air) -> None:
    air.send("a", "b", "b", "c")  # c overhears it
    air.send("a", "b")
    assert air.told() == {"ab": (2, {Verdict.DELIVERED: 1}, 1)}


def test_an_arrival_in_the_instant_of_its_departure_may_be_recorded_first(air: Air) -> None:
    frame = MACS["b"] + MACS["a"] + b"\x08\x00now"
    for node, direction in ("bI", "bI", "aO", "aO", "bI"):
        air.see(node, frame, Direction.OUTBOUND if direction == "O" else Direction.INBOUND)
    assert air.told() == {"ab": (3, {Verdict.DELIVERED: 2, Verdict.DUPLICATED: 1}, 0)}


def test_an_arrival_before_the_instant_of_its_departure_is_another_frames(air: Air) -> None:
    frame = MACS["b"] + MACS["a"] + b"\x08\x00now"
    air.see("b", frame, Direction.INBOUND, t_ns=1)
    air.see("a", frame, Direction.OUTBOUND, t_ns=2)
    assert air.told() == {"ab": (1, {}, 1)}


def test_group_frames_count_for_everybody_who_ever_heard_the_sender(air: Air) -> None:
    air.send("a", "all", "b", "c")
    air.send("a", "all", "b")
    air.send("b", "all")
    assert air.told() == {"ab": (2, {Verdict.DELIVERED: 2}, 0), "ac": (2, {Verdict.DELIVERED: 1}, 1)}


def test_a_peer_that_never_answers_shows_as_all_missing(air: Air) -> None:
    air.send("a", "b")
    assert air.told() == {"ab": (1, {}, 1)}


def test_copies_do_not_make_up_for_losses_of_others(air: Air) -> None:
    air.send("a", "b", "b", copies=3)
    air.send("a", "b")
    assert air.told() == {"ab": (4, {Verdict.DELIVERED: 1, Verdict.DUPLICATED: 2}, 1)}


def test_equal_frames_count_each_time_also_when_under_way_together(air: Air) -> None:
    frame = MACS["b"] + MACS["a"] + bytes(50)
    for _ in range(3):
        air.see("a", frame, Direction.OUTBOUND)
    for _ in range(2):
        air.see("b", frame, Direction.INBOUND)
    assert air.told() == {"ab": (3, {Verdict.DELIVERED: 2}, 1)}


def test_the_kernels_counters_tell_full_queues_from_losses(air: Air) -> None:
    air.state("ab", "up", KernelCounts(queue_full=10, waiting=0, reordered=5))
    for _ in range(7):
        air.send("a", "b")
    air.send("a", "b", "b")
    air.state("ab", "up")  # a change without counters
    air.state("ab", "up", KernelCounts(queue_full=14, waiting=2, reordered=6))
    assert air.told() == {"ab": (6, {Verdict.REORDERED: 1, Verdict.QUEUE_FULL: 4, Verdict.LOST: 1}, 0)}


@pytest.mark.parametrize("last", [None, KernelCounts(queue_full=None, waiting=0, reordered=0)])
def test_without_the_last_counters_nothing_is_claimed(air: Air, last: KernelCounts | None) -> None:
    air.state("ab", "up", NOTHING_YET)
    air.send("a", "b")
    air.state("ab", "up", last)
    assert air.told() == {"ab": (1, {}, 1)}


def test_frames_under_way_at_the_end_do_not_count(air: Air) -> None:
    air.state("ab", "up", NOTHING_YET)
    air.send("a", "b", "b")
    air.send("a", "b")
    air.state("ab", "up", KernelCounts(queue_full=0, waiting=1, reordered=0))
    assert air.told() == {"ab": (1, {Verdict.DELIVERED: 1}, 0)}


@pytest.mark.parametrize(
    ("state", "verdict"),
    [
        ("outage", Verdict.OUTAGE),
        ("no_carrier", Verdict.OUTAGE),
        ("out_of_range", Verdict.OUT_OF_RANGE),
    ],
)
def test_what_is_sent_while_nothing_arrives_has_its_reason(air: Air, state: str, verdict: Verdict) -> None:
    air.state("ab", "up", NOTHING_YET)
    air.state("ac", "up", NOTHING_YET)
    air.send("a", "all", "b", "c")
    air.state("ab", state)
    air.send("a", "all", "c")
    air.send("a", "b")
    air.send("a", "c", "c")
    air.state("ab", "up", NOTHING_YET)
    air.state("ac", "up", NOTHING_YET)
    air.send("a", "b", "b")
    assert air.told() == {
        "ab": (4, {Verdict.DELIVERED: 2, verdict: 2}, 0),
        "ac": (3, {Verdict.DELIVERED: 3}, 0),
    }


def test_what_arrives_all_the_same_was_sent_in_the_instant_of_the_change(air: Air) -> None:
    air.state("ab", "outage")
    air.send("a", "b", "b")
    assert air.told() == {"ab": (1, {Verdict.DELIVERED: 1}, 0)}


def test_frames_that_nobody_sent_are_corrupted_ones_where_frames_are_corrupted(air: Air) -> None:
    changed = MACS["b"] + MACS["a"] + b"\x08\x00" + bytes(40)
    for t_ns, corrupts in enumerate((False, True)):
        air.see("b", b"", Direction.INBOUND, t_ns=t_ns)
        air.state("ab", "up", NOTHING_YET, corrupts=corrupts)
        air.send("a", "b", t_ns=t_ns)
        air.see("b", changed, Direction.INBOUND, t_ns=t_ns)
    air.state("ab", "up", KernelCounts(0, 0, 0))
    assert air.told() == {"ab": (2, {Verdict.CORRUPTED: 1, Verdict.LOST: 1}, 0)}


def test_frames_to_strangers_and_empty_ones_are_left_out(air: Air) -> None:
    air.links = PacketLinks({})
    air.send("a", "b", "b")
    air.send("a", "all")
    air.see("a", b"", Direction.OUTBOUND)
    assert air.told() == {}
