"""A scenario file's text with other events, the rest as it was written, comments included."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import yaml

from netlab.scenario.document import Document
from netlab.scenario.overrides import apply_overrides

_WIDTH = 118


def own_events(text: str, overrides: Sequence[str] = ()) -> list[dict[str, Any]]:
    """The `events` of a file as plain values, with ``overrides`` (as after `--set`) applied."""
    events = _data(text, overrides).get("events") or []
    return [dict(event) for event in events]


def with_events(
    text: str,
    events: Sequence[Mapping[str, Any]],
    *,
    duration: str | None = None,
    overrides: Sequence[str] = (),
    others: Mapping[str, Any] | None = None,
    remark: str = "",
) -> str:
    """Return the file with these events instead of its own.

    Args:
        text: The file.
        events: What `events` shall be, as plain values.
        duration: A new duration, None for the file's own.
        overrides: As after `--set`; they become part of the file.
        others: Further top-level values, such as the seed that was used.
        remark: A comment for the top.
    """
    changes = {**(others or {}), **({"duration": duration} if duration is not None else {})}
    head = "".join(f"# {line}\n" for line in remark.splitlines())
    if overrides:
        data = _data(text, overrides) | changes
        data.pop("events", None)
        return head + _dumped(data) + _events_text(events)
    for key, value in changes.items():
        text = _replaced(text, key, f"{key}: {yaml.safe_dump(value).splitlines()[0]}\n")
    return head + _replaced(text, "events", _events_text(events))


def _data(text: str, overrides: Sequence[str]) -> dict[str, Any]:
    document = Document("saved", yaml.safe_load(text) or {})
    apply_overrides(document, overrides)
    return document.data


def _events_text(events: Sequence[Mapping[str, Any]]) -> str:
    """One line per event, as people write them."""
    if not events:
        return ""
    return "events:\n" + "".join(f"  - {_flow(event)}\n" for event in events)


def _flow(value: object) -> str:
    return yaml.safe_dump(value, default_flow_style=True, sort_keys=False, width=10_000, allow_unicode=True).strip()


def _dumped(data: Mapping[str, Any]) -> str:
    return yaml.safe_dump(dict(data), sort_keys=False, default_flow_style=None, width=_WIDTH, allow_unicode=True)


def _replaced(text: str, key: str, block: str) -> str:
    """Put ``block`` where the top-level key stands, or at the end."""
    root = yaml.compose(text, Loader=yaml.SafeLoader)
    pairs = root.value if isinstance(root, yaml.MappingNode) else []
    for name, value in pairs:
        if name.value == key:
            lines = text.splitlines(keepends=True)
            end = _last_line(value) + 1
            return "".join(lines[: name.start_mark.line]) + block + "".join(lines[end:])
    return text + ("" if text.endswith("\n") or not text else "\n") + block


def _last_line(node: yaml.Node) -> int:
    """The line on which a value ends; a block's own mark lies behind the comments that follow it."""
    if isinstance(node, yaml.CollectionNode) and not node.flow_style and node.value:
        last = node.value[-1]
        return _last_line(last[1] if isinstance(last, tuple) else last)
    if isinstance(node, yaml.ScalarNode) and node.style in ("|", ">"):
        return node.end_mark.line - 1
    return node.end_mark.line
