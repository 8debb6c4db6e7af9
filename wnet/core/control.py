"""When HELLOs and TCs leave, and what they say.

Theory of operation.
* As in Trickle (RFC 6206) the interval starts short whenever links come or go, and doubles up to a long one while
  nothing does; a change is told at once, within a few milliseconds.
* A link that carried traffic and was lost is searched for with short, partial HELLOs every ``hello_fast_s`` for
  ``search_s``; others, and by a node that is alone, at a fifth of ``hello_slow_s``.
* HELLOs tell a digest of all TCs held. Where that of a new neighbour differs, it is sent what came here since both last
  knew the same: so two parts of a team that meet know each other without waiting for the next round of TCs, and where a
  whole team's links come back at once, nobody is sent what all know.
* All that is bounded by the team's share of the channel (:mod:`wnet.core.budget`). Links that come up are told on
  credit.
"""

from __future__ import annotations

from collections.abc import Callable

from wnet.core import wire, wire_control
from wnet.core.budget import Budget
from wnet.core.context import Context
from wnet.core.flooding import Floods
from wnet.core.link import Link
from wnet.core.links import LinkTable
from wnet.core.outbox import CONTROL, FRAME_OVERHEAD_S, Outbox
from wnet.core.topology import Node, incoming_of
from wnet.core.transmissions import Packet
from wnet.core.trickle import Trickle
from wnet.core.wire_control import Hello, Incoming, NodeInfo, Topology

_AT_ONCE_S = 0.005
"""A change is told within this, at random, so that neighbours do not all speak at once."""
_SPACING_S = 0.02
_FLOOD_SHARE, _MOST_SPACING_S = 0.1, 0.2
"""TCs of one node follow one another so that they, relayed by all, take no more than this part of the channel."""
_GATHER = 0.25
"""A TC waits for other links to come up for this part of that time, or up to twice as long."""
_LEAST_WAIT_S = 0.001
_CREDIT_S, _RELAY_CREDIT_S = 10.0, 5.0
"""Links that come up are told on credit: many come at once, then none for long. Those that go spend what is saved."""
_LONGEST_INTERVALS = 3.0
"""A debt does not delay HELLOs by more than so many of the slow intervals."""
_TC_FAST_S = 1.0
"""A changed TC is repeated after this; digests tell who lacks it then."""
_SYNC_INTERVAL_S = 5.0
_PATIENCE_S = 0.5
_HEARD_BY_ALL_S = 0.1
"""A radio's new neighbours come up together; what one was sent within this, the others have heard."""
_SLOW_SEARCH = 5
_SEARCH_RESERVE_S = 5.0
"""Searching leaves what is saved in this time, so that what it finds can be told at once."""
_UTILISATION_STEP = 0.05


