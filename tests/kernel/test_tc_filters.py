"""Filters and mirrors: the bytes that tc sends for the same orders."""

import json
import struct
from pathlib import Path

import pytest

from netlab.kernel import tc
from netlab.kernel.netlink import attributes

GOLDEN = json.loads((Path(__file__).parents[1] / "data/netem/tc.json").read_text())["cases"]
MAC = bytes.fromhex("020000000005")
FLOWER, U32 = tc.Classifier.FLOWER, tc.Classifier.U32
LO = 1
U32_SEL = 5


def options_of(message: bytes) -> bytes:
    return attributes(message, 36)[2]


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("matchall", tc.add_filter(LO, 3, tc.ANY, [LO, LO], classifier=FLOWER)),
        ("flower", tc.add_filter(LO, 2, tc.match_mac(MAC), [LO], classifier=FLOWER)),
        ("flower_group", tc.add_filter(LO, 1, tc.GROUP, [LO, LO], classifier=FLOWER)),
        ("u32_mac", tc.add_filter(LO, 2, tc.match_mac(MAC), [LO], classifier=U32)),
    ],
)
def test_filter_is_what_tc_sends(name: str, message: bytes) -> None:
    golden = GOLDEN[name]
    assert options_of(message) == bytes.fromhex(golden["options"]), golden["command"]
    handle, parent, info = struct.unpack_from("=III", message, 24)
    assert (handle, parent, info) == (golden["handle"], golden["parent"], golden["info"])


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("u32_all", tc.add_filter(LO, 3, tc.ANY, [LO], classifier=U32)),
        ("u32_group", tc.add_filter(LO, 1, tc.GROUP, [LO, LO], classifier=U32)),
    ],
)
def test_short_u32_match_differs_from_tc_by_an_empty_second_key_only(name: str, message: bytes) -> None:
    golden = attributes(bytes.fromhex(GOLDEN[name]["options"]), 0)
    ours = attributes(options_of(message), 0)
    actions = {kind: payload for kind, payload in ours.items() if kind != U32_SEL}
    assert actions == {kind: payload for kind, payload in golden.items() if kind != U32_SEL}
    assert golden[U32_SEL][2] == 1
    assert ours[U32_SEL][2] == 2
    assert ours[U32_SEL][16:24] == golden[U32_SEL][16:24]  # mask and value of the first key
    assert ours[U32_SEL][32:40] == bytes(8)  # mask and value of the second


def test_clsact_is_what_tc_sends() -> None:
    handle, parent, info = struct.unpack_from("=III", tc.add_clsact(LO), 24)
    golden = GOLDEN["clsact"]
    assert (handle, parent, info) == (golden["handle"], golden["parent"], golden["info"])


@pytest.mark.parametrize("classifier", list(tc.Classifier))
def test_a_rule_that_is_not_the_last_goes_on_with_the_next_filter(classifier: tc.Classifier) -> None:
    mirred = struct.Struct("=IIiiiiI")  # struct tc_mirred
    go_on = tc.add_filter(LO, 1, tc.ANY, [5, 6], classifier=classifier, last=False)
    stop = tc.add_filter(LO, 1, tc.ANY, [5, 6], classifier=classifier)
    assert mirred.pack(0, 0, -1, 0, 0, 2, 6) in go_on  # mirror, then TC_ACT_UNSPEC
    assert mirred.pack(0, 0, 4, 0, 0, 1, 6) in stop  # redirect, then TC_ACT_STOLEN
    assert mirred.pack(0, 0, 3, 0, 0, 2, 5) in go_on
    assert mirred.pack(0, 0, 3, 0, 0, 2, 5) in stop  # mirror, then the next action


def test_a_filter_has_targets_and_no_more_than_it_holds() -> None:
    with pytest.raises(ValueError, match="at least 1"):
        tc.add_filter(LO, 1, tc.ANY, [], classifier=U32)
    tc.add_filter(LO, 1, tc.ANY, [5] * tc.ACTIONS_MAX, classifier=U32)
    with pytest.raises(ValueError, match="at most 31"):
        tc.add_filter(LO, 1, tc.ANY, [5] * (tc.ACTIONS_MAX + 1), classifier=U32)
