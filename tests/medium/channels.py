"""Shared channels for the tests of this folder: who hears whom, offered load, and what came of it."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from media import port

from netlab.medium.channel import Channel
from netlab.medium.channel_records import Decided
from netlab.medium.phy import PHYS, Phy, airtime_s
from netlab.medium.rate_control import FixedRate, RateControl

G = PHYS["802.11g-20MHz"]
SIX = G.rate(6e6)
NOISE_DBM = -91.0
STRONG_DBM = -50.0


def strengths(count: int, pairs: Mapping[tuple[int, int], float] | None = None) -> list[list[float]]:
    """A matrix: everyone is strong, or only these ``pairs`` (both ways) hear each other."""
    if pairs is None:
        return [[STRONG_DBM] * count for _ in range(count)]
    matrix = [[-math.inf] * count for _ in range(count)]
    for (a, b), power_dbm in pairs.items():
        matrix[a][b] = matrix[b][a] = power_dbm
    return matrix


def channel(
    rssi_dbm: Sequence[Sequence[float]],
    *,
    seed: int = 1,
    phy: Phy = G,
    rate_control: RateControl | None = None,
    limit_packets: int | None = None,
    limit_bytes: int | None = None,
) -> Channel:
    """Stations with this matrix of signal strengths, at 6 Mbit/s unless told otherwise."""
    made = Channel(
        [port(index) for index in range(len(rssi_dbm))],
        phy,
        noise_dbm=NOISE_DBM,
        seed=seed,
        limit_packets=limit_packets,
        limit_bytes=limit_bytes,
        rate_control=rate_control or FixedRate(SIX),
    )
    made.set_rssi(rssi_dbm)
    return made


def without_retries(phy: Phy = G) -> Phy:
    """A radio that tries once."""
    return replace(phy, retry_limit=1)


def drain(used: Channel, *, until_s: float = math.inf) -> list[Decided]:
    """Let everything happen, event by event."""
    decided: list[Decided] = []
    while (at_s := used.next_event()) is not None and at_s <= until_s:
        decided += used.advance(at_s)
    return decided


def saturate(used: Channel, flows: Mapping[int, int | None], *, for_s: float, size_bytes: int = 1500) -> list[Decided]:
    """Keep two frames in every sender of ``flows`` (sender: receiver, None for a group) for ``for_s`` seconds."""
    sent = bytes(size_bytes)
    for sender, receiver in flows.items():
        for _ in range(2):
            used.offer(sender, sent, receiver, now=0.0)
    decided: list[Decided] = []
    while (at_s := used.next_event()) is not None and at_s <= for_s:
        for done in used.advance(at_s):
            decided.append(done)
            used.offer(done.sender, sent, flows[done.sender], now=at_s)
    return decided


def verdicts(decided: Iterable[Decided]) -> Counter[str]:
    """How often each verdict was given, by name."""
    return Counter(verdict.name for done in decided for _port, verdict in done.fates)


def on_air_s(size_bytes: int) -> float:
    """Airtime of an Ethernet frame at 6 Mbit/s."""
    return airtime_s(SIX, G.psdu_bytes(size_bytes))
