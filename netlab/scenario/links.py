"""Point-to-point links (wires, tethers) of a scenario file, and the wires that they make."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Self

from pydantic import Field, model_validator

from netlab.scenario.base import NodeName, StrictModel
from netlab.scenario.words import NO_WORDS, Words


class Ends(StrictModel):
    """Names two nodes: `between: [a, b]` for both directions, or `from: a` with `to: b` for one."""

    between: tuple[NodeName, NodeName] | None = None
    from_: NodeName | None = Field(default=None, alias="from")
    to: NodeName | None = None

    @model_validator(mode="after")
    def _one_way_of_naming(self) -> Self:
        one_way = (self.from_ is not None, self.to is not None)
        if self.between is not None and any(one_way):
            raise ValueError("between names both directions, from and to one; use the one or the other")
        if self.between is None and not all(one_way):
            raise ValueError("the two ends are missing; write between: [a, b], or from: a with to: b for one direction")
        return self

    @property
    def ends(self) -> tuple[str, str]:
        """The two nodes in the order of the file; for one direction sender first."""
        if self.between is not None:
            return self.between
        assert self.from_ is not None
        assert self.to is not None
        return (self.from_, self.to)

    @property
    def directions(self) -> tuple[tuple[str, str], ...]:
        """The (sender, receiver) pairs that are meant."""
        a, b = self.ends
        return ((a, b),) if self.between is None else ((a, b), (b, a))


class Link(Ends, Words):
    """An entry of `links`. Two nodes share at most one wire; `from`/`to` entries refine one direction of it."""

    @model_validator(mode="after")
    def _consistent_words(self) -> Self:
        if self.between is not None and (complaint := self.inconsistency()):
            raise ValueError(complaint)
        return self


@dataclass(frozen=True, slots=True)
class Wire:
    """Two nodes joined by a wire, with the words of either direction; ``a`` is the end that the file names first."""

    a: str
    b: str
    forward: Words
    backward: Words


def wires(links: Iterable[Link]) -> tuple[Wire, ...]:
    """Join the entries of `links` into wires, in the order of their first appearance.

    A `from`/`to` entry lays its words over those of the `between` entry for that direction. A direction that no entry
    describes is perfect.
    """
    names: dict[frozenset[str], tuple[str, str]] = {}
    words: dict[tuple[str, str], Words] = {}
    for link in sorted(links, key=lambda link: link.between is None):
        plain = link.laid_over(NO_WORDS)
        for direction in link.directions:
            words[direction] = link.laid_over(words[direction]) if direction in words else plain
    for link in links:
        names.setdefault(frozenset(link.ends), link.ends)
    return tuple(Wire(a, b, words.get((a, b), NO_WORDS), words.get((b, a), NO_WORDS)) for a, b in names.values())
