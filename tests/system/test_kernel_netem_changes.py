"""The netem engine changes everything or nothing, on a kernel that really refuses."""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from netlab.clock import clock_here
from netlab.engines.base import Pair
from netlab.engines.netem import NetemEngine
from netlab.errors import MachineError
from netlab.kernel import messages, tc
from netlab.kernel.counters import root_qdiscs
from netlab.kernel.netlink import NetlinkSocket
from netlab.medium.impairments import PERFECT, Distribution, GilbertElliottLoss, Impairment, RandomLoss
from netlab.medium.segments import SegmentKind
from tests.system.kernel_rig import BROADCAST, in_lab, links_here, plan, running, tc_features, who_gets

pytestmark = pytest.mark.usefixtures("netem_kernel")

BEFORE = Impairment(delay_s=0.02, jitter_s=0.003, distribution=Distribution.NORMAL, loss=GilbertElliottLoss(0.1, 0.4))
DUPLICATING = Impairment(delay_s=0.5, duplicate_ratio=0.5, loss=RandomLoss(1.0), limit_packets=3)
SEED_BYTES = re.compile(rb"\x0c\x00\x0e\x00.{8}", re.DOTALL)  # another one at every change


def settings() -> dict[str, bytes]:
    """Every netem of the lab as the kernel has it, by interface, without its seed."""
    with contextlib.closing(NetlinkSocket()) as sock:
        qdiscs = root_qdiscs(sock)
    ifnames = {index: ifname for ifname, (index, _) in links_here().items()}
    return {ifnames[index]: SEED_BYTES.sub(b"", q.options) for index, q in qdiscs.items() if q.kind == "netem"}


@pytest.fixture
def refuses_beside() -> None:
    if tc_features().netem_duplicates_beside_netem:
        pytest.skip("this kernel lets netem duplicate beside another netem, so there is nothing that it refuses")


@pytest.mark.usefixtures("refuses_beside")
@in_lab
def test_a_change_that_is_refused_half_way_leaves_every_qdisc_as_it_was() -> None:
    lab = plan(SegmentKind.RADIO, 3, BEFORE)
    wanted: Mapping[Pair, Impairment] = dict.fromkeys(lab.segments[0].pairs, DUPLICATING)
    with running(lab) as (engine, nodes), contextlib.closing(NetlinkSocket()) as sock:
        engine.set_pairs({(1, 0): PERFECT})
        sock.request([tc.add_inner_netem(links_here()["p1_2"][0])])
        former = settings()
        with pytest.raises(MachineError) as caught:
            engine.set_pairs(dict(wanted))
        assert settings() == former
        assert str(caught.value) == (
            "netem for n1 radio0 -> n2 radio0 (link s): the kernel refuses: Invalid argument (netem: cannot mix "
            "duplicating netems with other netems in tree); use `--engine air`, which needs no kernel support; "
            "nothing has been changed"
        )
        assert who_gets(nodes, 1, nodes[0].mac) == [0]
        engine.set_pairs({pair: DUPLICATING for pair in wanted if pair != (1, 2)})
        assert settings() != former


@in_lab
def test_where_the_former_state_cannot_be_restored_the_error_says_so() -> None:
    with running(plan(SegmentKind.RADIO, 3, BEFORE)) as (engine, _), contextlib.closing(NetlinkSocket()) as sock:
        sock.request([delete_root(links_here()["p1_2"][0])])
        former = settings()
        with pytest.raises(
            MachineError, match=r"n1 radio0 -> n2 radio0 \(link s\): .*No such file.*Qdisc not found"
        ) as e:
            engine.set_pairs({(0, 1): PERFECT, (1, 2): PERFECT, (2, 1): PERFECT})
        assert str(e.value).endswith(
            "but at n1 radio0 -> n2 radio0, whose state is unknown until the next change that succeeds"
        )
        assert "start it again" in str(e.value)
        assert settings() == former


@in_lab
def test_a_refused_outage_cuts_nobody_off() -> None:
    with running(plan(SegmentKind.RADIO, 3)) as (engine, nodes), contextlib.closing(NetlinkSocket()) as sock:
        sock.request([delete_root(links_here()["p1_2"][0])])
        with pytest.raises(MachineError, match="Qdisc not found"):
            engine.set_outage({(0, 1), (0, 2), (1, 2)}, active=True)
        assert who_gets(nodes, 0, BROADCAST) == [1, 2]


@pytest.mark.parametrize("kind", list(SegmentKind))
@in_lab
def test_a_bring_up_that_is_refused_half_way_leaves_nothing(kind: SegmentKind, monkeypatch: pytest.MonkeyPatch) -> None:
    count = 2 if kind is SegmentKind.WIRE else 4
    refuse_the_last(monkeypatch, count * (count - 1))
    open_before = len(list(Path("/proc/self/fd").iterdir()))
    engine = NetemEngine(plan(kind, count))
    with pytest.raises(MachineError, match=r"netem for n\d radio0 -> n\d radio0 \(link s\): the kernel refuses: Inv"):
        engine.bring_up()
    assert set(links_here()) == {"lo"}
    assert settings() == {}
    assert len(list(Path("/proc/self/fd").iterdir())) == open_before
    monkeypatch.undo()
    engine.bring_up()
    assert len(settings()) == count * (count - 1)
    engine.close()


@in_lab
def test_every_change_is_one_message_to_the_kernel(monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[int] = []
    send = NetlinkSocket._send

    def counted(self: NetlinkSocket, batch: list[bytes], sequence: int) -> None:
        sent.append(len(batch))
        send(self, batch, sequence)

    with running(plan(SegmentKind.RADIO, 9)) as (engine, _):
        monkeypatch.setattr(NetlinkSocket, "_send", counted)
        pairs = set(engine._layout.shapes)
        engine.set_pairs(dict.fromkeys(pairs, BEFORE))
        engine.set_outage(pairs, active=True)
        engine.set_outage(pairs, active=True)  # so already
        engine.set_carrier(set(range(9)), up=False)
    assert [count for count in sent if count != 1] == [72, 72, 9]


@pytest.mark.skipif(clock_here() != "virtual", reason="a slow machine takes its time: `make test-vm`")
@in_lab
def test_a_large_segment_is_up_at_once() -> None:
    """Kernels before 6.8 act on 100 carriers a second if more than that come in one message."""
    engine = NetemEngine(plan(SegmentKind.RADIO, 20))
    assert engine.bring_up() < 0.1
    engine.close()


def delete_root(ifindex: int) -> bytes:
    """As somebody does who runs `tc qdisc del dev ... root` in the lab."""
    return tc._encode(ifindex, messages.RTM_DELQDISC, "netem", None, parent=0xFFFFFFFF, flags=0)


def refuse_the_last(monkeypatch: pytest.MonkeyPatch, count: int) -> None:
    """Have the kernel refuse the last of so many qdiscs: its loss model lacks a field."""
    made: list[int] = []
    add: Callable[..., bytes] = tc.add_netem

    def damaged(ifindex: int, impairment: Impairment, *, seed: int) -> bytes:
        made.append(ifindex)
        if len(made) < count:
            return add(ifindex, impairment, seed=seed)
        order = bytearray(add(ifindex, Impairment(loss=GilbertElliottLoss(0.1, 0.2)), seed=seed))
        at = order.index(b"\x14\x00\x02\x00")  # NETEM_LOSS_GE with its length
        order[at + 2] = 9  # no such loss model
        return bytes(order)

    monkeypatch.setattr(tc, "add_netem", damaged)