class Control:
    """One node's HELLOs and TCs."""

    def __init__(
        self,
        context: Context,
        links: LinkTable,
        floods: Floods,
        outbox: Outbox,
        *,
        next_sequence: Callable[[], int],
        own_info: Callable[[], NodeInfo],
        now: float,
    ) -> None:
        self._config = config = context.config
        self._graph = context.graph
        self._members = context.members
        self._journal = context.journal
        self._rng = rng = context.rng
        self._links = links
        self._floods = floods
        self._outbox = outbox
        self._next_sequence = next_sequence
        self._own_info = own_info
        self._hello = Trickle(config.hello_fast_s, config.hello_slow_s, now=now + config.hello_fast_s * rng.random())
        self._tc = Trickle(_TC_FAST_S, config.tc_slow_s, now=now + _TC_FAST_S)
        self._promised = float("inf")
        """When the next HELLOs are due by what the last ones told."""
        self._told = self._tc_content()
        """What the last TC said."""
        self._foreign: tuple[int, int] | None = None
        self._synchronised = [float("-inf")] * len(context.members)
        """When known TCs were sent last, by member."""
        self._search_due = now
        self._searched: dict[int, float] = {}
        self._sequences = [0] * len(context.members)
        self._budget = Budget(config.control_share, now=now)
        self._busy_s, self._busy_at, self._busy_ratio = 0.0, now, 0.0

    # -- what others call --------------------------------------------------------------------------------------------

    def changed(self, *, is_loss: bool, now: float) -> None:
        """Links came or went, someone new was heard, or what this node tells of itself changed: tell at once, a loss
        before anything that is sent another way because of it."""
        credit_s = 0.0 if is_loss else _CREDIT_S
        delay_s = 0.0 if is_loss else _AT_ONCE_S * self._rng.random()
        self._hello.reset(delay_s, spacing_s=_SPACING_S, credit_s=credit_s, now=now)
        if self._tc_content() != self._told:
            flood_s = len(self._graph.nodes) * self._airtime_s(self._tc_bytes())
            spacing_s = min(max(flood_s / _FLOOD_SHARE, _SPACING_S), _MOST_SPACING_S)
            delay_s = 0.0 if is_loss else _GATHER * spacing_s * (1.0 + self._rng.random())
            self._tc.reset(delay_s, spacing_s=spacing_s, credit_s=credit_s, now=now)

    def contradict(self, epoch: int, sequence: int, link: Link, *, now: float) -> None:
        """A TC names this node but is none of its own: an earlier start's, or another node's if a second comes."""
        if self._foreign is not None and self._foreign[0] == epoch and self._foreign[1] != sequence:
            self._journal.conflict(self._graph.own.mac, link.peer_mac, now=now)
        self._foreign = (epoch, sequence)

    def compare(self, link: Link, *, now: float) -> None:
        """Look at the digest of a neighbour's HELLO; one that differs for long means that a TC was lost."""
        if link.digest == self._graph.digest:
            link.agreed_at, link.differs_since = now, float("inf")
            return
        link.differs_since = min(link.differs_since, now)
        is_patient = now - link.differs_since < _PATIENCE_S or now - link.synchronised_at < _SYNC_INTERVAL_S
        if not is_patient and self._send_known(link, now=now):
            link.synchronised_at = now

    def synchronise(self, link: Link, *, now: float) -> None:
        """Send a new neighbour the TCs that it may lack."""
        link.differs_since = float("inf")
        if link.digest != self._graph.digest:
            self._send_known(link, now=now)

    def _send_known(self, link: Link, *, now: float) -> bool:
        """Send the TCs that came since the neighbour knew the same ones. Return False, and send none, if some went out
        just now: on a radio all hear what one is sent, and may say so in their next HELLOs."""
        if self._members[link.member].is_radio and now - self._synchronised[link.member] < _HEARD_BY_ALL_S:
            return False
        self._synchronised[link.member] = now
        own = self._graph.own
        for node in list(self._graph.nodes.values()):
            if node.tail is None or node.mac == link.neighbour or node.came_at < link.agreed_at:
                continue
            if node is not own or not self._tc.is_urgent:  # else a newer one follows
                self._budget.spend(self._airtime_s(len(node.tail)), now=now)
                self._floods.send_to(link, self.packet_of(node, now=now), now=now)
        return True

    def packet_of(self, node: Node, *, now: float) -> Packet:
        """Return a node's last TC as it travels."""
        age_s = max(now - node.told_at, 0.0)
        return Packet(wire.TC, node.tail or b"", self._config.hop_limit, CONTROL, None, age_s=age_s)

    def may_relay_unasked(self, size_bytes: int, *, now: float) -> bool:
        """Whether another node's TC that nobody asked this one to relay leaves enough for its own."""
        return self._budget.wait_s(self._airtime_s(size_bytes), now=now, reserve_s=-_RELAY_CREDIT_S) == 0.0

    def account(self, size_bytes: int, *, now: float) -> None:
        """Account for what is sent besides: another node's TC, a probe."""
        self._budget.spend(self._airtime_s(size_bytes), now=now)

    # -- time --------------------------------------------------------------------------------------------------------

    def next_due(self) -> float:
        """When :meth:`handle` has something to do."""
        return min(self._hello.due, self._tc.due, self._search_due)

    def handle(self, *, now: float) -> None:
        """Send what is due and affordable."""
        self._budget.divide(len(self._graph.nodes))
        if self._hello.due <= now and (
            self._promised <= now or self._is_affordable(self._hello, self._hello_bytes(), now)
        ):
            self._send_hellos(now)
        if self._tc.due <= now and self._is_affordable(self._tc, self._tc_bytes(), now):
            self._send_tc(now)
        if self._search_due <= now:
            self._search(now)

    def _is_affordable(self, trickle: Trickle, size_bytes: int, now: float) -> bool:
        wait_s = self._budget.wait_s(self._airtime_s(size_bytes), now=now, reserve_s=-trickle.credit_s)
        if wait_s > 0.0:
            trickle.due = now + max(wait_s, _LEAST_WAIT_S)  # a sum that rounds to now would be asked for for ever
        return wait_s == 0.0

    def _hello_bytes(self) -> int:
        return (60 + wire_control.HEARD_BYTES * len(self._graph.own.incoming)) * len(self._members)

    def _tc_bytes(self) -> int:
        return 80 + wire_control.LINK_BYTES * len(self._graph.own.incoming)

    def _airtime_s(self, size_bytes: int) -> float:
        return FRAME_OVERHEAD_S + 8 * (size_bytes + wire.ETHERNET_BYTES) / self._config.channel_bps

    # -- HELLO -------------------------------------------------------------------------------------------------------

    def _send_hellos(self, now: float) -> None:
        self._measure_utilisation(now)
        interval_s = self._promise(now)
        mprs = self._floods.mprs
        for member in range(len(self._members)):
            self._send_hello(member, interval_s, mprs, is_partial=False, now=now)

    def _promise(self, now: float) -> float:
        """Return the time until the next HELLOs: the interval's, or longer if that is not affordable.

        It is kept in any case, since neighbours probe whoever is silent for longer than told.
        """
        wait_s = self._hello.sent(self._rng, now=now)
        affordable_s = self._budget.wait_s(2.0 * self._airtime_s(self._hello_bytes()), now=now)
        longest_s = max(_LONGEST_INTERVALS * self._config.hello_slow_s, affordable_s - self._budget.debt_wait_s)
        wait_s = max(wait_s, min(affordable_s, longest_s))
        self._promised = self._hello.due = now + wait_s
        return wait_s

    def _send_hello(
        self, member: int, interval_s: float, mprs: frozenset[bytes], *, is_partial: bool, now: float
    ) -> None:
        links = self._links.heard(member, is_partial=is_partial, mprs=mprs, now=now)
        most = (self._outbox.limit_bytes(member) - 300) // wire_control.HEARD_BYTES
        if len(links) > most:  # in turn, from one HELLO to the next
            first = self._sequences[member] * most % len(links)
            links, is_partial = (links + links)[first : first + most], True
        own = self._graph.own
        self._sequences[member] = (self._sequences[member] + 1) & 0xFFFF
        body = wire_control.encode_hello(
            Hello(
                own.mac,
                own.epoch,
                member,
                self._sequences[member],
                interval_s,
                self._graph.digest,
                self._busy_ratio,
                is_partial,
                own.info,
                links,
            )
        )
        self._budget.spend(self._airtime_s(len(body)), now=now)
        self._outbox.add_control(member, wire.GROUP + self._members[member].mac + wire.ETHERTYPE, body)

    def _search(self, now: float) -> None:
        """Send partial HELLOs where a link was lost, and by a node that is alone."""
        fast_s, slow_s = self._config.hello_fast_s, self._config.hello_slow_s / _SLOW_SEARCH
        wait_s: dict[int, float] = {}
        for link in self._links:
            if link.lost_at is not None and now - link.lost_at < self._config.search_s * _SLOW_SEARCH:
                is_fast = link.is_missed and now - link.lost_at < self._config.search_s
                wait_s[link.member] = min(wait_s.get(link.member, slow_s), fast_s if is_fast else slow_s)
        if not self._graph.own.incoming:
            wait_s = {member: wait_s.get(member, slow_s) for member in range(len(self._members))}
        self._search_due = now + min(wait_s.values(), default=slow_s) * (1.0 - 0.1 * self._rng.random())
        waited = {member: (now - self._searched.get(member, float("-inf"))) / wait_s[member] for member in wait_s}
        for member in sorted(waited, key=lambda member: -waited[member]):
            if waited[member] < 0.8:
                continue
            if self._budget.wait_s(self._airtime_s(100), now=now, reserve_s=_SEARCH_RESERVE_S) == 0.0:
                interval_s = wait_s[member]
                self._searched[member] = now
                until_next_s = max(self._hello.due - now, interval_s)
                self._send_hello(member, until_next_s, frozenset(), is_partial=True, now=now)

    # -- TC ----------------------------------------------------------------------------------------------------------

    def _send_tc(self, now: float) -> None:
        is_urgent = self._tc.is_urgent
        self._tc.sent(self._rng, now=now)
        own = self._graph.own
        if not own.incoming and own.tail is None:
            return
        self._told = info, links = self._tc_content()
        most = (self._outbox.least_limit_bytes - 400) // wire_control.LINK_BYTES
        topology = Topology(own.mac, self._config.tc_slow_s, info, links[:most])
        sequence = self._next_sequence()
        tail = wire.tail_of(own.epoch, sequence, wire_control.encode_tc(topology))
        self._graph.note_own_tc(sequence, tail, now=now)
        if self._floods.send(self.packet_of(own, now=now), is_retried=is_urgent, now=now):
            self._budget.spend(self._airtime_s(len(tail)), now=now)

    def _tc_content(self) -> tuple[NodeInfo, tuple[Incoming, ...]]:
        return self._graph.own.info, incoming_of(self._graph.own)

    def refresh_info(self, *, now: float) -> None:
        """Put what this node tells of itself into the graph."""
        info = self._own_info()
        ratio = min(self._busy_ratio + self._links.sending_ratio, 1.0)
        told = self._graph.own.info.utilisation_ratio
        if abs(ratio - told) <= _UTILISATION_STEP:
            ratio = told
        self._graph.set_own_info(info._replace(utilisation_ratio=ratio))

    def _measure_utilisation(self, now: float) -> None:
        elapsed_s = now - self._busy_at
        if elapsed_s > 0.0:
            self._busy_ratio = min((self._outbox.busy_s - self._busy_s) / elapsed_s, 1.0)
            self._busy_s, self._busy_at = self._outbox.busy_s, now
        self.refresh_info(now=now)
