"""The JSON Schema of the scenario format, for editors that complete and check YAML as it is typed."""

from __future__ import annotations

from typing import Any

from netlab.scenario.model import Scenario


def json_schema() -> dict[str, Any]:
    """Return the format as JSON Schema (draft 2020-12). It checks each value, not the references between them."""
    schema = Scenario.model_json_schema(by_alias=True, mode="validation")
    # A file's name is its default name, and generated nodes can be the only ones.
    schema["required"] = [key for key in schema["required"] if key not in ("name", "nodes")]
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", "title": "netlab scenario"} | schema
