"""Settings read from a table: values, all mistakes at once, no secret in a message."""

from __future__ import annotations

from dataclasses import fields

import pytest

from wnet import config
from wnet.config import ConfigError, MeshConfig, Metric


def test_a_table_changes_what_it_names() -> None:
    read = config.parse({"metric": "ett", "tries": 2, "hello_slow_s": 1, "redundant_dscp": 46}, source="wnet.toml")
    assert (read.metric, read.tries, read.hello_slow_s, read.redundant_dscp) == (Metric.ETT, 2, 1.0, 46)
    assert read.channel_bps == MeshConfig().channel_bps


def test_every_mistake_is_told_with_file_and_key() -> None:
    with pytest.raises(ConfigError) as caught:
        config.parse({"metric": "hops", "tries": 9, "hop_limit": 2.5, "tires": 1, "key": "00ff"}, source="wnet.toml")
    problems = caught.value.problems
    assert [problem.split(": ")[1] for problem in problems] == ["metric", "tries", "hop_limit", "tires", "key"]
    assert "quality, etx, ett" in problems[0]
    assert "from 1 to 7" in problems[1]
    assert not any("00ff" in problem for problem in problems)


def test_every_setting_can_be_read_and_its_default_is_within_its_bounds() -> None:
    assert {field.name for field in fields(MeshConfig)} == set(config.CHECKS)
    for field in fields(MeshConfig):
        value = getattr(MeshConfig(), field.name)
        if value not in (None, ()):
            assert config.CHECKS[field.name](value) == value


def test_a_key_is_not_shown() -> None:
    key = config.parse({"key": ["ab" * 32, "cd" * 32]}, source="x").key
    assert key == (b"\xab" * 32, b"\xcd" * 32)
    assert "ab" * 8 not in repr(MeshConfig(key=key))
