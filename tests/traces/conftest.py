"""Traces told in a few words; times in scenario seconds."""

from __future__ import annotations

from bisect import insort

import pytest

from netlab.traces.model import Delivery, Fragment, Presence, Published, Remark, Step, Stream, Trace, Window

T0_NS = 1_800_000_000_000_000_000


def ns(at_s: float) -> int:
    return T0_NS + round(at_s * 1e9)


class Story:
    """Builds a trace of node a (and b) with urgent stream 0 and bulk stream 1, both a->b, and stream 2 from a to c."""

    def __init__(self) -> None:
        streams = (
            Stream(0, "a", "b", "telemetry", 1),
            Stream(1, "a", "b", "bulk", 9),
            Stream(2, "a", "c", "fpv", 5, keeps_latest=True),
            Stream(3, "b", "a", "commands", 2),
        )
        self.trace = Trace("run.mcap", T0_NS, 10.0, streams)
        for stream in streams:
            self.trace.published[stream.index], self.trace.delivered[stream.index] = [], []

    def publish(self, stream: int, seq: int, at_s: float, *, accepted: bool = True, size_bytes: int = 100) -> None:
        reason = None if accepted else "peer_offline"
        entry = Published(stream, stream, seq, ns(at_s), size_bytes, accepted, reason)
        self.trace.published[stream].append(entry)

    def deliver(self, stream: int, seq: int, at_s: float, *, published_s: float, size_bytes: int = 100) -> None:
        self.trace.delivered[stream].append(Delivery(stream, seq, ns(published_s), ns(at_s), size_bytes))

    def send(
        self,
        stream: int,
        seq: int,
        at_s: float,
        *,
        index: int = 0,
        count: int = 1,
        interface: str = "eth0",
        destination: str | None = None,
        size_bytes: int = 1442,
    ) -> None:
        told = self.trace.streams[stream]
        fragment = Fragment(
            ns(at_s),
            (told.source, interface),
            1,
            stream * 1000 + seq,
            index,
            count,
            told.priority,
            told.destination if destination is None else destination,
            size_bytes,
            (stream, seq),
        )
        insort(self.trace.fragments.setdefault(told.source, []), fragment, key=lambda entry: entry.t_ns)

    def peer(self, node: str, peer: str, at_s: float, *, online: bool) -> None:
        presence = self.trace.presence.setdefault((node, peer), Presence())
        presence.t_ns.append(ns(at_s))
        presence.online.append(online)
        self.trace.remarks.append(Remark(ns(at_s), node, f"{peer} {'up' if online else 'down'}"))

    def window(self, node: str, peer: str, at_s: float, *, cwnd: float, in_flight: float) -> None:
        self.trace.windows.setdefault((node, peer), []).append(Window(ns(at_s), cwnd, in_flight))

    def restore(self, between: tuple[str, str], at_s: float, *, planned_s: float | None = None) -> None:
        step = Step(ns(at_s), at_s if planned_s is None else planned_s, f"restored {between}", "outage", between)
        self.trace.timeline.append(step)


@pytest.fixture
def story() -> Story:
    return Story()


@pytest.fixture(scope="session")
def story_class() -> type[Story]:
    """For property tests, which need a fresh story per example."""
    return Story
