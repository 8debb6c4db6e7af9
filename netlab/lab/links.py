"""The live state of every pair: what the timeline and a person have done to it, forwarded to the engine.

A pair that the timeline and a person both took down comes back when both have let go.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, TypeVar

import yaml
from pydantic import ValidationError

from netlab.engines.base import Engine, LabPlan, Pair
from netlab.errors import LabError
from netlab.medium.impairments import PERFECT, Impairment
from netlab.medium.segments import Segment, SegmentKind
from netlab.scenario.events import LinkChange

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_T = TypeVar("_T")


class Links:
    """Impairments, outages and carriers of a running lab."""

    def __init__(self, plan: LabPlan, engine: Engine) -> None:
        self._plan = plan
        self._engine = engine
        self._segment_of = {pair: segment for segment in plan.segments for pair in _all_pairs(segment.ports)}
        self._impairments: dict[Pair, Impairment | None] = {
            pair: segment.pairs.get(pair) for pair, segment in self._segment_of.items()
        }
        self._rssi_dbm: dict[str, NDArray[np.float64]] = {}  # [sender, receiver] in the order of the segment's ports
        self._out: dict[str, set[Pair]] = {}  # who holds which pairs down
        self._unplugged: dict[str, set[int]] = {}  # who holds which ports without carrier

    def impairment(self, pair: Pair) -> Impairment | None:
        """What the pair does to frames now; None is out of range."""
        return self._impairments[pair]

    def set_pairs(self, changes: dict[Pair, Impairment | None]) -> None:
        """Change pairs.

        Raises:
            LabError: A word that the pair cannot obey; nothing is changed then.
        """
        for pair, impairment in changes.items():
            if impairment is not None and (problem := _misplaced(impairment, self._segment_of[pair])):
                raise LabError(problem)
        self._engine.set_pairs(changes)
        self._impairments.update(changes)

    def set_rssi(self, segment: str, rssi_dbm: NDArray[np.float64]) -> None:
        """Say how strongly the ports of a segment hear each other; see ``Engine.set_rssi``."""
        self._engine.set_rssi(segment, rssi_dbm)
        self._rssi_dbm[segment] = rssi_dbm

    def set_outage(self, holder: str, pairs: set[Pair], *, active: bool) -> None:
        """Take pairs down silently on behalf of ``holder``, or let go of them."""
        with _holding(self._out, holder, pairs, hold=active) as (taken, released):
            if taken:
                self._engine.set_outage(taken, active=True)
            if released:
                self._engine.set_outage(released, active=False)

    def set_carrier(self, holder: str, ports: set[int], *, up: bool) -> None:
        """Pull or plug cables on behalf of ``holder``."""
        with _holding(self._unplugged, holder, ports, hold=not up) as (taken, released):
            if taken:
                self._engine.set_carrier(taken, up=False)
            if released:
                self._engine.set_carrier(released, up=True)

    def between(self, a: str, b: str, *, one_way: bool = False) -> tuple[set[Pair], SegmentKind]:
        """The pairs that join two nodes: their wire's if there is one, else their radios'.

        Raises:
            LabError: Unknown node, or nothing joins them; says what does.
        """
        for node in (a, b):
            if node not in self._plan.nodes:
                raise LabError(f"there is no node '{node}'; nodes are {', '.join(self._plan.nodes)}")
        wanted = {(a, b)} if one_way else {(a, b), (b, a)}
        by_kind: dict[SegmentKind, set[Pair]] = {}
        for pair, segment in self._segment_of.items():
            if self._names(pair) in wanted:
                by_kind.setdefault(segment.kind, set()).add(pair)
        for kind in (SegmentKind.WIRE, SegmentKind.RADIO):
            if kind in by_kind:
                return by_kind[kind], kind
        joined = sorted({self._names(pair)[1] for pair in self._segment_of if self._names(pair)[0] == a})
        raise LabError(f"no link joins '{a}' and '{b}'; '{a}' is linked to {', '.join(joined) or 'nothing'}")

    def describe(self, *, counters: bool = False) -> list[dict[str, Any]]:
        """Every directed pair that is or was in range, as plain values; with the engine's counters, if it has any."""
        counted = self._engine.pair_counters() if counters else {}
        out, unplugged = _held(self._out), _held(self._unplugged)
        rows = []
        for pair, impairment in self._impairments.items():
            if impairment is None and pair not in self._segment_of[pair].pairs:
                continue
            state = "up"
            if impairment is None:
                state = "out_of_range"
            elif pair in out:
                state = "outage"
            elif unplugged & set(pair):
                state = "no_carrier"
            sender, receiver = self._names(pair)
            rows.append(
                {
                    "segment": self._segment_of[pair].name,
                    "from": sender,
                    "to": receiver,
                    "state": state,
                    "impairment": asdict(impairment) if impairment is not None else None,
                    **({"counters": asdict(counted[pair])} if pair in counted else {}),
                }
            )
        return rows

    def _names(self, pair: Pair) -> tuple[str, str]:
        return self._plan.ports[pair[0]].node, self._plan.ports[pair[1]].node


@contextlib.contextmanager
def _holding(
    holders: dict[str, set[_T]], holder: str, items: set[_T], *, hold: bool
) -> Iterator[tuple[set[_T], set[_T]]]:
    """Hold items or let go of them; gives what nobody held before and what nobody holds any more.

    If the body fails, that is, if the engine refuses, nobody holds anything else than before.
    """
    before, former = _held(holders), set(holders.setdefault(holder, set()))
    holders[holder] = former | items if hold else former - items
    after = _held(holders)
    try:
        yield after - before, before - after
    except BaseException:
        holders[holder] = former
        raise


def _held(holders: dict[str, set[_T]]) -> set[_T]:
    return set().union(*holders.values())


def _misplaced(impairment: Impairment, segment: Segment) -> str | None:
    """Which word a segment's pairs do not have, and what to do."""
    if impairment.rssi_dbm is not None and segment.wifi is None and segment.channel is None:
        return "rssi belongs to 802.11 radios (radio: phy, or driver: hwsim); remove it"
    limits = (impairment.rate_bps, impairment.limit_packets, impairment.limit_bytes)
    if segment.channel is not None and limits != (None, PERFECT.limit_packets, None):
        return "rate and limit of a pair have no meaning where radios share a channel; remove them"
    return None


def _all_pairs(ports: tuple[int, ...]) -> list[Pair]:
    return [(sender, receiver) for sender in ports for receiver in ports if sender != receiver]


def parse_words(a: str, b: str, words: Mapping[str, str]) -> LinkChange:
    """Read impairment words as a scenario file's `link` event would.

    Raises:
        LabError: With every wrong word and what to do.
    """
    try:
        values = {key: yaml.safe_load(value) for key, value in words.items()}
        return LinkChange.model_validate({"between": [a, b], **values})
    except yaml.YAMLError as error:
        raise LabError(f"link {a} {b}: {error}") from None
    except ValidationError as error:
        problems = [f"{'.'.join(map(str, p['loc']))}: {_without_prefix(p['msg'])}" for p in error.errors()]
        problems = [problem.removesuffix(", between, from, to, over") for problem in problems]  # the command's own
        raise LabError("\n".join(f"link {a} {b}: {problem.removeprefix(': ')}" for problem in problems)) from None


def _without_prefix(message: str) -> str:
    return message.removeprefix("Value error, ")
