"""Service ids and the addresses that follow from them; nothing is looked up, nothing is assigned.

A service id is written ``HID/RID.LSID``: the host's IP address, the robot on that host, the service on that robot.

Source: WNet and RoSe (ROBOCOMM 2007), section IV.B. Equation 5 is damaged in the text that we have ("port = (RID +4)
% 1024 + LSID"): with a modulo, no two robots of a host would have their services apart. Read as
``port = (RID + 4) * 1024 + LSID`` it has all the properties that the paper states: 1024 services a robot, and ports for
the 32 robots of a host, all above the well-known ones. Linux gives ports from 32768 on to
clients (ip_local_port_range), which only robots 28 to 31 can meet.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cached_property
from ipaddress import IPv4Address, IPv6Address, ip_address

from rose.errors import AddressError

ROBOTS_PER_HOST = 32
SERVICES_PER_ROBOT = 1024
ROBOTS_PER_HOST_IPV6 = 1 << 16
SERVICES_PER_ROBOT_IPV6 = 1 << 16
#: First byte of all multicast groups over IPv4, the paper's example.
GROUP_PREFIX = 226
#: Over IPv6: transient, site-local (RFC 4291, section 2.7), then "RS".
GROUP_PREFIX_IPV6 = bytes.fromhex("ff155253")
#: Below every service's port: where hosts announce themselves.
ANNOUNCE_PORT = 4 * SERVICES_PER_ROBOT - 1

PACKED_BYTES = 20
_MAPPED = bytes(10) + b"\xff\xff"
_FIRST_PORT = 4 * SERVICES_PER_ROBOT
_PORTS = 65536 - _FIRST_PORT
_FORM = re.compile(r"(?P<host>[^/]+)/(?P<robot>\d{1,5})\.(?P<service>\d{1,5})")

Host = IPv4Address | IPv6Address


@dataclass(frozen=True, order=True)
class ServiceId:
    """One service of one robot on one host.

    Over IPv4 ``robot`` is 0..31 and ``service`` 0..1023. Over IPv6 both are 0..65535: the group carries them whole.
    Only the port has no room for more than 60 robots of 1024 services; beyond it two services of one host may share a
    port, which the second finds out when it starts.
    """

    host: Host
    robot: int
    service: int

    def __post_init__(self) -> None:
        is_ipv4 = isinstance(self.host, IPv4Address)
        robots = ROBOTS_PER_HOST if is_ipv4 else ROBOTS_PER_HOST_IPV6
        services = SERVICES_PER_ROBOT if is_ipv4 else SERVICES_PER_ROBOT_IPV6
        _require_unicast(self.host)
        for what, value, limit in (("robot", self.robot, robots), ("service", self.service, services)):
            if not 0 <= value < limit:
                way_out = "; IPv6 hosts have 65536 of each" if is_ipv4 else ""
                raise AddressError(f"{what} {value} is impossible; it is 0 to {limit - 1}{way_out}")

    @classmethod
    def parse(cls, text: str) -> ServiceId:
        """Return the id that ``text`` writes, such as ``10.0.0.114/0.2`` or ``fd00::72/0.2``.

        Raises:
            AddressError: It is not of that form, or beyond its limits.
        """
        found = _FORM.fullmatch(text.strip())
        if found is None:
            raise AddressError(f"'{text}' is no service id; write HOST/ROBOT.SERVICE, such as 10.0.0.114/0.2")
        try:
            host = ip_address(found["host"].strip("[]"))
        except ValueError:
            raise AddressError(f"'{found['host']}' is no IP address; a service id begins with one") from None
        return cls(host, int(found["robot"]), int(found["service"]))

    def __str__(self) -> str:
        return f"{self.host}/{self.robot}.{self.service}"

    @cached_property
    def port(self) -> int:
        """The UDP port of the service's commands and of its group. Source: section IV.B, equation 5."""
        return _FIRST_PORT + (self.robot * SERVICES_PER_ROBOT + self.service) % _PORTS

    @cached_property
    def group(self) -> Host:
        """The multicast group that the service publishes to.

        Over IPv4: prefix, port in network byte order, last byte of the host's address. Over IPv6: prefix, robot,
        service, last eight bytes of the host's address.
        """
        if isinstance(self.host, IPv4Address):
            return IPv4Address(bytes([GROUP_PREFIX]) + self.port.to_bytes(2, "big") + self.host.packed[-1:])
        numbers = self.robot.to_bytes(2, "big") + self.service.to_bytes(2, "big")
        return IPv6Address(GROUP_PREFIX_IPV6 + numbers + self.host.packed[-8:])

    @cached_property
    def packed(self) -> bytes:
        """Twenty bytes: host (IPv4 as ::ffff:a.b.c.d, RFC 4291, section 2.5.5.2), robot, service; big endian."""
        host = self.host.packed if isinstance(self.host, IPv6Address) else _MAPPED + self.host.packed
        return host + self.robot.to_bytes(2, "big") + self.service.to_bytes(2, "big")

    @classmethod
    def unpack(cls, packed: bytes) -> ServiceId:
        """Return the id that :attr:`packed` wrote.

        Raises:
            AddressError: It is no possible id.
        """
        mapped = IPv6Address(packed[:16])
        return cls(
            mapped.ipv4_mapped or mapped, int.from_bytes(packed[16:18], "big"), int.from_bytes(packed[18:], "big")
        )


def announce_group(host: Host) -> Host:
    """Return the group in which the hosts of ``host``'s address family announce themselves, on ``ANNOUNCE_PORT``."""
    if isinstance(host, IPv4Address):
        return IPv4Address(bytes([GROUP_PREFIX]) + ANNOUNCE_PORT.to_bytes(2, "big") + b"\0")
    return IPv6Address(GROUP_PREFIX_IPV6 + b"\xff" * 4 + bytes(8))


def collisions(ids: list[ServiceId]) -> list[tuple[ServiceId, ServiceId]]:
    """Return the pairs of ids that have one group and port although they differ: hosts whose last byte is the same."""
    first: dict[tuple[Host, int], ServiceId] = {}
    found = []
    for sid in ids:
        other = first.setdefault((sid.group, sid.port), sid)
        if other != sid:
            found.append((other, sid))
    return found


def _require_unicast(host: Host) -> None:
    if host.is_multicast or host.is_unspecified:
        raise AddressError(f"{host} is not the address of a host; take the one of its network device")
    if isinstance(host, IPv4Address) and host.packed[-1] in (0, 255):
        raise AddressError(f"{host} ends with {host.packed[-1]}; the groups of hosts go by the last byte, 1 to 254")
