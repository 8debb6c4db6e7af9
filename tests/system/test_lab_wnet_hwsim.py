"""wnet over the kernel's own radios in monitor mode: signals, rates and reports of mac80211. Needs mac80211_hwsim."""

from __future__ import annotations

import json
from collections import defaultdict
from pathlib import Path
from typing import Any

import pytest

from netlab.capture.reader import Capture
from netlab.capture.records import Kind, PacketRecord
from netlab.capture.schemas import Direction
from netlab.kernel import hwsim
from netlab.lab.facade import Lab
from netlab.pytest_plugin import MakeLab
from wnet.core import wire
from wnet.io import dot11, radiotap

pytestmark = pytest.mark.usefixtures("wifi")

#: Rates travel in one byte, an eighth of an octave a step.
ONE_BYTE = 2 ** (1 / 16) - 1 + 1e-6
HEARD = [{"between": ["a", "r"], "rssi": "-62dBm"}, {"between": ["r", "b"], "rssi": "-75dBm", "loss": "10%"}]
TWO_HOPS: dict[str, Any] = {
    "duration": "4s",
    "mesh": "wnet",
    "nodes": {"a": {"processes": ["udp_mesh"]}, "r": {}, "b": {"processes": ["udp_mesh"]}},
    "radio": {"driver": "hwsim", "propagation": {"model": "table", "pairs": HEARD}},
    "traffic": [{"from": "a", "to": "b", "topic": "t", "size": "100B", "rate": "10Hz"}],
}


@pytest.fixture
def wifi() -> None:
    problem = hwsim.missing()
    if problem:
        pytest.skip(f"{problem}; to run this test too: netlab vm --clock virtual -- pytest {Path(__file__).name}")


def test_messages_cross_two_hops_and_every_frame_tells_its_signal(make_lab: MakeLab) -> None:
    lab = make_lab(TWO_HOPS)
    link = json.loads(lab.exec("r", "ip", "-json", "link", "show", "radio0").stdout)[0]
    assert (link["link_type"], link["address"]) == ("ieee802.11/radiotap", "02:4e:4c:00:00:01")
    result = lab.run()
    stream = result.stream("t")
    assert stream["delivered"] == stream["sent"] == 40, result.report()
    with Capture.open(lab.capture) as capture:
        packets = [record for record in capture.records({Kind.PACKET}) if isinstance(record, PacketRecord)]
    on_air = [record for record in packets if record.interface == "radio0"]
    assert {record.linktype for record in on_air} == {127}
    heard = {node: set[float | None]() for node in "arb"}
    reports = 0
    for record in on_air:
        header = radiotap.decode(record.frame)
        assert header is not None
        if header.is_echo and record.direction is Direction.INBOUND:
            reports += 1
        elif record.direction is Direction.INBOUND:
            heard[record.node].add(header.signal_dbm)
    assert heard == {"a": {-62.0}, "r": {-62.0, -75.0}, "b": {-75.0}}
    assert reports > 0, "the driver tells when a frame is on the air"


def test_data_is_sent_and_heard_at_the_rate_that_the_daemon_asks_for(make_lab: MakeLab) -> None:
    lab = make_lab(TWO_HOPS)
    lab.run()
    asked, reported, heard = rates(lab)
    for sender in "arb":
        for kind in (wire.HELLO, wire.TC, wire.ACK):
            assert asked[sender, kind] == {None}, "the driver's choice"
            assert reported[sender, kind] == heard[sender, kind] == {1_000_000}, "which is the slowest"
        assert heard[sender, wire.UNICAST] <= reported[sender, wire.UNICAST] <= asked[sender, wire.UNICAST]
        assert heard[sender, wire.UNICAST]
        assert None not in asked[sender, wire.UNICAST]
    assert asked["a", wire.UNICAST] == {54_000_000}, "33 dB carry it"
    assert max(asked["b", wire.UNICAST]) <= 36_000_000, "20 dB carry no more"


def rates(lab: Lab) -> list[dict[tuple[str, int], set[Any]]]:
    """In bit/s, by node and kind of frame: those that its daemon asked for, its driver reported, and others heard."""
    found: list[dict[tuple[str, int], set[Any]]] = [defaultdict(set) for _ in range(3)]
    senders = {bytes.fromhex(f"024e4c00000{place}"): node for place, node in enumerate("arb")}
    with Capture.open(lab.capture) as capture:
        packets = [record for record in capture.records({Kind.PACKET}) if isinstance(record, PacketRecord)]
    for record in packets:
        header = radiotap.decode(record.frame) if record.interface == "radio0" else None
        if header is not None:
            frame = dot11.decode(record.frame, header.length_bytes)
            assert frame is not None
            way = 0 if record.direction is Direction.OUTBOUND else 1 if header.is_echo else 2
            found[way][senders[frame[6:12]], frame[wire.ETHERNET_BYTES]].add(header.rate_bps)
    return found


def test_the_daemon_knows_what_its_radios_hear(make_lab: MakeLab) -> None:
    lab = make_lab(TWO_HOPS)
    lab.begin()
    lab.wait_until(3.0)
    links = json.loads(lab.exec("r", "wnet", "links", "--json").stdout)["links"]
    assert {(row["neighbour"][-2:], row["is_usable"]) for row in links} == {("01", True), ("03", True)}
    told = {row["neighbour"][-2:]: row["snr_in_db"] for row in links}
    assert told["01"] - told["03"] == pytest.approx(13.0, abs=1.0)
    rate_bps = {row["neighbour"][-2:]: row["rate_bps"] for row in links}
    assert rate_bps["01"] == pytest.approx(54e6, rel=ONE_BYTE), "that of data, not that of the last HELLO"
    assert any(rate_bps["03"] == pytest.approx(rate * 1e6, rel=ONE_BYTE) for rate in (9, 12, 18, 24, 36)), rate_bps
