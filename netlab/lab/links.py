"""The live state of every pair: what the timeline and a person have done to it, forwarded to the engine.

A pair that the timeline and a person both took down comes back when both have let go.
"""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any, TypeVar

import yaml
from pydantic import ValidationError

from netlab.engines.base import Engine, LabPlan, Pair
from netlab.errors import LabError
from netlab.lab.signals import Signals
from netlab.medium.impairments import PERFECT, Impairment
from netlab.medium.segments import Segment, SegmentKind
from netlab.scenario.events import LinkChange

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_T = TypeVar("_T")
#: Who holds pairs down, or motion still.
TIMELINE, PERSON = "timeline", "person"


class Links:
    """Impairments, outages and carriers of a running lab."""

    def __init__(self, plan: LabPlan, engine: Engine) -> None:
        self._plan = plan
        self._engine = engine
        self._segment_of = {pair: segment for segment in plan.segments for pair in _all_pairs(segment.ports)}
        self._impairments: dict[Pair, Impairment | None] = {
            pair: segment.pairs.get(pair) for pair, segment in self._segment_of.items()
        }
        self._out_of_range = {pair for pair, impairment in self._impairments.items() if impairment is None}
        self.signals = Signals(plan)
        self._heard: set[Pair] = set()  # as last described
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
        self._out_of_range |= {pair for pair, impairment in changes.items() if impairment is None}
        self._out_of_range -= {pair for pair, impairment in changes.items() if impairment is not None}

    def set_rssi(self, segment: str, rssi_dbm: NDArray[np.float64]) -> None:
        """Say how strongly the ports of a segment hear each other; see ``Engine.set_rssi``."""
        self._engine.set_rssi(segment, rssi_dbm)
        self.signals.set(segment, rssi_dbm)

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

    def describe(self, *, counters: bool = False, heard_only: bool = False) -> list[dict[str, Any]]:
        """Every directed pair that is or was in range, as plain values.

        Args:
            counters: With the engine's counters, if it has any.
            heard_only: Only pairs with a signal strength that is high enough, or was so at the last time.
        """
        counted = self._engine.pair_counters() if counters else {}
        out, unplugged = _held(self._out), _held(self._unplugged)
        words: dict[int, dict[str, Any]] = {}  # by identity: most pairs share one impairment
        rows = []
        for pair, impairment in self._impairments.items():
            segment = self._segment_of[pair]
            if (impairment is None and pair not in segment.pairs) or (heard_only and not self._newsworthy(pair)):
                continue
            sender, receiver = self._names(pair)
            if impairment is not None and id(impairment) not in words:
                words[id(impairment)] = asdict(impairment)
            rows.append(
                {
                    "segment": segment.name,
                    "from": sender,
                    "to": receiver,
                    "state": self._state(pair, out, unplugged),
                    "impairment": words[id(impairment)] if impairment is not None else None,
                    **_signal(self.signals, pair),
                    **({"counters": asdict(counted[pair])} if pair in counted else {}),
                }
            )
        return rows

    def heard(self, segment: Segment) -> NDArray[np.bool_]:
        """Who hears whom of a segment with strengths, ``[sender, receiver]`` in the order of its ports."""
        heard = self.signals.heard(segment)
        place = {port: place for place, port in enumerate(segment.ports)}
        for sender, receiver in self._out_of_range:
            if sender in place and receiver in place:
                heard[place[sender], place[receiver]] = False
        return heard

    def is_held(self, pair: Pair) -> bool:
        """Whether somebody holds the pair, or a cable at its ends, down."""
        return any(pair in held for held in self._out.values()) or bool(_held(self._unplugged) & set(pair))

    def _state(self, pair: Pair, out: set[Pair], unplugged: set[int]) -> str:
        if self._impairments[pair] is None or not self.signals.is_heard(pair):
            return "out_of_range"
        if pair in out:
            return "outage"
        return "no_carrier" if unplugged & set(pair) else "up"

    def _newsworthy(self, pair: Pair) -> bool:
        if self.signals.rssi_dbm(pair) is None:
            return False
        was_heard = pair in self._heard
        if self.signals.is_heard(pair):
            self._heard.add(pair)
            return True
        self._heard.discard(pair)
        return was_heard

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


def carried(node: str) -> str:
    """Who holds the pairs of a node down that is still carried."""
    return f"carried {node}"


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


def _signal(signals: Signals, pair: Pair) -> dict[str, Any]:
    """Strength and ratio for a row; nothing where there are none, null where nothing is heard at all."""
    rssi_dbm, snr_db = signals.rssi_dbm(pair), signals.snr_db(pair)
    if rssi_dbm is None or snr_db is None:
        return {}
    heard = math.isfinite(rssi_dbm)
    return {"rssi_dbm": round(rssi_dbm, 1) if heard else None, "snr_db": round(snr_db, 1) if heard else None}


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
