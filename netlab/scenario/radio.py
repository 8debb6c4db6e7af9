"""The radio block: which radios hear one another: as constants, by a measured trace, or by where they are."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

from pydantic import (
    BeforeValidator,
    Field,
    GetJsonSchemaHandler,
    ModelWrapValidatorHandler,
    PrivateAttr,
    TypeAdapter,
    WithJsonSchema,
    model_validator,
)
from pydantic_core import CoreSchema

from netlab.scenario.base import StrictModel, Switch, suggestion
from netlab.scenario.link_trace import LinkTraceFile
from netlab.scenario.links import Ends
from netlab.scenario.quantities import DECIBELS, Quantity, describe
from netlab.scenario.radio_physics import (
    DEFAULT_FREQUENCY_HZ,
    DEFAULT_TX_POWER_DBM,
    MODEL_NAMES,
    PHY_NAMES,
    AntennaKeys,
    AntennaWords,
    Carrier,
    NoiseFloor,
    PhyName,
    RadioEnds,
    RadioSettings,
    TransmitPower,
    is_physical,
    model_schemas,
    propagation_model,
    wrong_rate,
)
from netlab.scenario.words import Words

if TYPE_CHECKING:
    from netlab.world.propagation.model import PropagationModel


class TableWords(Words):
    """Words of a table: ``path_loss_db`` is a strength told by what is lost on the way, antennas included."""

    path_loss_db: Annotated[float, Quantity(DECIBELS, maximum=300.0)] | None = Field(default=None, alias="path_loss")

    @model_validator(mode="after")
    def _one_strength(self) -> Self:
        if self.path_loss_db is not None and self.rssi_dbm is not None:
            raise ValueError("path_loss and rssi say the same; remove one")
        return self


class TablePair(Ends, TableWords):
    """How two radios hear each other, or one the other; its words win over the radio's."""


class TableDefault(TableWords):
    """Words of the pairs that a table does not name."""

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {"anyOf": [{"const": "out_of_range"}, handler(schema)]}


def _table_default(value: object) -> object:
    if isinstance(value, str) and value != "out_of_range":
        raise ValueError(f"'{value}' is not possible here; write out_of_range or a block of link words")
    return None if value == "out_of_range" else value


_WITHOUT_POSITIONS = ("none", "table")


def _model_name(value: object) -> str:
    known = (*_WITHOUT_POSITIONS, *MODEL_NAMES)
    if not isinstance(value, str) or (value not in known and not is_physical(value)):
        raise ValueError(f"unknown propagation model {describe(value)}; {suggestion(str(value), known, 'known are')}")
    return value


class Propagation(StrictModel):
    """Who hears whom. `none`: everyone hears everyone. `table`: the pairs named, others by ``default``.

    Any other model computes how strongly from where the radios are, and brings its own words. ``default`` None means
    out of range. ``interpolate``: between two rows of ``file`` values go from one to the other instead of staying.
    """

    model: Annotated[str, BeforeValidator(_model_name), WithJsonSchema({"enum": list(_WITHOUT_POSITIONS)})]
    pairs: tuple[TablePair, ...] = ()
    default: Annotated[TableDefault | None, BeforeValidator(_table_default)] = None
    file: LinkTraceFile | None = None
    interpolate: Switch = False
    _physics: PropagationModel | None = PrivateAttr(default=None)

    @property
    def physics(self) -> PropagationModel | None:
        """The model that computes signal strengths from positions; None for `none` and `table`."""
        return self._physics

    @property
    def has_path_losses(self) -> bool:
        """Whether a table tells by path losses how strongly radios hear each other, so that their power counts."""
        words: list[TableWords] = [*self.pairs, *filter(None, [self.default])]
        rows = () if self.file is None else self.file.rows
        losses = [*(entry.path_loss_db for entry in words), *(row.path_loss_db for row in rows)]
        return any(loss_db is not None for loss_db in losses)

    @property
    def strengths_change(self) -> bool:
        """Whether a measured file says how strongly radios hear each other as time goes on."""
        return self.file is not None and self.file.has_strengths

    @property
    def changes_with_time(self) -> bool:
        """Whether something of it changes at all times, and not just with events and rows."""
        return self.physics is not None or self.strengths_change or self.interpolate

    @model_validator(mode="wrap")
    @classmethod
    def _with_its_own_words(cls, data: Any, handler: ModelWrapValidatorHandler[Propagation]) -> Propagation:
        if not isinstance(data, dict) or not is_physical(data.get("model")):
            return handler(data)
        physics = propagation_model(data)
        propagation = handler({"model": data["model"]})
        propagation._physics = physics
        return propagation

    @model_validator(mode="after")
    def _table_keys_with_table(self) -> Self:
        keys = [key for key in ("pairs", "default", "file") if key in self.model_fields_set]
        if self.model == "none" and keys:
            raise ValueError(f"{keys[0]} belongs to model: table; with none everyone hears everyone")
        if self.interpolate and self.file is None:
            raise ValueError("interpolate is about the rows of a file, and there is none; add file or remove it")
        return self

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {"anyOf": [handler(schema), *model_schemas(handler)]}


