"""Datagrams of udp_mesh: any sound one and damage to it, by chance (``rng``), and odd ones with their reasons."""

from __future__ import annotations

from random import Random
from typing import Any

from scapy.packet import Packet, Raw

from netlab.scapy_layers.udp_mesh import (
    Ack,
    AckRange,
    Backlog,
    Data,
    Floor,
    Hello,
    Link,
    Ping,
    Probe,
    Purged,
    UdpMesh,
)

TOPICS = [
    "t",
    "telemetry",
    "map/3",
    "größe",
    "雪",
    "x" * 255,
    "\x7f\x80\u07ff\u0800\ud7ff\ue000\uffff\U00010000\U0010ffff",
]
EPOCHS = [0x11_0000_0007, 0x22_0000_0008, 0xFFFF_FFFF_FFFF_FFFF]


def _tags(rng: Random) -> list[int]:
    return [rng.choice([0, 7, 8, rng.getrandbits(32)]) for _ in range(rng.choice([0, 1, 2, 40]))]


def _data(rng: Random) -> Packet:
    count = rng.choice([1, 2, 3, 65535])
    index = rng.choice([0, count - 1])
    topic = {"topic": rng.choice(TOPICS).encode()} if index == 0 else {}
    return Data(
        flags=rng.choice([0, 0, 0, 1]),
        priority=rng.randrange(256),
        message_id=rng.choice([rng.randrange(20), rng.getrandbits(48)]),
        index=index,
        count=count,
        data=rng.randbytes(rng.choice([0, 1, 30])),
        **topic,
    )


def _ack(rng: Random) -> Packet:
    ranges = [AckRange(gap=rng.randrange(100), length=rng.randrange(100)) for _ in range(rng.choice([0, 1, 5]))]
    first_range = rng.choice([0, 3, 0xFFFF])
    least = first_range + sum(pair.gap + pair.length + 2 for pair in ranges)
    largest = rng.choice([least, least + rng.randrange(1000), (1 << 48) - 1])
    clocks = {"received_us": rng.getrandbits(32), "delay_us": rng.getrandbits(32)}
    return Ack(largest=largest, first_range=first_range, ranges=ranges, **clocks)


def _hello(rng: Random) -> Packet:
    node = rng.choice([b"base", b"robot 1", b"x" * 63])
    return Hello(interval_ms=rng.getrandbits(16), floor=rng.getrandbits(48), heard=_tags(rng), node=node)


def _link(rng: Random) -> Packet:
    numbers = {"number": rng.randrange(256), "rounds": rng.randrange(256)}
    return Link(mtu_bytes=rng.getrandbits(16), rate_bps=rng.getrandbits(32), reached=_tags(rng), **numbers)


def _frame(rng: Random) -> Packet:
    makers = [
        lambda: _data(rng),
        lambda: _ack(rng),
        lambda: _hello(rng),
        lambda: Probe(wanted=_tags(rng)),
        Ping,
        lambda: Floor(message_id=rng.getrandbits(48)),
        lambda: Purged(message_id=rng.getrandbits(48)),
        lambda: Backlog(priority=rng.randrange(256)),
        lambda: _link(rng),
    ]
    return rng.choice(makers)()


def random_datagram(rng: Random) -> bytes:
    """Return a datagram that every decoder takes."""
    return bytes(
        UdpMesh(
            flags=rng.choice([0, 1, 2, 3, 8, 11]),
            epoch=rng.choice(EPOCHS),
            destination_tag=rng.choice([0, 7, 8]),
            packet_number=rng.choice([rng.randrange(50), rng.getrandbits(48)]),
            frames=[_frame(rng) for _ in range(rng.randrange(5))],
        )
    )


def damaged(datagram: bytes, rng: Random) -> bytes:
    """Return it cut, longer, or with one byte changed; by chance still a sound one."""
    match rng.randrange(4):
        case 0:
            return datagram[: rng.randrange(len(datagram))]
        case 1:
            return datagram + rng.randbytes(rng.randrange(1, 4))
        case _:
            changed = bytearray(datagram)
            changed[rng.choice([2, 3, rng.randrange(2, len(changed))])] = rng.randrange(256)
            return bytes(changed)


