"""Multipoint relays: the few neighbours whose relaying reaches every node two links away (RFC 3626, section 8.3.1)."""

from __future__ import annotations

from collections.abc import Mapping


def select(coverage: Mapping[bytes, frozenset[bytes]], costs: Mapping[bytes, float]) -> frozenset[bytes]:
    """Return neighbours that together cover all that any of them covers; few, not always the fewest (NP-hard).

    Args:
        coverage: Of every neighbour, the two-hop neighbours that it reaches.
        costs: Of every neighbour, the cost of the link to it; of two that cover as much the cheaper one is taken.
    """
    left = frozenset().union(*coverage.values())
    chosen: set[bytes] = set()
    while left:
        best = max(coverage, key=lambda mac: (len(coverage[mac] & left), -costs[mac], mac))
        chosen.add(best)
        left -= coverage[best]
    return frozenset(_without_needless(chosen, coverage, costs))


def _without_needless(
    chosen: set[bytes], coverage: Mapping[bytes, frozenset[bytes]], costs: Mapping[bytes, float]
) -> set[bytes]:
    """Drop those whose two-hop neighbours the others cover, the dearest first."""
    for mac in sorted(chosen, key=lambda mac: (-costs[mac], mac)):
        others = frozenset().union(*(coverage[other] for other in chosen if other != mac))
        if coverage[mac] <= others:
            chosen.discard(mac)
    return chosen
