"""What holds whatever happens: a story of losses, cuts, stalls, restarts, lapses of memory and odd clocks, drawn by
Hypothesis.

Delivered at most once within a receiver's epoch; every reliable message ends, and in one way only; acknowledged means
delivered; urgent fragments pass; memory is bounded.
"""

from __future__ import annotations

import contextlib
from collections import Counter, deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from random import Random
from typing import Any

from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from udp_mesh.core import events
from udp_mesh.core.events import DropReason
from udp_mesh.core.mesh import Refused
from udp_mesh.core.settings import Keep, Offline, Reliability

RELAXED = settings(
    deadline=None,
    max_examples=25,
    phases=[Phase.explicit, Phase.generate],  # a story is long: shrinking one takes minutes
    suppress_health_check=[HealthCheck.too_slow],
)
NAMES = ("a", "b", "c")

clocks = st.tuples(st.sampled_from([0.0, 7.5, 4000.0, 1e6]), st.sampled_from([0.999, 1.0, 1.001]))
links = st.fixed_dictionaries(
    {
        "delay_s": st.floats(0, 0.08),
        "loss_ratio": st.floats(0, 0.35),
        "duplicate_ratio": st.floats(0, 0.5),
        "jitter_s": st.sampled_from([0.0, 0.001, 0.03, 0.2]),
        "rate_bps": st.sampled_from([0.0, 2e5, 5e6]),
    }
)
publish = st.fixed_dictionaries(
    {
        "sender": st.sampled_from(NAMES),
        "to": st.sampled_from((*NAMES, "all")),
        "size": st.sampled_from([0, 10, 1300, 1400, 5000, 30_000]),
        "priority": st.integers(0, 3),
        "reliability": st.sampled_from([Reliability.RELIABLE, Reliability.RELIABLE, Reliability.BEST_EFFORT]),
        "keep": st.sampled_from([Keep.ALL, Keep.ALL, Keep.LATEST]),
        "offline": st.sampled_from([Offline.DISCARD, Offline.LATEST]),
        "lifetime_s": st.sampled_from([None, None, 0.3, 5.0]),
        "is_tracked": st.booleans(),
    }
)
step = st.one_of(
    publish,
    publish,
    publish,
    st.tuples(st.just("pass"), st.sampled_from([0.001, 0.02, 0.2, 1.0, 5.0])),
    st.tuples(st.just("cut"), st.sampled_from(NAMES), st.sampled_from(NAMES)),
    st.tuples(st.just("mend"), st.sampled_from(NAMES), st.sampled_from(NAMES)),
    st.tuples(st.just("restart"), st.sampled_from(NAMES)),
    st.tuples(st.just("forget"), st.sampled_from(NAMES), st.sampled_from(NAMES)),
    st.tuples(st.just("stall"), st.sampled_from(NAMES), st.sampled_from([0.1, 2.0])),
)


