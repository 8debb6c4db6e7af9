"""The team's key: bytes written down once, what opens, and what is believed of it."""

from __future__ import annotations

from collections.abc import Callable
from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from udp_mesh.core import wire, wire_seal
from udp_mesh.core.events import MessageDelivered, PeerUp
from udp_mesh.core.keys import epoch_key, key_id, parse_key
from udp_mesh.core.mesh import MeshCore, Path, new_epoch
from udp_mesh.core.packets import BadDatagram
from udp_mesh.core.replay import WINDOW, ReplayWindow
from udp_mesh.core.seal import Opened, Seal
from udp_mesh.core.settings import Settings
from udp_mesh.core.wire_links import mark_bridged

KEY, OTHER_KEY, THIRD_KEY = bytes(range(32)), bytes(range(1, 33)), bytes(range(2, 34))
EPOCH = 0x1122334455667788
HEADER = "754d 01 02 1122334455667788 00000007 000000000009"
PLAIN = bytes.fromhex(HEADER) + wire.PING
SEALED = bytes.fromhex(
    "754d 01 06 1122334455667788 00000007 000000000009 93 00 000000000000 5a 0bef7f5e37466a62d0fc62ea82ecbf57"
)
SEALED_LATER = bytes.fromhex(
    "754d 01 06 1122334455667788 00000007 000000000009 93 00 000000000001 11 f2a36112eb8c954f527cd30c25b4d2ef"
)
SEALED_ON_ANOTHER_CARRIER = bytes.fromhex(
    "754d 01 06 1122334455667788 00000007 000000000009 93 01 000000000002 90 356c114556471c20a5e0c34c051e7cf9"
)


def opened(seal: Seal, datagram: bytes) -> bytes | BadDatagram:
    view = memoryview(datagram)
    header = wire_seal.decode_clear(view)
    if isinstance(header, BadDatagram):
        return header
    result = seal.open(header, view)
    return result.data if isinstance(result, Opened) else result


def test_keys_and_what_is_derived_from_them_are_the_documented_bytes() -> None:
    assert parse_key("000102030405060708090a0b0c0d0e0f101112131415161718191a1b1c1d1e1f") == KEY
    assert key_id(KEY) == 0x93
    assert epoch_key(KEY, EPOCH).hex() == "f3da429be99faaecbb74532d8737f91520bf265739af3f907c1e6130a95946ef"


@pytest.mark.parametrize("text", ["", "00" * 31, "00" * 33, "zz" * 32, "00 " * 32, "team secret"])
def test_anything_but_64_digits_is_no_key_and_is_not_repeated(text: str) -> None:
    with pytest.raises(ValueError, match="64 hexadecimal digits") as caught:
        parse_key(text)
    assert not text or text not in str(caught.value)


def test_sealed_datagrams_are_the_documented_bytes() -> None:
    seal = Seal([KEY], epoch=EPOCH)
    assert seal.seal(PLAIN, len(PLAIN), carrier=5) == SEALED
    assert seal.seal(PLAIN, len(PLAIN), carrier=5) == SEALED_LATER
    assert seal.seal(PLAIN, len(PLAIN), carrier=6) == SEALED_ON_ANOTHER_CARRIER
    assert len(SEALED) == len(PLAIN) + wire.SEAL_BYTES
    assert wire.decode(SEALED) is BadDatagram.SEALED  # who has no key says so


def test_a_run_is_sealed_packet_by_packet() -> None:
    one, many = Seal([KEY], epoch=EPOCH), Seal([KEY], epoch=EPOCH)
    last = PLAIN[:-1]
    singly = b"".join(one.seal(datagram, len(datagram), carrier=0) for datagram in (PLAIN, PLAIN, last))
    assert many.seal(PLAIN + PLAIN + last, len(PLAIN), carrier=0) == singly


def test_each_datagram_opens_once_once_its_sender_is_believed() -> None:
    receiver = Seal([KEY], epoch=1)
    assert opened(receiver, SEALED) == PLAIN
    assert opened(receiver, SEALED) == PLAIN  # nothing is remembered of whom nobody believes
    receiver.believe(EPOCH)
    assert opened(receiver, SEALED) is BadDatagram.REPLAYED
    assert opened(receiver, SEALED_ON_ANOTHER_CARRIER) == PLAIN
    assert opened(receiver, SEALED_ON_ANOTHER_CARRIER) is BadDatagram.REPLAYED
    assert opened(receiver, SEALED_LATER) == PLAIN


