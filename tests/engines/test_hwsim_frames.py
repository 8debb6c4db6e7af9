"""802.11 data frames back to the Ethernet frames that they carry."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from scapy.layers.dot11 import Dot11, Dot11QoS
from scapy.layers.l2 import LLC, SNAP

from netlab.engines.hwsim_frames import ethernet_of

A, B, C, D = (bytes.fromhex(f"0200000000{n:02x}") for n in range(1, 5))
ALL = b"\xff" * 6
PAYLOAD = b"\x08\x00" + bytes(range(40))
SNAP_HEADER = bytes(LLC(dsap=0xAA, ssap=0xAA, ctrl=3) / SNAP(OUI=0, code=0))[:6]


def header(flags: int, *addresses: bytes, subtype: int = 0) -> bytes:
    """Frame control, duration, addresses, sequence control behind the third, QoS control where the subtype has it."""
    first, second, third, *fourth = addresses
    return bytes([subtype << 4 | 2 << 2, flags, 0, 0]) + first + second + third + b"\x10\0" + b"".join(fourth)


def test_ad_hoc_frames() -> None:
    assert ethernet_of(header(0, A, B, C) + SNAP_HEADER + PAYLOAD) == A + B + PAYLOAD


def test_as_scapy_builds_them() -> None:
    frame = Dot11(type=2, subtype=8, FCfield=0, addr1=A.hex(":"), addr2=B.hex(":"), addr3=C.hex(":")) / Dot11QoS()
    assert ethernet_of(bytes(frame) + SNAP_HEADER + PAYLOAD) == A + B + PAYLOAD


def test_mesh_unicast_names_its_ends_in_the_third_and_fourth_address() -> None:
    mesh = b"\x00\x1f" + bytes(4)
    frame = header(0x03, A, B, C, D, subtype=8) + b"\0\x01" + mesh + SNAP_HEADER + PAYLOAD
    assert ethernet_of(frame) == C + D + PAYLOAD


def test_mesh_group_frames_come_from_the_third_address() -> None:
    mesh = b"\x00\x1f" + bytes(4)
    frame = header(0x02, ALL, B, C, subtype=8) + b"\0\x01" + mesh + SNAP_HEADER + PAYLOAD
    assert ethernet_of(frame) == ALL + C + PAYLOAD


def test_ends_beyond_the_mesh_stand_in_the_mesh_control() -> None:
    group = b"\x01\x1f" + bytes(4) + D
    assert ethernet_of(header(0x02, ALL, B, C, subtype=8) + b"\0\x01" + group + SNAP_HEADER + PAYLOAD) == (
        ALL + D + PAYLOAD
    )
    proxied = b"\x02\x1f" + bytes(4) + A + B
    frame = header(0x03, C, D, C, D, subtype=8) + b"\0\x01" + proxied + SNAP_HEADER + PAYLOAD
    assert ethernet_of(frame) == A + B + PAYLOAD


@pytest.mark.parametrize(
    "frame",
    [
        b"",
        bytes([0x80, 0]) + bytes(60),  # beacon
        header(0, A, B, C, subtype=4),  # null: no data
        header(0x40, A, B, C) + SNAP_HEADER + PAYLOAD,  # encrypted
        header(0, A, B, C) + b"\xaa\xaa\x03\0\0\x01" + PAYLOAD,  # another organisation's
        (header(0x03, A, B, C, D, subtype=8) + b"\0\x01\x02")[:33],
    ],
)
def test_everything_else_carries_none(frame: bytes) -> None:
    assert ethernet_of(frame) is None


@given(st.binary(max_size=120))
def test_no_bytes_make_it_fail(data: bytes) -> None:
    ethernet_of(data)
    ethernet_of(bytes([0x88, 0x03]) + data)
