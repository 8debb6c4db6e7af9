"""What holds whatever happens on the way over bridges: a story of losses, duplicates, deafness and restarts."""

from __future__ import annotations

import contextlib
from collections import Counter
from typing import Any

from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from udp_mesh.core.events import DropReason, MessageAcked, MessageDelivered, MessageDropped, MessageQueued
from udp_mesh.core.mesh import Refused

RELAXED = settings(
    deadline=None,
    max_examples=20,
    phases=[Phase.explicit, Phase.generate],  # a story is long: shrinking one takes minutes
    suppress_health_check=[HealthCheck.too_slow],
)
WHERE = {"rover": (0,), "east": (0, 2), "west": (0, 2), "far": (2,)}
ENDS = ("rover", "far")
publish = st.tuples(st.just("publish"), st.sampled_from(ENDS), st.sampled_from([0, 500, 20_000]), st.booleans())
step = st.one_of(
    publish,
    publish,
    publish,
    st.tuples(st.just("pass"), st.sampled_from([0.001, 0.02, 0.2, 1.0, 5.0])),
    st.tuples(st.just("deaf"), st.sampled_from(list(WHERE)), st.sampled_from([0, 2])),
    st.tuples(st.just("hears"), st.sampled_from(list(WHERE)), st.sampled_from([0, 2])),
    st.tuples(st.just("restart"), st.sampled_from(list(WHERE))),
)


class Story:
    """Two bridges between two carriers, and what the ends have sent: payload -> (sender's epoch, message id)."""

    def __init__(self, net: Any, keys: tuple[bytes, ...]) -> None:
        self.net = net
        self.keys = keys
        self.sent: dict[bytes, tuple[int, int]] = {}
        self.restarted: set[str] = set()
        self.events: list[tuple[int, Any]] = []  # of every life, with its epoch
        for name in WHERE:
            self.begin(name)

    def begin(self, name: str) -> None:
        if name in self.net.cores:
            self.collect(name)
            self.net.stop(name)
            self.restarted.add(name)
        self.net.add(name, bridge=name in ("east", "west"), keys=self.keys)

    def collect(self, name: str) -> None:
        self.events += [(self.net.cores[name].epoch, event) for event in self.net.events[name]]
        self.net.events[name].clear()

    def play(self, action: tuple[Any, ...]) -> None:
        if action[0] == "publish":
            self.publish(*action[1:])
        elif action[0] == "pass":
            self.net.run(action[1])
        elif action[0] == "deaf":
            self.net.deaf.add(action[1:])
        elif action[0] == "hears":
            self.net.deaf.discard(action[1:])
        else:
            self.begin(action[1])

    def publish(self, sender: str, size: int, is_for_all: bool) -> None:
        payload = len(self.sent).to_bytes(4, "big") + bytes(size)
        to = "all" if is_for_all else ENDS[sender == ENDS[0]]
        with contextlib.suppress(Refused):
            message_id = self.net.publish(sender, "t", payload, to)
            self.sent[payload] = self.net.cores[sender].epoch, message_id

    def end(self) -> None:
        """Let everything heal, and give it time."""
        self.net.deaf.clear()
        for link in self.net.links.values():
            link.loss_ratio = 0.0
        self.net.run(120.0)
        for name in WHERE:
            self.collect(name)


@given(
    seed=st.integers(0, 1 << 32),
    loss_ratio=st.floats(0, 0.3),
    duplicate_ratio=st.floats(0, 0.5),
    jitter_s=st.sampled_from([0.0, 0.01, 0.1]),
    keys=st.sampled_from([(), (bytes(32),)]),
    steps=st.lists(step, min_size=3, max_size=25),
)
@RELAXED
def test_messages_over_bridges_are_delivered_once_and_end_in_one_way(
    places: Any, seed: int, keys: tuple[bytes, ...], steps: list[Any], **link: float
) -> None:
    story = Story(places(WHERE, seed=seed, **link), keys)
    story.net.run(3.0)
    for action in steps:
        story.play(action)
    story.end()
    check(story)


def check(story: Story) -> None:
    of = {kind: [(e, v) for e, v in story.events if isinstance(v, kind)] for kind in (MessageDelivered, MessageAcked)}
    got = Counter((epoch, event.payload) for epoch, event in of[MessageDelivered])
    assert all(count == 1 for count in got.values()), "at most once in a life of the receiver"
    assert {payload for _epoch, payload in got} <= set(story.sent), "nothing is invented"
    delivered = {(event.source, event.message_id) for _epoch, event in of[MessageDelivered]}
    sender_of = {core.epoch: name for name, core in story.net.cores.items()}
    acked = {(epoch, event.message_id, event.peer) for epoch, event in of[MessageAcked]}
    for epoch, message_id, _peer in acked:
        if epoch in sender_of:
            assert (sender_of[epoch], message_id) in delivered, "acknowledged means delivered"
    dropped = {(e, v.message_id, v.peer): v.reason for e, v in story.events if isinstance(v, MessageDropped)}
    assert not acked & dropped.keys(), "a message ends in one way"
    for (_epoch, _message_id, peer), reason in dropped.items():
        assert reason is DropReason.PEER_RESTARTED, reason
        assert peer in story.restarted, "unknown only if the receiver was restarted"
    queued = {
        (e, v.message_id, v.peer)
        for e, v in story.events
        if isinstance(v, MessageQueued) and e in sender_of and v.peer != "all"
    }
    assert queued <= acked | dropped.keys(), "every message ends"
