"""The judge: what it counts, how wide its bounds are, and that media which are wrong on purpose fail."""

from __future__ import annotations

import math
import random
from dataclasses import replace

import pytest
from agreement_rig import fates, judge, lab, mutants, page, references, through_medium, tracks, trial
from agreement_rig.cells import CELLS, Cell, Reach, scaled
from agreement_rig.judge import Figure, Kind, Verdict
from agreement_rig.mutants import MUTANTS, Mutant
from agreement_rig.tracks import Track

from netlab.medium.impairments import Distribution, Impairment, RandomLoss

PROMISED_FRAMES = 20_000
SEED = 11

LOSSY = Impairment(delay_s=0.005, loss=RandomLoss(0.05))
JITTERY = Impairment(delay_s=0.020, jitter_s=0.001, distribution=Distribution.NORMAL)


def track(*arrivals: tuple[int, float, bool], frames: int = 10) -> Track:
    """Arrivals as (number, delay_s, corrupted), of frames sent 1 ms apart."""
    made = Track(frames)
    for number, delay_s, corrupted in arrivals:
        made.add(number, number * 0.001, delay_s, corrupted)
    return made


def cell(*imps: Impairment, frames: int = 50_000, reach: Reach = Reach.WIRE) -> Cell:
    return Cell("a cell", (imps,), frames, reach)


def failures(must: Cell, actual: Cell) -> set[str]:
    """Figures that fail where a medium does ``actual`` and ``must`` was asked for."""
    observed = through_medium.run([actual], SEED)[0]
    found = trial.references_of(must)
    return {
        figure.name
        for phase in range(len(must.phases))
        for figure in judge.judge(must, phase, found[phase], {"medium": observed})
        if not figure.passed
    }


# -- counting ---------------------------------------------------------------------------------------------------------


def test_series_count_what_they_say() -> None:
    seen = track((0, 0.01, False), (1, 0.01, True), (1, 0.01, False), (4, 0.0, False), (9, 0.01, False))
    gone = tracks.lost(seen)
    assert list(gone) == [0, 0, 1, 1, 0, 1, 1, 1, 1, 0]
    assert list(tracks.copies(seen)) == [0, 1, 0, 0, 0, 0, 0, 0, 0, 0]
    assert list(tracks.corrupted(seen)) == [0, 1, 0, 0, 0, 0, 0, 0, 0, 0]
    assert list(tracks.at_once(seen)) == [0, 0, 0, 0, 1, 0, 0, 0, 0, 0]
    assert list(tracks.burst_starts(gone)) == [0, 0, 1, 0, 0, 1, 0, 0, 0, 0]
    assert list(tracks.single_losses(bytearray([0, 1, 0, 1, 1, 0, 1, 0]))) == [0, 1, 0, 0, 0, 0, 1, 0]


def test_the_first_frames_can_be_left_out() -> None:
    rest = track((0, 0.01, False), (3, 0.02, True)).without_first(2)
    assert (rest.frames, list(rest.numbers), list(rest.delays_s), list(rest.corrupted)) == (8, [1], [0.02], [1])


def test_neighbours_that_alternate_are_anticorrelated() -> None:
    assert tracks.lag_one(track(*((k, 0.01 + 0.001 * (k % 2), False) for k in range(10)))) == pytest.approx(-1)


def test_the_rate_is_counted_between_the_first_and_the_last_arrival() -> None:
    assert tracks.rate_bps(track((0, 0.01, False), (5, 0.01, False), (9, 0.011, False)), 1250) == pytest.approx(2e6)


