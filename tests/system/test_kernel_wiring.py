"""Namespaces and veths as the kernel sees them; each test in a child with namespaces of its own."""

from __future__ import annotations

import array
import contextlib
import socket
import struct
from pathlib import Path

import pytest

from netlab.kernel import messages, netlink, offloads
from netlab.kernel.links import list_links
from netlab.kernel.netlink import NetlinkSocket
from netlab.kernel.wiring import VethSpec, Wiring, build
from tests.system.kernel_rig import ETHERTYPE, in_lab, links_here, visiting

IFLA_ADDRESS, IFLA_MTU, IFLA_OPERSTATE = 1, 4, 16
OPERSTATE_UP = 6
ETH_P_ALL = 3
ETH_P_IP = 0x0800
TX_OFFLOADS = ("tx-checksum-ip-generic", "tx-scatter-gather", "tx-tcp-segmentation", "tx-udp-segmentation")


def line(count: int, far: str = "far") -> tuple[list[str], list[VethSpec]]:
    nodes = [f"n{i}" for i in range(count)]
    veths = []
    for link in range(count - 1):
        for side, node, ifname in ((1, link, "right"), (2, link + 1, "left")):
            mac = bytes([2, 0, 0, side]) + link.to_bytes(2, "big")
            veths.append(VethSpec(nodes[node], ifname, mac, f"10.0.{link}.{side}/24", 1400, f"{far}{link}.{side}"))
    return nodes, veths


def ipv6_interfaces_here() -> set[str]:
    return {text.split()[-1] for text in Path("/proc/thread-self/net/if_inet6").read_text().splitlines()}


@in_lab
def test_everything_is_up_running_addressed_and_named() -> None:
    nodes, veths = line(3)
    before = Path("/proc/thread-self/ns/net").readlink()
    built = build(nodes, veths)
    assert Path("/proc/thread-self/ns/net").readlink() == before
    assert sorted(built.namespace_fds) == nodes
    with visiting(built.namespace_fds["n1"]):
        links = links_here()
        assert set(links) == {"lo", "left", "right"}
        for name, mac in (("left", "020000020000"), ("right", "020000010001")):
            attrs = links[name][1]
            assert attrs[IFLA_ADDRESS].hex() == mac
            assert attrs[IFLA_MTU] == struct.pack("=I", 1400)
            assert attrs[IFLA_OPERSTATE] == bytes([OPERSTATE_UP])
        routes = Path("/proc/thread-self/net/fib_trie").read_text()
        for address in ("10.0.0.2", "10.0.1.1", "10.0.0.255", "127.0.0.1"):  # with broadcast address
            assert f"|-- {address}\n" in routes


@in_lab
def test_far_ends_are_aligned_with_the_specs_and_silent() -> None:
    nodes, veths = line(3)
    built = build(nodes, veths)
    links = links_here()
    assert tuple(links[veth.peer_ifname][0] for veth in veths) == built.peer_ifindex
    assert not ipv6_interfaces_here() & {veth.peer_ifname for veth in veths}


