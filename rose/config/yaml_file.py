"""YAML to a tree with lines. Scalars are typed as in JSON, so that ``on`` stays a word."""

from __future__ import annotations

import re

import yaml

from rose.config.tree import Complaints, Node

_INTEGER = re.compile(r"[+-]?(?:0|[1-9]\d{0,17})")
_FLOAT = re.compile(r"[+-]?(?:\d+\.\d*|\.\d+|\d+)(?:[eE][+-]?\d+)?")
_WORDS: dict[str, object] = {"true": True, "false": False, "null": None, "~": None, "": None}
_DEPTH_MAX = 20


class _NoUse(Exception):
    def __init__(self, line: int) -> None:
        super().__init__()
        self.line = line


def read_yaml(text: str, complaints: Complaints) -> Node | None:
    """Return the file's tree; None after a complaint."""
    try:
        _refuse_deep(text)
        root = yaml.compose(text, Loader=yaml.BaseLoader)
    except _NoUse as error:
        complaints.add(error.line, "", "aliases and deep nesting have no use here; write it out")
        return None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        complaints.add(mark.line + 1 if mark else 1, "", f"not YAML: {error.problem or error.context}")
        return None
    except (yaml.YAMLError, ValueError) as error:
        complaints.add(1, "", f"not YAML: {' '.join(str(error).split())}")
        return None
    if root is None:
        complaints.add(1, "", "the file is empty")
        return None
    return _convert(root, complaints)


def _refuse_deep(text: str) -> None:
    depth = 0
    for event in yaml.parse(text, Loader=yaml.BaseLoader):
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > _DEPTH_MAX or isinstance(event, yaml.AliasEvent):
            line = event.start_mark.line + 1 if event.start_mark else 1
            raise _NoUse(line)


def _convert(node: yaml.Node, complaints: Complaints) -> Node:
    line = node.start_mark.line + 1
    if isinstance(node, yaml.SequenceNode):
        return Node([_convert(item, complaints) for item in node.value], line)
    if isinstance(node, yaml.MappingNode):
        found: dict[str, Node] = {}
        for key, value in node.value:
            name = str(key.value) if isinstance(key, yaml.ScalarNode) else ""
            if not name or name in found:
                what = f"is given twice (first in line {found[name].line})" if name else "a key has to be one word"
                complaints.add(key.start_mark.line + 1, name, what)
                continue
            found[name] = _convert(value, complaints)
        return Node(found, line)
    quoted = isinstance(node, yaml.ScalarNode) and node.style
    return Node(node.value if quoted else scalar(node.value), line, str(node.value))


def scalar(text: str) -> object:
    if text in _WORDS:
        return _WORDS[text]
    if _INTEGER.fullmatch(text):
        return int(text)
    return float(text) if _FLOAT.fullmatch(text) else text
