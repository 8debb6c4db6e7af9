"""Fragments that left the same interface again."""

from __future__ import annotations

from netlab.traces.model import Fragment, Trace


def retransmissions(trace: Trace, node: str) -> list[Fragment]:
    """Fragments of a node that it had sent before on the same interface to the same destination, in order.

    The same fragment on another interface is redundancy, to another destination a fan-out (so is a broadcast that goes
    to fixed neighbours one after another); neither counts, nor do the copies of a topic with ``redundancy``, as far as
    the daemon's events tell them from retransmissions.
    """
    seen: set[tuple[object, ...]] = set()
    again = []
    for fragment in trace.fragments.get(node, []):
        target = (fragment.interface, fragment.destination, fragment.address)
        key = (*target, fragment.epoch, fragment.message_id, fragment.index)
        if key in seen and not fragment.is_copy:
            again.append(fragment)
        seen.add(key)
    return again