@in_lab
def test_offloads_are_off_at_both_ends() -> None:
    def features(sock: NetlinkSocket, ifname: str) -> dict[str, bool]:
        names = offloads._feature_names(sock.fileno(), ifname)
        blocks = (len(names) + 31) // 32
        answer = array.array("I", [0x3A, blocks, *[0] * (4 * blocks)])  # ETHTOOL_GFEATURES
        offloads._ethtool(sock.fileno(), ifname, answer)
        active = [answer[2 + 4 * block + 2] for block in range(blocks)]
        return {name: bool(active[bit // 32] >> bit % 32 & 1) for bit, name in enumerate(names)}

    built = build(*line(2))
    with contextlib.closing(NetlinkSocket()) as here:
        ends = [features(here, "far0.1")]
    with visiting(built.namespace_fds["n0"]), contextlib.closing(NetlinkSocket()) as there:
        ends.append(features(there, "right"))
    for end in ends:
        assert not [name for name in TX_OFFLOADS if end[name]]
        assert not [name for name, on in end.items() if on and name.startswith("tx-") and "segmentation" in name]


@in_lab
def test_a_datagram_leaves_with_its_checksum_and_arrives_at_once() -> None:
    built = build(*line(2))
    with socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(ETH_P_ALL)) as far:
        far.bind(("far0.1", ETH_P_ALL))
        far.settimeout(5)
        with visiting(built.namespace_fds["n0"]):
            node = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        node.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        node.sendto(b"x" * 100, ("10.0.0.255", 9))  # the very first frame: nothing may be thrown away
        frame = next(f for f in iter(lambda: far.recv(2000), b"") if f[12:14] == b"\x08\x00" and f[23] == 17)
    pseudo = frame[26:34] + b"\0\x11" + frame[38:40]
    words = struct.unpack(f"!{(len(pseudo) + 108) // 2}H", pseudo + frame[34:142])
    total = sum(words)
    while total >> 16:
        total = (total & 0xFFFF) + (total >> 16)
    assert total == 0xFFFF  # RFC 768: the sum with the checksum in place


@in_lab
def test_the_very_first_frames_of_a_large_lab_arrive_both_ways() -> None:
    """Nothing may be thrown away for an interface that is up but not yet active."""

    def received_here(ifname: str) -> int:
        lines = Path("/proc/thread-self/net/dev").read_text().splitlines()
        return next(int(line.split()[2]) for line in lines if line.split()[0] == ifname + ":")

    nodes, veths = line(80)
    frame = b"\xff" * 6 + bytes(6) + ETHERTYPE.to_bytes(2, "big") + bytes(46)
    with socket.socket(socket.AF_PACKET, socket.SOCK_RAW, socket.htons(ETH_P_IP)) as far:
        far.settimeout(1)
        built = build(nodes, veths)
        for veth in veths:
            far.sendto(frame, (veth.peer_ifname, ETHERTYPE))
        for node in nodes:
            with visiting(built.namespace_fds[node]), socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
                for veth in veths:
                    if veth.namespace == node and veth.address is not None:
                        sock.sendto(b"first", (veth.address.rpartition(".")[0] + ".255", 9))
        heard = {far.recvfrom(100)[1][0] for _ in veths}
    assert heard == {veth.peer_ifname for veth in veths}
    for veth in veths:
        with visiting(built.namespace_fds[veth.namespace]):
            assert received_here(veth.ifname) == 1


@in_lab
def test_far_end_down_takes_the_carrier_and_up_gives_it_back() -> None:
    def carrier(built: Wiring) -> bool:
        with visiting(built.namespace_fds["n0"]), contextlib.closing(NetlinkSocket()) as sock:
            return {link.ifname: link.running for link in list_links(sock)}["right"]

    def wait(built: Wiring, wanted: bool) -> None:
        for _ in range(100_000):
            if carrier(built) is wanted:
                return
        raise AssertionError(f"carrier did not become {wanted}")

    built = build(*line(2))
    assert carrier(built)
    built.set_peers([0], up=False)
    wait(built, False)
    built.set_peers([0], up=True)
    wait(built, True)


@in_lab
def test_errors_name_node_and_interface_and_leave_nothing() -> None:
    nodes, veths = line(3)
    open_before = len(list(Path("/proc/self/fd").iterdir()))
    with pytest.raises(OSError, match="node n1: interface left: File exists"):
        build(nodes, [*veths, VethSpec("n1", "left", veths[0].mac, None, 1500, "more")])
    assert set(links_here()) == {"lo"}
    with pytest.raises(OSError, match="node n1: interface other: File exists"):
        build(nodes, [*veths, VethSpec("n1", "other", veths[0].mac, None, 1500, "far0.1")])
    with pytest.raises(OSError, match="node n0: interface right: Invalid argument"):
        build(nodes, [VethSpec("n0", "right", veths[0].mac, None, 10, "far")])
    assert set(links_here()) == {"lo"}
    assert len(list(Path("/proc/self/fd").iterdir())) == open_before
    build(nodes, veths)


def test_wrong_arguments_are_refused_before_anything_is_made() -> None:
    nodes, veths = line(2)
    with pytest.raises(ValueError, match="no namespace 'n1'"):
        build(nodes[:1], veths)
    with pytest.raises(ValueError, match="not distinct"):
        build(["a", "a"], [])


@in_lab
def test_second_build_in_the_same_namespace_takes_other_indices() -> None:
    first = build(*line(2))
    second = build(*line(2, "other"))
    assert not set(first.peer_ifindex) & set(second.peer_ifindex)


@in_lab
def test_a_refused_order_is_found_in_a_long_batch() -> None:
    with contextlib.closing(NetlinkSocket()) as sock:
        up = messages.set_up(messages.LOOPBACK_INDEX, up=True)
        sock.request([up] * 700)
        with pytest.raises(netlink.NetlinkError) as caught:
            sock.request([up] * 333 + [messages.set_up(4711, up=True)] + [up] * 333)
        assert caught.value.position == 333
        sock.request([up])  # all answers have been read


@in_lab
def test_a_hundred_nodes_and_nothing_is_left() -> None:
    built = build(*line(100))
    assert len(links_here()) == 1 + 198
    built.close()
    built.close()
    assert set(links_here()) == {"lo"}
    assert built.namespace_fds == {}
