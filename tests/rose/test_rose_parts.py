"""Messages longer than a datagram: cut, put together, and useful where a part is missing."""

from __future__ import annotations

import math

import msgspec
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rose.core.parts import ELEMENTS_MAX, SLICE_BYTES, assemble, cut
from rose.core.types import AnyMessage, Message, info_of, type_id
from rose.errors import RoseError, TypeMismatchError
from tests.rose.messages import Names, Note, Pose, Scan

PART_BYTES = 400


def put_together(message: Message, parts: list[bytes | None], *, cls: type[Message] | None = None) -> object:
    info = info_of(type(message))
    return assemble(parts, cls or type(message), info.type_id, is_sliced=info.sliced is not None)


@given(
    st.one_of(
        st.builds(Scan, st.just(1.5), st.lists(st.floats(0, 100), max_size=400)),
        st.builds(Names, st.lists(st.text(max_size=20), max_size=200)),
        st.builds(Note, st.text(max_size=3000)),
    ),
    st.integers(200, 1400),
)
def test_what_is_cut_fits_and_is_put_together_again(message: Message, part_bytes: int) -> None:
    pieces = cut(message, part_bytes=part_bytes)
    assert all(len(payload) <= part_bytes for payload in pieces.payloads)
    assembled = assemble(pieces.payloads, type(message), b"", is_sliced=pieces.is_sliced)
    assert assembled.message == message
    assert assembled.completeness == 1.0
    assert assembled.missing == ()


@given(st.integers(60, 400), st.data())
def test_a_missing_slice_is_a_gap_and_the_rest_is_right(beams: int, data: st.DataObject) -> None:
    scan = Scan(2.0, [float(beam) for beam in range(beams)])
    payloads: list[bytes | None] = list(cut(scan, part_bytes=PART_BYTES).payloads)
    lost = data.draw(st.sets(st.integers(0, len(payloads) - 1), max_size=len(payloads) - 1))
    for place in lost:
        payloads[place] = None
    assembled = assemble(payloads, Scan, b"", is_sliced=True)
    assert isinstance(assembled.message, Scan)
    gaps = {beam for first, end in assembled.missing for beam in range(first, end)}
    assert len(assembled.message.ranges_m) == beams
    assert assembled.completeness == pytest.approx(1 - len(gaps) / beams)
    assert bool(gaps) == bool(lost)
    for beam, distance in enumerate(assembled.message.ranges_m):
        assert math.isnan(distance) if beam in gaps else distance == float(beam)


def test_a_message_that_is_not_sliced_needs_all_its_parts() -> None:
    note = Note("x" * 1000)
    payloads = list(cut(note, part_bytes=PART_BYTES).payloads)
    assert len(payloads) == 3
    with pytest.raises(TypeMismatchError, match="not all of it"):
        assemble([payloads[0], None, payloads[2]], Note, b"", is_sliced=False)


def test_what_is_too_long_is_refused_when_it_is_published() -> None:
    with pytest.raises(RoseError, match="at most 4096"):
        cut(Note("x" * 4096 * PART_BYTES), part_bytes=PART_BYTES)
    with pytest.raises(RoseError, match="element 1 of 'names'"):
        cut(Names(["short", "x" * 500]), part_bytes=PART_BYTES)


@given(st.lists(st.one_of(st.none(), st.binary(max_size=60)), min_size=1, max_size=4), st.booleans())
def test_no_parts_from_the_network_do_worse_than_a_mismatch(parts: list[bytes | None], is_sliced: bool) -> None:
    for cls in (Scan, Note, Pose, AnyMessage):
        try:
            assemble(parts, cls, b"none", is_sliced=is_sliced)
        except TypeMismatchError:
            continue


def test_a_forged_length_does_not_make_memory() -> None:
    head = (0).to_bytes(4, "big") + (ELEMENTS_MAX + 1).to_bytes(4, "big")
    with pytest.raises(TypeMismatchError, match="outside its array"):
        assemble([head + msgspec.msgpack.encode([1.0, [2.0]])], Scan, b"", is_sliced=True)


def test_slices_that_overlap_are_of_different_messages() -> None:
    payloads = cut(Scan(1.0, [float(n) for n in range(200)]), part_bytes=PART_BYTES).payloads
    with pytest.raises(TypeMismatchError, match="different messages"):
        assemble([payloads[0], payloads[0]], Scan, b"", is_sliced=True)


def test_unknown_types_are_plain_values() -> None:
    note = cut(Note("hello"), part_bytes=PART_BYTES).payloads
    assembled = assemble(note, AnyMessage, b"none", is_sliced=False)
    assert assembled.message == AnyMessage(["hello"], b"none")
    known = assemble(note, AnyMessage, type_id("test/note"), is_sliced=False)
    assert known.message == Note("hello")


def test_a_slice_has_its_place_before_it() -> None:
    (payload,) = cut(Scan(1.0, [7.0]), part_bytes=PART_BYTES).payloads
    assert payload[:SLICE_BYTES] == bytes.fromhex("00000000 00000001")
    assert msgspec.msgpack.decode(payload[SLICE_BYTES:]) == [1.0, [7.0]]
