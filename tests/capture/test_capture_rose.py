"""What `netlab inspect` says of rose's datagrams."""

from __future__ import annotations

from netlab.capture import rose as frames
from rose.core.addressing import ServiceId
from rose.core.messages import Done
from rose.core.station import Station

LASER, MAP = ServiceId.parse("10.0.0.1/0.1"), ServiceId.parse("10.0.0.2/0.2")


def told(datagram: bytes) -> str | None:
    header = frames.header_of(datagram)
    return None if header is None else frames.describe(header)


def test_datagrams_in_one_line() -> None:
    laser = Station(LASER, epoch_ns=1)
    (published,) = laser.publish(Done(), wall_ns=1)
    assert told(published) == "rose 10.0.0.1/0.1 publishes #0 rose/done"
    _number, frames_ = laser.command(Done(), MAP, wall_ns=1)
    assert told(laser.datagrams(frames_)[0]) == "rose 10.0.0.1/0.1 commands #0 rose/done"


def test_foreign_bytes_are_not_ours() -> None:
    assert told(b"") is None
    assert told(b"hello") is None
    assert told(b"RS" + bytes(100)) is None
