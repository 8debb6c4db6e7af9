"""Motion files of other programs, in the words of their manuals."""

from __future__ import annotations

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from netlab.world.choreography import Choreography
from netlab.world.imports import TraceFormat, TraceProblems, read_motion

# The shape of a file of ns-2's `setdest` generator: initial places, distances for god, orders.
NS2 = """
# nodes: 2, pause: 1.00, max speed: 5.00  max x = 200.00, max y = 100.00
$node_(0) set X_ 10.0
$node_(0) set Y_ 20.0
$node_(0) set Z_ 0.000000000000
$node_(1) set X_ 0.0
$node_(1) set Y_ 0.0
$node_(1) set Z_ 0.0
$god_ set-dist 0 1 2
$ns_ at 2.0 "$node_(0) setdest 10.0 40.0 5.0"
$ns_ at 4.0 "$node_(0) setdest 30.0 30.0 10.0"
$ns_ at 3.5 "$god_ set-dist 0 1 1"
$ns_ at 1.0 "$node_(1) setdest 3.0 4.0 1.0"
"""


def position(text: str, trace_format: TraceFormat, name: str, at_s: float) -> tuple[float, ...]:
    return Choreography(read_motion(text, trace_format), (), None).track(name).at(at_s).position_m


def test_setdest_starts_at_its_time_and_is_interrupted_by_the_next() -> None:
    assert position(NS2, TraceFormat.NS2, "0", 1.9) == (10, 20, 0)
    assert position(NS2, TraceFormat.NS2, "0", 3.0) == pytest.approx((10, 25, 0))
    assert position(NS2, TraceFormat.NS2, "0", 4.0) == pytest.approx((10, 30, 0))  # not yet at 40
    assert position(NS2, TraceFormat.NS2, "0", 5.0) == pytest.approx((20, 30, 0))
    assert position(NS2, TraceFormat.NS2, "0", 60.0) == pytest.approx((30, 30, 0))
    assert position(NS2, TraceFormat.NS2, "1", 6.0) == pytest.approx((3, 4, 0))
    assert position(NS2, TraceFormat.NS2, "1", 3.5) == pytest.approx((1.5, 2, 0))


def test_bonnmotion_has_a_line_per_node() -> None:
    text = "0.0 5.0 5.0 10.0 25.0 5.0\n0.0 1.0 1.0\n"
    assert position(text, TraceFormat.BONNMOTION, "0", 5.0) == pytest.approx((15, 5, 0))
    assert position(text, TraceFormat.BONNMOTION, "1", 5.0) == (1, 1, 0)


def test_bonnmotion_of_three_dimensions() -> None:
    text = "0.0 5.0 5.0 1.0 10.0 25.0 5.0 3.0 20.0 25.0 5.0 3.0"
    assert position(text, TraceFormat.BONNMOTION_3D, "0", 5.0) == pytest.approx((15, 5, 2))


def test_csv_names_nodes() -> None:
    text = "# from the survey\nat_s,node,x,y\n0,husky,0,0\n0, beacon ,7,7\n10,husky,20,0\n"
    assert position(text, TraceFormat.CSV, "husky", 5.0) == (10, 0, 0)
    assert position(text, TraceFormat.CSV, "beacon", 5.0) == (7, 7, 0)


@pytest.mark.parametrize(
    ("trace_format", "text", "problem"),
    [
        (TraceFormat.NS2, "$node_(0) set X_ 1.0\n$ns_ at 1.0 node walk", "^2: neither `"),
        (TraceFormat.NS2, "$node_(0) set X_ 1.0.0", "^1: '1.0.0' is not a number"),
        (TraceFormat.BONNMOTION, "0 1 2\n0 1 2 3 4", "^2: expected `t x y` again"),
        (TraceFormat.BONNMOTION, "5 1 2 4 1 2", "^1: expected `t x y` again"),
        (TraceFormat.BONNMOTION, "0 1 nan", "^1: 'nan' is impossible"),
        (TraceFormat.CSV, "at_s,who,x,y\n", "^1: the columns must be at_s,node,x,y or"),
        (TraceFormat.CSV, "at_s,node,x,y\n0,a,1\n", "^2: 3 cells; there must be 4"),
        (TraceFormat.CSV, "at_s,node,x,y\n2,a,1,1\n1,a,1,1\n", "^3: 1 s is before the row above of 'a'"),
        (TraceFormat.CSV, "at_s,node,x,y\n0,a,here,1\n", "^2: 'here' is not a number"),
    ],
)
def test_wrong_lines_are_named(trace_format: TraceFormat, text: str, problem: str) -> None:
    with pytest.raises(TraceProblems, match=problem):
        read_motion(text, trace_format)


@given(st.text(max_size=200), st.sampled_from(TraceFormat))
def test_no_text_breaks_the_readers(text: str, trace_format: TraceFormat) -> None:
    with contextlib.suppress(TraceProblems):
        assert isinstance(read_motion(text, trace_format), dict)
