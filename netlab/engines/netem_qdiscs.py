"""The netem qdiscs of all pairs: what is in force in each, and changes that happen everywhere or nowhere.

Theory. All changes of one call go to the kernel in one batch, and the kernel does not stop at a message that it
refuses. So after a refusal every pair of the call is told its former state again, the refused one too: netem_change()
in net/sched/sch_netem.c sets delay, loss and limit *before* it checks whether it may duplicate, and leaves them set
when it may not. A pair that is as it should be is left alone, since a change restarts netem's loss model; and every
message has a seed of its own, since a repeated one would repeat the same random numbers.
"""

from __future__ import annotations

import errno
from collections.abc import Mapping

from netlab.engines import netem_plan
from netlab.engines.base import LabPlan, Pair
from netlab.errors import MachineError
from netlab.kernel import tc
from netlab.kernel.netem import uses_table
from netlab.kernel.netlink import NetlinkError, NetlinkSocket
from netlab.medium.impairments import Impairment

INSTEAD = "use `--engine air`, which needs no kernel support"
_GONE = "something in the lab has removed the lab's own interface or qdisc; end this lab and start it again"
_WAYS_OUT = {errno.ENOENT: _GONE, errno.ENODEV: _GONE, errno.EPERM: "the lab's supervisor has lost its capabilities"}


class Qdiscs:
    """One netem per pair, at the root of the interface that ``ifindex`` gives."""

    def __init__(self, plan: LabPlan, sock: NetlinkSocket, ifindex: Mapping[Pair, int]) -> None:
        self._plan = plan
        self._sock = sock
        self._ifindex = ifindex
        self._segment_of = {
            pair: segment.name for segment in plan.segments for pair in ifindex if set(pair) <= set(segment.ports)
        }
        self._in_force: dict[Pair, Impairment] = {}
        self._generation: dict[Pair, int] = {}
        self._has_table: set[Pair] = set()

    def creation(self, wanted: Mapping[Pair, Impairment]) -> tuple[list[bytes], list[str]]:
        """The messages that make the qdiscs, and for each whose it is; the caller sends them, all or nothing."""
        orders = []
        for pair, impairment in wanted.items():
            orders.append(tc.add_netem(self._ifindex[pair], impairment, seed=self._next_seed(pair)))
            self._note(pair, impairment)
        return orders, [self._label(pair) for pair in wanted]

    def change(self, wanted: Mapping[Pair, Impairment]) -> None:
        """Bring pairs into a state, in one batch.

        Raises:
            MachineError: The kernel refuses one; then all are as they were before, or the text names those that are
                not. Names pair, link, the kernel's reason and the way out.
        """
        changes = {pair: value for pair, value in wanted.items() if value != self._in_force.get(pair)}
        former = {pair: self._in_force.pop(pair) for pair in changes if pair in self._in_force}
        pairs = list(changes)
        try:
            self._sock.request([self._order(pair, changes[pair]) for pair in pairs])
        except NetlinkError as error:
            text = refusal(self._label(pairs[error.position]), error)
            raise MachineError(text + self._restore(former, pairs)) from error
        except OSError as error:
            text = f"the kernel's answers were lost: {error}; try again"
            raise MachineError(text + self._restore(former, pairs)) from error
        self._in_force.update(changes)

    def _restore(self, former: Mapping[Pair, Impairment], pairs: list[Pair]) -> str:
        """Tell pairs their former state one by one; returns what to add to the error's text."""
        stuck = []
        for pair in pairs:
            try:
                if pair in former:
                    self._sock.request([self._order(pair, former[pair])])
                    self._in_force[pair] = former[pair]
                else:
                    stuck.append(pair)  # its last restoration has failed already
            except OSError:
                stuck.append(pair)
        if not stuck:
            return "; nothing has been changed"
        names = ", ".join(netem_plan.pair_name(self._plan, pair) for pair in stuck)
        return f"; nothing has been changed but at {names}, whose state is unknown until the next change that succeeds"

    def _order(self, pair: Pair, impairment: Impairment) -> bytes:
        replace_table = pair in self._has_table
        order = tc.change_netem(
            self._ifindex[pair], impairment, seed=self._next_seed(pair), replace_table=replace_table
        )
        self._note_table(pair, impairment)  # also when it is refused in the end: nobody knows how far it came
        return order

    def _note(self, pair: Pair, impairment: Impairment) -> None:
        self._in_force[pair] = impairment
        self._note_table(pair, impairment)

    def _note_table(self, pair: Pair, impairment: Impairment) -> None:
        if uses_table(impairment):
            self._has_table.add(pair)

    def _next_seed(self, pair: Pair) -> int:
        generation = self._generation[pair] = self._generation.get(pair, -1) + 1
        return netem_plan.pair_seed(self._plan.seed, pair, generation)

    def _label(self, pair: Pair) -> str:
        return f"netem for {netem_plan.pair_name(self._plan, pair)} (link {self._segment_of[pair]})"


def refusal(label: str, error: NetlinkError) -> str:
    """What was refused, why by the kernel's own words, and what to do."""
    reason = (error.strerror or "").rstrip(".")  # the kernel's own texts may end in a full stop
    return f"{label}: the kernel refuses: {reason}; {_WAYS_OUT.get(error.errno or 0, INSTEAD)}"
