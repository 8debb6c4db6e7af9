"""A topic's rate limit in a scenario: messages per second (`2Hz`) or payload bits per second (`500kbit`)."""

from __future__ import annotations

from typing import Annotated

from pydantic import BeforeValidator, WithJsonSchema

from netlab.scenario.quantities import FREQUENCY, RATE, Quantity, describe

_MESSAGES = Quantity(FREQUENCY, maximum=1e6, above_minimum=True)
_BITS = Quantity(RATE, maximum=1e12, above_minimum=True)


def _rate_limit(value: object) -> dict[str, float]:
    if not isinstance(value, str):
        raise ValueError(f"expected messages per second like 2Hz or a rate like 500kbit, found {describe(value)}")
    if value.strip().lower().endswith("hz"):
        return {"rate_limit_hz": _MESSAGES.parse(value)}
    return {"rate_limit_bps": _BITS.parse(value)}


#: As the daemon's configuration names it: ``rate_limit_hz`` or ``rate_limit_bps``.
RateLimit = Annotated[
    dict[str, float],
    BeforeValidator(_rate_limit),
    WithJsonSchema({"type": "string", "examples": ["2Hz", "500kbit"]}),
]
