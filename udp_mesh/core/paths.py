"""By which carrier a peer is reached, where there are several.

Theory of operation.
* Beacons leave by every carrier under one number, so hearing them tells which paths are alive and what each loses.
* The path in use changes when it is silent while another is heard, when another is clearly better (much faster by the
  carriers' known rates, or a fifth of the beacons less lost), or when an acknowledgement is overdue and another path of
  about the same speed is alive: then the probe already leaves there, and the suspect path rests for a while.
* A path over a bridge is taken where there is no direct one of comparable speed.
* Acknowledgements go back the way the packets came, so that both directions choose on their own.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from udp_mesh.core.carriers import Carrier, Path

STALE_BEACONS = 2.5
STALE_AT_LEAST_S = 1.5
REST_S = 5.0
LOSS_GAIN = 0.1
CLEARLY_LESS_LOSS = 0.2
CLEARLY_FASTER = 4.0
_NEVER_S = float("-inf")
_FASTEST_BPS = 1e9  # stands for a rate that nobody knows
_MOST_MISSED = 64


@dataclass(slots=True)
class PathState:
    """One carrier on which a peer was heard."""

    path: Path
    heard_s: float
    loss_ratio: float = 0.0
    newest_number: int = -1
    """Of the broadcasts that arrived here."""
    rests_until_s: float = _NEVER_S

    def on_broadcast(self, number: int) -> None:
        """Note which broadcasts arrived: the gaps are losses."""
        missed = number - self.newest_number - 1
        if self.newest_number >= 0 and missed >= 0:
            for _ in range(min(missed, _MOST_MISSED)):
                self.loss_ratio += LOSS_GAIN * (1 - self.loss_ratio)
            self.loss_ratio -= LOSS_GAIN * self.loss_ratio
        self.newest_number = max(self.newest_number, number)


class Paths:
    """The carriers on which one peer was heard, at most one address on each, and on each one behind every link."""

    __slots__ = ("_by_carrier", "_links")

    def __init__(self, links: Mapping[int, Carrier] = MappingProxyType({})) -> None:
        self._by_carrier: dict[tuple[int, int], PathState] = {}
        self._links = links

    def heard(self, path: Path, *, now: float) -> PathState:
        """Note a datagram that came this way; the newest address on a carrier replaces the older one."""
        key = path.carrier, path.via
        state = self._by_carrier.get(key)
        if state is None or state.path != path:
            others = [known for known, other in self._by_carrier.items() if other.path[:2] == path[:2]]
            for known in others:  # the link behind this bridge is another one now
                del self._by_carrier[known]
            state = self._by_carrier[key] = PathState(path, now)
        state.heard_s = now
        return state

    def restart(self) -> None:
        """Forget the numbers of broadcasts: the peer was restarted."""
        for state in self._by_carrier.values():
            state.newest_number = -1

    def best(self, current: Path, carriers: Mapping[int, Carrier], *, stale_s: float, now: float) -> Path:
        """Return the path to use from now on: the current one unless another is clearly better.

        ``stale_s``: silence on a path after which it counts as dead.
        """
        best = self._by_carrier.get((current.carrier, current.via))
        chosen = current
        for state in self._by_carrier.values():
            if state.path == current or state.rests_until_s > now or _is_dead(state, carriers, now - stale_s):
                continue
            if (
                best is None
                or _is_dead(best, carriers, now - stale_s)
                or self._is_clearly_better(state, best, carriers)
            ):
                best, chosen = state, state.path
        return chosen

    def alternative(self, current: Path, carriers: Mapping[int, Carrier], *, stale_s: float, now: float) -> Path | None:
        """Return where to send while the current path does not answer: another of about its speed that is heard."""
        mine = self._by_carrier.get((current.carrier, current.via))
        found: PathState | None = None
        for state in self._by_carrier.values():
            if state.path == current or state.rests_until_s > now or _is_dead(state, carriers, now - stale_s):
                continue
            if self._rate(current, carriers) > CLEARLY_FASTER * self._rate(state.path, carriers):
                continue
            if state.path.via and not current.via:  # a bridge is no answer to one late acknowledgement
                continue
            if found is None or state.loss_ratio < found.loss_ratio:
                found = state
        if found is None:
            return None
        if mine is not None:
            mine.rests_until_s = now + REST_S
        return found.path

    def heard_on(self, carrier: int, *, since_s: float) -> bool:
        """Whether the peer itself, not a bridge, was heard on a carrier since then."""
        state = self._by_carrier.get((carrier, 0))
        return state is not None and state.heard_s >= since_s

    def __iter__(self) -> Iterator[PathState]:
        """What is known of each path."""
        return iter(self._by_carrier.values())

    def _rate(self, path: Path, carriers: Mapping[int, Carrier]) -> float:
        hops = carriers.get(path.carrier), self._links.get(path.via) if path.via else None
        if hops[0] is None:
            return 0.0
        return min(hop.rate_bps or _FASTEST_BPS for hop in hops if hop is not None)

    def _is_clearly_better(self, state: PathState, other: PathState, carriers: Mapping[int, Carrier]) -> bool:
        own_bps, other_bps = self._rate(state.path, carriers), self._rate(other.path, carriers)
        if own_bps * CLEARLY_FASTER < other_bps:
            return False
        if own_bps > CLEARLY_FASTER * other_bps:
            return True
        if bool(state.path.via) != bool(other.path.via):
            return not state.path.via
        return state.loss_ratio + CLEARLY_LESS_LOSS < other.loss_ratio


def _is_dead(state: PathState, carriers: Mapping[int, Carrier], heard_since_s: float) -> bool:
    return state.path.carrier not in carriers or state.heard_s < heard_since_s