@pytest.mark.parametrize("bit", range(0, 26 * 8, 7))
def test_one_flipped_bit_does_not_hide_a_frame_s_number(bit: int) -> None:
    _plan, (place,) = lab.build([cell(LOSSY)], 1)
    frame = place.frame(4711)
    flipped = bytearray(frame)
    flipped[bit // 8] ^= 1 << bit % 8
    assert lab.number_of(bytes(flipped)) == 4711
    assert bytes(flipped) != frame


# -- bounds -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("judged", CELLS, ids=lambda one: f"{one.name}, {one.reach.value}")
def test_every_bound_is_as_narrow_as_promised(judged: Cell) -> None:
    """20,000 frames at least; ratios within the 99 % interval of 20,000 frames, quantiles of delays within 0.2 ms."""
    frames = judged.frames - judged.skip
    assert frames >= PROMISED_FRAMES
    if references.needs_samples(judged):
        return  # bounds that come from samples: the command checks them when it has them
    for phase in range(len(judged.phases)):
        must = references.reference(judged, phase, [])
        for expected in must.figures.values():
            interval = judge.Z_99 * math.sqrt(expected.variance / PROMISED_FRAMES)
            assert judge.ERRORS * math.sqrt(expected.variance / frames) <= interval
        for delays in must.delays.values():
            widths = [judge.quantile_bounds(delays, share, int(0.85 * frames)) for share in judge.QUANTILES]
            assert max(map(max, widths)) <= judge.PROMISED_S


def test_a_sample_s_variance_knows_bursts() -> None:
    """Each value ten times over: the mean of n varies as that of n / 10."""
    rng = random.Random(SEED)
    bursty = [value for value in (float(rng.random() < 0.2) for _ in range(20_000)) for _ in range(10)]
    found = references.sampled([bursty])
    assert found.mean == pytest.approx(0.2, abs=0.02)
    assert found.variance == pytest.approx(2 * 10 * 0.2 * 0.8, rel=0.2)  # twice: the sample errs as much itself


def test_zero_is_zero_and_nothing_arrived_is_no_delay() -> None:
    assert not Verdict(0.0, 1e-6, 0.0).passed
    assert Verdict(0.0, 0.0, 0.0).passed
    silent = cell(replace(LOSSY, loss=RandomLoss(1.0)), frames=1000)
    assert failures(cell(replace(LOSSY, loss=None), frames=1000), silent) >= {"lost", "delay"}


# -- right and wrong media --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("imp", [LOSSY, JITTERY], ids=["loss", "jitter"])
def test_a_right_medium_passes(imp: Impairment) -> None:
    assert failures(cell(imp), cell(imp)) == set()


@pytest.mark.parametrize(
    ("must", "actual", "expected"),
    [
        (LOSSY, replace(LOSSY, loss=RandomLoss(0.06)), {"lost", "loss bursts", "single losses"}),
        (LOSSY, replace(LOSSY, loss=RandomLoss(0.04)), {"lost", "loss bursts", "single losses"}),
        (LOSSY, replace(LOSSY, delay_s=0.006), {"delay"}),
        (JITTERY, replace(JITTERY, delay_s=0.019), {"delay"}),
        (JITTERY, replace(JITTERY, jitter_s=0.00115), {"delay"}),
        (JITTERY, replace(JITTERY, distribution=Distribution.UNIFORM), {"delay"}),
        (JITTERY, replace(JITTERY, loss=RandomLoss(0.0002)), {"lost"}),
        (LOSSY, replace(LOSSY, duplicate_ratio=0.0002), {"copies"}),
        (LOSSY, replace(LOSSY, corrupt_ratio=0.0002), {"corrupted"}),
        (LOSSY, replace(LOSSY, loss=RandomLoss(0.066, correlation=0.1)), {"lost", "loss bursts", "single losses"}),
    ],
)
def test_a_wrong_impairment_fails_by_the_right_figure(must: Impairment, actual: Impairment, expected: set[str]) -> None:
    found = failures(cell(must), cell(actual))
    assert found
    assert found <= expected


def test_receivers_that_share_their_losses_fail() -> None:
    imps = (LOSSY,) * 3
    judged = cell(*imps, reach=Reach.BROADCAST)
    observed = through_medium.run([judged], SEED)[0]
    observed[0][1] = observed[0][0]
    (must,) = trial.references_of(judged)
    figures = judge.judge(judged, 0, must, {"medium": observed})
    assert {figure.receiver for figure in figures if not figure.passed} == {"1+2"}


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda mutant: mutant.name)
@pytest.mark.parametrize("index", [2, 8, 11], ids=lambda index: CELLS[index].name)
def test_media_that_are_wrong_on_purpose_fail(mutant: Mutant, index: int) -> None:
    judged = CELLS[index]
    if not mutant.fits(judged, 0):
        pytest.skip("this cell cannot show this error")
    result = trial.try_mutant(mutant, [judged], [trial.references_of(judged)])
    assert (result.tried, result.missed) == (1, [])


