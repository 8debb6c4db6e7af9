"""The words for radio waves: propagation models by name, power, frequency and antennas of radios.

Propagation models bring their own words (:mod:`netlab.world.propagation`). They compute with NumPy, which a lab of
wires does without: it is imported when a scenario names a model.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, Self

from pydantic import BeforeValidator, Field, GetJsonSchemaHandler, WithJsonSchema, model_validator
from pydantic_core import CoreSchema

from netlab.scenario.base import StrictModel, suggestion
from netlab.scenario.quantities import ANGLE, DECIBELS, FREQUENCY, POWER, BitsPerSecond, Quantity, describe

if TYPE_CHECKING:
    from netlab.world.antenna import Antenna
    from netlab.world.propagation.model import PropagationModel

#: Names of the project's own models; a name with a colon is somebody's `module:Class`.
MODEL_NAMES = ("free_space", "log_distance", "tunnel", "subt")
DEFAULT_FREQUENCY_HZ = 2.437e9
DEFAULT_TX_POWER_DBM = 20.0
_FACES = {"front": (0.0,), "back": (180.0,), "both": (0.0, 180.0)}


def is_physical(name: object) -> bool:
    """Whether ``propagation: {model: name}`` computes signal strengths from positions."""
    return isinstance(name, str) and (name in MODEL_NAMES or ":" in name)


def propagation_model(block: Mapping[str, object]) -> PropagationModel:
    """Check a `propagation:` block that names such a model.

    Raises:
        ValueError: No such model; a pydantic ValidationError for its words.
    """
    from netlab.world.propagation.registry import model_class

    words = {key: value for key, value in block.items() if key != "model"}
    return model_class(str(block["model"])).model_validate(words)


def model_schemas(handler: GetJsonSchemaHandler) -> list[dict[str, Any]]:
    """JSON Schemas of the project's own models, `model:` included, and of anybody's."""
    from netlab.world.propagation.registry import MODELS

    schemas: list[dict[str, Any]] = []
    for name, model in MODELS.items():
        schema = handler.resolve_ref_schema(handler(model.__pydantic_core_schema__))
        properties = {"model": {"const": name}, **schema["properties"]}
        schemas.append({**schema, "properties": properties, "required": ["model"]})
    path = {"type": "string", "pattern": "^.+:.+$"}
    return [*schemas, {"type": "object", "properties": {"model": path}, "required": ["model"]}]


def _facing(value: object) -> tuple[float, ...]:
    if isinstance(value, (list, tuple)):
        if not value:
            raise ValueError("an antenna faces somewhere; name front, back or an angle")
        return tuple(angle for part in value for angle in _facing(part))
    if value in _FACES:
        return _FACES[str(value)]
    if isinstance(value, str) and value.isalpha():
        raise ValueError(
            f"'{value}' is no direction; {suggestion(value, list(_FACES), 'write an angle such as 90deg, or')}"
        )
    return (_Angle.parse(value),)


def _pattern(value: object) -> tuple[tuple[float, float], ...]:
    if not isinstance(value, (list, tuple)) or not value:
        raise ValueError(
            f"expected a list of [angle, gain], such as [[0deg, 9dB], [180deg, -6dB]], found {describe(value)}"
        )
    points = []
    for point in value:
        if not isinstance(point, (list, tuple)) or len(point) != 2:
            raise ValueError(f"expected [angle, gain], such as [90deg, -3dB], found {describe(point)}")
        points.append((_Angle.parse(point[0]), _Gain.parse(point[1])))
    angles = [angle % 360.0 for angle, _ in points]
    if len(set(angles)) != len(angles):
        raise ValueError("the pattern has two gains at the same angle; remove one")
    return tuple(points)


_Angle = Quantity(ANGLE, minimum=-360.0, maximum=360.0)
_Gain = Quantity(DECIBELS, minimum=-100.0, maximum=60.0)
_TEXTS = {"type": "array", "items": {"type": "string"}}
Facing = Annotated[
    tuple[float, ...],
    BeforeValidator(_facing),
    WithJsonSchema({"anyOf": [{"enum": list(_FACES)}, {"type": "string", "examples": ["90deg"]}, _TEXTS]}),
]
Pattern = Annotated[
    tuple[tuple[float, float], ...], BeforeValidator(_pattern), WithJsonSchema({"type": "array", "items": _TEXTS})
]


class AntennaWords(StrictModel):
    """`omni`; a gain all around; a sector with ``beamwidth_deg``; or a measured ``pattern``.

    Angles count counter-clockwise from straight ahead and turn with the robot.
    """

    gain_dbi: Annotated[float, _Gain] = Field(default=0.0, alias="gain")
    beamwidth_deg: Annotated[float, Quantity(ANGLE, above_minimum=True, maximum=360.0)] | None = Field(
        default=None, alias="beamwidth"
    )
    front_to_back_db: Annotated[float, Quantity(DECIBELS, maximum=80.0)] = Field(default=20.0, alias="front_to_back")
    facing_deg: Facing = Field(default=(0.0,), alias="facing")
    pattern: Pattern | None = None

    @model_validator(mode="before")
    @classmethod
    def _omni(cls, value: object) -> object:
        if value == "omni":
            return {}
        if isinstance(value, str):
            raise ValueError(f"'{value}' is no antenna; write omni, or a block with gain, beamwidth and facing")
        return value

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        given = self.model_fields_set
        lonely = [key for key in ("front_to_back_db", "facing_deg") if key in given and self.beamwidth_deg is None]
        if self.pattern is not None and given != {"pattern"}:
            raise ValueError("pattern says all about an antenna; remove the other words beside it")
        if lonely:
            raise ValueError(f"{lonely[0].rpartition('_')[0]} belongs to a sector; add beamwidth: 60deg")
        return self

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {"anyOf": [{"const": "omni"}, handler(schema)]}

    def antenna(self) -> Antenna:
        """Its gains as a value."""
        from netlab.world import antenna

        if self.pattern is not None:
            return antenna.table(self.pattern)
        if self.beamwidth_deg is None:
            return antenna.omni(self.gain_dbi)
        return antenna.sector(
            self.gain_dbi,
            beamwidth_deg=self.beamwidth_deg,
            front_to_back_db=self.front_to_back_db,
            facing_deg=self.facing_deg,
        )


class AntennaKeys(StrictModel):
    """How a block names its antenna: in full, or by its gain all around."""

    antenna: AntennaWords | None = None
    antenna_gain_dbi: Annotated[float, _Gain] | None = Field(default=None, alias="antenna_gain")

    @model_validator(mode="after")
    def _one_antenna(self) -> Self:
        if self.antenna is not None and self.antenna_gain_dbi is not None:
            raise ValueError("antenna says all about it; put the gain there, or remove antenna_gain")
        return self

    @property
    def antenna_words(self) -> AntennaWords | None:
        """The antenna that is named; None leaves it to others."""
        if self.antenna_gain_dbi is None:
            return self.antenna
        return AntennaWords.model_construct(gain_dbi=self.antenna_gain_dbi)


#: The radios of netlab.medium.phy, whose tables a scenario without phy does without.
PHY_NAMES = ("802.11g-20MHz", "802.11n-20MHz-1x1", "802.11n-20MHz-2x2", "subt")


def _phy(value: object) -> str:
    if value not in PHY_NAMES:
        raise ValueError(f"unknown phy {describe(value)}; {suggestion(str(value), PHY_NAMES, 'known are')}")
    return str(value)


PhyName = Annotated[str, BeforeValidator(_phy), WithJsonSchema({"enum": list(PHY_NAMES)})]
NoiseFloor = Annotated[float, Quantity(POWER, minimum=-120.0, maximum=-30.0)]
TransmitPower = Annotated[float, Quantity(POWER, minimum=-30.0, maximum=60.0)]
Carrier = Annotated[float, Quantity(FREQUENCY, minimum=1e8, maximum=1e11)]


class RadioEnds(AntennaKeys):
    """What a radio of a node may have of its own; what is left out is as in the scenario's `radio:` block.

    All radios on one frequency are of one kind: ``phy``, ``rate_bps`` and ``noise_dbm`` are those of their channel.
    """

    frequency_hz: Carrier | None = Field(default=None, alias="frequency")
    tx_power_dbm: TransmitPower | None = Field(default=None, alias="tx_power")
    phy: PhyName | None = None
    rate_bps: BitsPerSecond | None = Field(default=None, alias="rate")
    noise_dbm: NoiseFloor | None = Field(default=None, alias="noise")


@dataclass(frozen=True, slots=True)
class RadioSettings:
    """One radio of a node with everything filled in; ``phy`` None has no airtime, ``rate_bps`` None is adaptive."""

    frequency_hz: float
    tx_power_dbm: float
    antenna: AntennaWords
    phy: str | None
    rate_bps: float | None
    noise_dbm: float | None

    @property
    def channel(self) -> tuple[str | None, float | None, float | None]:
        """What all radios on one frequency have in common."""
        return self.phy, self.rate_bps, self.noise_dbm


def wrong_rate(phy: str, rate_bps: float) -> str | None:
    """Say which rates a radio has if this is none of them."""
    from netlab.medium.phy import PHYS

    try:
        PHYS[phy].rate(rate_bps)
    except ValueError as error:
        return f"rate: {error}"
    return None
