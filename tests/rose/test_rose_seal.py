"""Group keys: without one nothing is readable, accepted or changed; with one, keys can be changed without a gap."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rose.core.addressing import ServiceId
from rose.core.keys import KeyRing, parse_key
from rose.core.messages import Done
from rose.core.station import Published, Station, Whole
from rose.core.wire import Fault
from tests.rose.messages import Note

LASER, MAP = ServiceId.parse("10.0.0.1/0.1"), ServiceId.parse("10.0.0.2/0.2")
KEY, OTHER = bytes(range(32)), bytes(range(32, 64))
S = 1_000_000_000
NOW_NS = 100_000 * S


def station(sid: ServiceId, keys: KeyRing | None, *, epoch_ns: int = NOW_NS) -> Station:
    made = Station(sid, epoch_ns=epoch_ns, keys=keys)
    if sid == MAP:
        made.subscribe(LASER, Note)
    return made


def received(at: Station, datagrams: list[bytes], *, wall_ns: int = NOW_NS) -> list[object]:
    texts: list[object] = []
    for datagram in datagrams:
        got = at.receive(datagram, now=1.0, wall_ns=wall_ns)
        texts += [s.message.text for s in got.samples] if isinstance(got, Published) else []  # type: ignore[attr-defined]
    return texts


def note(at: Station, text: str = "secret plan", *, wall_ns: int = NOW_NS) -> list[bytes]:
    return at.publish(Note(text), wall_ns=wall_ns)


def test_with_the_key_it_is_read_and_without_it_it_is_not() -> None:
    sent = note(station(LASER, KeyRing(team=[KEY])))
    assert b"secret" not in b"".join(sent)
    assert received(station(MAP, KeyRing(team=[KEY])), sent) == ["secret plan"]
    blind = station(MAP, None)
    assert received(blind, sent) == []
    assert blind.faults == {Fault.UNKNOWN_KEY: 1}
    stranger = station(MAP, KeyRing(team=[OTHER]))
    assert received(stranger, sent) == []
    assert stranger.faults == {Fault.UNKNOWN_KEY: 1}


def test_who_expects_a_seal_takes_nothing_open() -> None:
    at = station(MAP, KeyRing(by_service={LASER: [KEY]}))
    assert received(at, note(station(LASER, None))) == []
    assert at.faults == {Fault.UNSEALED: 1}


def test_a_keyed_service_takes_no_orders_from_those_without() -> None:
    laser = Station(LASER, epoch_ns=NOW_NS, keys=KeyRing(by_service={LASER: [KEY]}))
    _number, frames = Station(MAP, epoch_ns=NOW_NS).command(Done(), LASER, wall_ns=NOW_NS)
    for datagram in Station(MAP, epoch_ns=NOW_NS).datagrams(frames):
        assert laser.receive(datagram, now=1.0, wall_ns=NOW_NS) is None
    assert laser.faults == {Fault.UNSEALED: 1}


def test_groups_are_apart() -> None:
    """Two services with keys of their own: who knows one key reads one of them."""
    ring = KeyRing(by_service={LASER: [KEY], MAP: [OTHER]})
    sent = note(station(LASER, ring))
    reader = Station(ServiceId.parse("10.0.0.3/0.3"), epoch_ns=NOW_NS, keys=KeyRing(by_service={MAP: [OTHER]}))
    reader.subscribe(LASER, Note)
    assert received(reader, sent) == []


@given(st.data())
def test_no_changed_bit_is_accepted(data: st.DataObject) -> None:
    (sent,) = note(station(LASER, KeyRing(team=[KEY])))
    at = station(MAP, KeyRing(team=[KEY]))
    place, bit = data.draw(st.integers(0, len(sent) - 1)), data.draw(st.integers(0, 7))
    changed = bytearray(sent)
    changed[place] ^= 1 << bit
    assert received(at, [bytes(changed)]) == []
    assert received(at, [sent]) == ["secret plan"]  # and nothing was changed by it


def test_replays_are_dropped() -> None:
    sent = note(station(LASER, KeyRing(team=[KEY])))
    at = station(MAP, KeyRing(team=[KEY]))
    assert received(at, sent + sent) == ["secret plan"]
    assert at.faults == {Fault.REPLAYED: 1}


def test_a_recording_of_an_earlier_start_is_dropped() -> None:
    ring = KeyRing(team=[KEY])
    old = note(station(LASER, ring, epoch_ns=NOW_NS - 10 * S), "old", wall_ns=NOW_NS - 10 * S)
    at = station(MAP, ring)
    assert received(at, note(station(LASER, ring), "new") + old) == ["new"]
    assert at.faults == {Fault.REPLAYED: 1}


def test_a_subscriber_that_starts_afresh_does_not_believe_an_old_recording() -> None:
    ring = KeyRing(team=[KEY])
    old = note(station(LASER, ring, epoch_ns=NOW_NS - 3600 * S), "old", wall_ns=NOW_NS - 3600 * S)
    at = station(MAP, ring)
    assert received(at, old) == []
    assert at.faults == {Fault.STALE: 1}
    assert received(at, note(station(LASER, ring), "new")) == ["new"]


def test_keys_are_changed_without_a_gap() -> None:
    """The order of docs/rose.md: add the new one behind, put it first at the sender, remove the old one."""
    steps = [([KEY], [KEY]), ([KEY], [KEY, OTHER]), ([OTHER, KEY], [KEY, OTHER]), ([OTHER], [OTHER])]
    at = station(MAP, KeyRing(team=steps[0][1]))
    for number, (sender_keys, receiver_keys) in enumerate(steps):
        laser = station(LASER, KeyRing(team=sender_keys), epoch_ns=NOW_NS + number)
        at = station(MAP, KeyRing(team=receiver_keys))
        assert received(at, note(laser, str(number))) == [str(number)]
    assert received(at, note(station(LASER, KeyRing(team=[KEY])))) == []


def test_a_repeated_command_is_no_replay() -> None:
    ring = KeyRing(team=[KEY])
    asker, laser = Station(MAP, epoch_ns=NOW_NS, keys=ring), Station(LASER, epoch_ns=NOW_NS, keys=ring)
    _number, frames = asker.command(Note("go"), LASER, wall_ns=NOW_NS)
    for _ in range(2):
        (datagram,) = asker.datagrams(frames)
        assert isinstance(laser.receive(datagram, now=1.0, wall_ns=NOW_NS), Whole)


@pytest.mark.parametrize("text", ["", "00", "zz" * 32, "00" * 33, "00 " * 32])
def test_what_is_no_key_is_refused_without_being_repeated(text: str) -> None:
    with pytest.raises(ValueError, match="64 hexadecimal digits") as caught:
        parse_key(text)
    assert not text or text not in str(caught.value)
