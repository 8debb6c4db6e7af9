"""The radio block: which radios hear one another, with which words, as constants or as a measured trace over time."""

from __future__ import annotations

import csv
import io
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, GetJsonSchemaHandler, ValidationInfo, WithJsonSchema, model_validator
from pydantic_core import CoreSchema

from netlab.scenario.base import NotYet, Problems, StrictModel, Switch, not_yet, suggestion
from netlab.scenario.links import Ends
from netlab.scenario.quantities import FREQUENCY, POWER, Quantity, describe
from netlab.scenario.words import Words, read_file

TRACE_COLUMNS = ("at_s", "from", "to", "loss_percent", "delay_ms", "rate_mbit")
_LATER_MODELS = ("free_space", "log_distance", "tunnel", "subt")
_MOST_TRACE_PROBLEMS = 20


@dataclass(frozen=True, slots=True)
class TraceRow:
    """From ``at_s`` on, this is how ``sender`` reaches ``receiver``; None leaves the word as it was before.

    ``loss_ratio`` 1 means out of range. ``line`` is the row's line in the file, for messages.
    """

    at_s: float
    sender: str
    receiver: str
    loss_ratio: float | None
    delay_s: float | None
    rate_bps: float | None
    line: int


@dataclass(frozen=True, slots=True)
class LinkTrace:
    """A measured trace: the file's name as the scenario gives it, and its rows by time."""

    name: str
    rows: tuple[TraceRow, ...]


def parse_link_trace(name: str, text: str) -> LinkTrace:
    """Read a CSV trace with the columns ``TRACE_COLUMNS``; lines that begin with # are comments, empty cells keep.

    Raises:
        Problems: One text per wrong line, with the file's name and the line.
    """
    problems: list[str] = []
    rows: list[TraceRow] = []
    header: list[str] | None = None
    for number, cells in enumerate(csv.reader(io.StringIO(text)), start=1):
        if not cells or cells[0].lstrip().startswith("#"):
            continue
        stripped = [cell.strip() for cell in cells]
        if header is None:
            header = stripped
            if header != list(TRACE_COLUMNS):
                raise Problems([f"{name}:{number}: the columns must be {','.join(TRACE_COLUMNS)}"])
            continue
        try:
            rows.append(_trace_row(stripped, number))
        except ValueError as error:
            problems.append(f"{name}:{number}: {error}")
    if header is None:
        problems.append(f"{name}: the file is empty; it needs the columns {','.join(TRACE_COLUMNS)}")
    if problems:
        raise Problems(problems[:_MOST_TRACE_PROBLEMS])
    return LinkTrace(name, tuple(sorted(rows, key=lambda row: row.at_s)))


def _trace_row(cells: list[str], line: int) -> TraceRow:
    if len(cells) != len(TRACE_COLUMNS):
        raise ValueError(f"{len(cells)} cells; there must be {len(TRACE_COLUMNS)}")
    at_s, sender, receiver, loss_percent, delay_ms, rate_mbit = cells
    loss = _cell("loss_percent", loss_percent, 100.0)
    delay = _cell("delay_ms", delay_ms)
    rate = _cell("rate_mbit", rate_mbit)
    at = _cell("at_s", at_s)
    if at is None:
        raise ValueError("at_s is empty; give the time in seconds")
    if rate == 0:
        raise ValueError("rate_mbit 0 is impossible; leave the cell empty, or give loss_percent 100 for out of range")
    return TraceRow(
        at_s=at,
        sender=sender,
        receiver=receiver,
        loss_ratio=None if loss is None else loss / 100,
        delay_s=None if delay is None else delay / 1e3,
        rate_bps=None if rate is None else rate * 1e6,
        line=line,
    )


def _cell(column: str, text: str, most: float = float("inf")) -> float | None:
    if not text:
        return None
    try:
        value = float(text)
    except ValueError:
        raise ValueError(f"{column} '{text}' is not a number; the column's name gives the unit") from None
    if not 0 <= value <= most or value == float("inf"):
        raise ValueError(f"{column} {text} is impossible; it must be {'0 or more' if most > 100 else '0 to 100'}")
    return value


