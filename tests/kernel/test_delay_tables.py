"""Delay tables: within one unit of those that tc ships; the uniform one behaves like netem without a table."""

import array
import itertools
import json
import statistics
from pathlib import Path

import pytest

from netlab.kernel.delay_tables import delay_table
from netlab.medium.impairments import Distribution

GOLDEN = json.loads((Path(__file__).parents[1] / "data/netem/tc.json").read_text())["cases"]
QOPT_AND_ATTRIBUTE_BYTES = 24 + 4


def values(table: bytes) -> list[int]:
    return array.array("h", table).tolist()


@pytest.mark.parametrize("distribution", [Distribution.NORMAL, Distribution.PARETO, Distribution.PARETONORMAL])
def test_table_equals_the_one_that_tc_sends_within_one_unit(distribution: Distribution) -> None:
    sent_by_tc = values(bytes.fromhex(GOLDEN[distribution.value]["options"])[QOPT_AND_ATTRIBUTE_BYTES:])
    ours = values(delay_table(distribution))
    assert len(ours) == len(sent_by_tc) == 4096
    assert max(abs(a - b) for a, b in zip(ours, sent_by_tc, strict=True)) <= 1


def test_uniform_table_is_a_straight_line_of_mean_zero() -> None:
    line = values(delay_table(Distribution.UNIFORM))
    assert sum(line) == 0
    assert {b - a for a, b in itertools.pairwise(line)} == {4}
    assert (line[0], line[-1]) == (-8190, 8190)  # plus and minus one jitter is 8192


def test_normal_table_has_the_deviation_of_one_jitter() -> None:
    table = values(delay_table(Distribution.NORMAL))
    assert statistics.pstdev(table) == pytest.approx(8192, rel=0.01)
    assert statistics.fmean(table) == pytest.approx(0, abs=10)


@pytest.mark.parametrize("distribution", list(Distribution))
def test_tables_are_inverse_distributions(distribution: Distribution) -> None:
    table = values(delay_table(distribution))
    assert table == sorted(table)