def test_belief_needs_the_datagram_that_gives_it() -> None:
    receiver = Seal([KEY], epoch=1)
    receiver.believe(EPOCH)
    view = memoryview(SEALED)
    header = wire_seal.decode_clear(view)
    assert isinstance(header, wire_seal.SealHeader)
    result = receiver.open(header, view)
    assert isinstance(result, Opened)
    assert not result.is_believed


def test_a_foreign_key_a_changed_byte_and_a_plain_datagram_are_told_apart() -> None:
    assert opened(Seal([OTHER_KEY], epoch=1), SEALED) is BadDatagram.UNKNOWN_KEY
    assert opened(Seal([KEY], epoch=1), PLAIN) is BadDatagram.UNSEALED
    assert opened(Seal([KEY], epoch=1), SEALED[:45]) is BadDatagram.TRUNCATED
    assert opened(Seal([KEY], epoch=1), b"\0" * 60) is BadDatagram.FOREIGN


@given(st.integers(3, len(SEALED) - 1), st.integers(1, 255))
def test_no_byte_can_be_changed_but_for_the_mark_of_a_bridge(at: int, mask: int) -> None:
    changed = bytearray(SEALED)
    changed[at] ^= mask
    result = opened(Seal([KEY], epoch=1), bytes(changed))
    assert isinstance(result, BadDatagram) != (bytes(changed) == mark_bridged(SEALED))


def test_what_a_bridge_passes_on_opens_and_tells_so_and_counts_as_the_same() -> None:
    receiver = Seal([KEY], epoch=1)
    assert opened(receiver, mark_bridged(SEALED)) == mark_bridged(PLAIN)
    receiver.believe(EPOCH)
    assert opened(receiver, SEALED) is BadDatagram.REPLAYED


@given(st.binary(max_size=120), st.booleans())
def test_any_bytes_are_refused_without_an_exception(data: bytes, is_ours: bool) -> None:
    datagram = SEALED[:4] + data if is_ours else data
    assert isinstance(opened(Seal([KEY], epoch=1), datagram), BadDatagram)


def test_every_key_opens_and_the_first_one_seals() -> None:
    receiver = Seal([OTHER_KEY, KEY], epoch=EPOCH)
    assert opened(receiver, SEALED) == PLAIN
    answer = receiver.seal(PLAIN, len(PLAIN), carrier=0)
    assert opened(Seal([OTHER_KEY], epoch=2), answer) == PLAIN
    receiver.use([THIRD_KEY])
    assert opened(receiver, SEALED) is BadDatagram.UNKNOWN_KEY
    again = receiver.seal(PLAIN, len(PLAIN), carrier=0)
    assert opened(Seal([THIRD_KEY], epoch=2), again) == PLAIN


@given(st.lists(st.integers(0, 3 * WINDOW), max_size=60))
def test_the_window_takes_each_number_once_and_forgets_only_old_ones(numbers: list[int]) -> None:
    window, taken = ReplayWindow(), set[int]()
    for number in numbers:
        is_new = window.is_new(number)
        if number in taken:
            assert not is_new
        elif number > max(taken, default=0) - WINDOW:
            assert is_new
        if is_new:
            window.take(number)
            taken.add(number)


def core_of(name: str, *keys: bytes, seed: int, now: float = 0.0) -> MeshCore:
    rng = Random(seed)
    core = MeshCore(Settings(name=name, keys=keys), epoch=new_epoch(rng), rng=rng, now=now)
    core.add_carrier(0)
    return core


def test_two_nodes_with_one_key_talk_and_nothing_is_longer_than_set(make_net: Callable) -> None:
    net = make_net(delay_s=0.01, loss_ratio=0.1, duplicate_ratio=0.1, jitter_s=0.004)
    net.keep_datagrams = True
    for name in ("a", "b"):
        net.add(name, keys=(KEY,))
    net.meet()
    for size in (0, 1300, 1331, 1400, 200_000):
        net.publish("a", "t", b"m" * size, to="b")
    assert net.run(10.0, until=lambda: len(net.delivered("b")) == 5)
    assert sorted(len(event.payload) for event in net.delivered("b")) == [0, 1300, 1331, 1400, 200_000]
    sent = [datagram.data for _at, datagram in net.sent["a"]]
    assert max(map(len, sent)) == Settings(name="").payload_bytes
    assert all(b"mmmm" not in data and wire.decode(data) is BadDatagram.SEALED for data in sent)
    assert net.cores["b"].stats()["bad_replayed"] > 0  # the network's duplicates


