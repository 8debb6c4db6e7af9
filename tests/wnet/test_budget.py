"""The share of the channel that one node's HELLOs and TCs may take."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from wnet.core.budget import Budget

SHARE, RESERVE_S, CREDIT_S = 0.02, 5.0, 10.0
airtimes_s = st.floats(1e-5, 0.01)
frames = st.lists(st.tuples(st.booleans(), airtimes_s, st.floats(0.0, 5.0)), max_size=60)


@given(frames, st.integers(1, 100))
def test_who_leaves_a_reserve_never_keeps_others_from_sending_it(frames, nodes: int) -> None:
    budget, now = Budget(SHARE, now=0.0), 0.0
    budget.divide(nodes)
    reserve_s = RESERVE_S * SHARE / nodes
    for is_search, airtime_s, pause_s in frames:
        now += pause_s
        if not is_search:
            budget.spend(airtime_s, now=now)
        elif budget.wait_s(airtime_s, now=now, reserve_s=RESERVE_S) == 0.0:
            budget.spend(airtime_s, now=now)
            assert budget.wait_s(reserve_s * (1 - 1e-9), now=now) == 0.0


@given(st.integers(1, 100), airtimes_s)
def test_the_wait_for_a_frame_with_a_reserve_is_long_enough(nodes: int, airtime_s: float) -> None:
    budget = Budget(SHARE, now=0.0)
    budget.divide(nodes)
    budget.spend(1.0, now=0.0)
    wait_s = budget.wait_s(airtime_s, now=0.0, reserve_s=RESERVE_S)
    part = SHARE / nodes
    assert wait_s == pytest.approx((budget.debt_wait_s * part + airtime_s) / part + RESERVE_S)
    if airtime_s / part + RESERVE_S < 14.0:  # more than can be saved in 15 s is never affordable
        assert budget.wait_s(airtime_s, now=wait_s + 1e-6, reserve_s=RESERVE_S) == 0.0


@given(frames, st.integers(1, 100))
def test_what_is_sent_on_credit_owes_no_more_than_that_and_is_paid_back_in_that_time(frames, nodes: int) -> None:
    budget, now = Budget(SHARE, now=0.0), 0.0
    budget.divide(nodes)
    for is_on_credit, airtime_s, pause_s in frames:
        now += pause_s
        if budget.wait_s(airtime_s, now=now, reserve_s=-CREDIT_S if is_on_credit else 0.0) == 0.0:
            budget.spend(airtime_s, now=now)
    assert budget.debt_wait_s <= CREDIT_S * (1 + 1e-9)
