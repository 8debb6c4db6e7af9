"""Datagrams of udp_mesh by chance: any sound one, and damage to it. Everything comes from the passed ``rng``."""

from __future__ import annotations

from random import Random

from scapy.packet import Packet

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

TOPICS = ["t", "telemetry", "map/3", "größe", "雪", "x" * 255]
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
