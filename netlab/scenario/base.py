"""What all scenario models share: strictness, readable complaints, names, switches, and keys of later versions."""

from __future__ import annotations

import difflib
import re
from collections.abc import Iterable, Mapping, Sequence
from typing import Annotated, Any, TypeVar

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    ModelWrapValidatorHandler,
    ValidationError,
    WithJsonSchema,
    model_validator,
)
from pydantic_core import InitErrorDetails, PydanticCustomError

from netlab.scenario.quantities import describe

_Model = TypeVar("_Model", bound="StrictModel")

# RFC 1123 section 2.1: letters, digits and hyphens, no hyphen at either end, at most 63 octets per label.
_HOSTNAME = re.compile(r"[A-Za-z0-9](?:[A-Za-z0-9-]{0,61}[A-Za-z0-9])?")
# inet_aton(3) reads these as IPv4 addresses before any name service is asked.
_NUMERIC_HOST = re.compile(r"\d+|0[xX][0-9a-fA-F]+")
RESERVED_NAMES = frozenset({"all", "localhost", "none"})
_TOPIC = re.compile(r"[A-Za-z0-9_/][A-Za-z0-9_./-]{0,127}")
_EMPTY = "has no value; give one or remove the key"
_SWITCHES = {"on": True, "yes": True, "true": True, "off": False, "no": False, "false": False}


class Problems(ValueError):
    """Several mistakes found by one validator; each is reported as a problem of its own."""

    def __init__(self, problems: Iterable[str]) -> None:
        self.problems = tuple(problems)
        super().__init__("\n".join(self.problems))


class StrictModel(BaseModel):
    """Immutable; refuses unknown and empty keys and says which known key was probably meant."""

    model_config = ConfigDict(frozen=True, extra="forbid", hide_input_in_errors=True)

    @model_validator(mode="wrap")
    @classmethod
    def _explain(cls: type[_Model], data: Any, handler: ModelWrapValidatorHandler[_Model]) -> _Model:
        empty = [key for key, value in data.items() if value is None] if isinstance(data, dict) else []
        lines = [InitErrorDetails(type=custom(_EMPTY), loc=(key,), input=None) for key in empty]
        try:
            model = handler({key: value for key, value in data.items() if value is not None} if empty else data)
        except ValidationError as error:
            found = (dict(line) for line in error.errors(include_url=False))
            lines += [cls._explained(line) for line in found if line["loc"] not in [(key,) for key in empty]]
        if lines:
            raise ValidationError.from_exception_data(cls.__name__, lines)
        return model

    @classmethod
    def _explained(cls, line: dict[str, Any]) -> InitErrorDetails:
        kind, loc = line["type"], line["loc"]
        if kind == "extra_forbidden" and len(loc) == 1:
            problem: PydanticCustomError | str = custom(unknown_key(str(loc[0]), cls.file_keys()))
        elif kind in ("value_error", "assertion_error"):
            problem = "value_error"
        else:
            problem = custom(line["msg"]) if kind == "problem" else _generic(line)
        details = InitErrorDetails(type=problem, loc=loc, input=line["input"])
        if problem == "value_error":
            details["ctx"] = {"error": line["ctx"]["error"]}
        return details

    @classmethod
    def file_keys(cls) -> list[str]:
        """The keys that a file may use, in the order of their definition."""
        return [info.alias or name for name, info in cls.model_fields.items()]


def custom(message: str) -> PydanticCustomError:
    """A finished problem text; braces in it are literal."""
    return PydanticCustomError("problem", message.replace("{", "{{").replace("}", "}}"))


