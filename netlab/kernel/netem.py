"""An :class:`~netlab.medium.impairments.Impairment` as the options of sch_netem. Knows the format, sends nothing.

pyroute2's own netem options lack loss models, delay tables, 64-bit times and the seed; the classes here add them to
pyroute2's machinery. Source of numbers and meanings: linux/pkt_sched.h and net/sched/sch_netem.c.

Every message is *complete*: the kernel's netem_change() keeps what a message does not mention (correlations,
reordering, corruption, rate, delay table), so an attribute that is off is sent as zero. Other traps handled here:

* A change without a seed draws a new one and a change with the same seed restarts the same random numbers, which biases
  the loss when links change often; callers give a different seed with every change.
* A table cannot be taken away again: ``replace_table`` sends the uniform one.
* Times in ticks are cut to 64 ns and 274 s; the 64-bit attributes, which newer kernels prefer, are exact.
"""

from __future__ import annotations

from typing import Any

from pyroute2.netlink import nla

from netlab.kernel.delay_tables import delay_table
from netlab.kernel.netlink import attributes
from netlab.medium.impairments import (
    Distribution,
    FourStateLoss,
    GilbertElliottLoss,
    Impairment,
    LossModel,
    PeriodicLoss,
    RandomLoss,
    TraceLoss,
)

_U32_MAX = 0xFFFFFFFF
_QOPT_BYTES = 24  # struct tc_netem_qopt
_PRNG_SEED = 14
_NO_LIMIT_PACKETS = 0x7FFFFFFF
_NS_PER_S = 1_000_000_000
_TICK_NS = 64  # PSCHED_SHIFT in net/pkt_sched.h
_BITS_PER_BYTE = 8


class NetemOptions(nla):  # type: ignore[misc]  # pyroute2 is untyped
    """TCA_OPTIONS of a netem qdisc: struct tc_netem_qopt, then attributes."""

    prefix = "TCA_NETEM_"
    fields = (("latency", "I"), ("limit", "I"), ("loss", "I"), ("gap", "I"), ("duplicate", "I"), ("jitter", "I"))
    nla_map = (
        ("TCA_NETEM_UNSPEC", "none"),
        ("TCA_NETEM_CORR", "correlations"),
        ("TCA_NETEM_DELAY_DIST", "cdata"),
        ("TCA_NETEM_REORDER", "probability"),
        ("TCA_NETEM_CORRUPT", "probability"),
        ("TCA_NETEM_LOSS", "loss_model"),
        ("TCA_NETEM_RATE", "rate"),
        ("TCA_NETEM_ECN", "uint32"),
        ("TCA_NETEM_RATE64", "uint64"),
        ("TCA_NETEM_PAD", "hex"),
        ("TCA_NETEM_LATENCY64", "int64"),
        ("TCA_NETEM_JITTER64", "int64"),
        ("TCA_NETEM_SLOT", "hex"),
        ("TCA_NETEM_SLOT_DIST", "hex"),
        ("TCA_NETEM_PRNG_SEED", "uint64"),
    )

    class correlations(nla):  # type: ignore[misc]
        """struct tc_netem_corr."""

        fields = (("delay_corr", "I"), ("loss_corr", "I"), ("dup_corr", "I"))

    class probability(nla):  # type: ignore[misc]
        """struct tc_netem_reorder and struct tc_netem_corrupt."""

        fields = (("probability", "I"), ("correlation", "I"))

    class rate(nla):  # type: ignore[misc]
        """struct tc_netem_rate."""

        fields = (("rate", "I"), ("packet_overhead", "i"), ("cell_size", "I"), ("cell_overhead", "i"))

    class loss_model(nla):  # type: ignore[misc]
        """The Markov loss models; plain random loss is in the fixed part."""

        nla_flags = 0x8000  # NLA_F_NESTED, as tc sets it
        nla_map = (("NETEM_LOSS_UNSPEC", "none"), ("NETEM_LOSS_GI", "four_state"), ("NETEM_LOSS_GE", "gilbert_elliott"))

        class four_state(nla):  # type: ignore[misc]
            """struct tc_netem_gimodel; mind its order."""

            fields = (("p13", "I"), ("p31", "I"), ("p32", "I"), ("p14", "I"), ("p23", "I"))

        class gilbert_elliott(nla):  # type: ignore[misc]
            """struct tc_netem_gemodel; ``h`` is the probability that a frame *survives* the bad state."""

            fields = (("p", "I"), ("r", "I"), ("h", "I"), ("k1", "I"))


def inexpressible(impairment: Impairment) -> str | None:
    """Say what of ``impairment`` sch_netem cannot do, or None if it can do all."""
    if isinstance(impairment.loss, PeriodicLoss):
        return "periodic loss"
    if isinstance(impairment.loss, TraceLoss):
        return "loss by trace"
    if impairment.limit_bytes is not None:
        return "a queue limit in bytes (netem counts packets)"
    return None


