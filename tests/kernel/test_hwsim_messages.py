"""mac80211_hwsim's and nl80211's messages: golden bytes, and whatever may come in."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from netlab.kernel import genl, hwsim, nl80211
from netlab.kernel.netlink import HEADER, attributes

RADIO = bytes.fromhex("420000000100")
FRAME = bytes(range(33))
FAMILY = 0x1C


def frame_body(**changes: bytes | None) -> bytes:
    """The attributes of a frame as the kernel sends them (numbers of mac80211_hwsim.h)."""
    parts: dict[str, tuple[int, bytes]] = {
        "transmitter": (2, RADIO),
        "frame": (3, FRAME),
        "flags": (4, struct.pack("=I", 1)),
        "freq": (19, struct.pack("=I", 2412)),
        "rates": (7, struct.pack("=8b", 3, 2, 1, 4, -1, 0, -1, 0)),
        "cookie": (8, struct.pack("=Q", 77)),
    }
    given_ = {name: (kind, changes.get(name, value)) for name, (kind, value) in parts.items()}
    return b"".join(genl.attribute(kind, value) for kind, value in given_.values() if value is not None)


def sent() -> hwsim.SentFrame:
    parsed = hwsim.parse_sent(frame_body())
    assert parsed is not None
    return parsed


def test_a_frame_of_the_kernel_is_read() -> None:
    assert sent() == (RADIO, FRAME, 1, ((3, 2), (1, 4)), struct.pack("=Q", 77), struct.pack("=I", 2412))


@pytest.mark.parametrize("missing", ["transmitter", "frame", "flags", "rates", "cookie"])
def test_a_frame_that_lacks_something_is_none(missing: str) -> None:
    assert hwsim.parse_sent(frame_body(**{missing: None})) is None
    if missing in ("flags", "rates"):
        assert hwsim.parse_sent(frame_body(**{missing: b"\0"})) is None


@given(st.binary(max_size=200))
def test_no_bytes_make_the_parser_fail(data: bytes) -> None:
    hwsim.parse_sent(data)


def test_a_delivery_names_receiver_strength_and_channel() -> None:
    message = hwsim.delivery(FAMILY, RADIO, sent(), FRAME, rate=3, signal_dbm=-62)
    length, kind, flags, _, _ = HEADER.unpack_from(message)
    assert (length, kind, flags, message[16:20]) == (len(message), FAMILY, 1, bytes([2, 1, 0, 0]))
    assert attributes(message, 20) == {
        1: RADIO,
        3: FRAME,
        5: struct.pack("=I", 3),
        6: struct.pack("=i", -62),
        19: struct.pack("=I", 2412),
    }


def test_a_status_says_what_was_tried_and_whether_it_was_acknowledged() -> None:
    message = hwsim.status(FAMILY, sent(), ((3, 2), (1, 1)), acked=True, signal_dbm=-50)
    found = attributes(message, 20)
    assert message[16] == 3
    assert struct.unpack("=I", found[4])[0] == 1 | 4
    assert struct.unpack("=8b", found[7]) == (3, 2, 1, 1, -1, 0, -1, 0)
    assert found[8] == struct.pack("=Q", 77)
    failed = attributes(hwsim.status(FAMILY, sent(), ((3, 7),), acked=False, signal_dbm=0), 20)
    assert struct.unpack("=I", failed[4])[0] == 1


def test_a_new_radio_goes_with_the_socket_and_has_no_interface() -> None:
    found = attributes(hwsim.new_radio(FAMILY, "nl7-0"), 20)
    assert found == {16: b"", 18: b"", 12: bytes(4), 17: b"nl7-0"}


@pytest.mark.parametrize(
    ("planned", "attempts", "made"),
    [
        (((3, 2), (1, 4)), 1, ((3, 1),)),
        (((3, 2), (1, 4)), 4, ((3, 2), (1, 2))),
        (((3, 2), (1, 4)), 9, ((3, 2), (1, 7))),
        (((0, 1),), 7, ((0, 7),)),
        ((), 3, ()),
    ],
)
def test_attempts_are_spread_over_the_rates_that_were_planned(
    planned: tuple[hwsim.Rate, ...], attempts: int, made: tuple[hwsim.Rate, ...]
) -> None:
    assert hwsim.split_attempts(planned, attempts) == made


@given(st.lists(st.tuples(st.integers(0, 11), st.integers(1, 7)), min_size=1, max_size=4), st.integers(1, 64))
def test_every_attempt_is_at_some_rate(planned: list[hwsim.Rate], attempts: int) -> None:
    assert sum(count for _, count in hwsim.split_attempts(tuple(planned), attempts)) == attempts


def test_joining_a_mesh_and_a_cell() -> None:
    found = attributes(nl80211.join_mesh(FAMILY, 5, b"tunnel", 2437), 20)
    assert found == {
        3: struct.pack("=I", 5),
        38: struct.pack("=I", 2437),
        159: bytes(4),
        12: struct.pack("=I", 100),
        24: b"tunnel",
    }
    cell = nl80211.join_ibss(FAMILY, 5, b"team", 2412, b"\x02\0\0\0\0\1")
    assert cell[16] == 43
    assert {kind: attributes(cell, 20)[kind] for kind in (52, 6, 60)} == {52: b"team", 6: b"\x02\0\0\0\0\1", 60: b""}


def test_a_monitor_hears_other_networks_and_control_frames() -> None:
    found = attributes(nl80211.new_interface(FAMILY, 1, "mon0", nl80211.IFTYPE_MONITOR), 20)
    assert set(attributes(found[23], 0)) == {3, 4}
    assert found[4] == b"mon0\0"
    mesh = attributes(nl80211.new_interface(FAMILY, 1, "radio0", nl80211.IFTYPE_MESH_POINT, RADIO), 20)
    assert (mesh[6], 23 in mesh) == (RADIO, False)


def test_a_station_is_read_from_a_dump() -> None:
    info = [
        genl.attribute(7, struct.pack("=b", -71)),
        genl.attribute(6, b"\x04"),
        genl.number(10, 12),
        genl.number(11, 3),
        genl.number(12, 1),
    ]
    message = genl.message(FAMILY, 19, genl.attribute(6, RADIO), genl.nested(21, *info))
    assert nl80211.parse_station(message) == nl80211.Station(RADIO, -71, True, 12, 3, 1)
    bare = genl.message(FAMILY, 19, genl.attribute(6, RADIO))
    assert nl80211.parse_station(bare) == nl80211.Station(RADIO, None, False, 0, 0, 0)