@dataclass(slots=True)
class Story:
    """A network, and when each node began its lives: (epoch, index of its first event), newest last."""

    net: Any
    clocks: dict[str, tuple[float, float]]
    lives: dict[str, list[tuple[int, int]]] = field(default_factory=dict)
    sent: dict[tuple[int, int], bytes] = field(default_factory=dict)  # (epoch, message id) -> payload

    def begin(self, name: str) -> None:
        core = self.net.add(name, clock=self.clocks[name], queue_bytes=100_000, reassembly_bytes=200_000)
        self.lives.setdefault(name, []).append((core.epoch, len(self.net.events[name])))

    def play(self, action: Any) -> None:
        net = self.net
        if isinstance(action, dict):
            self.publish(**action)
        elif action[0] == "pass":
            net.run(action[1])
        elif action[0] in ("cut", "mend") and action[1] != action[2]:
            net.one_way(action[1], action[2], is_cut=action[0] == "cut")
        elif action[0] == "restart":
            net.stop(action[1])
            self.begin(action[1])
        elif action[0] == "forget":
            self.forget(*action[1:])
        elif action[0] == "stall":  # its process stands still; what is sent to it meanwhile waits in its socket
            core = net.cores.pop(action[1])
            net.run(action[2])
            net.cores[action[1]] = core

    def forget(self, name: str, sender: str) -> None:
        """Purge every partial message at a node, as if nothing had come of it for too long; best while one arrives."""
        peers = self.net.cores[name]._state.peers
        policy = {"priority": 2, "reliability": Reliability.RELIABLE, "keep": Keep.ALL, "offline": Offline.DISCARD}
        self.publish(sender, name, 30_000, **policy)
        self.net.run(0.3, until=lambda: any(peer.session.reassembler._partials for peer in peers.values()))
        for peer in peers.values():
            peer.session.reassembler.purge_stale(now=float("inf"), is_online=True)

    def publish(self, sender: str, to: str, size: int, **policy: Any) -> None:
        payload = len(self.sent).to_bytes(4, "big") + bytes(size)
        topic = f"{policy['keep'].value}/{policy['priority']}"
        with contextlib.suppress(Refused):
            message_id = self.net.publish(sender, topic, payload, to, **policy)
            self.sent[self.lives[sender][-1][0], message_id] = payload

    def end(self) -> None:
        """Let everything heal, and give it time."""
        for link in self.net.links.values():
            link.is_cut = False
        self.net.run(45.0)

    def life(self, name: str, index: int) -> list[events.Event]:
        first = self.lives[name][index][1]
        following = self.lives[name][index + 1 :]
        return self.net.events[name][first : following[0][1] if following else None]


@given(
    seed=st.integers(0, 1 << 32),
    link=links,
    own_clocks=st.tuples(clocks, clocks, clocks),
    steps=st.lists(step, min_size=3, max_size=25),
)
@RELAXED
def test_whatever_happens_messages_are_delivered_once_and_end_in_one_way(
    make_net: Any, seed: int, link: dict[str, float], own_clocks: Any, steps: list[Any]
) -> None:
    story = Story(make_net(seed=seed, **link), dict(zip(NAMES, own_clocks, strict=True)))
    for name in NAMES:
        story.begin(name)
    story.net.run(1.0)
    for action in steps:
        story.play(action)
    story.end()
    check_delivered_at_most_once(story)
    check_every_end(story)
    for core in story.net.cores.values():
        stats = core.stats()
        assert stats["queued_bytes"] == 0
        assert stats["reassembly_bytes"] <= 200_000


def check_delivered_at_most_once(story: Story) -> None:
    for name, lives in story.lives.items():
        for index in range(len(lives)):
            got = [e for e in story.life(name, index) if isinstance(e, events.MessageDelivered)]
            payloads = Counter(e.payload for e in got)
            assert all(count == 1 for count in payloads.values())
            assert set(payloads) <= set(story.sent.values()), "nothing is invented"


def check_every_end(story: Story) -> None:
    for name, lives in story.lives.items():
        for index, (epoch, _first) in enumerate(lives):
            own = story.life(name, index)
            acked = [(e.message_id, e.peer) for e in own if isinstance(e, events.MessageAcked)]
            drops = [e for e in own if isinstance(e, events.MessageDropped)]
            dropped = {(e.message_id, e.peer): e.reason for e in drops}
            assert len(acked) == len(set(acked))
            assert len(drops) == len(dropped), "and once"
            assert not dropped.keys() & set(acked), "a message ends in one way"
            for message_id, peer in acked:
                delivered = {e.payload for e in story.net.delivered(peer)}
                assert story.sent[epoch, message_id] in delivered, "acknowledged means delivered"
            for (_message_id, peer), reason in dropped.items():
                if reason is DropReason.PEER_RESTARTED:
                    assert len(story.lives[peer]) > 1, "unknown only if the receiver was restarted"
            queued = [(e.message_id, e.peer) for e in own if isinstance(e, events.MessageQueued)]
            assert len(queued) == len(set(queued)), "a message that is begun anew is still the same"
            ended = dropped.keys() | set(acked)
            assert ended <= set(queued)
            if index == len(lives) - 1:
                assert {peer for _message_id, peer in set(queued) - ended} <= {"all"}, "every message ends"


