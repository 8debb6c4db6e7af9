"""Quantities with units as people write them (`20ms`, `10mbit`, `2%`) and their value in SI units.

Owns every unit that a scenario may use. Knows nothing of scenarios: the annotated types at the end plug into any
pydantic model. Rates and times use tc's words (tc(8), "PARAMETERS"): ``mbit`` is 1e6 bit/s, ``mibit`` 2**20 bit/s.
Sizes are SI: ``kB`` is 1000 bytes, ``KiB`` 1024.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from typing import Annotated, Any

from pydantic import GetCoreSchemaHandler, GetJsonSchemaHandler
from pydantic_core import CoreSchema, core_schema

_QUANTITY = re.compile(r"([+-]?(?:\d+(?:\.\d*)?|\.\d+)(?:[eE][+-]?\d{1,2})?)\s*([^\d\s].*)?")
_MOST = 1e18  # in SI units; far beyond anything real, and still exact enough to count with


@dataclass(frozen=True, slots=True, eq=False)
class Dimension:
    """A kind of quantity: its units by spelling, each with its size in the SI unit.

    ``shown`` are the units named in error messages and used by :meth:`format`, smallest first. ``hints`` explain
    spellings that are refused because people mean different things by them.
    """

    noun: str
    example: str
    units: Mapping[str, Decimal]
    shown: tuple[str, ...]
    case_sensitive: bool = False
    hints: Mapping[str, str] = field(default_factory=dict)

    def parse(self, value: object) -> float:
        """Return ``value`` (text such as ``20ms``) in SI units.

        Raises:
            ValueError: No unit, an unknown unit, or not a quantity; the text says what fits.
        """
        if isinstance(value, bool) or not isinstance(value, (int, float, str)):
            raise ValueError(f"expected {self.noun}, found {describe(value)}; write it like {self.example}")
        match = _QUANTITY.fullmatch(str(value).strip())
        if match is None:
            raise ValueError(f"'{value}' is not {self.noun}; write it like {self.example}")
        number, unit = match.groups()
        if unit is None:
            raise ValueError(f"{value} has no unit; write {self.noun} like {self.example} (units: {self._choices})")
        result = float(Decimal(number) * self._factor(unit.strip(), str(value)))
        if abs(result) > _MOST:
            raise ValueError(f"'{str(value)[:40]}' is impossible; write {self.noun} like {self.example}")
        return result

    def format(self, value: float) -> str:
        """Return the shortest exact text for ``value`` (SI units); ``parse`` reads it back to the same number."""
        exact = Decimal(repr(float(value)))
        for unit in reversed(self.shown):
            if abs(exact) >= self.units[unit]:
                break
        else:
            unit = self.shown[0]
        return f"{(exact / self.units[unit]).normalize():f}{unit}"

    @property
    def _choices(self) -> str:
        return ", ".join(self.shown)

    def _factor(self, unit: str, text: str) -> Decimal:
        if unit in self.units:
            return self.units[unit]
        lowered = unit.lower()
        if lowered in self.hints:
            raise ValueError(f"'{text}': {self.hints[lowered]}")
        if not self.case_sensitive:
            for spelling, factor in self.units.items():
                if spelling.lower() == lowered:
                    return factor
        raise ValueError(
            f"'{text}' has an unknown unit '{unit}'; write {self.noun} like {self.example} (units: {self._choices})"
        )


def describe(value: object) -> str:
    """Name a YAML value in a person's words, for messages."""
    if value is None:
        return "nothing"
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, Mapping):
        return "a block of keys"
    if isinstance(value, (list, tuple)):
        return "a list"
    return f"'{value}'"


def _units(**factors: str) -> dict[str, Decimal]:
    return {name: Decimal(factor) for name, factor in factors.items()}


