"""A lab's plan as kernel devices, filters and netem qdiscs. Pure: names devices by what they are, sends nothing.

Theory. ``Far(i)`` is the far end of port i's veth. What the node sends comes in there; what leaves there reaches the
node. Every directed pair (i, j) needs a queue of its own:

* Two ports on a segment: everything from i goes out at Far(j), so Far(j)'s root qdisc is the pair's netem.
* More ports: the frames of several senders meet at Far(j), so each pair gets a veth of its own. i's filters copy a
  frame to ``Entry(i, j)``, whose root qdisc is the pair's netem; what comes out of its other end ``Exit(i, j)`` goes on
  to Far(j). A group frame is thus copied *before* the loss is drawn, once for each receiver, as on the air.

What no filter takes goes to the stack of the lab's own namespace, which has no address and so throws it away.
Pairs out of range have their queue too and lose everything, so that coming into range is one change of a qdisc.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, replace

from netlab.engines.base import LabPlan, Pair
from netlab.kernel.netem import inexpressible, narrow_limit
from netlab.kernel.tc import ACTIONS_MAX, ANY, GROUP, Match, match_mac
from netlab.medium.impairments import PERFECT, Impairment, RandomLoss
from netlab.medium.segments import Segment, SegmentKind

LOSE_ALL = RandomLoss(1.0)
OUT_OF_RANGE = replace(PERFECT, loss=LOSE_ALL)


@dataclass(frozen=True, slots=True)
class Far:
    """Far end of a port's veth."""

    port: int


@dataclass(frozen=True, slots=True)
class Entry:
    """Where a pair's frames go in."""

    pair: Pair


@dataclass(frozen=True, slots=True)
class Exit:
    """Where a pair's frames come out."""

    pair: Pair


Device = Far | Entry | Exit


@dataclass(frozen=True, slots=True)
class Rule:
    """A filter at the ingress of ``device``: frames that match go to every target (1 to 31), and nowhere else.

    Unless ``last``, later rules see the frame, too.
    """

    device: Device
    priority: int
    match: Match
    targets: tuple[Device, ...]
    last: bool = True


@dataclass(frozen=True, slots=True)
class NetemPlan:
    """``shapes``: the device whose root qdisc is the pair's netem. ``pair_veths``: pairs with a veth of their own."""

    pair_veths: tuple[Pair, ...]
    shapes: dict[Pair, Device]
    rules: tuple[Rule, ...]
    impairments: dict[Pair, Impairment | None]


def compile_plan(plan: LabPlan) -> NetemPlan:
    """Lay out devices, filters and qdiscs.

    Raises:
        ValueError: A port is on two segments, or a pair's ends are not on its segment.
    """
    _check(plan)
    pairs = [(segment, pair) for segment in plan.segments for pair in _pairs(segment)]
    return NetemPlan(
        pair_veths=tuple(pair for segment, pair in pairs if not _is_direct(segment)),
        shapes={pair: _entry(segment, pair) if not _is_direct(segment) else Far(pair[1]) for segment, pair in pairs},
        rules=tuple(rule for segment in plan.segments for rule in _segment_rules(plan, segment)),
        impairments={pair: segment.pairs.get(pair) for segment, pair in pairs},
    )


def effective(impairment: Impairment | None, *, outage: bool) -> Impairment:
    """What the pair's qdisc does: during an outage all new frames are lost, those in its queue still arrive."""
    base = OUT_OF_RANGE if impairment is None else impairment
    return replace(base, loss=LOSE_ALL) if outage else base


def problems(plan: LabPlan) -> list[str]:
    """List what sch_netem cannot express, by pair."""
    return [text for pair, impairment in _given(plan) for text in [inexpressible_pair(plan, pair, impairment)] if text]


def inexpressible_pair(plan: LabPlan, pair: Pair, impairment: Impairment | None) -> str | None:
    """Say what of one pair's impairment sch_netem cannot express, or None."""
    text = None if impairment is None else inexpressible(impairment)
    return None if text is None else f"{pair_name(plan, pair)}: {text}"