#: Channels on which mac80211_hwsim's own rules let a mesh or an ad-hoc network beacon, by centre in MHz.
HWSIM_CHANNELS_MHZ = (*range(2412, 2463, 5), 5180, 5200, 5220, 5240, *range(5745, 5826, 20))
_HWSIM_KEYS = ("mode", "mesh_id", "ssid", "retry_limit", "monitor", "rssi")
_PHYSICAL_KEYS = ("frequency", "tx_power", "antenna", "antenna_gain")
_MOST_RADIOS = 8
_MOST_NAME_BYTES = 32  # IEEE 802.11-2016, 9.4.2.2 and 9.4.2.99


def _network_name(value: object) -> str:
    if not isinstance(value, str) or not 1 <= len(value.encode()) <= _MOST_NAME_BYTES or "\0" in value:
        raise ValueError(f"expected a name of 1 to {_MOST_NAME_BYTES} bytes, found {describe(value)}")
    return value


NetworkName = Annotated[str, BeforeValidator(_network_name), WithJsonSchema({"type": "string", "maxLength": 32})]


class Radio(AntennaKeys, Words):
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
    frequency_hz: Carrier | None = Field(default=None, alias="frequency")
    retry_limit: Annotated[int, Field(ge=1, le=64)] = 7
    monitor: Switch = False
    phy: PhyName | None = None
    noise_dbm: NoiseFloor | None = Field(default=None, alias="noise")
    tx_power_dbm: TransmitPower = Field(default=DEFAULT_TX_POWER_DBM, alias="tx_power")

    @property
    def hwsim_frequency_mhz(self) -> int:
        """The channel's centre of 802.11 interfaces; their driver knows whole MHz."""
        return HWSIM_CHANNELS_MHZ[0] if self.frequency_hz is None else round(self.frequency_hz / 1e6)

    @property
    def network(self) -> str:
        """The identifier of the 802.11 network that all radios form."""
        return self.mesh_id or self.ssid or "netlab"

    @property
    def pair_words(self) -> Words:
        """The words that hold for every pair; on a shared channel, rate and queue are the stations' own."""
        words = Words().laid_over(self)
        return words if self.phy is None else words.model_copy(update={"rate_bps": None, "limit": None})

    def settings(self, own: tuple[RadioEnds, ...] | None) -> tuple[RadioSettings, ...]:
        """The radios of a node that has ``own`` ones; None has one that is as all are."""
        return tuple(self._filled(radio) for radio in (own or (RadioEnds(),)))

    def _filled(self, own: RadioEnds) -> RadioSettings:
        rate_bps = self.rate_bps if own.phy in (None, self.phy) else None  # a rate of one kind is none of another
        return RadioSettings(
            frequency_hz=own.frequency_hz or self.frequency_hz or DEFAULT_FREQUENCY_HZ,
            tx_power_dbm=self.tx_power_dbm if own.tx_power_dbm is None else own.tx_power_dbm,
            antenna=own.antenna_words or self.antenna_words or AntennaWords(),
            phy=own.phy or self.phy,
            rate_bps=own.rate_bps or rate_bps,
            noise_dbm=self.noise_dbm if own.noise_dbm is None else own.noise_dbm,
        )

    @model_validator(mode="after")
    def _consistent_words(self) -> Self:
        if complaint := self.inconsistency() or self._misplaced() or self._misplaced_on_channel():
            raise ValueError(complaint)
        return self

    def _misplaced_on_channel(self) -> str | None:
        if self.phy is None:
            if self.propagation.has_path_losses or self.propagation.strengths_change:
                remedy = "remove driver: hwsim and " if self.driver == "hwsim" else ""
                return f"path losses and strengths over time need a phy; {remedy}add phy: {PHY_NAMES[0]}"
            return "noise belongs to radios with a phy; add phy or remove it" if self.noise_dbm is not None else None
        if self.driver == "hwsim":
            return "phy has no meaning with driver: hwsim, whose radios share no airtime; remove one of them"
        if self.propagation.file is not None and any(row.rate_bps is not None for row in self.propagation.file.rows):
            return (
                f"{self.propagation.file.name} has rates, and with phy the radio's rate is everyone's; empty rate_mbit"
            )
        if self.rate_bps is not None:
            return wrong_rate(self.phy, self.rate_bps)
        return None

    def _misplaced(self) -> str | None:
        given = {type(self).model_fields[name].alias or name for name in self.model_fields_set}
        if self.driver == "engine":
            misplaced = [key for key in _HWSIM_KEYS if key in given and not (key == "rssi" and self.phy is not None)]
            if misplaced:
                return f"{misplaced[0]} belongs to 802.11 radios; add driver: hwsim or remove it"
        elif self.mode == "mesh" and self.ssid is not None:
            return "ssid names an ad-hoc network, and this is a mesh; write mesh_id, or mode: ibss"
        elif self.mode == "ibss" and self.mesh_id is not None:
            return "mesh_id names a mesh, and this is an ad-hoc network; write ssid, or mode: mesh"
        return self._misplaced_in_space(given)

    def _misplaced_in_space(self, given: set[str]) -> str | None:
        physics = self.propagation.physics
        if physics is None:
            allowed = ("frequency",) if self.driver == "hwsim" else ()
            allowed = ("tx_power",) if self.propagation.has_path_losses else allowed
            misplaced = [key for key in _PHYSICAL_KEYS if key in given and key not in allowed]
            what = f"to a propagation model that goes by positions ({', '.join(MODEL_NAMES)})"
            return f"{misplaced[0]} belongs {what}; choose one or remove it" if misplaced else None
        if self.driver == "hwsim":
            return f"propagation model {self.propagation.model} has no meaning with driver: hwsim; use none or table"
        if self.phy is None:
            return f"propagation model {self.propagation.model} needs a phy; add phy: {PHY_NAMES[0]}"
        if "rssi" in given:
            return f"rssi is what propagation model {self.propagation.model} computes; remove it"
        return None


_OWN_RADIOS = TypeAdapter(tuple[RadioEnds, ...])


def node_radio(value: Any) -> object:
    """Check a node's `radio:`: none, a block or a list of blocks; what is wrong in a block is told by its own key.

    Raises:
        ValueError: None of these.
    """
    if isinstance(value, str) and value != "none":
        raise ValueError(f"'{value}' is not possible here; write none, or a block of the node's own radio settings")
    if isinstance(value, dict):
        return (RadioEnds.model_validate(value),)
    if isinstance(value, list):
        if not 1 <= len(value) <= _MOST_RADIOS:
            raise ValueError(f"a node has 1 to {_MOST_RADIOS} radios; write none for a node without")
        return _OWN_RADIOS.validate_python(value)
    return value


NodeRadio = Annotated[
    Literal["none"] | tuple[RadioEnds, ...],
    BeforeValidator(node_radio),
    WithJsonSchema({"anyOf": [{"const": "none"}, {"type": "object"}, {"type": "array", "items": {"type": "object"}}]}),
]