def _link_trace(value: object, info: ValidationInfo) -> LinkTrace:
    if not isinstance(value, str):
        raise ValueError(f"expected the name of a CSV file, found {describe(value)}")
    return parse_link_trace(value, read_file(info, value))


class TablePair(Ends, Words):
    """How two radios hear each other, or one the other; its words win over the radio's."""


class TableDefault(Words):
    """Words of the pairs that a table does not name."""

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {"anyOf": [{"const": "out_of_range"}, handler(schema)]}


def _table_default(value: object) -> object:
    if isinstance(value, str) and value != "out_of_range":
        raise ValueError(f"'{value}' is not possible here; write out_of_range or a block of link words")
    return None if value == "out_of_range" else value


class Propagation(StrictModel):
    """Who hears whom. `none`: everyone hears everyone. `table`: the pairs named, others by ``default``.

    ``default`` None means out of range.
    """

    model: Annotated[
        Literal["none", "table"],
        BeforeValidator(lambda value: not_yet(value, ("none", "table"), _LATER_MODELS, "propagation model")),
    ]
    pairs: tuple[TablePair, ...] = ()
    default: Annotated[TableDefault | None, BeforeValidator(_table_default)] = None
    file: Annotated[LinkTrace, BeforeValidator(_link_trace), WithJsonSchema({"type": "string"})] | None = None
    corner_loss: NotYet = None
    exponent: NotYet = None
    path_loss: NotYet = None
    range: NotYet = None

    @model_validator(mode="after")
    def _table_keys_with_table(self) -> Self:
        keys = [key for key in ("pairs", "default", "file") if key in self.model_fields_set]
        if self.model == "none" and keys:
            raise ValueError(f"{keys[0]} belongs to model: table; with none everyone hears everyone")
        return self


#: Channels on which mac80211_hwsim's own rules let a mesh or an ad-hoc network beacon, by centre in MHz.
HWSIM_CHANNELS_MHZ = (*range(2412, 2463, 5), 5180, 5200, 5220, 5240, *range(5745, 5826, 20))
_HWSIM_KEYS = ("mode", "mesh_id", "ssid", "frequency", "retry_limit", "monitor", "rssi")
_MOST_NAME_BYTES = 32  # IEEE 802.11-2016, 9.4.2.2 and 9.4.2.99


def _frequency(value: object) -> int:
    frequency_mhz = FREQUENCY.parse(value) / 1e6
    if frequency_mhz not in HWSIM_CHANNELS_MHZ:
        raise ValueError(
            f"'{value}' is not the centre of a channel that may be used here; use 2412MHz to 2462MHz in steps of 5MHz, "
            "5180, 5200, 5220 or 5240MHz, or 5745MHz to 5825MHz in steps of 20MHz"
        )
    return int(frequency_mhz)


def _network_name(value: object) -> str:
    if not isinstance(value, str) or not 1 <= len(value.encode()) <= _MOST_NAME_BYTES or "\0" in value:
        raise ValueError(f"expected a name of 1 to {_MOST_NAME_BYTES} bytes, found {describe(value)}")
    return value


#: The radios of netlab.medium.phy, whose tables a scenario without phy does without.
PHY_NAMES = ("802.11g-20MHz", "802.11n-20MHz-1x1", "802.11n-20MHz-2x2", "subt")


def _phy(value: object) -> str:
    if value not in PHY_NAMES:
        raise ValueError(f"unknown phy {describe(value)}; {suggestion(str(value), PHY_NAMES, 'known are')}")
    return str(value)


def _wrong_rate(phy: str, rate_bps: float) -> str | None:
    from netlab.medium.phy import PHYS

    try:
        PHYS[phy].rate(rate_bps)
    except ValueError as error:
        return f"rate: {error}"
    return None


