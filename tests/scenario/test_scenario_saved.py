"""Other events in a file's text: what was written stays, overrides become part of it."""

from __future__ import annotations

import yaml

from netlab.scenario.saved import own_events, with_events

TEXT = """# A comment at the top.
name: x
duration: 10s          # short
nodes: {a: , b: }
events:
  - {at: 1s, mark: one}   # gone with the block
  - at: 2s
    mark: two

# what is expected
expect: []
"""


def test_only_the_events_change() -> None:
    text = with_events(TEXT, [{"at": "3s", "outage": {"between": ["a", "b"], "for": "1s"}}])
    expected = TEXT.split("events:")[0] + "events:\n  - {at: 3s, outage: {between: [a, b], for: 1s}}\n"
    assert text == expected + "\n# what is expected\nexpect: []\n"


def test_a_file_without_events_gets_them_at_its_end() -> None:
    text = with_events("name: x\nnodes: {a: }", [{"at": "3s", "mark": "m"}])
    assert text == "name: x\nnodes: {a: }\nevents:\n  - {at: 3s, mark: m}\n"


def test_no_events_leave_no_block() -> None:
    assert "events" not in yaml.safe_load(with_events(TEXT, []))


def test_a_new_duration_and_a_remark() -> None:
    text = with_events(TEXT, own_events(TEXT), duration="12s", remark="Saved.\nTwice.")
    assert text.startswith("# Saved.\n# Twice.\n# A comment at the top.\n")
    assert yaml.safe_load(text) == yaml.safe_load(TEXT) | {"duration": "12s"}


def test_overrides_become_part_of_the_file() -> None:
    overrides = ("duration=20s", "events.0.at=4s")
    text = with_events(TEXT, own_events(TEXT, overrides), overrides=overrides, others={"seed": 5})
    data = yaml.safe_load(text)
    assert (data["duration"], data["seed"]) == ("20s", 5)
    assert [event["at"] for event in data["events"]] == ["4s", "2s"]
