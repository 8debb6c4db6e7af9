"""The impairment words that links, radios and live changes share, in tc-netem's vocabulary, one-way.

Only what a file says: a word that is not given is None, so that words can be laid over one another. They become values
of the medium in :mod:`netlab.timeline.impairments`. Source of the words: tc-netem(8).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Self

from pydantic import BeforeValidator, Field, GetJsonSchemaHandler, ValidationInfo, WithJsonSchema, model_validator
from pydantic_core import CoreSchema

from netlab.scenario.base import StrictModel
from netlab.scenario.quantities import SIZE, BitsPerSecond, Dbm, Ratio, Seconds, describe

#: Validation context: a function from a file name in the scenario to that file's text. Raises OSError.
ReadText = Callable[[str], str]


@dataclass(frozen=True, slots=True)
class QueueLimit:
    """A queue's limit in packets or in bytes; exactly one is set."""

    packets: int | None = None
    size_bytes: int | None = None


class GilbertElliott(StrictModel):
    """`loss gemodel p r 1-h 1-k`; what is left out takes tc's defaults (r = 1-p, 1-h = 100 %, 1-k = 0 %)."""

    p: Ratio
    r: Ratio | None = None
    loss_in_bad: Ratio = Field(default=1.0, alias="1-h")
    loss_in_good: Ratio = Field(default=0.0, alias="1-k")


class FourState(StrictModel):
    """`loss state p13 p31 p32 p23 p14`; left out: tc's defaults (p31 = 1-p13, p32 0 %, p23 100 %, p14 0 %)."""

    p13: Ratio
    p31: Ratio | None = None
    p32: Ratio = 0.0
    p23: Ratio = 1.0
    p14: Ratio = 0.0


class Periodic(StrictModel):
    """Every ``every``-th frame is lost, the first being frame number ``offset`` (from 0)."""

    every: Annotated[int, Field(ge=1)]
    offset: Annotated[int, Field(ge=0)] = 0


def read_file(info: ValidationInfo, name: str) -> str:
    """Return the text of a file that the scenario names.

    Raises:
        ValueError: The file cannot be read, or files are not available where the scenario came from.
    """
    read: ReadText | None = info.context
    if read is None:
        raise ValueError(f"file '{name}' cannot be read here; give the values themselves")
    try:
        return read(name)
    except OSError as error:
        raise ValueError(f"cannot read '{name}': {error.strerror}; paths are relative to the scenario file") from None
    except UnicodeDecodeError:
        raise ValueError(f"'{name}' is not a text file") from None


def _loss_trace(value: object, info: ValidationInfo) -> tuple[bool, ...]:
    if isinstance(value, str):
        lines = (line.partition("#")[0] for line in read_file(info, value).splitlines())
        marks: list[object] = [char for line in lines for char in line if not (char.isspace() or char == ",")]
    elif isinstance(value, (list, tuple)):
        marks = list(value)
    else:
        raise ValueError(f"expected a list of 0 and 1 or the name of a file, found {describe(value)}")
    wrong = next((mark for mark in marks if str(mark) not in ("0", "1")), None)
    if wrong is not None:
        raise ValueError(f"a loss trace consists of 0 (delivered) and 1 (lost), found {describe(wrong)}")
    if not marks:
        raise ValueError("the loss trace is empty; give at least one 0 or 1")
    return tuple(str(mark) == "1" for mark in marks)


LossTrace = Annotated[
    tuple[bool, ...],
    BeforeValidator(_loss_trace),
    WithJsonSchema({"anyOf": [{"type": "string"}, {"type": "array", "items": {"enum": [0, 1]}}]}),
]


