"""Cross-reference check of the words that some radios lack, and of those that they alone have."""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum

from netlab.scenario.document import Path
from netlab.scenario.model import Scenario
from netlab.scenario.problems import Problem
from netlab.scenario.radio import HWSIM_CHANNELS_MHZ, Radio
from netlab.scenario.radio_physics import RadioEnds, RadioSettings, wrong_rate
from netlab.scenario.words import Words

#: 802.11 has no such thing between two radios: a damaged frame fails its checksum and is lost, a second copy is
#: dropped, frames of one sender stay in order.
WORDS_NOT_FOR_WIFI = ("duplicate", "reorder", "corrupt")
#: Words of a pair that are a station's own where all share one channel.
WORDS_NOT_FOR_CHANNEL = {"rate_bps": "rate", "limit": "limit"}
_RSSI_BELONGS = "rssi belongs to 802.11 radios (radio: phy, or driver: hwsim); remove it"

#: Each has a subnet of its own, from 10.200.0.0/16 to below the meshes' 10.240.0.0/16.
MOST_CHANNELS = 40
_NO_HWSIM_CHANNEL = (
    "is not the centre of a channel that may be used here; use 2412MHz to 2462MHz in steps of 5MHz, "
    "5180, 5200, 5220 or 5240MHz, or 5745MHz to 5825MHz in steps of 20MHz"
)


def check_radio(scenario: Scenario) -> Iterator[Problem]:
    """Yield every word that what it speaks of cannot obey."""
    kind = _kind(scenario)
    yield from _waves(scenario)
    for index, link in enumerate(scenario.links):
        yield from _complaints(link, ("links", index), _Kind.PLAIN)
    if scenario.radio is not None:
        propagation = scenario.radio.propagation
        if kind is _Kind.WIFI:  # else the radio's own validator has spoken of its rssi
            yield from _complaints(scenario.radio, ("radio",), kind)
        for index, pair in enumerate(propagation.pairs):
            yield from _complaints(pair, ("radio", "propagation", "pairs", index), kind)
        if propagation.default is not None:
            yield from _complaints(propagation.default, ("radio", "propagation", "default"), kind)
    for index, event in enumerate(scenario.events):
        change = event.link
        if change is not None and all(name in scenario.nodes for name in change.ends):
            over = change.over or next(iter(scenario.joined(*change.ends)), None)
            yield from _complaints(change, ("events", index, "link"), kind if over == "radio" else _Kind.PLAIN)
            if over == "radio" and change.rssi_dbm is not None and (source := _strengths(scenario)):
                yield ("events", index, "link", "rssi"), f"rssi is what {source} says; remove it"


def _strengths(scenario: Scenario) -> str | None:
    """What says all along how strongly radios hear each other, if anything does."""
    propagation = None if scenario.radio is None else scenario.radio.propagation
    if propagation is None or (propagation.physics is None and not propagation.strengths_change):
        return None
    return propagation.file.name if propagation.file is not None else f"propagation model {propagation.model}"


def _waves(scenario: Scenario) -> Iterator[Problem]:
    """What radios say of power, frequency and antennas, where it has a meaning."""
    radio = scenario.radio
    physics = None if radio is None else radio.propagation.physics
    if radio is not None and radio.driver == "hwsim" and (radio.frequency_hz or 2412e6) / 1e6 not in HWSIM_CHANNELS_MHZ:
        yield ("radio", "frequency"), f"{radio.hwsim_frequency_mhz}MHz {_NO_HWSIM_CHANNEL}"
    if radio is not None and physics is not None and physics.needs_terrain and scenario.terrain is None:
        what = f"model {radio.propagation.model} is about tunnels, and there are none"
        yield ("radio", "propagation", "model"), f"{what}; add terrain, or use log_distance"
    if radio is not None and physics is not None and not physics.knows_materials and scenario.terrain is not None:
        for index, tunnel in enumerate(scenario.terrain.tunnels):
            if tunnel.material is not None:
                what = f"propagation model {radio.propagation.model} does not know what tunnels are made of"
                yield ("terrain", "tunnels", index, "material"), f"{what}; use model: tunnel, or remove material"
    for name, node in scenario.nodes.items():
        if isinstance(node.radio, tuple) and physics is None and not _only_power(radio, node.radio):
            what = "a radio of its own means nothing here" if radio is not None else "there is no radio"
            yield ("nodes", name, "radio"), f"{what}; give radio: a propagation model that goes by positions"
    if physics is not None:
        yield from _channels(scenario)


def _only_power(radio: Radio | None, own: tuple[RadioEnds, ...]) -> bool:
    """Whether a node's radio differs by its power alone, and the table's path losses give that a meaning."""
    if radio is None or not radio.propagation.has_path_losses:
        return False
    return len(own) == 1 and own[0].model_fields_set <= {"tx_power_dbm"}


def _channels(scenario: Scenario) -> Iterator[Problem]:
    """What radios on one frequency do not have in common, and nodes that would be on one twice."""
    first: dict[float, tuple[str, RadioSettings]] = {}
    for name in scenario.radio_nodes:
        seen: set[float] = set()
        for place, radio in enumerate(scenario.radios(name)):
            path: Path = (
                ("nodes", name, "radio") if len(scenario.radios(name)) == 1 else ("nodes", name, "radio", place)
            )
            complaint = wrong_rate(radio.phy, radio.rate_bps) if radio.phy and radio.rate_bps else None
            if complaint is not None:
                yield path, complaint
            other, settings = first.setdefault(radio.frequency_hz, (name, radio))
            if settings.channel != radio.channel:
                what = f"'{other}' has another phy, rate or noise on {radio.frequency_hz / 1e6:g}MHz"
                yield path, f"{what}; radios on one frequency share a channel: make them equal, or change the frequency"
            if radio.frequency_hz in seen and scenario.meshes[name] is None:
                yield path, "two radios of one node on one frequency need a mesh to tell them apart; add mesh: flood"
            seen.add(radio.frequency_hz)
    if len(first) > MOST_CHANNELS:
        yield ("radio",), f"there are {len(first)} frequencies; the most is {MOST_CHANNELS}"


class _Kind(Enum):
    PLAIN = "a wire, or a radio without airtime"
    CHANNEL = "a radio with a phy"
    WIFI = "a real 802.11 interface"


def _kind(scenario: Scenario) -> _Kind:
    radio = scenario.radio
    if radio is None or radio.driver == "hwsim":
        return _Kind.PLAIN if radio is None else _Kind.WIFI
    return _Kind.PLAIN if radio.phy is None else _Kind.CHANNEL


def _complaints(words: Words, path: Path, kind: _Kind) -> Iterator[Problem]:
    given = words.given()
    if kind is _Kind.WIFI:
        for word in WORDS_NOT_FOR_WIFI:
            if word in given:
                yield (*path, word), f"{word} has no meaning between 802.11 radios (driver: hwsim); use loss or jitter"
    elif kind is _Kind.CHANNEL:
        for name, word in WORDS_NOT_FOR_CHANNEL.items():
            if name in given:
                yield (*path, word), f"{word} of a pair has no meaning where radios share a channel; set it in radio"
    elif "rssi_dbm" in given:
        yield (*path, "rssi"), _RSSI_BELONGS
