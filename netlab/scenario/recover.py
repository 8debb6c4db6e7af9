"""What is left of a document when the parts that do not validate are taken out, so that the rest can still be checked.

One wrong unit must not hide a misspelt node elsewhere in the file. The remains serve the cross-reference check only.
"""

from __future__ import annotations

import copy
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from pydantic import ValidationError

from netlab.scenario.document import Path
from netlab.scenario.links import Ends
from netlab.scenario.model import Scenario
from netlab.scenario.problems import validation_problems
from netlab.scenario.words import ReadText

_LISTS = ("links", "traffic", "events", "expect")
_ENDS = ("between", "from", "to")
#: Stand-ins for required values that are wrong, so that the names in the same entry are still looked at.
_STAND_INS = {
    "traffic": {"size": "1kB", "rate": "1Hz"},
    "events": {"at": "0s", "for": "1s", "up": "1s", "down": "1s", "until": "1000h"},
    "expect": {"p50": "1s", "p90": "1s", "p99": "1s"},
}


@dataclass(frozen=True, slots=True)
class Doubt:
    """What a check must not conclude from, because part of the file was taken out.

    ``nodes`` are the names of all nodes of the file, wrong ones too; ``sections`` are the top-level keys that are
    incomplete. ``indexes`` gives, per list section, the place in the file of each entry that is left.
    """

    nodes: tuple[str, ...] = ()
    sections: frozenset[str] = frozenset()
    indexes: Mapping[str, Sequence[int]] | None = None

    def written(self, path: Path) -> Path:
        """Translate a path in the remains into a path in the file."""
        if self.indexes and len(path) > 1 and path[0] in self.indexes and isinstance(path[1], int):
            return (path[0], self.indexes[str(path[0])][path[1]], *path[2:])
        return path


NO_DOUBT = Doubt()


def remains(data: dict[str, Any], wrong: Collection[Path], read: ReadText | None) -> tuple[Scenario, Doubt] | None:
    """Return ``data`` without the parts at the ``wrong`` paths as a scenario, or None when too little is left."""
    kept = copy.deepcopy(data)
    dropped = {str(path[0]) for path in wrong if path} - {"nodes", *_LISTS}
    for section in dropped:
        kept.pop(section, None)
    kept |= {"name": kept.get("name", "x"), "duration": kept.get("duration", "1000h")}
    nodes = tuple(kept["nodes"]) if isinstance(kept.get("nodes"), dict) else ()
    _drop_nodes(kept, wrong)
    sections = dropped | {str(path[0]) for path in wrong if len(path) == 1}
    for section in sections & set(_LISTS):
        kept.pop(section, None)
    for path in wrong:
        _repair(kept, path)
    indexes = {section: list(range(len(kept[section]))) for section in _LISTS if isinstance(kept.get(section), list)}
    scenario = _validated(kept, read, indexes, sections)
    return None if scenario is None else (scenario, Doubt(nodes, frozenset(sections), indexes))


def _drop_nodes(kept: dict[str, Any], wrong: Collection[Path]) -> None:
    """Take the wrong nodes out of ``kept``."""
    names = {str(path[1]) for path in wrong if len(path) > 1 and path[0] == "nodes"}
    nodes = kept.get("nodes")
    if isinstance(nodes, dict):
        kept["nodes"] = {name: body for name, body in nodes.items() if name not in names} or {"x": {}}


def _repair(kept: dict[str, Any], path: Path) -> None:
    """Take one wrong value out of an entry of a list, or put a stand-in there."""
    section = str(path[0])
    if section not in _LISTS or len(path) < 3:
        return
    here = kept[section][path[1]]
    keys = [part for part in path[2:] if isinstance(part, str)]
    for key in keys[:-1]:
        here = here.get(key) if isinstance(here, dict) else None
    if keys and isinstance(here, dict):
        here.pop(keys[-1], None)
        here |= {key: value for key, value in _STAND_INS.get(section, {}).items() if key == keys[-1]}


def _validated(
    kept: dict[str, Any], read: ReadText | None, indexes: dict[str, list[int]], sections: set[str]
) -> Scenario | None:
    """Validate ``kept``; entries that are still wrong are dropped, and their sections noted in ``sections``."""
    try:
        return Scenario.model_validate(kept, context=read)
    except ValidationError as error:
        still = [path for path, _ in validation_problems(error, kept)]
    for section, places in indexes.items():
        bad = {path[1] for path in still if len(path) > 1 and path[0] == section}
        if bad:
            _drop_entries(kept, section, places, bad, sections)
    try:
        return Scenario.model_validate(kept, context=read)
    except ValidationError:
        return None


def _drop_entries(
    kept: dict[str, Any], section: str, places: list[int], bad: Iterable[str | int], sections: set[str]
) -> None:
    sound = []
    for index, entry in enumerate(kept[section]):
        ends = _only_ends(entry) if index in bad and section == "links" else None
        if index not in bad or ends is not None:
            sound.append((index, ends or entry))
    if len(sound) < len(kept[section]):
        sections.add(section)
    kept[section] = [entry for _, entry in sound]
    places[:] = [places[index] for index, _ in sound]


def _only_ends(link: Any) -> dict[str, Any] | None:
    """A wrong link still says whom it joins, if that much is right."""
    if not isinstance(link, dict):
        return None
    ends = {key: link[key] for key in _ENDS if key in link}
    try:
        Ends.model_validate(ends)
    except ValidationError:
        return None
    return ends
