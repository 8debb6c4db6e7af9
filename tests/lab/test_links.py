"""The live state of pairs: who holds what down, and what the engine is told."""

from __future__ import annotations

from typing import Any

import pytest

from netlab.engines.base import LabPlan, Pair, PairCounters
from netlab.errors import LabError, MachineError
from netlab.lab.links import Links
from netlab.medium.impairments import PERFECT, Impairment
from netlab.medium.segments import Port, Segment, SegmentKind


class RecordingEngine:
    """Notes what it is told."""

    def __init__(self) -> None:
        self.namespace_fds: dict[str, int] = {}
        self.calls: list[tuple[Any, ...]] = []
        self.counters: dict[Pair, PairCounters] = {}

    def bring_up(self) -> float:
        return 0.0

    def timing(self) -> dict[str, float] | None:
        return None

    def problem(self) -> str | None:
        return None

    def set_pairs(self, changes: dict[Pair, Impairment | None]) -> None:
        self.calls.append(("pairs", changes))

    def set_outage(self, pairs: set[Pair], *, active: bool) -> None:
        self.calls.append(("outage", pairs, active))

    def set_rssi(self, segment: str, rssi_dbm: Any) -> None:
        self.calls.append(("rssi", segment, rssi_dbm))

    def set_carrier(self, ports: set[int], *, up: bool) -> None:
        self.calls.append(("carrier", ports, up))

    def record_verdicts(self, fd: int) -> None: ...

    def pair_counters(self) -> dict[Pair, PairCounters]:
        return self.counters

    def close(self) -> None: ...


def _port(index: int, node: str, ifname: str) -> Port:
    return Port(index, node, ifname, bytes([2, 0, 0, 0, 0, index]), f"10.1.0.{index + 1}/24")


@pytest.fixture
def engine() -> RecordingEngine:
    return RecordingEngine()


@pytest.fixture
def links(engine: RecordingEngine) -> Links:
    """a-b by wire and by radio, c only by radio and deaf to b."""
    ports = (
        _port(0, "a", "eth0"),
        _port(1, "b", "eth0"),
        _port(2, "a", "radio0"),
        _port(3, "b", "radio0"),
        _port(4, "c", "radio0"),
    )
    wire = Segment("a-b", SegmentKind.WIRE, (0, 1), {(0, 1): PERFECT, (1, 0): PERFECT})
    heard = {(2, 3): PERFECT, (3, 2): PERFECT, (2, 4): PERFECT, (4, 2): PERFECT}
    radio = Segment("radio", SegmentKind.RADIO, (2, 3, 4), heard)
    plan = LabPlan("test", 1, ("a", "b", "c"), ports, (wire, radio))
    return Links(plan, engine)


def test_the_wire_wins_where_wire_and_radio_join_two_nodes(links: Links) -> None:
    assert links.between("a", "b") == ({(0, 1), (1, 0)}, SegmentKind.WIRE)
    assert links.between("c", "a") == ({(4, 2), (2, 4)}, SegmentKind.RADIO)
    assert links.between("a", "b", one_way=True) == ({(0, 1)}, SegmentKind.WIRE)


def test_unknown_nodes_and_missing_links_are_named(links: Links) -> None:
    with pytest.raises(LabError, match=r"no node 'd'; nodes are a, b, c"):
        links.between("a", "d")
    with pytest.raises(LabError, match="no link joins 'a' and 'a'"):
        links.between("a", "a")


def test_a_pair_returns_only_when_all_holders_let_go(links: Links, engine: RecordingEngine) -> None:
    pairs = {(0, 1), (1, 0)}
    links.set_outage("timeline", pairs, active=True)
    links.set_outage("person", pairs, active=True)
    links.set_outage("timeline", pairs, active=False)
    assert engine.calls == [("outage", pairs, True)]
    links.set_outage("person", pairs, active=False)
    assert engine.calls[1:] == [("outage", pairs, False)]


def test_carriers_are_held_in_the_same_way(links: Links, engine: RecordingEngine) -> None:
    links.set_carrier("person", {0, 1}, up=False)
    links.set_carrier("timeline", {1}, up=False)
    links.set_carrier("person", {0, 1}, up=True)
    assert engine.calls == [("carrier", {0, 1}, False), ("carrier", {0}, True)]


def test_the_description_follows_every_change(links: Links) -> None:
    def state(sender: str, receiver: str) -> str:
        rows = [row for row in links.describe() if (row["from"], row["to"]) == (sender, receiver)]
        return str(rows[-1]["state"])  # the radio's, where there are two

    assert state("c", "a") == "up"
    links.set_outage("person", {(4, 2)}, active=True)
    assert state("c", "a") == "outage"
    assert state("a", "c") == "up"
    links.set_pairs({(2, 4): None})
    assert state("a", "c") == "out_of_range"
    links.set_carrier("person", {3}, up=False)
    assert state("b", "a") == "no_carrier"


def test_pairs_that_were_never_in_range_are_not_listed(links: Links) -> None:
    assert ("b", "c") not in {(row["from"], row["to"]) for row in links.describe()}


def test_what_the_engine_refuses_has_not_happened(
    links: Links, engine: RecordingEngine, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_arguments: object, **_named: object) -> None:
        raise MachineError("the kernel refuses")

    pairs, _ = links.between("a", "b")
    links.set_outage("person", pairs, active=True)
    before = links.describe()
    with monkeypatch.context() as patched:
        for name in ("set_pairs", "set_outage", "set_carrier"):
            patched.setattr(engine, name, refuse)
        with pytest.raises(MachineError):
            links.set_pairs(dict.fromkeys(pairs, Impairment(delay_s=9.0)))
        with pytest.raises(MachineError):
            links.set_outage("person", pairs, active=False)
        with pytest.raises(MachineError):
            links.set_carrier("timeline", {0, 1}, up=False)
    assert links.describe() == before
    engine.calls.clear()
    links.set_outage("person", pairs, active=False)
    assert engine.calls == [("outage", pairs, False)]


def test_counters_stand_beside_the_state_where_the_engine_has_any(links: Links, engine: RecordingEngine) -> None:
    pair = next(iter(links.between("a", "b")[0]))
    engine.counters = {pair: PairCounters(queue_full=None, waiting=2, reordered=0)}
    assert not any("counters" in row for row in links.describe())
    rows = [row for row in links.describe(counters=True) if "counters" in row]
    assert [row["counters"] for row in rows] == [{"queue_full": None, "waiting": 2, "reordered": 0}]
