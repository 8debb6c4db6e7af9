"""Service ids and what follows from them: the paper's limits, and that no two services of a subnet meet."""

from __future__ import annotations

from ipaddress import IPv4Address, IPv6Address, ip_address

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rose.core.addressing import ServiceId, announce_group, collisions
from rose.errors import AddressError

last_bytes = st.integers(1, 254)
ipv4_ids = st.builds(
    lambda last, robot, service: ServiceId(IPv4Address(f"10.20.30.{last}"), robot, service),
    last_bytes,
    st.integers(0, 31),
    st.integers(0, 1023),
)
ipv6_ids = st.builds(
    lambda host, robot, service: ServiceId(IPv6Address((0xFD << 120) | host), robot, service),
    st.integers(1, (1 << 64) - 1),
    st.integers(0, 65535),
    st.integers(0, 65535),
)


def test_the_example_of_the_paper() -> None:
    """Section IV.B: prefix 226, port in network byte order, 114 as the last byte of the host."""
    sid = ServiceId.parse("192.168.5.114/0.2")
    assert sid.port == 4 * 1024 + 2
    assert sid.group == ip_address("226.16.2.114")


@given(st.one_of(ipv4_ids, ipv6_ids))
def test_printed_and_packed_ids_are_read_back(sid: ServiceId) -> None:
    assert ServiceId.parse(str(sid)) == sid
    assert ServiceId.unpack(sid.packed) == sid


@given(ipv4_ids, ipv4_ids)
def test_no_two_services_of_a_subnet_share_a_group_or_a_port_of_a_host(a: ServiceId, b: ServiceId) -> None:
    assert (a.group == b.group) == (a == b)
    if a.host == b.host:
        assert (a.port == b.port) == (a == b)


@given(ipv6_ids, ipv6_ids)
def test_no_two_services_of_an_ipv6_subnet_share_a_group(a: ServiceId, b: ServiceId) -> None:
    assert (a.group == b.group) == (a == b)


@given(st.one_of(ipv4_ids, ipv6_ids))
def test_ports_are_unprivileged_and_groups_are_multicast(sid: ServiceId) -> None:
    assert 4096 <= sid.port <= 65535
    assert sid.group.is_multicast
    assert sid.group.version == sid.host.version
    assert sid.group != announce_group(sid.host)


def test_every_robot_of_the_papers_limits_has_ports_for_every_service() -> None:
    host = IPv4Address("10.0.0.1")
    ports = {ServiceId(host, robot, service).port for robot in range(32) for service in (0, 1023)}
    assert len(ports) == 64
    assert max(ports) == 36 * 1024 - 1


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("10.0.0.1", "write HOST/ROBOT.SERVICE"),
        ("10.0.0.1/1", "write HOST/ROBOT.SERVICE"),
        ("10.0.0.1/1.-2", "write HOST/ROBOT.SERVICE"),
        ("robot1/0.1", "'robot1' is no IP address"),
        ("10.0.0.1/32.0", "robot 32 is impossible; it is 0 to 31; IPv6 hosts have"),
        ("10.0.0.1/0.1024", "service 1024 is impossible; it is 0 to 1023"),
        ("fd00::1/70000.1", "robot 70000 is impossible; it is 0 to 65535"),
        ("226.1.2.3/0.1", "is not the address of a host"),
        ("0.0.0.0/0.1", "is not the address of a host"),
        ("10.0.0.255/0.1", "ends with 255"),
        ("", "write HOST/ROBOT.SERVICE"),
    ],
)
def test_what_is_no_service_id_is_refused_with_the_way_out(text: str, words: str) -> None:
    with pytest.raises(AddressError, match=r"(?s).") as caught:
        ServiceId.parse(text)
    assert words in str(caught.value)


def test_hosts_with_the_same_last_byte_are_found() -> None:
    one, other = ServiceId.parse("10.0.0.7/0.1"), ServiceId.parse("10.0.1.7/0.1")
    assert collisions([one, other, ServiceId.parse("10.0.0.8/0.1")]) == [(one, other)]
