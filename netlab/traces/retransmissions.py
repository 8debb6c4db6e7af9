"""Fragments that left the same interface again."""

from __future__ import annotations

from netlab.traces.model import Fragment, Trace


def retransmissions(trace: Trace, node: str) -> list[Fragment]:
    """Fragments of a node that it had sent before on the same interface to the same destination, in order.

    The same fragment on another interface is redundancy, to another destination a fan-out; neither counts, nor do the
    copies of a topic with ``redundancy``, as far as the daemon's events tell them from retransmissions.
    """
    seen: set[tuple[tuple[str, str], str, int, int, int]] = set()
    again = []
    for fragment in trace.fragments.get(node, []):
        key = (fragment.interface, fragment.destination, fragment.epoch, fragment.message_id, fragment.index)
        if key in seen and not fragment.is_copy:
            again.append(fragment)
        seen.add(key)
    return again