class Loss(StrictModel):
    """One loss model: random by ``ratio``, or one of the others. A file may write just the percentage."""

    ratio: Ratio | None = None
    correlation: Ratio | None = None
    gemodel: GilbertElliott | None = None
    state: FourState | None = None
    periodic: Periodic | None = None
    trace: LossTrace | None = None

    @model_validator(mode="before")
    @classmethod
    def _from_percentage(cls, value: object) -> object:
        return value if isinstance(value, (dict, Loss)) else {"ratio": value}

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {"anyOf": [{"type": "string", "examples": ["2%"]}, handler(schema)]}

    @model_validator(mode="after")
    def _exactly_one(self) -> Self:
        models = ("ratio", "gemodel", "state", "periodic", "trace")
        given = [name for name in models if getattr(self, name) is not None]
        if len(given) != 1:
            found = " and ".join(given) if given else "none"
            raise ValueError(f"give exactly one of {', '.join(models)}; found {found}")
        if self.correlation is not None and self.ratio is None:
            raise ValueError(f"correlation belongs to random loss by ratio; remove it beside {given[0]}")
        return self


class Chance(StrictModel):
    """How often something happens to a frame; a file may write just the percentage."""

    ratio: Ratio
    correlation: Ratio = 0.0

    @model_validator(mode="before")
    @classmethod
    def _from_percentage(cls, value: object) -> object:
        return value if isinstance(value, (dict, Chance)) else {"ratio": value}

    @classmethod
    def __get_pydantic_json_schema__(cls, schema: CoreSchema, handler: GetJsonSchemaHandler) -> dict[str, Any]:
        return {"anyOf": [{"type": "string", "examples": ["2%"]}, handler(schema)]}


class Reorder(Chance):
    """``ratio`` of every ``gap``-th frame leaves at once, ahead of the delayed ones."""

    gap: Annotated[int, Field(ge=1)] = 1


def _limit(value: object) -> QueueLimit:
    if isinstance(value, QueueLimit):
        return value
    if isinstance(value, int) and not isinstance(value, bool):
        if value < 1:
            raise ValueError(f"{value} is impossible; a queue holds at least 1 packet")
        return QueueLimit(packets=value)
    size_bytes = SIZE.parse(value)
    if size_bytes < 1 or size_bytes != int(size_bytes):
        raise ValueError(f"'{value}' is impossible; a queue holds a whole number of bytes, at least 1B")
    return QueueLimit(size_bytes=int(size_bytes))


Limit = Annotated[
    QueueLimit,
    BeforeValidator(_limit),
    WithJsonSchema({"anyOf": [{"type": "integer", "minimum": 1}, {"type": "string", "examples": ["64kB"]}]}),
]


class Words(StrictModel):
    """One direction's impairment as far as a file gives it; None means that the word is not given."""

    delay_s: Seconds | None = Field(default=None, alias="delay")
    jitter_s: Seconds | None = Field(default=None, alias="jitter")
    delay_correlation: Ratio | None = None
    distribution: Literal["uniform", "normal", "pareto", "paretonormal"] | None = None
    loss: Loss | None = None
    duplicate: Chance | None = None
    reorder: Reorder | None = None
    corrupt: Chance | None = None
    rate_bps: BitsPerSecond | None = Field(default=None, alias="rate")
    limit: Limit | None = None
    rssi_dbm: Dbm | None = Field(default=None, alias="rssi")

    def given(self) -> dict[str, object]:
        """The words that are given, by attribute name."""
        return {name: value for name in WORD_NAMES if (value := getattr(self, name)) is not None}

    def laid_over(self, base: Words) -> Words:
        """Lay these words over ``base``: what is given here wins."""
        return Words().model_copy(update=base.given() | self.given())

    def inconsistency(self) -> str | None:
        """Say which word lacks the one that it depends on, or None."""
        if self.jitter_s is None and (self.distribution is not None or self.delay_correlation is not None):
            word = "distribution" if self.distribution is not None else "delay_correlation"
            return f"{word} shapes the jitter, and there is none; add jitter"
        if self.reorder is not None and self.reorder.ratio and not self.delay_s:
            return "reorder lets frames overtake delayed ones, and there is no delay; add delay"
        return None


WORD_NAMES = tuple(Words.model_fields)
NO_WORDS = Words()
