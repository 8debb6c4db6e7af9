"""The engine whose physics is the kernel's: one sch_netem per directed pair, frames handed on by filters.

Owns the devices between the far ends of the nodes' veths and keeps their qdiscs as told. What goes where is decided in
:mod:`netlab.engines.netem_plan`; how it is said to the kernel, in :mod:`netlab.kernel`.
"""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Iterable
from typing import TYPE_CHECKING

from netlab.engines import netem_plan
from netlab.engines.base import LabPlan, Pair, PairCounters
from netlab.engines.netem_counters import Counters
from netlab.engines.netem_plan import Device, Entry, Exit, Far
from netlab.engines.netem_qdiscs import INSTEAD, Qdiscs, refusal
from netlab.errors import LabError, MachineError
from netlab.kernel import pairs as pair_veths
from netlab.kernel import tc
from netlab.kernel.links import delete_group
from netlab.kernel.netem import narrow_limit
from netlab.kernel.netlink import NetlinkError, NetlinkSocket
from netlab.kernel.probe import TcFeatures, tc_features
from netlab.kernel.wiring import VethSpec, Wiring, build
from netlab.medium.impairments import Impairment

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

_log = logging.getLogger(__name__)


class NetemEngine:
    """See :class:`netlab.engines.base.Engine`. Must be brought up in the lab's own network namespace."""

    name = "netem"

    def __init__(self, plan: LabPlan) -> None:
        """Lay the plan out.

        Raises:
            MachineError: sch_netem cannot express an impairment; names pairs and reasons.
        """
        found = netem_plan.problems(plan)
        if found:
            raise MachineError("the netem engine cannot do this; " + INSTEAD + ":\n" + "\n".join(found))
        self._plan = plan
        self._layout = netem_plan.compile_plan(plan)
        self._impairments = dict(self._layout.impairments)
        self._outages: set[Pair] = set()
        self._unplugged: set[int] = set()
        self._wiring: Wiring | None = None
        self._sock: NetlinkSocket | None = None
        self._qdiscs: Qdiscs | None = None
        self._counters: Counters | None = None
        self._group: int | None = None
        self._ifindex: dict[Device, int] = {}

    @property
    def namespace_fds(self) -> dict[str, int]:
        """Network namespace of every node, held open for the lab's life."""
        return self._up()[0].namespace_fds

    def bring_up(self) -> float:
        """Create namespaces, interfaces, filters and qdiscs; after a failure nothing is left.

        Returns:
            Seconds from before the first namespace to the last interface, filter and qdisc in place.

        Raises:
            MachineError: The kernel lacks sch_netem or classifiers, or refuses an order; names it and the way out.
        """
        classifier = choose_classifier(tc_features())
        for text in netem_plan.warnings(self._plan):
            _log.warning("%s", text)
        started = time.monotonic()
        try:
            self._create(classifier)
        except BaseException:
            self._undo()
            raise
        return time.monotonic() - started

    def set_pairs(self, changes: dict[Pair, Impairment | None]) -> None:
        """Change pairs at once; None takes a pair out of range.

        Raises:
            MachineError: sch_netem cannot express one of them, or the kernel refuses one; then none is changed.
            ValueError: Unknown pair.
        """
        self._up()
        self._check_known(changes)
        found = [netem_plan.inexpressible_pair(self._plan, pair, imp) for pair, imp in changes.items()]
        refused = [text for text in found if text is not None]
        if refused:
            raise MachineError("the netem engine cannot do this; " + INSTEAD + ":\n" + "\n".join(refused))
        for pair, impairment in changes.items():
            if impairment is not None and (text := narrow_limit(impairment)) is not None:
                _log.warning("%s: %s", netem_plan.pair_name(self._plan, pair), text)
        self._change({pair: netem_plan.effective(imp, outage=pair in self._outages) for pair, imp in changes.items()})
        self._impairments.update(changes)

    def set_outage(self, pairs: set[Pair], *, active: bool) -> None:
        """Lose everything on ``pairs`` silently, or end that; frames in the queues still arrive.

        Raises:
            MachineError: The kernel refuses one; then none is changed.
            ValueError: Unknown pair.
        """
        self._up()
        self._check_known(pairs)
        self._change({pair: netem_plan.effective(self._impairments[pair], outage=active) for pair in pairs})
        self._outages = self._outages | pairs if active else self._outages - pairs

    def set_rssi(self, segment: str, rssi_dbm: NDArray[np.float64]) -> None:
        """Refuse: no qdisc shares airtime among interfaces.

        Raises:
            LabError: Always.
        """
        raise LabError(f"{segment}: shared airtime needs the air engine; use engine: air")

    def set_carrier(self, ports: set[int], *, up: bool) -> None:
        """Pull or plug the cable at these ports; what waits in a pulled port's queue is lost.

        Raises:
            MachineError: The kernel refuses one; then all are as before.
        """
        wiring, counters = self._up()[0], self._counters
        changing = sorted(port for port in ports if (port in self._unplugged) == up)
        assert counters is not None  # it is up
        try:
            with counters.around_carrier(changing, up=up):
                wiring.set_peers(changing, up=up)
        except OSError as error:
            for port in changing:
                with contextlib.suppress(OSError):
                    wiring.set_peers([port], up=not up)
            names = ", ".join(f"{self._plan.ports[port].node} {self._plan.ports[port].ifname}" for port in changing)
            raise MachineError(f"carrier of {names}: the kernel refuses: {error}; nothing has been changed") from error
        self._unplugged = self._unplugged.difference(changing) if up else self._unplugged.union(changing)

    def record_verdicts(self, fd: int) -> None:
        """Nothing is ever written: the kernel does not tell which frame it dropped, or why. The caller keeps ``fd``."""
        _log.info("the netem engine cannot record radio verdicts: the kernel keeps them to itself")

    def pair_counters(self) -> dict[Pair, PairCounters]:
        """What the kernel counted of every pair since bring-up.

        Raises:
            MachineError: The kernel does not say.
        """
        self._up()
        assert self._counters is not None  # it is up
        try:
            return self._counters.read()
        except OSError as error:
            raise MachineError(f"the kernel does not tell its counters: {error}") from error

    def timing(self) -> dict[str, float] | None:
        """None: the kernel is the medium."""
        return None

    def problem(self) -> str | None:
        """Always None: nothing of this engine runs outside the kernel."""
        return None

    def close(self) -> None:
        """Remove the pairs' devices and close this process's descriptors; idempotent."""
        self._undo()

    def _up(self) -> tuple[Wiring, NetlinkSocket]:
        if self._wiring is None or self._sock is None:
            raise RuntimeError("the engine is not up")
        return self._wiring, self._sock

    def _create(self, classifier: tc.Classifier) -> None:
        self._sock = NetlinkSocket()
        self._wiring = build(self._plan.nodes, _veths(self._plan))
        self._ifindex = {Far(port): index for port, index in enumerate(self._wiring.peer_ifindex)}
        made = pair_veths.create(self._sock, [_pair_ifnames(pair) for pair in self._layout.pair_veths])
        self._group = made.group
        for pair, (near, far) in zip(self._layout.pair_veths, made.indices, strict=True):
            self._ifindex[Entry(pair)], self._ifindex[Exit(pair)] = near, far
        shapes = {pair: self._ifindex[device] for pair, device in self._layout.shapes.items()}
        self._qdiscs = Qdiscs(self._plan, self._sock, shapes)
        self._start(self._qdiscs, classifier)
        self._counters = Counters(self._sock, shapes, dict(enumerate(self._wiring.peer_ifindex)))

    def _start(self, qdiscs: Qdiscs, classifier: tc.Classifier) -> None:
        """One batch for all qdiscs and filters."""
        wanted = {pair: netem_plan.effective(imp, outage=False) for pair, imp in self._impairments.items()}
        orders, labels = qdiscs.creation(wanted)
        for device in dict.fromkeys(rule.device for rule in self._layout.rules):
            orders.append(tc.add_clsact(self._ifindex[device]))
            labels.append(f"ingress of {device}")
        for rule in self._layout.rules:
            targets = [self._ifindex[target] for target in rule.targets]
            index = self._ifindex[rule.device]
            orders.append(
                tc.add_filter(index, rule.priority, rule.match, targets, classifier=classifier, last=rule.last)
            )
            labels.append(f"filter at {rule.device}")
        try:
            self._up()[1].request(orders)
        except NetlinkError as error:
            raise MachineError(refusal(labels[error.position], error)) from error

    def _change(self, wanted: dict[Pair, Impairment]) -> None:
        assert self._qdiscs is not None  # it is up
        self._qdiscs.change(wanted)

    def _check_known(self, named: Iterable[Pair]) -> None:
        unknown = sorted(set(named) - self._layout.shapes.keys())
        if unknown:
            raise ValueError(f"no such pairs of ports on one segment: {unknown}")

    def _undo(self) -> None:
        if self._sock is not None:
            if self._group is not None:
                delete_group(self._sock, self._group)
            self._sock.close()
        if self._wiring is not None:
            self._wiring.close()
        self._sock = self._wiring = self._group = self._qdiscs = self._counters = None
        self._unplugged = set()
        self._ifindex = {}