def test_a_judge_that_sees_too_little_is_told_so() -> None:
    """A hundred frames cannot tell 1 % of loss: the trial must say that it missed it."""
    short = scaled(CELLS[8], 100)
    result = trial.try_mutant(mutants.MUTANTS[0], [short], [trial.references_of(short)])
    assert result.missed == [f"{short.name}, phase 1"]


# -- frame by frame ---------------------------------------------------------------------------------------------------


def test_fates_are_compared_frame_by_frame() -> None:
    one = [[[track((0, 0.01, False), (1, 0.01, False), (1, 0.02, True), (3, 0.01, False))]]]
    other = [[[track((0, 0.011, False), (1, 0.02, True), (1, 0.01, False), (4, 0.01, False))]]]
    assert fates.compare(one, one) == fates.Fates(10, 0, 0.0)
    found = fates.compare(one, other)
    assert (found.receptions, found.differing) == (10, 2)
    assert found.delay_s == pytest.approx(0.001)


def test_the_same_seed_decides_alike_whatever_else_is_in_the_lab() -> None:
    cells = [scaled(one, 500) for one in CELLS[:12]]
    sending = through_medium.regular(cells)
    assert fates.compare(through_medium.run(cells, 5, sending), through_medium.run(cells, 5, sending)).differing == 0
    assert fates.compare(through_medium.run(cells, 5, sending), through_medium.run(cells, 6, sending)).differing > 0


# -- the page ---------------------------------------------------------------------------------------------------------


def outcome(value: float) -> trial.Outcome:
    verdicts = {name: Verdict(0.05, value, 0.004, 0.001) for name in page.CANDIDATES}
    figure = Figure(0, "lost", "", Kind.RATIO, True, verdicts)
    return trial.Outcome([trial.CellResult(cell(LOSSY), [figure])], [], fates.Fates(10, 0, 0.0))


def test_the_page_says_what_was_found() -> None:
    good, bad = page.page(outcome(0.051), "6.1", 7), page.page(outcome(0.06), "6.1", 7)
    assert "**They agree**" in good
    assert "| 5.000 % | 5.100 % | 5.100 % | 5.100 % | ± 0.400 % | agrees |" in good
    assert "**They do not agree**" in bad
    assert "* a cell, phase 1: lost  of netem is 0.06, must be 0.05 +- 0.004" in bad
    assert "| FAILS |" in bad


def test_a_bound_that_is_wider_than_promised_is_a_failure() -> None:
    verdicts = {"medium": Verdict(0.02, 0.02, 0.0001)}
    figure = Figure(0, "delay", "", Kind.DELAY, False, verdicts, {"medium": 0.5}, (0.02, 0.02, 0.02), 0.00021)
    found = trial.Outcome([trial.CellResult(cell(JITTERY), [figure])], [], None).failures
    assert found == ["a cell, phase 1: a quantile of the delay is bound by 0.210 ms, more than the 0.2 ms promised"]


def test_air_that_differs_from_the_medium_is_a_failure() -> None:
    fine = outcome(0.05)
    assert not fine.failures
    assert replace(fine, same=fates.Fates(10, 1, 0.0)).failures
    assert replace(fine, same=fates.Fates(10, 0, 0.001)).failures