def narrow_limit(impairment: Impairment, *, frame_bytes: int = 1514) -> str | None:
    """Say so when the queue limit alone keeps the link below its rate: delayed frames count towards the limit.

    Args:
        impairment: Rate and limit may be None; then there is nothing to say.
        frame_bytes: Size of the frames that should fill the link.
    """
    if impairment.rate_bps is None or impairment.limit_packets is None:
        return None
    needed = impairment.rate_bps * impairment.delay_s / (_BITS_PER_BYTE * frame_bytes)
    if impairment.limit_packets >= needed:
        return None
    return (
        f"limit {impairment.limit_packets} packets is less than rate x delay ({needed:.0f} packets of {frame_bytes} "
        f"bytes): the link cannot reach {impairment.rate_bps:g} bit/s"
    )


def netem_options(impairment: Impairment, *, seed: int, replace_table: bool) -> dict[str, Any]:
    """Return the value of TCA_OPTIONS for :class:`NetemOptions`.

    Args:
        impairment: What the qdisc does to frames.
        seed: 64 bits, for loss and corruption on kernels since 6.6; older ones pass over it.
        replace_table: The qdisc has a delay table from before, which a uniform jitter must replace.

    Raises:
        ValueError: sch_netem cannot express it (:func:`inexpressible`).
    """
    problem = inexpressible(impairment)
    if problem is not None:
        raise ValueError(f"sch_netem knows no {problem}")
    random_loss = impairment.loss if isinstance(impairment.loss, RandomLoss) else RandomLoss(0.0)
    reorders = impairment.reorder_ratio > 0
    limit = impairment.limit_packets
    return {
        "latency": _ticks(impairment.delay_s),
        "limit": _NO_LIMIT_PACKETS if limit is None else limit,
        "loss": _u32(random_loss.loss_ratio),
        # A gap without reordering probability means "all of every gap-th frame" to the kernel.
        "gap": impairment.reorder_gap if reorders else 0,
        "duplicate": _u32(impairment.duplicate_ratio),
        "jitter": _ticks(impairment.jitter_s),
        "attrs": [
            (
                "TCA_NETEM_CORR",
                {
                    "delay_corr": _u32(impairment.delay_correlation),
                    "loss_corr": _u32(random_loss.correlation),
                    "dup_corr": _u32(impairment.duplicate_correlation),
                },
            ),
            ("TCA_NETEM_REORDER", _probability(impairment.reorder_ratio, impairment.reorder_correlation)),
            ("TCA_NETEM_CORRUPT", _probability(impairment.corrupt_ratio, impairment.corrupt_correlation)),
            *_loss_model(impairment.loss),
            *_rate(impairment.rate_bps),
            ("TCA_NETEM_LATENCY64", _ns(impairment.delay_s)),
            ("TCA_NETEM_JITTER64", _ns(impairment.jitter_s)),
            ("TCA_NETEM_PRNG_SEED", seed),
            *_delay_table(impairment, replace_table),
        ],
    }


def tells_seed(options: bytes) -> bool:
    """Whether a netem's settings, as the kernel dumps them, have a seed: older kernels (before 6.6) know none."""
    return _PRNG_SEED in attributes(options, _QOPT_BYTES)


def uses_table(impairment: Impairment) -> bool:
    """Whether this impairment leaves a delay table in the qdisc."""
    return impairment.jitter_s > 0 and impairment.distribution is not Distribution.UNIFORM


def _delay_table(impairment: Impairment, replace_table: bool) -> list[tuple[str, bytes]]:
    if uses_table(impairment) or (replace_table and impairment.jitter_s > 0):
        return [("TCA_NETEM_DELAY_DIST", delay_table(impairment.distribution))]
    return []


def _loss_model(loss: LossModel | None) -> list[tuple[str, dict[str, Any]]]:
    if isinstance(loss, FourStateLoss):
        names = ("p13", "p31", "p32", "p14", "p23")
        return [_nested("NETEM_LOSS_GI", {name: _u32(getattr(loss, name)) for name in names})]
    if isinstance(loss, GilbertElliottLoss):
        survives = _U32_MAX - _u32(loss.loss_in_bad)
        fields = {"p": _u32(loss.p), "r": _u32(loss.r), "h": survives, "k1": _u32(loss.loss_in_good)}
        return [_nested("NETEM_LOSS_GE", fields)]
    return []


def _nested(kind: str, fields: dict[str, int]) -> tuple[str, dict[str, Any]]:
    return "TCA_NETEM_LOSS", {"attrs": [(kind, fields)]}


def _rate(rate_bps: float | None) -> list[tuple[str, Any]]:
    bytes_per_s = 0 if rate_bps is None else max(1, round(rate_bps / _BITS_PER_BYTE))
    fields = {"rate": min(bytes_per_s, _U32_MAX), "packet_overhead": 0, "cell_size": 0, "cell_overhead": 0}
    large: list[tuple[str, Any]] = [("TCA_NETEM_RATE64", bytes_per_s)] if bytes_per_s > _U32_MAX else []
    return [*large, ("TCA_NETEM_RATE", fields)]


def _probability(ratio: float, correlation: float) -> dict[str, int]:
    return {"probability": _u32(ratio), "correlation": _u32(correlation)}


def _u32(ratio: float) -> int:
    return round(ratio * _U32_MAX)


def _ns(time_s: float) -> int:
    return round(time_s * _NS_PER_S)


def _ticks(time_s: float) -> int:
    return min(_ns(time_s) // _TICK_NS, _U32_MAX)
