"""The whole impairment as netem options: attribute by attribute the bytes that tc sends, and complete."""

import json
import struct
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from netlab.kernel import tc
from netlab.kernel.netem import inexpressible, narrow_limit, netem_options
from netlab.kernel.netlink import attributes
from netlab.medium.impairments import (
    PERFECT,
    Distribution,
    FourStateLoss,
    GilbertElliottLoss,
    Impairment,
    PeriodicLoss,
    RandomLoss,
    TraceLoss,
)

GOLDEN = json.loads((Path(__file__).parents[1] / "data/netem/tc.json").read_text())["cases"]

CORR, DELAY_DIST, REORDER, CORRUPT, LOSS, RATE, RATE64, LATENCY64, JITTER64, PRNG_SEED = 1, 2, 3, 4, 5, 6, 8, 10, 11, 14
QOPT_BYTES = 24
TC_OPTIONS = 2
TC_ATTRIBUTES = 16 + 20  # netlink header, struct tcmsg

CASES = {
    "plain": Impairment(),
    "delay": Impairment(delay_s=0.02),
    "jitter_corr": Impairment(delay_s=0.02, jitter_s=0.002, delay_correlation=0.25),
    "loss_random": Impairment(loss=RandomLoss(0.01)),
    "loss_corr": Impairment(loss=RandomLoss(0.1, 0.3)),
    "loss_ge": Impairment(loss=GilbertElliottLoss(0.01, 0.25)),
    "loss_ge4": Impairment(loss=GilbertElliottLoss(0.01, 0.25, 0.8, 0.005)),
    "loss_state": Impairment(loss=FourStateLoss(p13=0.01, p31=0.2, p32=0.3, p23=0.4, p14=0.001)),
    "duplicate": Impairment(duplicate_ratio=0.01, duplicate_correlation=0.5),
    "reorder": Impairment(delay_s=0.01, reorder_ratio=0.25, reorder_correlation=0.5, reorder_gap=5),
    "corrupt": Impairment(corrupt_ratio=0.001, corrupt_correlation=0.1),
    "rate": Impairment(rate_bps=10e6, limit_packets=50),
    "rate64": Impairment(rate_bps=40e9, limit_packets=5000),
    "all": Impairment(
        limit_packets=500,
        delay_s=0.015,
        jitter_s=0.003,
        delay_correlation=0.1,
        loss=GilbertElliottLoss(0.02, 0.3),
        duplicate_ratio=0.005,
        duplicate_correlation=0.05,
        reorder_ratio=0.03,
        reorder_correlation=0.04,
        reorder_gap=2,
        corrupt_ratio=0.002,
        corrupt_correlation=0.06,
        rate_bps=2e6,
    ),
    "change": Impairment(delay_s=0.005, loss=RandomLoss(1.0)),
}


def options_of(message: bytes) -> bytes:
    return attributes(message, TC_ATTRIBUTES)[TC_OPTIONS]


def ours(impairment: Impairment, *, replace_table: bool = False) -> tuple[bytes, dict[int, bytes]]:
    options = options_of(tc.change_netem(7, impairment, seed=99, replace_table=replace_table))
    return options[:QOPT_BYTES], attributes(options, QOPT_BYTES)


@pytest.mark.parametrize("name", CASES)
def test_every_attribute_that_tc_sends_has_the_same_bytes(name: str) -> None:
    golden = bytes.fromhex(GOLDEN[name]["options"])
    fixed, attrs = ours(CASES[name])
    assert fixed == golden[:QOPT_BYTES], GOLDEN[name]["command"]
    for kind, payload in attributes(golden, QOPT_BYTES).items():
        assert attrs[kind] == payload, (GOLDEN[name]["command"], kind)


@pytest.mark.parametrize("name", CASES)
def test_attributes_that_tc_leaves_out_are_zero_so_that_a_change_clears_them(name: str) -> None:
    _, attrs = ours(CASES[name])
    sent_by_tc = attributes(bytes.fromhex(GOLDEN[name]["options"]), QOPT_BYTES)
    assert {CORR, REORDER, CORRUPT, RATE, LATENCY64, JITTER64, PRNG_SEED} <= attrs.keys()
    if name == "duplicate":  # tc forgets the correlation when only duplication has one
        sent_by_tc[CORR] = attrs[CORR]
    for kind in {CORR, REORDER, CORRUPT, RATE} - sent_by_tc.keys():
        assert not any(attrs[kind])


def test_header_is_the_one_that_tc_sends() -> None:
    for name, message in (
        ("delay", tc.add_netem(7, CASES["delay"], seed=1)),
        ("change", tc.change_netem(7, CASES["change"], seed=1, replace_table=False)),
    ):
        index, handle, parent, info = struct.unpack_from("=iIII", message, 20)
        golden = GOLDEN[name]
        assert (index, handle, parent, info) == (7, golden["handle"], golden["parent"], golden["info"])
    flags = [struct.unpack_from("=IHH", message)[2] for message in (tc.add_netem(7, PERFECT, seed=1),)]
    assert flags == [0x1 | 0x400 | 0x200]  # request, create, exclusive


def test_times_are_exact_to_the_nanosecond_and_long_ones_are_not_cut() -> None:
    fixed, attrs = ours(Impairment(delay_s=0.000_000_123, jitter_s=400.0))
    assert struct.unpack("=q", attrs[LATENCY64]) == (123,)
    assert struct.unpack("=q", attrs[JITTER64]) == (400_000_000_000,)
    assert struct.unpack("=6I", fixed)[0] == 123 // 64  # ticks
    assert struct.unpack("=6I", fixed)[5] == 0xFFFFFFFF  # saturated