@pytest.mark.parametrize(
    ("theirs", "ours_counts", "they_count"),
    [((), "bad_unsealed", "bad_sealed"), ((OTHER_KEY,), "bad_unknown_key", "bad_unknown_key")],
)
def test_without_the_key_there_is_no_peer(
    make_net: Callable, theirs: tuple[bytes, ...], ours_counts: str, they_count: str
) -> None:
    net = make_net()
    net.add("a", keys=(KEY,))
    net.add("b", keys=(KEY,))
    net.add("stranger", keys=theirs)
    net.run(5.0)
    assert {peer.name for peer in net.cores["a"].peers(now=net.now)} == {"b"}
    assert net.cores["stranger"].peers(now=net.now) == []
    assert net.cores["a"].stats()[ours_counts] >= 4
    assert net.cores["stranger"].stats()[they_count] >= 8


def test_keys_change_node_by_node_without_an_interruption(make_net: Callable) -> None:
    net = make_net(delay_s=0.005)
    for name in ("a", "b"):
        net.add(name, keys=(KEY,))
    net.meet()

    def turn(name: str, *keys: bytes) -> None:
        core = net.cores[name]
        core.reconfigure(Settings(name=name, keys=keys), now=net.now)

    steps = [((KEY, OTHER_KEY), "a"), ((KEY, OTHER_KEY), "b"), ((OTHER_KEY, KEY), "a")]
    steps += [((OTHER_KEY, KEY), "b"), ((OTHER_KEY,), "a"), ((OTHER_KEY,), "b")]
    for number, (keys, name) in enumerate(steps):
        turn(name, *keys)
        net.publish("a", "t", b"x", to="b")
        net.publish("b", "t", b"x", to="a")
        net.run(0.5)
        assert len(net.delivered("a")) == len(net.delivered("b")) == number + 1
    assert len(net.of("a", PeerUp)) == len(net.of("b", PeerUp)) == 1


def test_a_recording_of_an_earlier_time_changes_nothing_in_a_restarted_node(make_net: Callable) -> None:
    net = make_net(delay_s=0.005)
    net.keep_datagrams = True
    for name in ("a", "b"):
        net.add(name, keys=(KEY,))
    net.meet()
    net.publish("a", "order", b"forward", to="all")
    net.publish("a", "order", b"forward", to="b")
    net.run(1.0)
    assert len(net.delivered("b")) == 2
    recording = [datagram.data for _at, datagram in net.sent["a"]]
    fresh = core_of("b", KEY, seed=9, now=net.now)
    for data in recording:
        fresh.receive_datagram(data, Path(0, "mallory"), now=net.now)
    assert fresh.peers(now=net.now) == []
    assert fresh.next_event() is None
    assert fresh.stats()["bad_unproven_epoch"] == len(recording)
    answers = fresh.datagrams_to_send(now=net.now)
    assert len([datagram for datagram in answers if datagram.path.address]) == 1  # one introduction, not one for each


def test_a_replay_in_the_same_life_is_neither_delivered_nor_heard(make_net: Callable) -> None:
    net = make_net(delay_s=0.005)
    net.keep_datagrams = True
    for name in ("a", "b"):
        net.add(name, keys=(KEY,))
    net.meet()
    net.publish("a", "order", b"forward", to="all")
    net.run(1.0)
    recording = [datagram.data for _at, datagram in net.sent["a"]]
    net.stop("a")
    net.run(10.0)
    assert not net.cores["b"].peers(now=net.now)[0].online
    for data in recording:
        net.cores["b"].receive_datagram(data, Path(0, "mallory"), now=net.now)
    net.run(0.1)
    status = net.cores["b"].peers(now=net.now)[0]
    assert (status.online, status.address) == (False, "a")
    assert len(net.of("b", MessageDelivered)) == 1


def test_a_restarted_node_is_believed_after_one_exchange(make_net: Callable) -> None:
    net = make_net(delay_s=0.005)
    for name in ("a", "b"):
        net.add(name, keys=(KEY,))
    net.meet()
    net.add("b", keys=(KEY,))
    assert net.run(0.1, until=lambda: len(net.of("a", PeerUp)) == 2 and len(net.of("b", PeerUp)) == 2)


def test_turning_the_key_off_and_on_repeats_no_number() -> None:
    core = core_of("a", KEY, seed=1)
    first = [d.data for d in core.datagrams_to_send(now=0.0)]
    core.reconfigure(Settings(name="a"), now=0.5)
    core.reconfigure(Settings(name="a", keys=(KEY,)), now=0.6)
    core.handle_timer(now=2.0)
    later = [d.data for d in core.datagrams_to_send(now=2.0)]
    numbers = [header.number for header in (wire_seal.decode_clear(memoryview(d)) for d in first + later)]
    assert numbers == [0, 1]
