"""Templates give byte for byte what pyroute2 encodes; names and holes are checked."""

import ipaddress

import pytest
from hypothesis import given
from hypothesis import strategies as st

from netlab.kernel import messages
from netlab.kernel.templates import Template

INDEX = st.integers(1, 2**31 - 1)
NAME = st.text(st.characters(min_codepoint=33, max_codepoint=126, exclude_characters="/:"), min_size=1, max_size=15)
MAC = st.binary(min_size=6, max_size=6)


@given(INDEX, NAME, MAC, st.integers(68, 65535), INDEX, NAME, st.integers(0, 2**20), INDEX)
def test_veth(
    index: int, name: str, mac: bytes, mtu: int, peer_index: int, peer_name: str, peer_fd: int, group: int
) -> None:
    arguments = {
        "index": index,
        "ifname": name,
        "mac": mac,
        "mtu": mtu,
        "peer_index": peer_index,
        "peer_ifname": peer_name,
        "peer_fd": peer_fd,
        "group": group,
    }
    assert messages.create_veth(**arguments) == messages.encode_create_veth(**arguments)  # type: ignore[arg-type]


@pytest.mark.parametrize("length", range(1, 16))
def test_every_length_of_names_has_its_template(length: int) -> None:
    for peer_length in range(1, 16):
        arguments = {"index": 1, "mac": b"\1" * 6, "mtu": 1500, "peer_index": 6, "peer_fd": 3, "group": 9}
        names = {"ifname": "\1" * length, "peer_ifname": "f" * peer_length}
        assert messages.create_veth(**arguments, **names) == messages.encode_create_veth(**arguments, **names)  # type: ignore[arg-type]


@given(INDEX, st.integers(0, 2**32 - 1), st.integers(0, 32))
def test_address(index: int, ip: int, prefix_bits: int) -> None:
    interface = ipaddress.IPv4Interface((ip, prefix_bits))
    assert messages.add_address(index, interface) == messages.encode_add_address(index, interface)


@given(INDEX, st.booleans())
def test_small_orders(index: int, up: bool) -> None:
    assert messages.set_up(index, up=up) == messages.encode_set_up(index, up=up)
    assert messages.get_link(index) == messages.encode_get_link(index)
    assert messages.no_ipv6_address(index) == messages.encode_no_ipv6_address(index)


def test_point_to_point_prefixes_have_no_broadcast_address() -> None:
    broadcast_attribute = bytes.fromhex("08000400")
    assert broadcast_attribute in messages.add_address(1, ipaddress.IPv4Interface("10.0.0.1/30"))
    assert broadcast_attribute not in messages.add_address(1, ipaddress.IPv4Interface("10.0.0.0/31"))


@pytest.mark.parametrize("name", ["", "x" * 16, "ä" * 8])
def test_impossible_interface_names_are_refused(name: str) -> None:
    with pytest.raises(ValueError, match="1 to 15 bytes"):
        messages.create_veth(
            index=1, ifname=name, mac=bytes(6), mtu=1500, peer_index=2, peer_ifname="far", peer_fd=3, group=9
        )


def test_template_fills_every_place_of_a_hole() -> None:
    template = Template(b"..AB--AB..CD", {"x": b"AB", "y": b"CD"}, x=2)
    assert template.fill({"x": b"12", "y": b"34"}) == b"..12--12..34"


@pytest.mark.parametrize(
    ("values", "text"),
    [({"x": b"1"}, "takes 2 bytes"), ({}, "holes are"), ({"x": b"12", "y": b"1"}, "holes are")],
)
def test_template_refuses_wrong_values(values: dict[str, bytes], text: str) -> None:
    with pytest.raises(ValueError, match=text):
        Template(b"..AB..", {"x": b"AB"}).fill(values)


def test_template_refuses_missing_ambiguous_and_overlapping_markers() -> None:
    with pytest.raises(ValueError, match="hole x occurs 0 times, not 1"):
        Template(b"....", {"x": b"AB"})
    with pytest.raises(ValueError, match="hole x occurs 2 times, not 1"):
        Template(b"AB.AB", {"x": b"AB"})
    with pytest.raises(ValueError, match="overlap"):
        Template(b".ABC.", {"x": b"AB", "y": b"BC"})