_SECONDS = {
    "1e-9": ("ns", "nsec", "nsecs"),
    "1e-6": ("us", "µs", "usec", "usecs"),
    "1e-3": ("ms", "msec", "msecs"),
    "1": ("s", "sec", "secs"),
    "60": ("min",),
    "3600": ("h",),
}
DURATION = Dimension(
    "a duration",
    "20ms",
    {unit: Decimal(factor) for factor, units in _SECONDS.items() for unit in units},
    ("us", "ms", "s"),
    hints={"m": "'m' could be minutes or milliseconds; write ms or min"},
)
_RATES = _units(bit="1", kbit="1e3", mbit="1e6", gbit="1e9", tbit="1e12") | _units(
    kibit="1024", mibit="1048576", gibit="1073741824"
)
_BPS_HINT = "'bps' words mean bytes per second to tc and bits per second to most people; write kbit, mbit or gbit"
RATE = Dimension(
    "a rate",
    "10mbit",
    _RATES | {f"{unit}/s": factor for unit, factor in _RATES.items()},
    ("bit", "kbit", "mbit", "gbit"),
    hints={f"{prefix}bps": _BPS_HINT for prefix in ("", "k", "m", "g", "t")},
)
SIZE = Dimension(
    "a size",
    "200kB",
    _units(B="1", kB="1000", KB="1000", MB="1e6", GB="1e9", KiB="1024", MiB="1048576", GiB="1073741824"),
    ("B", "kB", "MB", "GB", "KiB", "MiB"),
    case_sensitive=True,
)
RATIO = Dimension("a percentage", "2%", {"%": Decimal("0.01")}, ("%",))
FREQUENCY = Dimension("a frequency", "10Hz", _units(Hz="1", kHz="1e3", MHz="1e6", GHz="1e9"), ("Hz", "kHz", "MHz"))
POWER = Dimension("a power", "-95dBm", _units(dBm="1"), ("dBm",))
DECIBELS = Dimension("decibels", "20dB", _units(dB="1", dBi="1"), ("dB",))
ANGLE = Dimension("an angle", "60deg", _units(deg="1"), ("deg",))
SPEED = Dimension("a speed", "1.5m/s", {"m/s": Decimal(1), "km/h": Decimal(1000) / Decimal(3600)}, ("m/s",))
LENGTH = Dimension("a length", "4m", _units(cm="0.01", m="1", km="1000"), ("cm", "m", "km"))


@dataclass(frozen=True, slots=True)
class Quantity:
    """Pydantic annotation: text with a unit of ``dimension`` becomes a float in SI units, within bounds (SI)."""

    dimension: Dimension
    minimum: float = 0.0
    maximum: float = float("inf")
    above_minimum: bool = False

    def parse(self, value: object) -> float:
        """Return ``value`` in SI units.

        Raises:
            ValueError: Not a quantity of this dimension, or outside the bounds.
        """
        number = self.dimension.parse(value)
        if number < self.minimum or (self.above_minimum and number == self.minimum):
            raise ValueError(f"'{value}' is impossible; it must be {self._bound}")
        if number > self.maximum:
            raise ValueError(f"'{value}' is impossible; the most is {self.dimension.format(self.maximum)}")
        return number

    @property
    def _bound(self) -> str:
        if self.minimum == 0:
            return "above zero" if self.above_minimum else "zero or more"
        return f"{'above' if self.above_minimum else 'at least'} {self.dimension.format(self.minimum)}"

    def __get_pydantic_core_schema__(self, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        return core_schema.no_info_plain_validator_function(self.parse)

    def __get_pydantic_json_schema__(self, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        units = "|".join(re.escape(unit) for unit in sorted(self.dimension.units, key=len, reverse=True))
        return {
            "type": "string",
            "pattern": rf"^[+-]?(\d+(\.\d*)?|\.\d+)([eE][+-]?\d+)?\s*({units})$",
            "description": f"{self.dimension.noun} with its unit",
            "examples": [self.dimension.example],
        }


#: A hundred days and more: enough for any mission, and nanoseconds of it fit 64 bits.
_MOST_S = 1e7
Seconds = Annotated[float, Quantity(DURATION, maximum=_MOST_S)]
PositiveSeconds = Annotated[float, Quantity(DURATION, maximum=_MOST_S, above_minimum=True)]
BitsPerSecond = Annotated[float, Quantity(RATE, above_minimum=True)]
Ratio = Annotated[float, Quantity(RATIO, maximum=1.0)]
Metres = Annotated[float, Quantity(LENGTH, maximum=1e6, above_minimum=True)]
MetresPerSecond = Annotated[float, Quantity(SPEED, maximum=1e4, above_minimum=True)]
Degrees = Annotated[float, Quantity(ANGLE, minimum=-360.0, maximum=360.0)]
Hertz = Annotated[float, Quantity(FREQUENCY, above_minimum=True)]
#: How strongly a radio is heard: from below any receiver's noise to one metre away.
Dbm = Annotated[float, Quantity(POWER, minimum=-110.0, maximum=0.0)]
