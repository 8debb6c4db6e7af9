"""The medium of 802.11 radios: attempts, retries and acknowledgements over the directed pairs. Pure: no clock, no I/O.

Theory of operation (IEEE 802.11-2016, 10.3). A group frame is sent once and never acknowledged; each receiver in range
draws its own loss. A unicast frame is tried until its receiver has it and its acknowledgement has come back, at most
``retry_limit`` times. Here a pair's impairment describes *one attempt*: with independent loss p the frame arrives with
1 - p^retry_limit. Acknowledgements are short and sent at a basic rate: one arrives whenever the way back is in range
and not cut; where it is not, the receiver has the frame, the sender tries to the limit and reports a failure. A
receiver that hears the same frame twice drops the second, so only the first is delivered.

Delay, rate and queue of the pair apply to the attempt that arrives, as on any other pair: attempts that fail take no
time, and pairs do not share airtime.
"""

from __future__ import annotations

from bisect import insort
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from netlab.medium.chance import stable_seed
from netlab.medium.impairments import Impairment
from netlab.medium.pair import DROPPED, Outcome, Pair
from netlab.medium.segments import DEFAULT_RSSI_DBM, Port, Segment
from netlab.medium.verdicts import Verdict

_RECEIVER_ADDRESS = slice(4, 10)  # address 1 of the 802.11 header
_NOBODY_ANSWERS = (Verdict.OUTAGE, Verdict.OUT_OF_RANGE)


@dataclass(frozen=True, slots=True)
class Transmission:
    """What became of one frame.

    ``outcomes`` has one entry per receiver that it concerns: the addressee, or all in range for a group frame;
    ``overheard`` those who get it though it is not for them. ``attempts`` is at least 1. ``done_s`` is when the sender
    is through with it (medium's time).
    """

    outcomes: list[Outcome]
    overheard: list[Outcome]
    attempts: int
    acked: bool
    done_s: float


@dataclass(frozen=True, slots=True)
class _Network:
    members: dict[bytes, int]  # port by interface address
    retry_limit: int
    monitor: bool


