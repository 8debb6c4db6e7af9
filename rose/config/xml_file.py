"""XML, the form of the paper, to the same tree that YAML gives.

Attributes and elements without children are keys with scalars. ``<service>`` elements are the list ``services``,
``<host>`` elements ``hosts`` by their address, ``<key>`` elements the list ``keys`` (of the team, or of the service
named by ``of``), ``<setting name="...">`` elements the block ``settings``. No document types, no entities:
a configuration needs none, and both can be used to attack a reader.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from xml.parsers import expat

from rose.config.tree import Complaints, Node
from rose.config.yaml_file import scalar

_LISTS = {"service": "services", "key": "keys", "arg": "argv"}
_DEPTH_MAX = 20


@dataclass(slots=True)
class _Element:
    tag: str
    line: int
    attributes: dict[str, str]
    children: list[_Element] = field(default_factory=list)
    text: str = ""


class _TooDeep(Exception):
    pass


def read_xml(text: str, complaints: Complaints) -> Node | None:
    """Return the file's tree, without its outermost element ``rose``; None after a complaint."""
    root = _parse(text, complaints)
    if root is None:
        return None
    if root.tag != "rose":
        complaints.add(root.line, "", f"the outermost element is <{root.tag}>; it has to be <rose>")
        return None
    return _block(root, complaints)


def _parse(text: str, complaints: Complaints) -> _Element | None:
    parser = expat.ParserCreate()
    open_elements = [_Element("", 0, {})]

    def start(tag: str, attributes: dict[str, str]) -> None:
        if len(open_elements) > _DEPTH_MAX:
            raise _TooDeep
        element = _Element(tag, parser.CurrentLineNumber, attributes)
        open_elements[-1].children.append(element)
        open_elements.append(element)

    def data(piece: str) -> None:
        open_elements[-1].text += piece

    def doctype(*_arguments: object) -> None:
        raise _TooDeep

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _tag: open_elements.pop()
    parser.CharacterDataHandler = data
    parser.StartDoctypeDeclHandler = doctype
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        complaints.add(error.lineno, "", f"not XML: {expat.ErrorString(error.code)}")
        return None
    except _TooDeep:
        complaints.add(parser.CurrentLineNumber, "", "document types and deep nesting have no use here; remove them")
        return None
    return open_elements[0].children[0]


def _block(element: _Element, complaints: Complaints) -> Node:
    found = {key: Node(scalar(value), element.line, value) for key, value in element.attributes.items()}
    settings: dict[str, Node] = {}
    hosts: dict[str, Node] = {}
    for child in element.children:
        if child.tag == "setting":
            _name(settings, child, "name", Node(scalar(child.text.strip()), child.line, child.text.strip()), complaints)
        elif child.tag == "host":
            inside = _Element("host", child.line, {k: v for k, v in child.attributes.items() if k != "address"})
            inside.children = child.children
            _name(hosts, child, "address", _block(inside, complaints), complaints)
        elif child.tag in _LISTS:
            listed = found.setdefault(_LISTS[child.tag], Node([], child.line)).value
            if isinstance(listed, list):
                listed.append(_value(child, complaints))
        elif child.tag in found:
            complaints.add(child.line, child.tag, f"is given twice (first in line {found[child.tag].line})")
        else:
            found[child.tag] = _value(child, complaints)
    if settings:
        found["settings"] = Node(settings, element.line)
    if hosts:
        found["hosts"] = Node(hosts, element.line)
    return Node(found, element.line)


def _value(element: _Element, complaints: Complaints) -> Node:
    if element.attributes or element.children:
        block = _block(element, complaints)
        if element.text.strip() and isinstance(block.value, dict):
            block.value["text"] = Node(element.text.strip(), element.line, element.text.strip())
        return block
    text = element.text.strip()
    return Node(text if element.tag in ("key", "arg") else scalar(text), element.line, text)


def _name(into: dict[str, Node], element: _Element, attribute: str, node: Node, complaints: Complaints) -> None:
    name = element.attributes.get(attribute)
    if name is None:
        complaints.add(element.line, element.tag, f'has no {attribute}="..."; add it')
    elif name in into:
        complaints.add(element.line, element.tag, f"'{name}' is given twice (first in line {into[name].line})")
    else:
        into[name] = node