NetworkName = Annotated[str, BeforeValidator(_network_name), WithJsonSchema({"type": "string", "maxLength": 32})]


class Radio(Words):
    """The defaults of every radio. The words here hold for every pair that is in range.

    ``driver`` `engine`: an Ethernet interface whose frames the engine carries; `hwsim`: a real 802.11 interface of the
    kernel's mac80211_hwsim, to which alone the keys from ``mode`` to ``monitor`` belong. With ``phy`` all radios share
    one channel: ``rate`` is then that of unicast frames (None: by rate control), ``limit`` a station's queue.
    """

    propagation: Propagation
    driver: Literal["engine", "hwsim"] = "engine"
    mode: Literal["mesh", "ibss"] = "mesh"
    mesh_id: NetworkName | None = None
    ssid: NetworkName | None = None
    frequency_mhz: Annotated[
        int, Field(alias="frequency"), BeforeValidator(_frequency), WithJsonSchema({"type": "string"})
    ] = HWSIM_CHANNELS_MHZ[0]
    retry_limit: Annotated[int, Field(ge=1, le=64)] = 7
    monitor: Switch = False
    phy: Annotated[str, BeforeValidator(_phy), WithJsonSchema({"enum": list(PHY_NAMES)})] | None = None
    noise_dbm: Annotated[float, Quantity(POWER, minimum=-120.0, maximum=-30.0)] | None = Field(
        default=None, alias="noise"
    )
    tx_power: NotYet = None
    antenna_gain: NotYet = None

    @property
    def network(self) -> str:
        """The identifier of the 802.11 network that all radios form."""
        return self.mesh_id or self.ssid or "netlab"

    @property
    def pair_words(self) -> Words:
        """The words that hold for every pair; on a shared channel, rate and queue are the stations' own."""
        words = Words().laid_over(self)
        return words if self.phy is None else words.model_copy(update={"rate_bps": None, "limit": None})

    @model_validator(mode="after")
    def _consistent_words(self) -> Self:
        if complaint := self.inconsistency() or self._misplaced() or self._misplaced_on_channel():
            raise ValueError(complaint)
        return self

    def _misplaced_on_channel(self) -> str | None:
        if self.phy is None:
            return "noise belongs to radios with a phy; add phy or remove it" if self.noise_dbm is not None else None
        if self.driver == "hwsim":
            return "phy has no meaning with driver: hwsim, whose radios share no airtime; remove one of them"
        if self.propagation.file is not None and any(row.rate_bps is not None for row in self.propagation.file.rows):
            return (
                f"{self.propagation.file.name} has rates, and with phy the radio's rate is everyone's; empty rate_mbit"
            )
        if self.rate_bps is not None:
            return _wrong_rate(self.phy, self.rate_bps)
        return None

    def _misplaced(self) -> str | None:
        if self.driver == "engine":
            given = {type(self).model_fields[name].alias or name for name in self.model_fields_set}
            misplaced = [key for key in _HWSIM_KEYS if key in given and not (key == "rssi" and self.phy is not None)]
            if "frequency" in misplaced:
                return "frequency is not available yet without driver: hwsim; remove it"
            return f"{misplaced[0]} belongs to 802.11 radios; add driver: hwsim or remove it" if misplaced else None
        if self.mode == "mesh" and self.ssid is not None:
            return "ssid names an ad-hoc network, and this is a mesh; write mesh_id, or mode: ibss"
        if self.mode == "ibss" and self.mesh_id is not None:
            return "mesh_id names a mesh, and this is an ad-hoc network; write ssid, or mode: mesh"
        return None


def node_radio(value: Any) -> object:
    """Accept a node's `radio: none`; refuse what later versions will take.

    Raises:
        ValueError: Anything else.
    """
    if value == "none":
        return value
    what = "several radios in a node are" if isinstance(value, list) else "a node's own radio settings are"
    raise ValueError(f"{what} not available yet; write none for a node without radio, or remove it")
