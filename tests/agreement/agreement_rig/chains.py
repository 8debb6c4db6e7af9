"""Loss models as hidden Markov chains: exact means and long-run variances of losses and bursts. Pure.

Theory. In state s a frame is lost with probability ``emission[s]``; then the chain moves by ``moves[s]``. The mean of n
successive values of a stationary series f has the variance V / n for large n, V = c0 + 2 (c1 + c2 + ...), c_k being the
covariance of values k frames apart. Bursts make V larger than the binomial p (1 - p): for Gilbert's model by the factor
(2 - p - r) / (p + r). V is summed numerically over the chain of (state, last three frames lost or not), so that it also
serves for figures about bursts.

Sources of the chains: tc-netem(8) (gemodel, state); S. Salsano, F. Ludovici, A. Ordine, "Definition of a general and
intuitive loss model for packet networks", 2009. Written without the project's own loss models, which they judge.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from netlab.medium.impairments import FourStateLoss, GilbertElliottLoss, LossModel, RandomLoss

_MIXING_STEPS = 3000
_NEGLIGIBLE = 1e-9

Window = tuple[bool, bool, bool]  # lost: the frame before last, the last one, this one
Distribution = dict[tuple[int, Window], float]


@dataclass(frozen=True, slots=True)
class Expected:
    """What a series must be: its mean, and V: the mean of n values has the variance ``variance`` / n."""

    mean: float
    variance: float


@dataclass(frozen=True, slots=True)
class Chain:
    """``moves[s]`` is the distribution of the next state, ``emission[s]`` the probability of loss in state s."""

    moves: tuple[tuple[float, ...], ...]
    emission: tuple[float, ...]


def chain_of(model: LossModel) -> Chain | None:
    """The chain of a loss model; None where it is none (correlated, periodic)."""
    if isinstance(model, RandomLoss) and not model.correlation:
        return Chain(((1.0,),), (model.loss_ratio,))
    if isinstance(model, GilbertElliottLoss):
        moves = ((1 - model.p, model.p), (model.r, 1 - model.r))
        return Chain(moves, (model.loss_in_good, model.loss_in_bad))
    if isinstance(model, FourStateLoss):
        m = model
        gap, burst = (1 - m.p13 - m.p14, 0.0, m.p13, m.p14), (0.0, 1 - m.p23, m.p23, 0.0)
        return Chain((gap, burst, (m.p31, m.p32, 1 - m.p31 - m.p32, 0.0), (1.0, 0.0, 0.0, 0.0)), (0.0, 0.0, 1.0, 1.0))
    return None


def is_lost(window: Window) -> float:
    """This frame is lost."""
    return float(window[2])


def starts_burst(window: Window) -> float:
    """This frame is lost, the one before arrived."""
    return float(window[2] and not window[1])


def is_single(window: Window) -> float:
    """The last frame was lost, those around it arrived."""
    return float(window[1] and not window[0] and not window[2])


def expected(chain: Chain, of: Callable[[Window], float]) -> Expected:
    """Mean and long-run variance of a figure of the stationary chain."""
    return _summed(_moments(chain, of))


def expected_jointly(chain: Chain) -> Expected:
    """The same for "lost at both of two receivers" whose chains are alike and independent."""
    return _summed([moment * moment for moment in _moments(chain, is_lost)])


def expected_restarted(chain: Chain, every: int) -> Expected:
    """Mean and long-run variance of the losses where the chain begins anew in state 0 every ``every`` frames."""
    at_start = tuple(float(state == 0) for state in range(len(chain.emission)))
    means = [_mean_after(chain, at_start, steps) for steps in range(every)]
    variance = sum(mean * (1 - mean) for mean in means)
    for first in range(every):
        occupied = _after(chain, at_start, first)
        lost_here = tuple(weight * loss for weight, loss in zip(occupied, chain.emission, strict=True))
        for steps in range(1, every - first):
            lost_here = _after(chain, lost_here, 1)
            together = _mean_after(chain, lost_here, 0)
            variance += 2 * (together - means[first] * means[first + steps])
    return Expected(sum(means) / every, variance / every)


def _after(chain: Chain, weights: tuple[float, ...], steps: int) -> tuple[float, ...]:
    for _ in range(steps):
        moved = zip(*(tuple(w * m for m in row) for w, row in zip(weights, chain.moves, strict=True)), strict=True)
        weights = tuple(map(sum, moved))
    return weights


def _mean_after(chain: Chain, weights: tuple[float, ...], steps: int) -> float:
    return sum(w * loss for w, loss in zip(_after(chain, weights, steps), chain.emission, strict=True))


def _summed(moments: list[float]) -> Expected:
    """From E[f] and E[f(t) f(t + k)], k = 0, 1, ...: the last of them is taken for E[f]^2."""
    mean_squared = moments[-1]
    covariances = [moment - mean_squared for moment in moments]
    return Expected(mean_squared**0.5, max(0.0, covariances[0] + 2 * sum(covariances[1:])))


def _moments(chain: Chain, of: Callable[[Window], float]) -> list[float]:
    """E[f(t) f(t + k)] for k = 0, 1, ..., and E[f]^2 as the last."""
    here = _stationary(chain)
    mean = sum(weight * of(window) for (_, window), weight in here.items())
    weighted = {place: weight * of(place[1]) for place, weight in here.items() if of(place[1])}
    moments = []
    for steps in range(_MIXING_STEPS):
        moments.append(sum(weight * of(window) for (_, window), weight in weighted.items()))
        if steps > 3 and abs(moments[-1] - mean * mean) < _NEGLIGIBLE * mean:
            break
        weighted = _step(chain, weighted)
    return [*moments, mean * mean]


def _stationary(chain: Chain) -> Distribution:
    states = len(chain.emission)
    weights: Distribution = {(state, (False, False, False)): 1 / states for state in range(states)}
    for _ in range(_MIXING_STEPS):
        moved = _step(chain, weights)
        change = sum(abs(moved[place] - weights.get(place, 0.0)) for place in moved)
        weights = moved
        if change < _NEGLIGIBLE * _NEGLIGIBLE:
            break
    return weights


def _step(chain: Chain, weights: Distribution) -> Distribution:
    """One frame later."""
    moved: Distribution = {}
    for (state, (_, before, last)), weight in weights.items():
        for following, probability in enumerate(chain.moves[state]):
            loss = chain.emission[following]
            for gone, chance in ((True, loss), (False, 1 - loss)):
                if probability * chance:
                    place = (following, (before, last, gone))
                    moved[place] = moved.get(place, 0.0) + weight * probability * chance
    return moved