@given(
    seed=st.integers(0, 1 << 32),
    rate_bps=st.sampled_from([5e5, 2e6, 1e7]),
    delay_s=st.floats(0.001, 0.05),
    gaps_s=st.lists(st.floats(0.05, 0.3), min_size=3, max_size=8),
)
@settings(RELAXED, max_examples=8)
def test_an_urgent_fragment_waits_for_no_more_than_two_others_or_two_milliseconds(
    make_net: Any, seed: int, rate_bps: float, delay_s: float, gaps_s: list[float]
) -> None:
    net = make_net(seed=seed, delay_s=delay_s, rate_bps=rate_bps, limit_packets=50)
    net.add("a", trace_fragments=True)
    net.add("b")
    net.meet()
    for _ in range(3):
        net.publish("a", "bulk", bytes(1_500_000), "b", priority=9)
    net.run(1.0)
    for gap_s in gaps_s:
        net.run(gap_s)
        published_s, before = net.now, len(net.events["a"])
        message_id = net.publish("a", "urgent", bytes(100), "b", priority=0)
        net.run(0.01)
        sent = [e for e in net.events["a"][before:] if isinstance(e, events.FragmentSent)]
        at = next(i for i, e in enumerate(sent) if e.message_id == message_id)
        assert at <= 2 or sent[at].now - published_s <= 0.002


@given(
    seed=st.integers(0, 1 << 32),
    loss_ratio=st.floats(0, 0.02),
    jitter_s=st.sampled_from([0.0, 0.03]),
    outage_s=st.sampled_from([0.0, 3.0]),
)
@settings(RELAXED, max_examples=3)
def test_what_a_core_holds_does_not_grow_with_what_it_has_sent(
    make_net: Any, seed: int, loss_ratio: float, jitter_s: float, outage_s: float
) -> None:
    net = make_net(seed=seed, loss_ratio=loss_ratio, jitter_s=jitter_s)
    for name in ("a", "b"):
        net.add(name)
    net.meet()

    def hour(messages: int) -> int:
        def one() -> None:
            with contextlib.suppress(Refused):
                net.publish("a", "telemetry", bytes(60), "b", lifetime_s=2.0)
                net.publish("b", "camera", bytes(3000), "a", keep=Keep.LATEST, reliability=Reliability.BEST_EFFORT)

        net.every(0.02, one, until_s=net.now + messages * 0.02)
        net.run(messages * 0.01)
        net.link("a", "b", is_cut=outage_s > 0)
        net.run(outage_s)
        net.link("a", "b", is_cut=False)
        net.run(messages * 0.01 + 5.0)
        for own in net.events.values():
            own.clear()
        return max(entries(core) for core in net.cores.values())

    held = [hour(200) for _ in range(4)]
    # Some is remembered of what was lost, up to limits of its own; one entry for each message would be 600 more.
    assert held[-1] <= held[0] + 300, held


def entries(thing: object, seen: set[int] | None = None) -> int:
    """Count what all containers below an object hold."""
    seen = set() if seen is None else seen
    if id(thing) in seen or isinstance(thing, (str, bytes, int, float, type, Random)) or thing is None:
        return 0
    seen.add(id(thing))
    if isinstance(thing, Mapping):
        parts: list[object] = [*thing.keys(), *thing.values()]
    elif isinstance(thing, (list, tuple, set, frozenset, deque)):
        parts = list(thing)
    else:
        slots = [name for kind in type(thing).__mro__ for name in getattr(kind, "__slots__", ())]
        parts = [getattr(thing, name, None) for name in slots] + list(getattr(thing, "__dict__", {}).values())
        return sum(entries(part, seen) for part in parts)
    return len(parts) + sum(entries(part, seen) for part in parts)
