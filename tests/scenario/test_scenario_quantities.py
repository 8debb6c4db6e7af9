"""Units: meanings of tc's words, what is refused and how, and that formatting reads back."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from netlab.scenario.quantities import (
    DURATION,
    FREQUENCY,
    LENGTH,
    POWER,
    RATE,
    RATIO,
    SIZE,
    SPEED,
    Dimension,
    Quantity,
)


@pytest.mark.parametrize(
    ("dimension", "text", "value"),
    [
        (DURATION, "20ms", 0.02),
        (DURATION, "1.1ms", 0.0011),
        (DURATION, "250us", 0.00025),
        (DURATION, "1 s", 1.0),
        (DURATION, "2min", 120.0),
        (DURATION, "1h", 3600.0),
        (DURATION, "3msecs", 0.003),
        (RATE, "10mbit", 10e6),
        (RATE, "10Mbit", 10e6),
        (RATE, "10Mbit/s", 10e6),
        (RATE, "1kibit", 1024.0),
        (RATE, "0.5gbit", 0.5e9),
        (SIZE, "200B", 200.0),
        (SIZE, "200kB", 200_000.0),
        (SIZE, "64KiB", 65_536.0),
        (RATIO, "2%", 0.02),
        (RATIO, "100%", 1.0),
        (FREQUENCY, "0.2Hz", 0.2),
        (FREQUENCY, "2437MHz", 2.437e9),
        (POWER, "-95dBm", -95.0),
        (SPEED, "1.5m/s", 1.5),
        (SPEED, "36km/h", 10.0),
        (LENGTH, "4m", 4.0),
    ],
)
def test_a_quantity_means_what_tc_and_si_say(dimension: Dimension, text: str, value: float) -> None:
    assert dimension.parse(text) == value


@pytest.mark.parametrize(
    ("dimension", "value", "complaint"),
    [
        (DURATION, 20, "20 has no unit; write a duration like 20ms (units: us, ms, s)"),
        (DURATION, "20", "20 has no unit"),
        (DURATION, 0, "0 has no unit"),
        (DURATION, "20parsec", "'20parsec' has an unknown unit 'parsec'"),
        (DURATION, "5m", "'m' could be minutes or milliseconds"),
        (DURATION, "soon", "'soon' is not a duration"),
        (DURATION, "", "is not a duration"),
        (DURATION, True, "expected a duration, found true"),
        (DURATION, ["1s"], "expected a duration, found a list"),
        (RATE, 10, "10 has no unit; write a rate like 10mbit (units: bit, kbit, mbit, gbit)"),
        (RATE, "10mbps", "'bps' words mean bytes per second to tc"),
        (SIZE, "200kb", "unknown unit 'kb'"),
        (RATIO, 0.05, "0.05 has no unit; write a percentage like 2% (units: %)"),
        (DURATION, "1e999999999s", "unknown unit 'e999999999s'"),
        (SIZE, f"{'9' * 400}B", "is impossible"),
        (POWER, "-95dB", "unknown unit 'dB'"),
    ],
)
def test_a_wrong_quantity_is_refused_with_what_fits(dimension: Dimension, value: object, complaint: str) -> None:
    with pytest.raises(ValueError) as caught:  # noqa: PT011 - the text is what matters and is checked
        dimension.parse(value)
    assert complaint in str(caught.value)


@pytest.mark.parametrize(
    ("quantity", "text", "complaint"),
    [
        (Quantity(DURATION), "-1ms", "'-1ms' is impossible; it must be zero or more"),
        (Quantity(RATE, above_minimum=True), "0mbit", "must be above zero"),
        (Quantity(RATIO, maximum=1.0), "101%", "'101%' is impossible; the most is 100%"),
        (Quantity(SIZE, minimum=18), "2B", "must be at least 18B"),
    ],
)
def test_impossible_values_are_refused(quantity: Quantity, text: str, complaint: str) -> None:
    with pytest.raises(ValueError, match="impossible") as caught:
        quantity.parse(text)
    assert complaint in str(caught.value)


_DIMENSIONS = st.sampled_from([DURATION, RATE, SIZE, RATIO, FREQUENCY, POWER, SPEED, LENGTH])


@given(_DIMENSIONS, st.floats(min_value=-1e15, max_value=1e15, allow_subnormal=False))
def test_formatting_reads_back_to_the_same_number(dimension: Dimension, value: float) -> None:
    assert dimension.parse(dimension.format(value)) == value


@given(_DIMENSIONS, st.decimals(min_value=0, max_value=10**6, places=3), st.data())
def test_every_unit_scales_by_its_factor(dimension: Dimension, number: object, data: st.DataObject) -> None:
    unit = data.draw(st.sampled_from(sorted(dimension.units)))
    assert dimension.parse(f"{number}{unit}") == pytest.approx(float(str(number)) * float(dimension.units[unit]))


@given(_DIMENSIONS, st.one_of(st.text(), st.integers(), st.floats(), st.booleans(), st.none()))
def test_anything_else_is_refused_and_never_crashes(dimension: Dimension, value: object) -> None:
    try:
        result = dimension.parse(value)
    except ValueError:
        return
    assert isinstance(value, str)
    assert isinstance(result, float)
