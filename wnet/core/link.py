"""One link: this node's member on one side, a neighbour's member on the other. Everything known of both directions."""

from __future__ import annotations

from typing import TYPE_CHECKING

from wnet.core import wire
from wnet.core.hop_timer import HopTimer
from wnet.core.loss import LossEstimate, SequenceWindow
from wnet.core.wire_control import Attributes, quantised

if TYPE_CHECKING:
    from wnet.core.members import Reception
    from wnet.core.transmissions import Entry, Transmission

    Pending = tuple[Transmission, Entry, float]  # and when it was sent

_LOSS_STEP, _SNR_STEP_DB, _RATE_STEP = 0.05, 3.0, 1.5
"""What is told of a link changes only by more than this, so that routes rest."""
_TRAFFIC_PAUSE_S = 0.3
"""Frames further apart than this are no steady traffic whose absence means anything."""


class Link:
    """State of one link; :mod:`wnet.core.neighbours` makes it usable or not.

    ``told``: this node's frames as the neighbour receives them, by its word; None before. ``is_listed``: its last word
    was that it hears this node as it is now. ``is_usable``: and it has acknowledged a probe since.
    ``agreed_at``: when its digest was this node's last; what came here until then it knows, too.
    ``misses``: frames in a row that were not acknowledged in time, ``missed_since`` the first was sent. ``is_suspect``:
    so many that alternates are used meanwhile. ``pending``: what is under way, by link sequence.
    """

    __slots__ = (
        "ack_attempt",
        "ack_due",
        "acks_owed",
        "address_pair",
        "agreed_at",
        "data_window",
        "differs_since",
        "digest",
        "epoch",
        "gap_s",
        "group_head",
        "hello_window",
        "interval_s",
        "is_listed",
        "is_missed",
        "is_suspect",
        "is_usable",
        "last_data",
        "last_heard",
        "last_sending",
        "link_id",
        "loss",
        "lost_at",
        "member",
        "missed_since",
        "misses",
        "neighbour",
        "next_sequence",
        "peer_mac",
        "peer_member",
        "pending",
        "probe",
        "published",
        "rate_bps",
        "rate_margin_db",
        "snr_db",
        "synchronised_at",
        "timer",
        "told",
    )

    def __init__(self, member: int, own_mac: bytes, peer_mac: bytes, neighbour: bytes, *, rto_min_s: float) -> None:
        self.member = member
        self.peer_mac = peer_mac
        self.neighbour = neighbour
        self.address_pair = peer_mac + own_mac + wire.ETHERTYPE
        self.group_head = wire.GROUP + own_mac + wire.ETHERTYPE
        self.peer_member = 0
        self.epoch = 0
        self.link_id = 0
        self.next_sequence = 0
        self.is_listed = self.is_usable = False
        self.digest = 0
        self.agreed_at = float("-inf")
        self.differs_since = float("inf")
        self.lost_at: float | None = None
        self.is_missed = False
        self.last_sending = float("-inf")
        self.synchronised_at = float("-inf")
        self.timer = HopTimer(rto_min_s)
        self.forget_direction_out()
        self.forget_direction_in()

    def forget_direction_out(self) -> None:
        """Forget what is under way to the neighbour and how it receives."""
        self.pending: dict[int, Pending] = {}
        self.told: Attributes | None = None
        self.probe: Transmission | None = None
        self.misses = 0
        self.missed_since = float("inf")
        self.is_suspect = False
        self.rate_margin_db = 0.0

    def forget_direction_in(self) -> None:
        """Forget what was received."""
        self.hello_window, self.data_window = SequenceWindow(), SequenceWindow()
        self.loss = LossEstimate()
        self.snr_db: float | None = None
        self.rate_bps: int | None = None
        self.published: Attributes | None = None
        self.last_heard = self.last_data = float("-inf")
        self.gap_s: float | None = None
        self.interval_s = 1.0
        self.acks_owed = 0
        self.ack_due = float("inf")
        self.ack_attempt = 0

    @property
    def is_lost(self) -> bool:
        """Whether the link was usable once and is not now."""
        return self.lost_at is not None

    def take_sequence(self) -> int:
        """Return the link sequence number for the next frame."""
        sequence = self.next_sequence
        self.next_sequence = (sequence + 1) & 0xFFFF
        return sequence

    def has_room(self) -> bool:
        """Whether another frame may be under way."""
        return len(self.pending) < self.timer.window

    def hear(self, reception: Reception | None, noise_dbm: float, *, now: float) -> None:
        """Note that a frame of the neighbour was received."""
        self.last_heard = now
        if reception is None:
            return
        if reception.signal_dbm is not None:
            noise = noise_dbm if reception.noise_dbm is None else reception.noise_dbm
            snr_db = reception.signal_dbm - noise
            self.snr_db = snr_db if self.snr_db is None else self.snr_db + (snr_db - self.snr_db) / 4.0

    def note_rate(self, reception: Reception | None) -> None:
        """Note the rate of a frame that was for this node alone: the neighbour chose it for this link."""
        if reception is not None and reception.rate_bps:
            self.rate_bps = reception.rate_bps

    def note_traffic(self, *, now: float) -> None:
        """Note a frame of data, to know how steady they are."""
        gap_s = now - self.last_data
        self.last_data = now
        if gap_s > _TRAFFIC_PAUSE_S:
            self.gap_s = None
        else:
            self.gap_s = gap_s if self.gap_s is None else self.gap_s + (gap_s - self.gap_s) / 8.0

    def note_sending(self, *, now: float) -> None:
        """Note that data leaves by this link, which makes it worth searching for when it is lost."""
        self.last_sending = now

    def miss(self, sent_at: float, *, now: float) -> None:
        """Note that a frame was not acknowledged in time."""
        self.misses += 1
        self.missed_since = min(self.missed_since, sent_at)
        if self.misses >= 2 and now - self.missed_since >= 1.5 * self.timer.rto_s:
            self.is_suspect = True

    def answer(self) -> None:
        """Note an acknowledgement."""
        self.misses = 0
        self.missed_since = float("inf")
        self.is_suspect = False

    @property
    def silence_due(self) -> float:
        """When silence of this link becomes suspicious: by its HELLOs, and earlier where traffic was steady."""
        by_hello = self.last_heard + 2.5 * self.interval_s + 0.05
        if self.gap_s is None:
            return by_hello
        return min(by_hello, self.last_heard + max(4.0 * self.gap_s, 0.1))

    def incoming(self) -> Attributes:
        """Return what to tell of the direction towards this node: as last time, unless it has changed much."""
        fresh = quantised(Attributes(self.loss.ratio, self.snr_db, self.rate_bps))
        if self.published is None or _differ(self.published, fresh):
            self.published = fresh
        return self.published


def _differ(told: Attributes, fresh: Attributes) -> bool:
    if (told.snr_db is None) != (fresh.snr_db is None) or (told.rate_bps is None) != (fresh.rate_bps is None):
        return True
    return (
        abs(told.loss_ratio - fresh.loss_ratio) > _LOSS_STEP
        or abs((told.snr_db or 0.0) - (fresh.snr_db or 0.0)) > _SNR_STEP_DB
        or max(told.rate_bps or 1, fresh.rate_bps or 1) > _RATE_STEP * min(told.rate_bps or 1, fresh.rate_bps or 1)
    )
