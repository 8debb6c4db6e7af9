"""What arrives: checks who sent it and to whom, then hands its frames to recovery, reassembly and liveness."""

from __future__ import annotations

from udp_mesh.core import wire
from udp_mesh.core.bridge import Bridge
from udp_mesh.core.congestion import AckSample
from udp_mesh.core.coordination import HOLD_S
from udp_mesh.core.events import MessageDelivered, Window
from udp_mesh.core.links import Links
from udp_mesh.core.liveness import Liveness
from udp_mesh.core.outbox import Outbox
from udp_mesh.core.peer import Path, Peer
from udp_mesh.core.reassembly import Verdict, WholeMessage
from udp_mesh.core.recovery import AckOutcome, SentRun
from udp_mesh.core.state import NodeState
from udp_mesh.core.wire_runs import Run, decode_run

WINDOW_EVENT_INTERVAL_S = 0.1
PROBE_CREDITS = 2


class Receiver:
    """Takes datagrams; anything that cannot be believed is counted by reason and dropped."""

    def __init__(self, state: NodeState, outbox: Outbox, liveness: Liveness, bridge: Bridge, links: Links) -> None:
        self._state = state
        self._bridge = bridge
        self._links = links
        self._outbox = outbox
        self._liveness = liveness

    def burst(self, data: bytes | memoryview, segment_bytes: int, path: Path, *, now: float) -> None:
        """Take datagrams of one length (the last may be shorter) that arrived together; runs are taken as a whole."""
        view = memoryview(data)
        at = 0
        while at < len(view):
            run = decode_run(view[at:], segment_bytes)
            count = 1 if run is None else len(run.payloads)
            if run is None or not self._run(run, path, now=now):
                for _ in range(count):
                    self.datagram(view[at : at + segment_bytes], path, now=now)
                    at += segment_bytes
            else:
                self._state.counters["datagrams_received"] += count
                at += count * segment_bytes

    def _run(self, run: Run, path: Path, *, now: float) -> bool:
        """Take a run that continues what a peer sends us; False, with nothing changed, if it is anything else."""
        peer = self._state.by_epoch.get(run.epoch)
        if peer is None or run.destination_tag != self._state.tag:
            return False
        acks = peer.session.acks
        if not acks.is_new_run(run.packet_number):
            return False
        result = peer.session.reassembler.take_run(run, now=now)
        if result is None:
            return False
        self._liveness.heard(peer, path, hears_us=True, now=now)
        peer.session.reply_path = path
        if isinstance(result, WholeMessage):
            self._deliver(peer, result, now=now)
        last = run.packet_number + len(run.payloads) - 1
        acks.record_run(run.packet_number, last, ack_now=run.ack_now, now=now)
        return True

    def datagram(self, data: bytes | memoryview, path: Path, *, sealed: bytes | memoryview = b"", now: float) -> None:
        """Take one datagram; never raises for what is in it. ``sealed``: as it arrived, if it was sealed."""
        counters = self._state.counters
        counters["datagrams_received"] += 1
        packet = wire.decode(data)
        if isinstance(packet, wire.BadDatagram):
            counters[f"bad_{packet.value}"] += 1
            return
        if packet.epoch == self._state.epoch:
            counters["own_datagrams"] += 1  # our broadcasts come back
            return
        way = self._bridged_way(packet, path) if packet.is_bridged else path
        if way is None:
            return
        path = way
        peer = self._sender(packet, path, now=now)
        is_for_us = packet.destination_tag in (0, self._state.tag)
        if packet.probes and is_for_us:
            heard = packet.beacons[0].heard if packet.beacons else ()
            self._liveness.on_probe(packet.epoch, packet.probes, heard, path, now=now)
        if peer is None:
            return
        if not is_for_us and self._bridge.unicast(sealed or data, packet, peer, path, now=now):
            self._liveness.heard(peer, path, hears_us=False, now=now)
            return
        if not is_for_us:
            counters["wrong_epoch"] += 1  # meant for who we were before our restart
            self._liveness.introduce(packet.epoch, path, ask=False, now=now)
            return
        hears_us = packet.destination_tag != 0 or any(self._state.tag in hello.heard for hello in packet.beacons)
        self._liveness.heard(peer, path, hears_us=hears_us, now=now)
        if packet.backlogs:
            peer.backlog_priority, peer.backlog_until_s = min(packet.backlogs), now + HOLD_S
        for link in packet.links:
            self._liveness.on_link(peer, link, path, now=now)
        if packet.is_broadcast:
            if not path.via:
                self._liveness.router.on_broadcast(peer, path, packet.packet_number, now=now)
            self._bridge.broadcast(sealed or data, packet, peer, path, now=now)
        elif packet.is_ack_eliciting:
            peer.session.reply_path = path
        if packet.is_unnumbered:
            self._unnumbered(peer, packet, now=now)
        else:
            self._numbered(peer, packet, now=now)

    def _bridged_way(self, packet: wire.Dissection, path: Path) -> Path | None:
        """The way back by the bridge that passed a datagram on; None if it never told of its sender."""
        told = self._links.way(wire.tag_of(packet.epoch), path)
        if told is None:
            self._state.counters["bridged_untold"] += 1
            return None
        return told.way

    def _sender(self, packet: wire.Dissection, path: Path, *, now: float) -> Peer | None:
        if packet.beacons:
            return self._liveness.on_hello(packet.epoch, packet.beacons[0], path, now=now)
        peer = self._state.by_epoch.get(packet.epoch)
        if peer is None:
            self._state.counters["unknown_sender"] += 1
            self._liveness.introduce(packet.epoch, path, ask=True, now=now)
        return peer

    def _unnumbered(self, peer: Peer, packet: wire.Dissection, *, now: float) -> None:
        for fragment in packet.fragments:
            if fragment.fragment_count == 1:
                self._fragment(peer, fragment, now=now)
        for hello in packet.beacons:
            self._settle(peer, hello.floor, now=now)

    def _numbered(self, peer: Peer, packet: wire.Dissection, *, now: float) -> None:
        session = peer.session
        if session.acks.is_duplicate(packet.packet_number):
            self._state.counters["duplicate_packets"] += 1
            if packet.is_ack_eliciting:
                session.acks.repeat(now=now)
            return
        for ack in packet.acks:
            self._ack(peer, ack, now=now)
        is_taken = True
        for fragment in packet.fragments:
            is_taken &= self._fragment(peer, fragment, now=now)
        for floor in packet.floors:
            self._settle(peer, floor, now=now)
        for message_id in packet.purged:
            transfer = peer.lane.transfers.get(message_id)
            if transfer is not None and transfer.is_started:
                self._outbox.start_over(transfer, now=now)
        if is_taken:
            session.acks.record(
                packet.packet_number,
                is_ack_eliciting=packet.is_ack_eliciting,
                ack_now=packet.ack_now,
                ack_later=packet.ack_later,
                now=now,
            )

    def _fragment(self, peer: Peer, fragment: wire.DataFragment, *, now: float) -> bool:
        """Take a fragment; False if its packet must not be acknowledged."""
        counters = self._state.counters
        result = peer.session.reassembler.take(fragment, now=now)
        if isinstance(result, WholeMessage):
            self._deliver(peer, result, now=now)
            return True
        if result is Verdict.STORED:
            return True
        counters[f"fragments_{result.name.lower()}"] += 1
        if result is Verdict.PURGED:
            frame = wire.encode_purged(fragment.message_id)
            if frame not in peer.session.control:
                peer.session.control.append(frame)
        return result in (Verdict.DUPLICATE, Verdict.CONTRADICTION)

    def _deliver(self, peer: Peer, whole: WholeMessage, *, now: float) -> None:
        self._state.counters["messages_delivered"] += 1
        self._state.events.append(
            MessageDelivered(
                now, whole.message_id, whole.topic, whole.about.priority, peer.name, whole.payload, whole.about.flags
            )
        )

    def _settle(self, peer: Peer, floor: int, *, now: float) -> None:
        purged = peer.session.reassembler.settle_below(floor)
        self._liveness.report_purged(peer, purged, is_settled=True, now=now)

    def _ack(self, peer: Peer, ack: wire.Ack, *, now: float) -> None:
        recovery = peer.session.recovery
        was_limited = peer.was_limited
        outcome = recovery.on_ack(ack, now=now)
        if outcome is None:
            self._state.counters["acks_of_unsent"] += 1
            return
        for run in outcome.acked:
            self._outbox.acknowledge(run, now=now)
        self.retry(outcome.lost, now=now)
        if len(recovery) == 0:
            peer.waiting_since_s = None
        self._congestion(peer, outcome, was_limited=was_limited, now=now)

    def _congestion(self, peer: Peer, outcome: AckOutcome, *, was_limited: bool, now: float) -> None:
        if not outcome.acked and not outcome.lost:
            return
        sample = AckSample(
            acked_bytes=outcome.acked_bytes,
            acked_packets=outcome.acked_packets,
            lost_packets=outcome.lost_packets,
            one_way_s=outcome.one_way_s if outcome.rtt_sampled else None,
            received_us=outcome.received_us,
            newest_bytes=outcome.newest_bytes,
            rate_bps=outcome.rate_bps,
            is_limited=was_limited,
            in_flight_bytes=peer.session.recovery.in_flight_bytes,
        )
        peer.congestion.on_ack(sample, rtt=peer.session.rtt, now=now)
        if now - peer.last_window_event_s >= WINDOW_EVENT_INTERVAL_S:
            peer.last_window_event_s = now
            congestion, session = peer.congestion, peer.session
            self._state.events.append(
                Window(
                    now,
                    peer.name,
                    congestion.cwnd_bytes,
                    session.recovery.in_flight_bytes,
                    session.rtt.srtt_s,
                    congestion.queue_delay_s,
                    congestion.rate_bps,
                )
            )

    def retry(self, runs: list[SentRun], *, now: float) -> None:
        """Queue what lost packets carried once more."""
        for run in runs:
            self._outbox.retry(run, now=now)

    def recovery_timer(self, peer: Peer, *, now: float) -> None:
        """Find packets lost by time, or send a probe when everything is silent."""
        recovery = peer.session.recovery
        if not peer.is_online or not len(recovery):
            return
        due_s = recovery.next_timer()
        if due_s is None or due_s > now:
            return
        self.retry(recovery.detect_lost(now=now), now=now)
        if not len(recovery) or recovery.probe_at_s > now:
            return
        packet = recovery.on_probe_timeout(now=now)
        self._liveness.router.on_probe_timeout(peer, now=now)
        repeated = tuple(part for part in packet.parts if part[0].message.is_reliable)
        self._outbox.retry(packet._replace(parts=repeated), now=now)
        if self._state.scheduler.head(peer.name) is None:
            peer.session.ping_wanted = True
        else:
            peer.session.probe_credits = PROBE_CREDITS
