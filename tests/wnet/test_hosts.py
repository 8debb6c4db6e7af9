"""What is read of the host: its ARP, its groups; and what it is told."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wnet.core import groups
from wnet.core.arp import Arp
from wnet.core.groups import Groups, Membership, mac_of

scapy = pytest.importorskip("scapy.all", reason="scapy is missing: make venv")

OWN, OTHER = bytes((2, 0, 0, 0, 0, 1)), bytes((2, 0, 0, 0, 0, 2))
MINE, THEIRS = bytes((10, 0, 0, 1)), bytes((10, 0, 0, 2))
OWNERS = {THEIRS: OTHER}


def arp(operation: int, sender: bytes, target: bytes, sender_mac: bytes = OWN) -> bytes:
    return (
        b"\xff" * 6
        + sender_mac
        + b"\x08\x06"
        + struct.pack("!HHBBH6s4s6s4s", 1, 0x0800, 6, 4, operation, sender_mac, sender, bytes(6), target)
    )


def test_a_request_for_a_known_address_is_answered_as_its_owner_would() -> None:
    answer = Arp(OWN).read(arp(1, MINE, THEIRS), OWNERS)
    assert answer is not None
    read = scapy.Ether(answer)[scapy.ARP]
    assert (read.op, read.hwsrc, read.psrc, read.hwdst, read.pdst) == (
        2,
        OTHER.hex(":"),
        "10.0.0.2",
        OWN.hex(":"),
        "10.0.0.1",
    )
    assert answer[:12] == OWN + OTHER


@pytest.mark.parametrize(
    "frame",
    [
        arp(1, MINE, bytes((10, 0, 0, 9))),
        arp(1, MINE, MINE),
        arp(2, MINE, THEIRS),
        arp(1, MINE, THEIRS, sender_mac=OTHER),
        arp(1, MINE, THEIRS)[:30],
    ],
    ids=["unknown", "gratuitous", "a reply", "not ours", "cut off"],
)
def test_everything_else_is_not_answered(frame: bytes) -> None:
    assert Arp(OWN).read(frame, OWNERS) is None


def test_own_addresses_are_learnt_from_own_arp_and_told_ones_come_first() -> None:
    book = Arp(OWN)
    for n in range(40):
        book.read(arp(1, bytes((10, 0, 1, n)), THEIRS), {})
    assert len(book.addresses) == 16
    assert book.addresses[0] == bytes((10, 0, 1, 39))
    book.tell([MINE])
    assert book.addresses == (MINE,)


def ipv4(payload: bytes) -> bytes:
    return (
        mac_of(bytes((224, 0, 0, 22)))
        + OWN
        + b"\x08\x00"
        + bytes(scapy.IP(dst="224.0.0.22", ttl=1, proto=2, options=[scapy.IPOption_Router_Alert()]) / payload)
    )


def test_igmp_reports_and_leaves_are_read() -> None:
    group = bytes((239, 1, 2, 3))
    assert groups.read(ipv4(b"\x16\0\0\0" + group)) == [Membership(group, True)]
    assert groups.read(ipv4(b"\x17\0\0\0" + group)) == [Membership(group, False)]
    source = bytes((10, 0, 0, 9))
    records = [  # RFC 3376, 4.2: type, length of auxiliary data, number of sources, group, sources
        b"\4\0\0\0" + group,
        b"\3\0\0\0" + bytes((239, 1, 2, 4)),
        b"\1\1\0\1" + bytes((239, 1, 2, 5)) + source + b"more",
        b"\6\0\0\1" + bytes((239, 1, 2, 6)) + source,
    ]
    report = b"\x22\0\0\0\0\0\0\4" + b"".join(records)
    read = groups.read(ipv4(report))
    assert read is not None
    assert [(m.group[3], m.is_joined) for m in read] == [(3, True), (4, False), (5, True)]


def test_mld_reports_are_read() -> None:
    hop = scapy.IPv6ExtHdrHopByHop(options=[scapy.RouterAlert()])
    head = mac_of(bytes(12) + bytes(3) + b"\x16") + OWN + b"\x86\xdd"
    group = "ff02::1:ff00:1"
    report = scapy.ICMPv6MLReport2(records=[scapy.ICMPv6MLDMultAddrRec(rtype=4, dst=group)])
    read = groups.read(head + bytes(scapy.IPv6(src="fe80::1", dst="ff02::16", hlim=1) / hop / report))
    assert read is not None
    assert mac_of(read[0].group) == bytes.fromhex("3333ff000001")
    first = head + bytes(scapy.IPv6(src="fe80::1", dst=group, hlim=1) / hop / scapy.ICMPv6MLReport(mladdr=group))
    assert groups.read(first) == [Membership(read[0].group, True)]


@given(st.sampled_from([b"\x08\x00", b"\x86\xdd"]), st.binary(max_size=100))
def test_reading_reports_never_raises(ethertype: bytes, rest: bytes) -> None:
    groups.read(bytes(12) + ethertype + rest)
    for kind in (0x22, 0x16):
        groups.read(bytes(12) + b"\x08\x00\x46" + bytes(8) + b"\x02" + bytes(14) + bytes((kind,)) + rest)
    head = bytes((0x60, 0, 0, 0, 0, 9, 0, 1)) + bytes(32)
    groups.read(bytes(12) + b"\x86\xdd" + head + b"\x3a\0\5\2\0\0\1\0\x8f" + rest)


def test_queries_are_such_as_a_host_believes() -> None:
    packet = groups.igmp_query(OWN)[14:]
    assert (packet[0], packet[8], packet[20:24]) == (0x46, 1, b"\x94\4\0\0")
    assert scapy.checksum(packet[:24]) == scapy.checksum(packet[24:]) == 0
    mld = scapy.Ether(groups.mld_query(OWN))
    query = mld[scapy.ICMPv6MLQuery2]
    told = query.cksum
    del query.cksum
    assert scapy.Ether(bytes(mld))[scapy.ICMPv6MLQuery2].cksum == told
    assert mld[scapy.IPv6].src.startswith("fe80::")
    assert mld[scapy.IPv6].hlim == 1
    assert mld.src != OWN.hex(":")


def test_memberships_are_forgotten_when_they_are_not_told_again() -> None:
    held = Groups(OWN, now=0.0)
    held.take([Membership(bytes((239, 0, 0, n)), True) for n in range(20)], now=0.0)
    assert len(held.macs) == 16
    held.take([Membership(bytes((239, 0, 0, n)), False) for n in range(1, 20)], now=0.0)
    assert held.macs == (bytes.fromhex("01005e000000"),)
    held.handle(now=60.0)
    assert held.macs
    held.handle(now=90.0)
    assert held.macs == ()
