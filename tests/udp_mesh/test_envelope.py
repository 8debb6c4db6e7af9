"""The envelope of stored, asking, answering and compressed messages: golden bytes, and a decoder that never raises."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from udp_mesh.core import envelope as envelopes
from udp_mesh.core import wire
from udp_mesh.core.envelope import DurableId, Envelope
from udp_mesh.core.mesh import Path

numbers = st.integers(0, (1 << 64) - 1)


@pytest.mark.parametrize(
    ("envelope", "text"),
    [
        (Envelope(DurableId(0x1122334455667788, 9), 7), "01 1122334455667788 0000000000000009 0000000000000007"),
        (Envelope(confirms=True), "02"),
        (Envelope(request=5), "04 0000000000000005"),
        (Envelope(response=5, status=1), "08 0000000000000005 01"),
        (Envelope(original_bytes=4096), "10 00001000"),
        (Envelope(request=5, original_bytes=4096), "14 0000000000000005 00001000"),
    ],
)
def test_every_envelope_has_the_documented_bytes(envelope: Envelope, text: str) -> None:
    assert envelopes.encode(envelope) == bytes.fromhex(text)
    assert envelopes.decode(bytes.fromhex(text) + b"rest") == (envelope, b"rest")


def test_confirmations_are_pairs_of_numbers() -> None:
    ids = [DurableId(1, 2), DurableId(3, 4)]
    data = envelopes.encode_ids(ids)
    assert data == bytes.fromhex("0000000000000001 0000000000000002 0000000000000003 0000000000000004")
    assert envelopes.decode_ids(memoryview(data + b"\0")) == ids


@given(
    st.builds(
        Envelope,
        stored=st.none() | st.builds(DurableId, numbers, numbers),
        request=st.none() | numbers,
        response=st.none() | numbers,
        original_bytes=st.none() | st.integers(0, (1 << 32) - 1),
        confirms=st.booleans(),
    ),
    st.binary(max_size=40),
)
def test_an_envelope_comes_back(envelope: Envelope, rest: bytes) -> None:
    data = envelopes.encode(envelope)
    assert len(data) <= envelopes.MAX_ENVELOPE_BYTES
    assert envelopes.decode(data + rest) == (None if envelope == Envelope() else (envelope, rest))


@given(st.binary(max_size=60))
def test_garbage_is_none_or_an_envelope(data: bytes) -> None:
    decoded = envelopes.decode(data)
    if decoded is not None:
        envelope, rest = decoded
        again = envelopes.decode(envelopes.encode(envelope))
        assert again is not None
        assert again[0] == envelope
        assert data.endswith(bytes(rest))


@pytest.mark.parametrize("size", [10, 5000])
def test_the_flag_travels_with_the_message_and_the_token_stays_at_home(make_net: Any, size: int) -> None:
    net = make_net()
    net.add("a")
    net.add("b")
    net.meet()
    core = net.cores["a"]
    core.publish("t", bytes(size), to="b", flags=wire.DATA_FLAG_ENVELOPE, token=42, now=net.now)
    core.publish("t", bytes(size), to="b", now=net.now)
    net.run(1.0)
    assert [message.flags for message in net.delivered("b")] == [wire.DATA_FLAG_ENVELOPE, 0]
    assert [event.token for event in net.events["a"] if hasattr(event, "token")] == [42, 0]


def test_fragments_that_disagree_about_the_flag_are_a_contradiction(make_net: Any) -> None:
    net = make_net()
    net.add("a")
    net.add("b")
    net.meet()
    header = wire.encode_header(
        epoch=net.cores["a"].epoch,
        destination_tag=wire.tag_of(net.cores["b"].epoch),
        packet_number=900,
        flags=0,
    )
    frames = b"".join(
        wire.encode_data_header(
            message_id=5, priority=1, index=index, count=2, payload_bytes=1, topic=b"t", flags=index
        )
        + b"x"
        for index in (0, 1)
    )
    net.cores["b"].receive_datagram(header + frames, Path(0, "a"), now=net.now)
    assert net.cores["b"].stats()["fragments_contradiction"] == 1