def _generic(line: dict[str, Any]) -> PydanticCustomError:
    kind, value = line["type"], describe(line["input"])
    context = line.get("ctx", {})
    if kind == "missing":
        return custom("is missing; add it")
    if kind in ("model_type", "dict_type", "model_attributes_type"):
        return custom(f"expected a block of keys, found {value}")
    if kind in ("tuple_type", "list_type"):
        return custom(f"expected a list, found {value}")
    if kind in ("int_type", "int_parsing", "int_from_float"):
        return custom(f"expected a whole number, found {value}")
    if kind in ("greater_than_equal", "less_than_equal", "greater_than", "less_than"):
        return custom(f"{value} is impossible; it must be {_bound(kind, context)}")
    if kind == "literal_error":
        return custom(f"{value} is not possible here; use {str(context['expected']).replace(chr(39), '')}")
    if kind in ("too_short", "too_long"):
        least_or_most = context.get("min_length") if kind == "too_short" else context.get("max_length")
        word = "at least" if kind == "too_short" else "at most"
        return custom(f"has {context['actual_length']} entries; give {word} {least_or_most}")
    if kind == "string_type":
        return custom(f"expected text, found {value}")
    return custom(f"{line['msg'][0].lower()}{line['msg'][1:]}, found {value}")


def _bound(kind: str, context: Mapping[str, Any]) -> str:
    words = {"greater_than_equal": ("at least", "ge"), "less_than_equal": ("at most", "le")}
    word, key = words.get(kind, ("above", "gt") if kind == "greater_than" else ("below", "lt"))
    return f"{word} {context[key]}"


def unknown_key(key: str, known: Iterable[str]) -> str:
    """The complaint about an unknown key, with the likeliest known one."""
    return f"unknown key '{key}'; {suggestion(key, known, 'known keys are')}"


def suggestion(word: str, known: Iterable[str], otherwise: str) -> str:
    """``did you mean 'x'?`` when a known word is close, else the list of known words after ``otherwise``."""
    names = list(known)
    close = difflib.get_close_matches(word, names, n=1, cutoff=0.7)
    if close:
        return f"did you mean '{close[0]}'?"
    shown = ", ".join(names[:20]) + (f", ... ({len(names)} in all)" if len(names) > 20 else "")
    return f"{otherwise} {shown}" if names else "there are none"


def _text(value: object) -> str:
    if isinstance(value, bool) or not isinstance(value, (str, int)):
        raise ValueError(f"expected a name, found {describe(value)}")
    return str(value)


def node_name(value: object) -> str:
    """Return a valid node name.

    Raises:
        ValueError: Not usable as a hostname, or reserved.
    """
    name = _text(value)
    if len(name) > 63:
        raise ValueError(f"'{name}' is {len(name)} characters long; a node's name is its hostname, at most 63")
    if not _HOSTNAME.fullmatch(name):
        raise ValueError(f"'{name}' is not a valid hostname; use letters, digits and inner hyphens")
    if _NUMERIC_HOST.fullmatch(name):
        raise ValueError(f"'{name}' would be read as an IP address; put a letter in front, as in n{name}")
    if name.lower() in RESERVED_NAMES:
        raise ValueError(f"'{name}' has a meaning of its own; choose another name")
    return name


def _topic(value: object) -> str:
    name = _text(value)
    if not _TOPIC.fullmatch(name):
        raise ValueError(f"'{name}' is not a valid topic; use letters, digits and _ . / - (at most 128 characters)")
    return name


def _switch(value: object) -> bool:
    if isinstance(value, bool):
        return value
    if isinstance(value, str) and value.lower() in _SWITCHES:
        return _SWITCHES[value.lower()]
    raise ValueError(f"expected a switch, found {describe(value)}; write true or false")


NodeName = Annotated[
    str, BeforeValidator(node_name), WithJsonSchema({"type": "string", "pattern": f"^{_HOSTNAME.pattern}$"})
]
Topic = Annotated[str, BeforeValidator(_topic), WithJsonSchema({"type": "string", "pattern": f"^{_TOPIC.pattern}$"})]
Switch = Annotated[bool, BeforeValidator(_switch), WithJsonSchema({"type": "boolean"})]


def not_yet(value: object, available: Sequence[str], later: Sequence[str], what: str) -> object:
    """Pass a known word on; refuse a word of a later version with that reason.

    Raises:
        ValueError: ``value`` is one of ``later`` or unknown.
    """
    if value in later:
        raise ValueError(f"{what} '{value}' is not available yet; use {', '.join(available)}")
    if value not in available:
        raise ValueError(f"unknown {what} {describe(value)}; {suggestion(str(value), available, 'known are')}")
    return value
