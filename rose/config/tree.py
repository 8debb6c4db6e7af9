"""A file's content with line numbers, whatever it was written in; and how to read values out of it.

A reader never stops at the first mistake: each is noted as ``file:line: key: what is wrong; what to do``.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from difflib import get_close_matches


@dataclass(frozen=True, slots=True)
class Node:
    """A scalar (str, int, float, bool or None), a list of nodes, or nodes by key; and the line where it begins.

    ``written``: a scalar as the file has it, for values that only look like numbers (0.10 is robot 0, service 10).
    """

    value: object
    line: int
    written: str = ""


@dataclass(slots=True)
class Complaints:
    """All that is wrong with one file."""

    file: str
    problems: list[str] = field(default_factory=list)

    def add(self, line: int, key: str, text: str) -> None:
        """Note a mistake; ``key`` is a dotted path, or empty."""
        self.problems.append(f"{self.file}:{line}: {key}: {text}" if key else f"{self.file}:{line}: {text}")


class Block:
    """A block of keys that is read key by key; :meth:`finish` complains about those that nobody asked for."""

    def __init__(self, node: Node, complaints: Complaints, path: str = "") -> None:
        self.line = node.line
        self._path, self.complaints = path, complaints
        self._asked: set[str] = set()
        self._nodes: dict[str, Node] = {}
        if isinstance(node.value, dict):
            self._nodes = node.value
        else:
            complaints.add(node.line, path, f"expected a block of keys, found {describe(node.value)}")

    def node(self, key: str) -> Node | None:
        """Return what stands under a key."""
        self._asked.add(key)
        return self._nodes.get(key)

    def text(self, key: str, default: str | None = None, *, choices: tuple[str, ...] = ()) -> str:
        """Return a text; without a default the key is required."""
        node = self.node(key)
        if node is None:
            if default is None:
                self.complain(self.line, key, "is missing; add it")
            return default or ""
        if not isinstance(node.value, str) or not node.value:
            self.complain(node.line, key, f"expected text, found {describe(node.value)}")
        elif choices and node.value not in choices:
            self.complain(node.line, key, f"'{node.value}' is not possible here; use {', '.join(choices)}")
        else:
            return node.value
        return default or ""

    def number(self, key: str, default: float, *, least: float, most: float) -> float:
        """Return a number within bounds."""
        node = self.node(key)
        if node is None:
            return default
        if isinstance(node.value, bool) or not isinstance(node.value, int | float):
            self.complain(node.line, key, f"expected a number, found {describe(node.value)}")
        elif not least <= node.value <= most:
            self.complain(node.line, key, f"{node.value} is impossible; it is {least:g} to {most:g}")
        else:
            return node.value
        return default

    def switch(self, key: str, default: bool) -> bool:
        """Return true or false."""
        node = self.node(key)
        if node is None:
            return default
        if not isinstance(node.value, bool):
            self.complain(node.line, key, f"expected true or false, found {describe(node.value)}")
            return default
        return node.value

    def items(self, key: str) -> list[Node]:
        """Return a list, empty if the key is not there."""
        node = self.node(key)
        if node is None:
            return []
        if not isinstance(node.value, list):
            self.complain(node.line, key, f"expected a list, found {describe(node.value)}")
            return []
        return node.value

    def entries(self) -> Iterator[tuple[str, Node]]:
        """Yield every key with its node, for blocks whose keys are names."""
        self._asked.update(self._nodes)
        yield from self._nodes.items()

    def complain(self, line: int, key: str, text: str) -> None:
        """Note a mistake under one of this block's keys."""
        self.complaints.add(line, f"{self._path}.{key}" if self._path else key, text)

    def finish(self) -> None:
        """Complain about unknown keys."""
        for key, node in self._nodes.items():
            if key not in self._asked:
                close = get_close_matches(key, self._asked, 1)
                known = f"did you mean '{close[0]}'?" if close else f"known keys are {', '.join(sorted(self._asked))}"
                self.complain(node.line, key, f"unknown key; {known}")


def plain(node: Node) -> object:
    """Return the values alone."""
    if isinstance(node.value, dict):
        return {key: plain(value) for key, value in node.value.items()}
    return [plain(item) for item in node.value] if isinstance(node.value, list) else node.value


def describe(value: object) -> str:
    """Say what a value is, for complaints."""
    if isinstance(value, dict):
        return "a block of keys"
    if isinstance(value, list):
        return "a list"
    return "nothing" if value is None or value == "" else f"'{value}'"
