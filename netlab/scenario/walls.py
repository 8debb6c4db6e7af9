"""The words for a tunnel's walls: a material by name, or its properties."""

from __future__ import annotations

from typing import Annotated, Any

from pydantic import Field, GetJsonSchemaHandler, model_validator
from pydantic_core import CoreSchema

from netlab.scenario.base import StrictModel, suggestion
from netlab.scenario.quantities import ANGLE, LENGTH, Quantity
from netlab.world.walls import MATERIALS, Walls

_COAL_MINE = Walls()


class WallWords(StrictModel):
    """A name in :data:`netlab.world.walls.MATERIALS`, or a block; what a block leaves out is a coal mine's."""

    permittivity: Annotated[float, Field(gt=1, le=100)] = _COAL_MINE.permittivity
    roughness_m: Annotated[float, Quantity(LENGTH, maximum=10.0)] = Field(
        default=_COAL_MINE.roughness_m, alias="roughness"
    )
    tilt_deg: Annotated[float, Quantity(ANGLE, maximum=45.0)] = Field(default=_COAL_MINE.tilt_deg, alias="tilt")

    @model_validator(mode="before")
    @classmethod
    def _by_name(cls, value: object) -> object:
        if not isinstance(value, str):
            return value
        if value not in MATERIALS:
            otherwise = "give permittivity, roughness and tilt, or one of"
            raise ValueError(f"unknown material '{value}'; {suggestion(value, list(MATERIALS), otherwise)}")
        named = MATERIALS[value]
        return {
            "permittivity": named.permittivity,
            "roughness": f"{named.roughness_m:g}m",
            "tilt": f"{named.tilt_deg:g}deg",
        }

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {"anyOf": [{"enum": list(MATERIALS)}, handler(schema)]}

    @property
    def walls(self) -> Walls:
        """As a value."""
        return Walls(self.permittivity, self.roughness_m, self.tilt_deg)