def why_not(plan: LabPlan) -> str | None:
    """Say why this engine cannot run ``plan`` on this kernel, or None; for ``--engine auto``.

    Raises:
        OSError: No network namespace to try it in.
    """
    found = netem_plan.problems(plan)
    if found:
        return "; ".join(found)
    try:
        choose_classifier(tc_features())
    except MachineError as error:
        return str(error)
    return None


def choose_classifier(features: TcFeatures) -> tc.Classifier:
    """Take flower where it works, else u32.

    Raises:
        MachineError: No sch_netem, or neither classifier.
    """
    if features.netem_problem is not None:
        raise MachineError(f"the netem engine cannot run: {features.netem_problem}; {INSTEAD}")
    if not features.classifiers:
        raise MachineError(f"the netem engine cannot run: this kernel has neither cls_flower nor cls_u32; {INSTEAD}")
    return features.classifiers[0]


def _veths(plan: LabPlan) -> list[VethSpec]:
    return [
        VethSpec(
            namespace=port.node,
            ifname=port.ifname,
            mac=port.mac,
            address=port.address,
            mtu=port.mtu,
            peer_ifname=f"far{port.index}",
        )
        for port in plan.ports
    ]


def _pair_ifnames(pair: Pair) -> tuple[str, str]:
    return f"p{pair[0]}_{pair[1]}", f"q{pair[0]}_{pair[1]}"
