"""The words of every directed pair of nodes as they change: wires and radios, from the start of the scenario on.

What a trace says of signal strengths is no word: it is :mod:`netlab.world.measured`'s business.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import permutations

from netlab.scenario.link_trace import TraceRow
from netlab.scenario.model import Scenario
from netlab.scenario.radio import Radio, TableWords
from netlab.scenario.words import Loss, Words

Hop = tuple[str, str]  # (sender, receiver), names of nodes


class RadioWords:
    """How each radio hears each other one. Starts with the rows of the trace up to time 0 applied."""

    def __init__(self, scenario: Scenario) -> None:
        radio = scenario.radio
        assert radio is not None
        #: Words of the pairs that nothing is said about; None means out of range.
        self.default = _default_words(radio)
        self._base = radio.pair_words
        self._words: dict[Hop, Words] = {}
        self._out_of_range: set[Hop] = set()
        default = radio.propagation.default
        if default is not None and default.path_loss_db is not None:
            for hop in permutations(scenario.radio_nodes, 2):
                self._words[hop] = _table_words(scenario, hop[0], default, self._base)
        for pair in radio.propagation.pairs:
            for hop in pair.directions:
                self._words[hop] = _table_words(scenario, hop[0], pair, self._base)
        self.later_rows: tuple[TraceRow, ...] = ()
        if radio.propagation.file is not None:
            for row in radio.propagation.file.rows:
                if row.has_strength:  # which says from then on whether it is heard at all
                    self._words.setdefault((row.sender, row.receiver), self.default or self._base)
            for row in radio.propagation.file.rows:
                if row.at_s <= 0 and row.has_words:
                    self.apply(row)
            self.later_rows = tuple(row for row in radio.propagation.file.rows if row.at_s > 0 and row.has_words)

    def special_hops(self) -> Iterator[Hop]:
        """The pairs that have words of their own or are out of range; all others are as ``default`` says."""
        yield from self._words
        yield from self._out_of_range - self._words.keys()

    def get(self, hop: Hop) -> Words | None:
        """The words of one pair now; None when it is out of range."""
        return None if hop in self._out_of_range else self._words.get(hop, self.default)

    def apply(self, row: TraceRow) -> None:
        """Let a row of the trace take effect."""
        hop = (row.sender, row.receiver)
        if row.loss_ratio == 1.0:
            self._out_of_range.add(hop)
        elif row.loss_ratio is not None:
            self._out_of_range.discard(hop)
        elif self.get(hop) is None:
            self._out_of_range.add(hop)
        self._words[hop] = _row_words(row).laid_over(self._words.get(hop, self.default or self._base))

    def change(self, hop: Hop, words: Words) -> None:
        """Lay ``words`` over a pair's; this puts it in range."""
        self._words[hop] = words.laid_over(self._words.get(hop, self.default or self._base))
        self._out_of_range.discard(hop)


class WireWords:
    """How each wire carries, per direction."""

    def __init__(self, scenario: Scenario) -> None:
        self._words: dict[Hop, Words] = {}
        for wire in scenario.wires():
            self._words[wire.a, wire.b] = wire.forward
            self._words[wire.b, wire.a] = wire.backward

    def get(self, hop: Hop) -> Words:
        """The words of one direction now."""
        return self._words[hop]

    def change(self, hop: Hop, words: Words) -> None:
        """Lay ``words`` over a direction's."""
        self._words[hop] = words.laid_over(self._words[hop])


def _default_words(radio: Radio) -> Words | None:
    if radio.propagation.model != "table":  # the others tell by signal strength who is in range
        return radio.pair_words
    default = radio.propagation.default
    return None if default is None else default.laid_over(radio.pair_words)


def _table_words(scenario: Scenario, sender: str, words: TableWords, base: Words) -> Words:
    """Words of a table laid over the radio's, a path loss as the strength that it leaves of the sender's power."""
    laid = words.laid_over(base)
    if words.path_loss_db is None:
        return laid
    return laid.model_copy(update={"rssi_dbm": scenario.radios(sender)[0].tx_power_dbm - words.path_loss_db})


def _row_words(row: TraceRow) -> Words:
    known: dict[str, object] = {"delay_s": row.delay_s, "rate_bps": row.rate_bps}
    if row.loss_ratio is not None and row.loss_ratio < 1.0:
        known["loss"] = Loss.model_construct(ratio=row.loss_ratio)
    return Words().model_copy(update={name: value for name, value in known.items() if value is not None})
