"""batman-adv frames for people. The golden ones were captured from Linux 6.1 (batman-adv 2022.3)."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from netlab.capture.batman import ETHERTYPE, inner_offset
from netlab.capture.describe import describe_frame

HEAD = bytes.fromhex("ffffffffffff02cf8b6faa8f4305")
OGM = HEAD + bytes.fromhex(
    "000f3200149a056702cf8b6faa8f02cf8b6faa8f00ff00200401001801010001a36377a90000000000000000024e4d00000200000201 0000"
)
ARP = bytes.fromhex("ffffffffffff024e4d0000010806000108000604 0001024e4d0000010af00001 0000000000000af00003")


def test_a_routing_message() -> None:
    assert describe_frame(OGM, 1) == "batman-adv OGM of 02:cf:8b:6f:aa:8f #345638247 tq 255 ttl 50 70 B"


def test_what_travels_inside_is_told_too() -> None:
    inside = "ARP who has 10.240.0.3, tell 10.240.0.1"
    assert describe_frame(ARP, 1) == inside
    unicast = HEAD + bytes.fromhex("400f3202024e4c000003") + ARP
    assert describe_frame(unicast, 1) == f"batman-adv unicast to 02:4e:4c:00:00:03: {inside}"
    addressed = HEAD + bytes.fromhex("420f3202024e4c000003 024e4c000000 0100") + ARP
    assert describe_frame(addressed, 1) == f"batman-adv unicast to 02:4e:4c:00:00:03: {inside}"
    broadcast = HEAD + bytes.fromhex("010f3200 00000007 024e4c000000") + ARP
    assert describe_frame(broadcast, 1) == f"batman-adv broadcast: {inside}"


def test_messages_of_version_five() -> None:
    ogm = HEAD + bytes.fromhex("040f3200 00000009 024e4c000000 0000 000186a0")
    assert describe_frame(ogm, 1) == "batman-adv OGMv2 of 02:4e:4c:00:00:00 #9 10000 Mbit/s ttl 50 34 B"
    probe = HEAD + bytes.fromhex("030f 024e4c000000 00000002 000001f4")
    assert describe_frame(probe, 1) == "batman-adv ELP of 02:4e:4c:00:00:00 #2 30 B"


@given(st.binary(max_size=80))
def test_any_bytes_are_described(tail: bytes) -> None:
    frame = HEAD + tail
    assert describe_frame(frame, 1).startswith("batman-adv")
    inner = inner_offset(frame, 14)
    assert inner is None or len(frame) >= inner + 14
    assert frame[12:14] == ETHERTYPE.to_bytes(2, "big")
