"""What can be set of a mesh: values, their bounds, and reading them from a table of a TOML file. Pure.

Files, interfaces and sockets belong to the daemon; every node of a mesh has to agree on ``metric`` and its parameters,
because each computes the whole path.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum

from udp_mesh.config_checks import Check, key, number, one_of

#: What a member's frames may carry so that 1500 bytes fit with a seal and a forward list of a dozen destinations; a
#: member that can do less still works (docs/wnet.md, "Sizes"). 802.11 carries up to 2304.
MEMBER_MTU_BYTES = 1700


class ConfigError(Exception):
    """Settings are wrong; ``problems`` lists every mistake as ``source: key: what is wrong; what to do``."""

    def __init__(self, problems: list[str]) -> None:
        super().__init__("\n".join(problems))
        self.problems = problems


class Metric(StrEnum):
    """What a link costs."""

    QUALITY = "quality"
    """The WNet paper's: 1 / weighted geometric mean of the qualities of signal, loss and utilisation."""
    ETX = "etx"
    """Expected transmissions until a frame and its acknowledgement have arrived (De Couto 2003)."""
    ETT = "ett"
    """Expected transmission time: ETX times the time of a frame at the link's rate (Draves 2004)."""


@dataclass(frozen=True, slots=True)
class MeshConfig:
    """One node's settings. Times in seconds, ratios 0..1."""

    metric: Metric = Metric.QUALITY
    """What a link costs."""
    signal_weight: float = 1.0
    """Exponent of the signal's quality in the geometric mean, 0..100; 0 leaves it out. So do links without a signal."""
    loss_weight: float = 1.0
    """Exponent of the loss ratio's quality, 0..100."""
    utilisation_weight: float = 0.0
    """Exponent of the utilisation's quality, 0..100. Above 0 traffic pushes routes to and fro."""
    noise_dbm: float = -95.0
    """Noise where the radio tells none, -130..0 (the paper's)."""
    signal_scale_db: float = 10.0
    """Decibels above the noise for a quality of 1 - 1/e, 0.1..100."""
    loss_base: float = 1e6
    """Base b of the loss ratio's sigmoid, above 1 (the paper's)."""
    loss_steepness: float = 4.0
    """c of the loss ratio's sigmoid: half the quality is gone at a ratio of 1/c, above 0 (the paper's)."""
    utilisation_base: float = 100.0
    """b of the utilisation's sigmoid (the paper's)."""
    utilisation_steepness: float = 10.0
    """c of the utilisation's sigmoid (the paper's)."""
    hello_fast_s: float = 0.1
    """Time between HELLOs while links change or are searched for, 0.02..60."""
    hello_slow_s: float = 2.0
    """Time between HELLOs of a settled node, 0.02..60."""
    tc_slow_s: float = 10.0
    """Time between TCs of a settled node, 0.1..600. A change of links is told at once."""
    search_s: float = 30.0
    """How long a lost link is searched for at ``hello_fast_s``, 0..3600; then at a fifth of ``hello_slow_s``."""
    control_share: float = 0.02
    """Part of the channel's time that HELLOs and TCs of the whole team may take, 0.0001..1."""
    channel_bps: float = 6e6
    """Rate of group frames on the channel that the team shares, 1e3..1e12; shares and airtimes are reckoned by it."""
    tries: int = 3
    """How often a frame is sent to a next hop that does not acknowledge it, 1..7; 1: nothing is acknowledged."""
    broadcast_tries: int = 1
    """The same of broadcast data and triggered TCs, to the multipoint relays only, 1..7."""
    ack_delay_s: float = 0.002
    """How long an acknowledgement may wait for others, 0..1."""
    rto_min_s: float = 0.01
    """Least time before a frame is sent again, 0.001..10."""
    lost_after_s: float = 0.12
    """A neighbour that owes an acknowledgement and says nothing for so long is lost, 0.02..60."""
    relay_jitter_s: float = 0.002
    """A relay waits up to this, at random, before it sends a flood on by radio, 0..1: who heard it with this node
    relays it, too."""
    hop_limit: int = 32
    """Transmissions in a row of one frame, 1..255."""
    redundant_dscp: int | None = None
    """Frames with this DSCP (0..63) or a more urgent one also travel a second, disjoint path; none: no frame does."""
    aggregate_bytes: int = 400
    """Frames up to this size to one next hop share a member's frame, 0..1500; 0: none do."""
    queue_frames: int = 200
    """Frames that wait per member and class of urgency, 1..100000; beyond it the oldest is dropped."""
    queue_target_s: float = 0.02
    """Where all frames of a class wait longer than this for 0.1 s, some are dropped for the others (RFC 8289),
    0.001..60."""
    queue_lifetime_s: float = 1.0
    """A frame that waited longer is dropped, 0.01..60."""
    key: tuple[bytes, ...] = field(default=(), repr=False)
    """The team's key, in a file 64 hexadecimal digits; the first of up to four seals, all open. None: no seal."""


def parse(table: Mapping[str, object], *, source: str) -> MeshConfig:
    """Check a table of settings that was read already; ``source`` names it in messages.

    Raises:
        ConfigError: With every mistake.
    """
    problems: list[str] = []
    values: dict[str, object] = {}
    for name, value in table.items():
        check = CHECKS.get(name)
        if check is None:
            problems.append(f"{source}: {name}: unknown key; known are {', '.join(CHECKS)}")
            continue
        try:
            values[name] = check(value)
        except ValueError as error:
            found = "" if name == "key" else f", not {value!r}"  # a secret does not belong into a log
            problems.append(f"{source}: {name}: {error}{found}")
    if problems:
        raise ConfigError(problems)
    return replace(MeshConfig(), **values)  # type: ignore[arg-type]


CHECKS: dict[str, Check] = {
    "metric": one_of(Metric),
    "signal_weight": number(0, 100, whole=False),
    "loss_weight": number(0, 100, whole=False),
    "utilisation_weight": number(0, 100, whole=False),
    "noise_dbm": number(-130, 0, whole=False),
    "signal_scale_db": number(0.1, 100, whole=False),
    "loss_base": number(1.001, 1e12, whole=False),
    "loss_steepness": number(0.1, 1000, whole=False),
    "utilisation_base": number(1.001, 1e12, whole=False),
    "utilisation_steepness": number(0.1, 1000, whole=False),
    "hello_fast_s": number(0.02, 60, whole=False),
    "hello_slow_s": number(0.02, 60, whole=False),
    "tc_slow_s": number(0.1, 600, whole=False),
    "search_s": number(0, 3600, whole=False),
    "control_share": number(0.0001, 1, whole=False),
    "channel_bps": number(1e3, 1e12, whole=False),
    "tries": number(1, 7, whole=True),
    "broadcast_tries": number(1, 7, whole=True),
    "ack_delay_s": number(0, 1, whole=False),
    "rto_min_s": number(0.001, 10, whole=False),
    "lost_after_s": number(0.02, 60, whole=False),
    "relay_jitter_s": number(0, 1, whole=False),
    "hop_limit": number(1, 255, whole=True),
    "redundant_dscp": number(0, 63, whole=True),
    "aggregate_bytes": number(0, 1500, whole=True),
    "queue_frames": number(1, 100_000, whole=True),
    "queue_target_s": number(0.001, 60, whole=False),
    "queue_lifetime_s": number(0.01, 60, whole=False),
    "key": key,
}
"""What each key of a file has to be; a check returns the value or raises ValueError."""