class WifiMedium:
    """All 802.11 radios of a lab. Every random draw depends on the seed and the frames of its pair alone."""

    def __init__(self, ports: Sequence[Port], segments: Iterable[Segment], seed: int) -> None:
        """Ports that no segment with ``wifi`` names are ignored.

        Args:
            ports: The lab's, ``ports[i].index == i``.
            segments: Of which those with ``wifi`` are taken.
            seed: The lab's.
        """
        self._ports = ports
        self._seed = seed
        self._network: dict[int, _Network] = {}
        self._pairs: dict[tuple[int, int], Pair] = {}
        self._hearers: dict[int, list[int]] = {}  # sender -> the receivers that group frames concern
        self._cut: set[tuple[int, int]] = set()
        self.counts = dict.fromkeys(Verdict, 0)
        self.unaddressed = 0
        for segment in segments:
            if segment.wifi is not None:
                self._add(segment, segment.wifi.retry_limit, segment.wifi.monitor)

    def transmit(self, sender: int, frame: bytes, *, ack: bool, now: float) -> Transmission:
        """Decide on one 802.11 frame.

        Args:
            sender: Its port.
            frame: IEEE 802.11 header and body; at least 10 bytes.
            ack: False for a unicast frame that wants no acknowledgement: it is tried once.
            now: Seconds, of any origin but always the same.
        """
        address = frame[_RECEIVER_ADDRESS]
        if address[0] & 1 or self._ports[sender].radiotap:  # in monitor mode all hear all, and nobody answers
            return self._group(sender, frame, now)
        network = self._network[sender]
        tries = network.retry_limit if ack else 1
        receiver = network.members.get(address)
        if receiver is None or receiver == sender:
            self.unaddressed += 1
            done = Transmission([], [], tries, False, now)
        else:
            done = self._unicast(sender, receiver, frame, tries, ack, now)
        if network.monitor:
            done.overheard.extend(self._overhear(sender, receiver, frame, done.attempts, now))
        return done

    def rssi_dbm(self, sender: int, receiver: int) -> float:
        """How strongly ``receiver`` hears ``sender``."""
        pair = self._pairs.get((sender, receiver))
        impairment = pair.impairment if pair is not None else None
        if impairment is None or impairment.rssi_dbm is None:
            return DEFAULT_RSSI_DBM
        return impairment.rssi_dbm

    def set_pairs(self, changes: Mapping[tuple[int, int], Impairment | None]) -> None:
        """Change pairs for later frames; None takes a pair out of range.

        Raises:
            ValueError: Two ports share no 802.11 segment; nothing is changed then.
        """
        self._check(changes)
        for (sender, receiver), impairment in changes.items():
            self._heard(sender, receiver).configure(impairment)

    def set_outage(self, pairs: Iterable[tuple[int, int]], *, active: bool) -> None:
        """Lose every later frame on ``pairs`` silently, or end that.

        Raises:
            ValueError: Two ports share no 802.11 segment; nothing is changed then.
        """
        chosen = set(pairs)
        self._check(chosen)
        for sender, receiver in chosen:
            self._pair(sender, receiver).set_outage(active)
        self._cut = self._cut | chosen if active else self._cut - chosen

    def _group(self, sender: int, frame: bytes, now: float) -> Transmission:
        outcomes: list[Outcome] = []
        for receiver in self._hearers[sender]:
            self._pair(sender, receiver).offer(frame, now, outcomes)
        self._count(outcomes)
        return Transmission(outcomes, [], 1, False, max([now, *(outcome[0] for outcome in outcomes)]))

    def _unicast(self, sender: int, receiver: int, frame: bytes, tries: int, ack: bool, now: float) -> Transmission:
        attempts, outcomes = _attempt(self._pair(sender, receiver), frame, tries, now)
        self._count(outcomes)
        due, _, _, verdict = outcomes[0]
        received = due != DROPPED
        acked = ack and received and self._answers(receiver, sender)
        if verdict in _NOBODY_ANSWERS or (ack and received and not acked):
            attempts = tries
        return Transmission(outcomes, [], attempts, acked, max(due, now))

    def _overhear(self, sender: int, addressee: int | None, frame: bytes, attempts: int, now: float) -> list[Outcome]:
        heard: list[Outcome] = []
        for other in self._hearers[sender]:
            if other != addressee:
                heard += _attempt(self._pair(sender, other), frame, attempts, now)[1]
        return heard

    def _answers(self, receiver: int, sender: int) -> bool:
        back = (receiver, sender)
        return back not in self._cut and self._pair(*back).impairment is not None

    def _count(self, outcomes: list[Outcome]) -> None:
        for outcome in outcomes:
            self.counts[outcome[3]] += 1

    def _add(self, segment: Segment, retry_limit: int, monitor: bool) -> None:
        members = {self._ports[index].mac: index for index in segment.ports}
        network = _Network(members, retry_limit, monitor)
        for index in segment.ports:
            self._network[index] = network
            self._hearers[index] = []
        self.set_pairs(segment.pairs)

    def _heard(self, sender: int, receiver: int) -> Pair:
        if receiver not in self._hearers[sender]:
            insort(self._hearers[sender], receiver)
        return self._pair(sender, receiver)

    def _pair(self, sender: int, receiver: int) -> Pair:
        pair = self._pairs.get((sender, receiver))
        if pair is None:
            a, b = self._ports[sender], self._ports[receiver]
            pair = Pair(receiver, None, stable_seed(self._seed, a.node, a.ifname, b.node, b.ifname))
            self._pairs[sender, receiver] = pair
        return pair

    def _check(self, pairs: Iterable[tuple[int, int]]) -> None:
        for sender, receiver in pairs:
            network = self._network.get(sender)
            if network is None or sender == receiver or network is not self._network.get(receiver):
                raise ValueError(f"ports {sender} and {receiver} share no 802.11 segment")


def _attempt(pair: Pair, frame: bytes, tries: int, now: float) -> tuple[int, list[Outcome]]:
    """Offer a frame until it is not lost; returns the attempts made and the last one's outcome."""
    outcomes: list[Outcome] = []
    for attempt in range(1, tries + 1):
        outcomes.clear()
        pair.offer(frame, now, outcomes)
        if outcomes[0][3] is not Verdict.LOST:
            return attempt, outcomes
    return tries, outcomes
