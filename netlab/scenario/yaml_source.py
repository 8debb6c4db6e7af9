"""YAML text to plain data with line numbers, without YAML 1.1's surprises.

Only plain scalars are typed, and only as YAML 1.2's core schema does: `on`, `off`, `yes`, `no` and `1:30` stay text,
so that a node may be called `on` and a forgotten unit is noticed. Keys are always text. A key given twice is an error.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Any

import yaml

from netlab.errors import ScenarioError
from netlab.scenario.document import Document, Path, dotted

_Loader: Any = getattr(yaml, "CBaseLoader", yaml.BaseLoader)
_INTEGER = re.compile(r"[+-]?(?:0|[1-9]\d{0,30})")
_FLOAT = re.compile(r"[+-]?(?:\d+\.\d*|\.\d+)(?:[eE][+-]?\d+)?")
_NULLS = frozenset({"", "~", "null", "Null", "NULL"})
_BOOLEANS = {"true": True, "True": True, "TRUE": True, "false": False, "False": False, "FALSE": False}
_STANDARD_TAG = "tag:yaml.org,2002:"
_MAX_DEPTH = 60  # the C composer recurses without a guard of its own
_MAX_PARTS = 500_000  # aliases can multiply a small file without bound


def plain_scalar(text: str) -> str | int | float | bool | None:
    """Return the value of an unquoted scalar."""
    if text in _NULLS:
        return None
    if text in _BOOLEANS:
        return _BOOLEANS[text]
    if _INTEGER.fullmatch(text):
        return int(text)
    return float(text) if _FLOAT.fullmatch(text) else text


def read_yaml(text: str, *, name: str) -> Document:
    """Parse one YAML document whose top is a block of keys.

    Raises:
        ScenarioError: Not YAML, several documents, keys given twice, or not a block of keys.
    """
    root = _compose(text, name)
    if root is None:
        raise ScenarioError([f"{name}: the file is empty; it needs at least duration: and nodes:"])
    converter = _Converter(name)
    data = converter.convert(root, ())
    if not isinstance(data, dict):
        converter.problems.append(f"{name}:1: a scenario is a block of keys (name:, duration:, nodes:, ...)")
    if converter.problems:
        raise ScenarioError(converter.problems)
    return Document(name, data, converter.marks)


def read_value(text: str) -> Any:
    """Parse a single YAML value, as after `--set key=`.

    Raises:
        ValueError: Not YAML; the text says why.
    """
    try:
        root = _compose(text, "")
        converter = _Converter("")
        value = None if root is None else converter.convert(root, ())
    except ScenarioError as error:
        raise ValueError(_without_line(error.problems[0])) from None
    if converter.problems:
        raise ValueError(_without_line(converter.problems[0]))
    return value


def _without_line(problem: str) -> str:
    return re.sub(r"^:\d+: |^: ", "", problem)


def _compose(text: str, name: str) -> yaml.Node | None:
    try:
        _refuse_deep_nesting(text, name)
        root: yaml.Node | None = yaml.compose(text, Loader=_Loader)
    except yaml.MarkedYAMLError as error:
        raise ScenarioError([_syntax_problem(error, text, name)]) from None
    except (yaml.YAMLError, UnicodeError) as error:
        raise ScenarioError([f"{name}: not YAML: {' '.join(str(error).split())}"]) from None
    return root


def _refuse_deep_nesting(text: str, name: str) -> None:
    depth = 0
    for event in yaml.parse(text, Loader=_Loader):
        if isinstance(event, yaml.CollectionStartEvent):
            depth += 1
            if depth > _MAX_DEPTH:
                line = event.start_mark.line + 1 if event.start_mark else 1
                raise ScenarioError([f"{name}:{line}: nested deeper than {_MAX_DEPTH} levels"])
        elif isinstance(event, yaml.CollectionEndEvent):
            depth -= 1


def _syntax_problem(error: yaml.MarkedYAMLError, source: str, name: str) -> str:
    mark = error.problem_mark or error.context_mark
    line = f":{mark.line + 1}" if mark else ""
    if isinstance(error, yaml.composer.ComposerError) and "another document" in str(error.problem):
        return f"{name}{line}: a second document begins; a file holds one scenario"
    if "nesting depth" in str(error.problem):  # PyYAML 6.0.4 and later has a limit of its own, beyond ours
        return f"{name}{line}: nested deeper than {_MAX_DEPTH} levels"
    text = ", ".join(part for part in (error.context, error.problem) if part)
    at_tab = mark is not None and "\t" in "".join(source.splitlines()[mark.line : mark.line + 1])[: mark.column + 1]
    hint = "; indent with spaces, not tabs" if at_tab else ""
    return f"{name}{line}: not YAML: {text}{hint}"


class _Converter:
    """Turns YAML nodes into plain data, noting the line of every path and every problem."""

    def __init__(self, name: str) -> None:
        self.marks: dict[Path, str] = {}
        self.problems: list[str] = []
        self._name = name
        self._open: set[int] = set()
        self._parts = 0

    def convert(self, node: yaml.Node, path: Path) -> Any:
        self._parts += 1
        self.marks.setdefault(path, self._line(node))
        if self._parts > _MAX_PARTS:
            raise ScenarioError([f"{self._line(node)}: the aliases multiply to more than {_MAX_PARTS:,} parts"])
        if id(node) in self._open:
            self._complain(node, path, "refers to itself; write it out")
            return None
        if not node.tag.startswith(_STANDARD_TAG):
            self._complain(node, path, f"tags such as {node.tag} mean nothing here; remove it")
            return None
        self._open.add(id(node))
        try:
            return self._contents(node, path)
        finally:
            self._open.discard(id(node))

    def _contents(self, node: yaml.Node, path: Path) -> Any:
        if isinstance(node, yaml.MappingNode):
            return self._mapping(node, path)
        if isinstance(node, yaml.SequenceNode):
            return [self.convert(item, (*path, index)) for index, item in enumerate(node.value)]
        quoted = isinstance(node, yaml.ScalarNode) and node.style
        return node.value if quoted else plain_scalar(node.value)

    def _mapping(self, node: yaml.MappingNode, path: Path) -> dict[str, Any]:
        result: dict[str, Any] = {}
        first: dict[str, str] = {}
        for key_node, value_node in node.value:
            if not isinstance(key_node, yaml.ScalarNode):
                self._complain(key_node, path, "a key must be a single word")
                continue
            key = key_node.value
            if key == "<<" and not key_node.style:
                continue
            if key in first:
                self._complain(key_node, (*path, key), f"is given twice (first in {first[key]}); remove one")
                continue
            first[key] = self._line(key_node)
            self.marks[(*path, key)] = first[key]
            result[key] = self.convert(value_node, (*path, key))
        return self._merged(node, path) | result

    def _merged(self, node: yaml.MappingNode, path: Path) -> dict[str, Any]:
        """YAML's merge key `<<`: what the mappings named there give and this one does not."""
        merged: dict[str, Any] = {}
        for source in _merge_sources(node):
            value = self.convert(source, path)
            if isinstance(value, dict):
                merged = value | merged
            else:
                self._complain(source, path, "<< takes a block of keys or a list of such")
        return merged

    def _complain(self, node: yaml.Node, path: Path, what: str) -> None:
        self.problems.append(f"{self._line(node)}: {dotted(path)}: {what}" if path else f"{self._line(node)}: {what}")

    def _line(self, node: yaml.Node) -> str:
        return f"{self._name}:{node.start_mark.line + 1}"


def _merge_sources(node: yaml.MappingNode) -> Iterator[yaml.Node]:
    for key_node, value_node in node.value:
        if isinstance(key_node, yaml.ScalarNode) and key_node.value == "<<" and not key_node.style:
            if isinstance(value_node, yaml.SequenceNode):
                yield from value_node.value
            else:
                yield value_node
