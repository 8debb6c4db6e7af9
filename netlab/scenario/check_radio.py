"""Cross-reference check of the words that 802.11 radios lack, and of those that they alone have."""

from __future__ import annotations

from collections.abc import Iterator

from netlab.scenario.document import Path
from netlab.scenario.model import Scenario
from netlab.scenario.problems import Problem
from netlab.scenario.words import Words

#: 802.11 has no such thing between two radios: a damaged frame fails its checksum and is lost, a second copy is
#: dropped, frames of one sender stay in order.
WORDS_NOT_FOR_WIFI = ("duplicate", "reorder", "corrupt")
_RSSI_BELONGS = "rssi belongs to 802.11 radios (radio: driver: hwsim); remove it"


def check_radio(scenario: Scenario) -> Iterator[Problem]:
    """Yield every word that what it speaks of cannot obey."""
    wifi = scenario.radio is not None and scenario.radio.driver == "hwsim"
    for index, link in enumerate(scenario.links):
        yield from _complaints(link, ("links", index), wifi=False)
    if scenario.radio is not None:
        propagation = scenario.radio.propagation
        if wifi:  # else the radio's own validator has spoken of its rssi
            yield from _complaints(scenario.radio, ("radio",), wifi=True)
        for index, pair in enumerate(propagation.pairs):
            yield from _complaints(pair, ("radio", "propagation", "pairs", index), wifi=wifi)
        if propagation.default is not None:
            yield from _complaints(propagation.default, ("radio", "propagation", "default"), wifi=wifi)
    for index, event in enumerate(scenario.events):
        change = event.link
        if change is not None and all(name in scenario.nodes for name in change.ends):
            over = change.over or next(iter(scenario.joined(*change.ends)), None)
            yield from _complaints(change, ("events", index, "link"), wifi=wifi and over == "radio")


def _complaints(words: Words, path: Path, *, wifi: bool) -> Iterator[Problem]:
    given = words.given()
    if wifi:
        for word in WORDS_NOT_FOR_WIFI:
            if word in given:
                yield (*path, word), f"{word} has no meaning between 802.11 radios (driver: hwsim); use loss or jitter"
    elif "rssi_dbm" in given:
        yield (*path, "rssi"), _RSSI_BELONGS
