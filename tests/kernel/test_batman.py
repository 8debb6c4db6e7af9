"""What is said to the kernel about a batman-adv interface, and in which order; the kernel itself is a fake."""

from __future__ import annotations

import contextlib
import struct
from collections.abc import Sequence

import pytest
from pyroute2.netlink.rtnl.ifinfmsg import ifinfmsg

from netlab.kernel import batman, genl
from netlab.kernel.links import Link
from netlab.kernel.netlink import HEADER, NetlinkError, attributes
from netlab.medium.meshes import BatmanOptions, RoutingAlgorithm

MAC = bytes.fromhex("024e4d000001")
FAMILY = 0x23
OPTIONS = BatmanOptions(RoutingAlgorithm.BATMAN_V, 0.5, 0.25, 15)


class FakeSocket:
    """Takes every order and answers what a kernel with these settings would."""

    def __init__(self, log: list[tuple[str, bytes]], kind: str, algorithm: str) -> None:
        self._log, self._kind, self._algorithm = log, kind, algorithm

    def request(self, orders: Sequence[bytes]) -> None:
        self._log += [(self._kind, order) for order in orders]

    def query(self, message: bytes) -> bytes:
        head = HEADER.pack(0, FAMILY, 0, 0, 0) + genl.GENERIC_HEADER.pack(0, 1, 0)
        if HEADER.unpack_from(message)[1] != FAMILY:
            return head + genl.attribute(1, struct.pack("=H", FAMILY))  # the controller tells the family's number
        return head + genl.text(2, self._algorithm)

    def dump(self, message: bytes) -> list[bytes]:
        head = HEADER.pack(0, FAMILY, 0, 0, 0) + genl.GENERIC_HEADER.pack(7, 1, 0)
        best = genl.attribute(22)  # BATADV_ATTR_FLAG_BEST: somebody is a next hop
        rows = ((1, 0, best), (2, 0, b""), (3, 0, b""), (3, 0x10, best), (4, 0x800, best))  # BATADV_TT_CLIENT_TEMP
        return [
            head + genl.attribute(16, MAC[:5] + bytes([node])) + genl.number(21, flags) + flag
            for node, flags, flag in rows
        ]

    def close(self) -> None:
        pass


@pytest.fixture
def log(monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, bytes]]:
    return fake_kernel(monkeypatch, "BATMAN_V")


def fake_kernel(monkeypatch: pytest.MonkeyPatch, algorithm: str) -> list[tuple[str, bytes]]:
    told: list[tuple[str, bytes]] = []

    def socket(protocol: int = 0) -> FakeSocket:
        return FakeSocket(told, "generic" if protocol else "route", algorithm)

    monkeypatch.setattr(batman, "NetlinkSocket", socket)
    monkeypatch.setattr(batman, "setns", lambda fd, kind: None)
    monkeypatch.setattr(batman.netns, "returning", contextlib.nullcontext)  # to return takes root even if nobody left
    monkeypatch.setattr(batman.links, "list_links", lambda sock: [Link(100, "eth0", True), Link(101, "eth1", True)])
    return told


def decoded(message: bytes) -> ifinfmsg:
    found = ifinfmsg(message)
    found.decode()
    return found


def settings(message: bytes) -> dict[int, bytes]:
    return attributes(message, genl.ATTRIBUTES_AT)


def test_it_is_made_set_up_and_given_members_in_an_order_that_loses_nothing(log: list[tuple[str, bytes]]) -> None:
    batman.create(-1, "bat0", MAC, "10.240.0.1/16", ["eth1", "eth0"], OPTIONS)
    kinds = [(kind, HEADER.unpack_from(order)[1]) for kind, order in log]
    assert kinds == [
        ("route", 16),  # create
        ("generic", FAMILY),  # set, before there is a member to send routing messages
        ("route", 16),
        ("route", 16),  # members
        ("generic", FAMILY),
        ("generic", FAMILY),  # their link probes
        ("route", 20),  # address
        ("route", 16),  # up
    ]
    made = decoded(log[0][1])
    assert (made.get_attr("IFLA_IFNAME"), made.get_attr("IFLA_ADDRESS")) == ("bat0", "02:4e:4d:00:00:01")
    info = made.get_attr("IFLA_LINKINFO")
    assert info.get_attr("IFLA_INFO_KIND") == "batadv"
    assert b"BATMAN_V\0" in log[0][1]
    members = [decoded(order) for _, order in log[2:4]]
    assert [(member["index"], member.get_attr("IFLA_MASTER")) for member in members] == [(101, 90), (100, 90)]
    assert decoded(log[-1][1])["index"] == 90


def test_the_settings_in_the_kernel_s_units(log: list[tuple[str, bytes]]) -> None:
    batman.create(-1, "bat0", MAC, "10.240.0.1/16", ["eth0"], OPTIONS)
    mesh, member = (order for kind, order in log if kind == "generic")
    assert genl.GENERIC_HEADER.unpack_from(mesh, HEADER.size)[0] == 15  # BATADV_CMD_SET_MESH
    told = settings(mesh)
    assert struct.unpack("=I", told[57]) == (500,)  # BATADV_ATTR_ORIG_INTERVAL
    assert told[53] == bytes([15])  # BATADV_ATTR_HOP_PENALTY
    assert told[46] == b"\0"  # BATADV_ATTR_BRIDGE_LOOP_AVOIDANCE_ENABLED
    assert genl.GENERIC_HEADER.unpack_from(member, HEADER.size)[0] == 16  # BATADV_CMD_SET_HARDIF
    assert struct.unpack("=I", settings(member)[58]) == (250,)  # BATADV_ATTR_ELP_INTERVAL
    assert struct.unpack("=I", settings(member)[6]) == (100,)  # BATADV_ATTR_HARD_IFINDEX


def test_what_is_not_given_stays_the_kernel_s() -> None:
    assert settings(batman.set_mesh(FAMILY, BatmanOptions())).keys() == {3, 46}


def test_a_member_that_is_not_there(log: list[tuple[str, bytes]]) -> None:
    with pytest.raises(OSError, match="no interface radio0 to put into the mesh"):
        batman.create(-1, "bat0", MAC, "10.240.0.1/16", ["eth0", "radio0"], OPTIONS)
    assert log == []


def test_a_kernel_that_ignores_the_algorithm_is_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    fake_kernel(monkeypatch, "BATMAN_IV")
    with pytest.raises(OSError, match=r"routes by BATMAN_IV, not BATMAN_V: .*routing_algo"):
        batman.create(-1, "bat0", MAC, "10.240.0.1/16", ["eth0"], OPTIONS)


def test_a_refusal_names_the_interface(monkeypatch: pytest.MonkeyPatch) -> None:
    fake_kernel(monkeypatch, "BATMAN_IV")

    def refuse(self: FakeSocket, orders: Sequence[bytes]) -> None:
        raise NetlinkError(95, 0, "Unknown device type")

    monkeypatch.setattr(FakeSocket, "request", refuse)
    with pytest.raises(OSError, match=r"mesh interface bat0: .*Unknown device type"):
        batman.create(-1, "bat0", MAC, "10.240.0.1/16", [], BatmanOptions())
    assert "Unknown device type" in (batman.problem() or "")


def test_a_route_is_what_has_a_next_hop_and_was_not_guessed_from_a_broadcast(log: list[tuple[str, bytes]]) -> None:
    assert batman.routed(-1) == {MAC, MAC[:5] + b"\x03"}
