"""The settings of `mesh: wnet`, in the words of a scenario file. The bounds are the daemon's own (wnet.config)."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from netlab.scenario.base import StrictModel
from netlab.scenario.quantities import DECIBELS, DURATION, POWER, RATE, RATIO, Quantity
from netlab.scenario.team_key import TeamKeys

Weight = Annotated[float, Field(ge=0, le=100)]
Base = Annotated[float, Field(ge=1.001, le=1e12)]
Steepness = Annotated[float, Field(ge=0.1, le=1000)]


def _seconds(minimum: float, maximum: float) -> Quantity:
    return Quantity(DURATION, minimum=minimum, maximum=maximum)


class WnetSettings(StrictModel):
    """Settings of wnet, at top level or in a node (which wins); None leaves the lab's or the daemon's default."""

    metric: Literal["quality", "etx", "ett"] | None = None
    signal_weight: Weight | None = None
    loss_weight: Weight | None = None
    utilisation_weight: Weight | None = None
    noise_dbm: Annotated[float, Quantity(POWER, minimum=-130.0, maximum=0.0)] | None = Field(
        default=None, alias="noise"
    )
    signal_scale_db: Annotated[float, Quantity(DECIBELS, minimum=0.1, maximum=100.0)] | None = Field(
        default=None, alias="signal_scale"
    )
    loss_base: Base | None = None
    loss_steepness: Steepness | None = None
    utilisation_base: Base | None = None
    utilisation_steepness: Steepness | None = None
    hello_fast_s: Annotated[float, _seconds(0.02, 60.0)] | None = Field(default=None, alias="hello_fast")
    hello_slow_s: Annotated[float, _seconds(0.02, 60.0)] | None = Field(default=None, alias="hello_slow")
    tc_slow_s: Annotated[float, _seconds(0.1, 600.0)] | None = Field(default=None, alias="tc_slow")
    search_s: Annotated[float, _seconds(0.0, 3600.0)] | None = Field(default=None, alias="search")
    control_share: Annotated[float, Quantity(RATIO, minimum=0.0001, maximum=1.0)] | None = None
    channel_bps: Annotated[float, Quantity(RATE, minimum=1e3, maximum=1e12)] | None = Field(
        default=None, alias="channel"
    )
    tries: Annotated[int, Field(ge=1, le=7)] | None = None
    broadcast_tries: Annotated[int, Field(ge=1, le=7)] | None = None
    ack_delay_s: Annotated[float, _seconds(0.0, 1.0)] | None = Field(default=None, alias="ack_delay")
    rto_min_s: Annotated[float, _seconds(0.001, 10.0)] | None = Field(default=None, alias="rto_min")
    lost_after_s: Annotated[float, _seconds(0.02, 60.0)] | None = Field(default=None, alias="lost_after")
    relay_jitter_s: Annotated[float, _seconds(0.0, 1.0)] | None = Field(default=None, alias="relay_jitter")
    hop_limit: Annotated[int, Field(ge=1, le=255)] | None = None
    redundant_dscp: Annotated[int, Field(ge=0, le=63)] | None = None
    aggregate_bytes: Annotated[int, Field(ge=0, le=1500)] | None = None
    queue_frames: Annotated[int, Field(ge=1, le=100_000)] | None = None
    queue_target_s: Annotated[float, _seconds(0.001, 60.0)] | None = Field(default=None, alias="queue_target")
    queue_lifetime_s: Annotated[float, _seconds(0.01, 60.0)] | None = Field(default=None, alias="queue_lifetime")
    key: TeamKeys | None = None

    def laid_over(self, base: WnetSettings) -> dict[str, Any]:
        """The table ``[mesh]`` of the daemon's file: these settings over ``base``; what is left out is its default."""
        return {**base.model_dump(exclude_none=True), **self.model_dump(exclude_none=True)}