def warnings(plan: LabPlan) -> list[str]:
    """List limits that keep a link below its rate."""
    found = ((pair, narrow_limit(impairment)) for pair, impairment in _given(plan))
    return [f"{pair_name(plan, pair)}: {text}" for pair, text in found if text is not None]


def pair_name(plan: LabPlan, pair: Pair) -> str:
    """``base eth0 -> robot1 eth0``, for a person."""
    ends = [plan.ports[port] for port in pair]
    return " -> ".join(f"{end.node} {end.ifname}" for end in ends)


def pair_seed(seed: int, pair: Pair, generation: int) -> int:
    """64 bits that differ for every pair and every change of it, and are the same in every run.

    A repeated seed would restart the same random numbers at every change and so bias the loss of a moving robot.
    """
    text = f"{seed}:{pair[0]}:{pair[1]}:{generation}".encode()
    return int.from_bytes(hashlib.blake2b(text, digest_size=8).digest(), "little")


def _given(plan: LabPlan) -> Iterator[tuple[Pair, Impairment]]:
    return ((pair, impairment) for segment in plan.segments for pair, impairment in segment.pairs.items())


def _check(plan: LabPlan) -> None:
    seen: set[int] = set()
    for segment in plan.segments:
        if len(set(segment.ports)) != len(segment.ports) or seen & set(segment.ports):
            raise ValueError(f"segment {segment.name}: a port is on two segments or twice on one")
        seen |= set(segment.ports)
        for pair in segment.pairs:
            if not set(pair) <= set(segment.ports) or pair[0] == pair[1]:
                raise ValueError(f"segment {segment.name}: pair {pair} does not join two of its ports")


def _pairs(segment: Segment) -> Iterator[Pair]:
    return ((i, j) for i in segment.ports for j in segment.ports if i != j)


def _is_direct(segment: Segment) -> bool:
    return len(segment.ports) == 2


def _entry(segment: Segment, pair: Pair) -> Device:
    return Far(pair[1]) if _is_direct(segment) else Entry(pair)


def _segment_rules(plan: LabPlan, segment: Segment) -> Iterator[Rule]:
    for sender in segment.ports:
        entries = {port: _entry(segment, (sender, port)) for port in segment.ports if port != sender}
        if segment.kind is SegmentKind.WIRE:
            yield from _copies(Far(sender), 1, ANY, tuple(entries.values()))
        else:
            yield from _radio_rules(plan, sender, entries)
    if not _is_direct(segment):
        for pair in _pairs(segment):
            yield _rule(Exit(pair), 1, ANY, (Far(pair[1]),))


def _radio_rules(plan: LabPlan, sender: int, entries: dict[int, Device]) -> Iterator[Rule]:
    """Group frames to all, a unicast frame to its addressee and to every monitor, to unknown addressees: monitors."""
    priority = 1
    monitors = [port for port in entries if plan.ports[port].monitor]
    matches = [(GROUP, list(entries))]
    matches += [(match_mac(plan.ports[port].mac), sorted({port, *monitors})) for port in entries]
    matches.append((ANY, monitors))
    for match, receivers in matches:
        made = list(_copies(Far(sender), priority, match, tuple(entries[port] for port in receivers)))
        priority += len(made)
        yield from made


def _copies(device: Device, priority: int, match: Match, targets: tuple[Device, ...]) -> Iterator[Rule]:
    """One rule, or several where the kernel allows fewer actions in one filter than there are targets."""
    while len(targets) > ACTIONS_MAX:
        yield _rule(device, priority, match, targets[:ACTIONS_MAX], last=False)
        targets, priority = targets[ACTIONS_MAX:], priority + 1
    if targets:
        yield _rule(device, priority, match, targets)


def _rule(device: Device, priority: int, match: Match, targets: tuple[Device, ...], *, last: bool = True) -> Rule:
    return Rule(device=device, priority=priority, match=match, targets=targets, last=last)
