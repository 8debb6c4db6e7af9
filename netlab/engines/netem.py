"""The engine whose physics is the kernel's: one sch_netem per directed pair, frames handed on by filters.

Owns the devices between the far ends of the nodes' veths and keeps their qdiscs as told. What goes where is decided in
:mod:`netlab.engines.netem_plan`; how it is said to the kernel, in :mod:`netlab.kernel`.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Iterable

from netlab.engines import netem_plan
from netlab.engines.base import LabPlan, Pair
from netlab.engines.netem_plan import Device, Entry, Exit, Far
from netlab.errors import MachineError
from netlab.kernel import pairs as pair_veths
from netlab.kernel import tc
from netlab.kernel.links import delete_group
from netlab.kernel.netem import uses_table
from netlab.kernel.netlink import NetlinkError, NetlinkSocket
from netlab.kernel.probe import TcFeatures, tc_features
from netlab.kernel.wiring import VethSpec, Wiring, build
from netlab.medium.impairments import Impairment

_log = logging.getLogger(__name__)
_INSTEAD = "use `--engine air`, which needs no kernel support"


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
            raise MachineError("the netem engine cannot do this; " + _INSTEAD + ":\n" + "\n".join(found))
        self._plan = plan
        self._layout = netem_plan.compile_plan(plan)
        self._impairments = dict(self._layout.impairments)
        self._outages: set[Pair] = set()
        self._in_force: dict[Pair, Impairment] = {}
        self._generation: dict[Pair, int] = {}
        self._has_table: set[Pair] = set()
        self._wiring: Wiring | None = None
        self._sock: NetlinkSocket | None = None
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
            MachineError: sch_netem cannot express one of them (then none is changed), or the kernel refuses.
            ValueError: Unknown pair.
        """
        self._up()
        self._check_known(changes)
        found = [netem_plan.inexpressible_pair(self._plan, pair, imp) for pair, imp in changes.items()]
        refused = [text for text in found if text is not None]
        if refused:
            raise MachineError("the netem engine cannot do this; " + _INSTEAD + ":\n" + "\n".join(refused))
        self._impairments.update(changes)
        self._apply(changes)

    def set_outage(self, pairs: set[Pair], *, active: bool) -> None:
        """Lose everything on ``pairs`` silently, or end that; frames in the queues still arrive.

        Raises:
            MachineError: The kernel refuses.
            ValueError: Unknown pair.
        """
        self._up()
        self._check_known(pairs)
        self._outages = self._outages | pairs if active else self._outages - pairs
        self._apply(pairs)

    def set_carrier(self, ports: set[int], *, up: bool) -> None:
        """Pull or plug the cable at these ports; what waits in a pulled port's queue is lost."""
        self._up()[0].set_peers(sorted(ports), up=up)

    def record_verdicts(self, fd: int) -> None:
        """Nothing is ever written: the kernel does not tell which frame it dropped, or why. The caller keeps ``fd``."""
        _log.info("the netem engine cannot record radio verdicts: the kernel keeps them to itself")

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
        self._request(*self._start_orders(classifier))

    def _start_orders(self, classifier: tc.Classifier) -> tuple[list[bytes], list[str]]:
        orders, labels = [], []
        for pair, device in self._layout.shapes.items():
            impairment = netem_plan.effective(self._impairments[pair], outage=False)
            orders.append(tc.add_netem(self._ifindex[device], impairment, seed=self._next_seed(pair)))
            labels.append(self._label(pair, impairment))
            self._note(pair, impairment)
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
        return orders, labels

    def _apply(self, changed: Iterable[Pair]) -> None:
        """One batch; a pair that is as it should be is left alone: a change restarts netem's loss model."""
        orders, labels, sent = [], [], {}
        for pair in changed:
            wanted = netem_plan.effective(self._impairments[pair], outage=pair in self._outages)
            if wanted == self._in_force.get(pair):
                continue
            index = self._ifindex[self._layout.shapes[pair]]
            replace_table = pair in self._has_table
            orders.append(tc.change_netem(index, wanted, seed=self._next_seed(pair), replace_table=replace_table))
            labels.append(self._label(pair, wanted))
            sent[pair] = wanted
            # Until the kernel has answered, nobody knows what is in force; then the next call tells it again.
            self._in_force.pop(pair, None)
        self._request(orders, labels)
        for pair, wanted in sent.items():
            self._note(pair, wanted)

    def _note(self, pair: Pair, impairment: Impairment) -> None:
        self._in_force[pair] = impairment
        if uses_table(impairment):
            self._has_table.add(pair)

    def _next_seed(self, pair: Pair) -> int:
        generation = self._generation[pair] = self._generation.get(pair, -1) + 1
        return netem_plan.pair_seed(self._plan.seed, pair, generation)

    def _label(self, pair: Pair, impairment: Impairment) -> str:
        # net/sched/sch_netem.c since 6.16 refuses duplication where a device has another netem.
        hint = " (some kernels refuse to duplicate frames)" if impairment.duplicate_ratio > 0 else ""
        return f"netem for {netem_plan.pair_name(self._plan, pair)}{hint}"

    def _request(self, orders: list[bytes], labels: list[str]) -> None:
        try:
            self._up()[1].request(orders)
        except NetlinkError as error:
            raise MachineError(f"{labels[error.position]}: the kernel refuses: {error.strerror}; {_INSTEAD}") from error

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
        self._sock = self._wiring = self._group = None
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
        raise MachineError(f"the netem engine cannot run: {features.netem_problem}; {_INSTEAD}")
    if not features.classifiers:
        raise MachineError(f"the netem engine cannot run: this kernel has neither cls_flower nor cls_u32; {_INSTEAD}")
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
