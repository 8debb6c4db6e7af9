"""Places as people write them: `[x, y]` or `[x, y, z]` in metres, a waypoint with what to do there behind."""

from __future__ import annotations

import math
from typing import Annotated, Any

from pydantic import BeforeValidator, Field, GetJsonSchemaHandler, WithJsonSchema, model_validator
from pydantic_core import CoreSchema

from netlab.scenario.base import StrictModel
from netlab.scenario.quantities import MetresPerSecond, Seconds, describe


def _position(value: object) -> tuple[float, ...]:
    """Read `[x, y]` or `[x, y, z]` in metres."""
    if not isinstance(value, (list, tuple)) or len(value) not in (2, 3):
        raise ValueError(f"expected [x, y] or [x, y, z] in metres, found {describe(value)}")
    for part in value:
        if isinstance(part, bool) or not isinstance(part, (int, float)) or not math.isfinite(part):
            raise ValueError(f"expected numbers (metres), found {describe(part)}")
    return tuple(float(part) for part in value)


Position = Annotated[
    tuple[float, ...],
    BeforeValidator(_position),
    WithJsonSchema({"type": "array", "items": {"type": "number"}, "minItems": 2, "maxItems": 3}),
]


class WaypointWords(StrictModel):
    """A place to go to: `[x, y]`, `[x, y, z]`, or either with `{pause: 5s, speed: 2m/s}` behind the numbers.

    ``speed_mps`` is that of the way there; None takes the node's.
    """

    position: Position
    pause_s: Seconds = Field(default=0.0, alias="pause")
    speed_mps: MetresPerSecond | None = Field(default=None, alias="speed")

    @model_validator(mode="before")
    @classmethod
    def _from_list(cls, value: object) -> object:
        if not isinstance(value, (list, tuple)):
            return value
        *numbers, last = value or [None]
        if not isinstance(last, dict):
            return {"position": value}
        if "position" in last:
            raise ValueError("the numbers in front are the position; remove position")
        return {"position": numbers, **last}

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        properties = {"pause": {"type": "string"}, "speed": {"type": "string"}}
        options = {"type": "object", "properties": properties, "additionalProperties": False}
        items = {"anyOf": [{"type": "number"}, options]}
        return {"type": "array", "items": items, "minItems": 2, "maxItems": 4}