def test_seed_is_the_kernel_headers_attribute_fourteen() -> None:
    options = options_of(tc.add_netem(7, PERFECT, seed=0x0123456789ABCDEF))
    assert struct.pack("=HHQ", 12, PRNG_SEED, 0x0123456789ABCDEF) in options


def test_a_correlation_of_duplication_alone_is_sent() -> None:
    _, attrs = ours(Impairment(duplicate_ratio=0.01, duplicate_correlation=0.5))
    assert struct.unpack("=3I", attrs[CORR]) == (0, 0, 0x80000000)


def test_no_limit_is_a_huge_limit() -> None:
    fixed, _ = ours(Impairment(limit_packets=None))
    assert struct.unpack("=6I", fixed)[1] == 0x7FFFFFFF


def test_gap_without_reordering_is_not_sent() -> None:
    # The kernel would take it for "all of every gap-th frame".
    fixed, _ = ours(Impairment(delay_s=0.01, reorder_gap=5))
    assert struct.unpack("=6I", fixed)[3] == 0


def test_table_is_sent_for_a_distribution_and_replaced_when_it_becomes_uniform() -> None:
    normal = Impairment(delay_s=0.02, jitter_s=0.002, distribution=Distribution.NORMAL)
    uniform = Impairment(delay_s=0.02, jitter_s=0.002)
    assert len(ours(normal)[1][DELAY_DIST]) == 8192
    assert DELAY_DIST not in ours(uniform)[1]
    replaced = ours(uniform, replace_table=True)[1][DELAY_DIST]
    assert len(replaced) == 8192
    assert replaced != ours(normal)[1][DELAY_DIST]
    assert DELAY_DIST not in ours(Impairment(delay_s=0.02), replace_table=True)[1]  # no jitter: it is not looked at


@pytest.mark.parametrize(
    ("impairment", "what"),
    [
        (Impairment(loss=PeriodicLoss(3)), "periodic"),
        (Impairment(loss=TraceLoss((True, False))), "trace"),
        (Impairment(limit_bytes=64_000), "bytes"),
    ],
)
def test_what_netem_cannot_do_is_named_and_refused(impairment: Impairment, what: str) -> None:
    assert what in (inexpressible(impairment) or "")
    with pytest.raises(ValueError, match=what):
        netem_options(impairment, seed=1, replace_table=False)


@pytest.mark.parametrize("name", CASES)
def test_all_other_impairments_are_expressible(name: str) -> None:
    assert inexpressible(CASES[name]) is None


def test_a_limit_below_rate_times_delay_is_pointed_out() -> None:
    # 100 Mbit/s x 200 ms = 2.5 MB = 1652 frames of 1514 bytes
    assert "1651" in (narrow_limit(Impairment(rate_bps=100e6, delay_s=0.2)) or "")
    assert narrow_limit(Impairment(rate_bps=100e6, delay_s=0.2, limit_packets=1700)) is None
    assert narrow_limit(Impairment(delay_s=0.2, limit_packets=1)) is None


RATIO = st.floats(0, 1)
IMPAIRMENTS = st.builds(
    Impairment,
    delay_s=st.floats(0, 10),
    jitter_s=st.floats(0, 1),
    delay_correlation=RATIO,
    distribution=st.sampled_from(Distribution),
    loss=st.none()
    | st.builds(RandomLoss, RATIO, RATIO)
    | st.builds(GilbertElliottLoss, RATIO, RATIO, RATIO, RATIO)
    | st.builds(FourStateLoss, RATIO, RATIO, RATIO, RATIO, RATIO),
    duplicate_ratio=RATIO,
    reorder_ratio=RATIO,
    reorder_gap=st.integers(1, 100),
    corrupt_ratio=RATIO,
    rate_bps=st.none() | st.floats(1, 1e12),
    limit_packets=st.none() | st.integers(0, 1_000_000),
)


@given(IMPAIRMENTS, st.integers(1, 2**31 - 1), st.integers(0, 2**64 - 1), st.booleans())
def test_template_gives_the_bytes_of_plain_pyroute2(
    impairment: Impairment, ifindex: int, seed: int, replace_table: bool
) -> None:
    plain = tc.encode_netem(ifindex, impairment, seed=seed, replace_table=replace_table, flags=0)
    assert tc.change_netem(ifindex, impairment, seed=seed, replace_table=replace_table) == plain


@given(IMPAIRMENTS)
def test_ratios_and_rates_never_overflow_their_fields(impairment: Impairment) -> None:
    fixed, attrs = ours(impairment)
    assert struct.unpack("=6I", fixed)[2] == round(
        (impairment.loss.loss_ratio if isinstance(impairment.loss, RandomLoss) else 0) * 0xFFFFFFFF
    )
    rate = struct.unpack_from("=I", attrs[RATE])[0]
    assert (rate == 0) == (impairment.rate_bps is None)
    assert (RATE64 in attrs) == (impairment.rate_bps is not None and round(impairment.rate_bps / 8) > 0xFFFFFFFF)
    assert (LOSS in attrs) == isinstance(impairment.loss, GilbertElliottLoss | FourStateLoss)
