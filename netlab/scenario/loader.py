"""Reading a scenario: text, overrides, expansion, validation, cross-references; every problem at once."""

from __future__ import annotations

import copy
import re
from collections.abc import Mapping, Sequence
from pathlib import Path as FilePath
from typing import Any

from pydantic import ValidationError

from netlab.errors import ScenarioError
from netlab.scenario.check_activity import check_activity, is_after_the_end
from netlab.scenario.check_motion import check_motion
from netlab.scenario.check_radio import check_radio
from netlab.scenario.check_rose import check_rose
from netlab.scenario.check_topology import Names, check_topology
from netlab.scenario.document import Document, line_of
from netlab.scenario.generate import expand
from netlab.scenario.model import Scenario
from netlab.scenario.overrides import apply_overrides, set_value
from netlab.scenario.problems import Problem, validation_problems
from netlab.scenario.recover import NO_DOUBT, Doubt, remains
from netlab.scenario.words import ReadText
from netlab.scenario.yaml_source import read_yaml


def load_scenario(
    path: str | FilePath, *, overrides: Sequence[str] = (), seed: int | None = None, engine: str | None = None
) -> Scenario:
    """Read and check a scenario file.

    Args:
        path: The YAML file. Files that it names are looked for beside it.
        overrides: `a.b.c=value` texts, as after `--set`.
        seed: Wins over the file's seed.
        engine: Wins over the file's engine.

    Raises:
        ScenarioError: With every problem, as ``file:line: key: what is wrong; what to do``.
    """
    file = FilePath(path)
    try:
        text = file.read_text(encoding="utf-8")
    except OSError as error:
        raise ScenarioError([f"{path}: cannot be read: {error.strerror}"]) from None
    except UnicodeDecodeError:
        raise ScenarioError([f"{path}: is not a text file in UTF-8"]) from None
    document = read_yaml(text, name=str(path))
    document.data.setdefault("name", _as_name(file.stem))
    return _build(document, overrides, seed, engine, _reader(file.parent))


def parse_scenario(
    source: str | Mapping[str, Any],
    *,
    name: str = "<dict>",
    overrides: Sequence[str] = (),
    seed: int | None = None,
    engine: str | None = None,
    directory: FilePath | None = None,
) -> Scenario:
    """Check a scenario given as YAML text or as plain data; ``name`` stands for the file in messages.

    Args:
        source: YAML text, or what it would parse to. It is not changed.
        name: What problems call it.
        overrides: `a.b.c=value` texts, as after `--set`.
        seed: Wins over the scenario's seed.
        engine: Wins over the scenario's engine.
        directory: Where files that it names are looked for; without it they are refused.

    Raises:
        ScenarioError: With every problem.
    """
    document = read_yaml(source, name=name) if isinstance(source, str) else Document(name, copy.deepcopy(dict(source)))
    document.data.setdefault("name", "scenario")
    return _build(document, overrides, seed, engine, _reader(directory) if directory else None)


def _build(
    document: Document, overrides: Sequence[str], seed: int | None, engine: str | None, read: ReadText | None
) -> Scenario:
    problems = apply_overrides(document, overrides)
    if seed is not None:
        set_value(document, ("seed",), seed, origin=f"--seed {seed}")
    if engine is not None:
        set_value(document, ("engine",), engine, origin=f"--engine {engine}")
    expand(document, read)
    scenario: Scenario | None = None
    try:
        scenario = Scenario.model_validate(document.data, context=read)
        found = _cross_check(scenario, NO_DOUBT)
    except ValidationError as error:
        found = validation_problems(error, document.data)
        rest = remains(document.data, [path for path, _ in found], read)
        found += _cross_check(*rest) if rest else []
    if any(text.partition("=")[0].strip() == "duration" for text in overrides):
        found = [problem for problem in found if not is_after_the_end(problem)]  # cut short on purpose
    problems += [f"{document.where(path)}: {message}" for path, message in found]
    if scenario is None or problems:
        raise ScenarioError(sorted(dict.fromkeys(problems), key=line_of))
    return scenario


def _cross_check(scenario: Scenario, doubt: Doubt) -> list[Problem]:
    found = [*check_topology(scenario, doubt), *check_radio(scenario), *check_rose(scenario, Names(scenario, doubt))]
    found += [*check_motion(scenario, doubt), *check_activity(scenario, doubt)]
    return [(doubt.written(path), message) for path, message in found]


def _reader(directory: FilePath) -> ReadText:
    return lambda name: (directory / name).read_text(encoding="utf-8")


def _as_name(stem: str) -> str:
    return re.sub(r"[^A-Za-z0-9_.-]+", "-", stem).strip("-.") or "scenario"