#: What -> (frames, or other values of the header, and the reason).
ODD: dict[str, tuple[dict[str, Any], str]] = {
    "another protocol": ({"magic": b"uX"}, "foreign"),
    "a later version": ({"version": 2}, "unknown_version"),
    "version 0": ({"version": 0}, "unknown_version"),
    "a flag of the future": ({"flags": 0x10}, "unknown_flags"),
    "sealed, and we have no key": ({"flags": 0x04, "sealed": bytes(40)}, "sealed"),
    "an unknown frame": ({"frames": [Ping(), Raw(b"\x09")]}, "unknown_frame"),
    "frame type 0": ({"frames": [Raw(bytes(30))]}, "unknown_frame"),
    "an index beyond the count": ({"frames": [Data(index=2, count=2, data=b"x")]}, "impossible_value"),
    "no fragments": ({"frames": [Data(index=0, count=0, topic=b"t")]}, "impossible_value"),
    "an unknown flag of a message": ({"frames": [Data(flags=2, topic=b"t")]}, "impossible_value"),
    "no topic": ({"frames": [Data(topic=b"", data=b"x")]}, "impossible_value"),
    "a topic longer than its frame": (
        {"frames": [Data(topic=b"t", topic_length=9, length=3, data=b"x")]},
        "impossible_value",
    ),
    "a topic that is no text": ({"frames": [Data(topic=b"\xff\xfe")]}, "impossible_value"),
    "a letter cut short": ({"frames": [Data(topic=b"\xe2\x82")]}, "impossible_value"),
    "a letter that goes on wrong": ({"frames": [Data(topic=b"\xe2\x82\xc0")]}, "impossible_value"),
    "two bytes where one would do": ({"frames": [Data(topic=b"\xc1\xbf")]}, "impossible_value"),
    "three bytes where two would do": ({"frames": [Data(topic=b"\xe0\x9f\xbf")]}, "impossible_value"),
    "four bytes where three would do": ({"frames": [Data(topic=b"\xf0\x8f\xbf\xbf")]}, "impossible_value"),
    "half a pair of UTF-16": ({"frames": [Data(topic=b"\xed\xa0\x80")]}, "impossible_value"),
    "a letter beyond Unicode": ({"frames": [Data(topic=b"\xf4\x90\x80\x80")]}, "impossible_value"),
    "a length beyond the datagram": ({"frames": [Data(topic=b"t", length=900)]}, "truncated"),
    "a length of which the rest is no frame": (
        {"frames": [Data(topic=b"t", length=2, data=b"\xee\xee")]},
        "unknown_frame",
    ),
    "a head cut short": ({"frames": [Raw(bytes(Data(topic=b"t"))[:9])]}, "truncated"),
    "acknowledged below packet 0": ({"frames": [Ack(largest=3, first_range=9)]}, "impossible_value"),
    "a gap below packet 0": ({"frames": [Ack(largest=9, ranges=[AckRange(gap=8)])]}, "impossible_value"),
    "more ranges than there are": ({"frames": [Ack(largest=9, further=7, ranges=[AckRange()])]}, "truncated"),
    "a name longer than its frame": ({"frames": [Hello(node=b"x", name_length=60)]}, "truncated"),
    "no name": ({"frames": [Hello(node=b"")]}, "impossible_value"),
    "a name that is too long": ({"frames": [Hello(node=b"x" * 64)]}, "impossible_value"),
    "a name with a line feed": ({"frames": [Hello(node=b"a\nb")]}, "impossible_value"),
    "more tags than there are": ({"frames": [Probe(tags=200, wanted=[1])]}, "truncated"),
    "a link of more nodes than there are": ({"frames": [Link(tags=9, reached=[1])]}, "truncated"),
    "half a floor": ({"frames": [Raw(bytes(Floor(message_id=9))[:4])]}, "truncated"),
    "half a backlog": ({"frames": [Raw(bytes(Backlog())[:1])]}, "truncated"),
    "a header cut short": ({"frames": []}, "truncated"),
}


def odd_datagram(name: str, *, epoch: int, tag: int, number: int) -> tuple[bytes, str]:
    """Return the bytes, as if from a sender that is known, and the reason for which they are dropped."""
    values, reason = ODD[name]
    header = {"epoch": epoch, "destination_tag": tag, "packet_number": number}
    data = bytes(UdpMesh(**{**header, **values}))
    return (data[:20] if name == "a header cut short" else data), reason
