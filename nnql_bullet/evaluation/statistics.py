"""Computes estimates with intervals, and a test of paired trials, with SciPy.

scipy.stats takes long to load, so each function imports what it needs.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from nnql_bullet.geometry import Array

RESAMPLES = 2000
"""Number of bootstrap resamples."""


class Estimate(NamedTuple):
    """An estimate with its 95 % interval."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        """The estimate and its interval in percent."""
        return f"{100 * self.value:.1f} ({100 * self.low:.1f}-{100 * self.high:.1f})"


def proportion(count: int, total: int) -> Estimate:
    """Estimates a proportion from `count` successes in `total` trials, with its Wilson interval (JASA 22, 1927).

    Raises:
        ValueError: If there is no trial.
    """
    from scipy.stats import binomtest

    interval = binomtest(count, total).proportion_ci(method="wilson")
    return Estimate(count / total, float(interval.low), float(interval.high))


def mcnemar(only_first: int, only_second: int) -> float:
    """Computes p of McNemar's exact test of paired trials (Psychometrika 12, 1947).

    Args:
        only_first: Trials in which only the first method succeeded.
        only_second: Trials in which only the second method succeeded.
    """
    from scipy.stats import binomtest

    discordant = only_first + only_second
    return float(binomtest(only_first, discordant).pvalue) if discordant else 1.0


def interquartile_mean(scores: Array) -> float:
    """Computes the mean of the middle half of scores (n,); of all scores if there are fewer than four."""
    from scipy.stats import trim_mean

    return float(trim_mean(scores, 0.25))


def success_over_seeds(scores: Sequence[Array], generator: np.random.Generator) -> Estimate | None:
    """Estimates the inter-quartile mean of success over training seeds, with a stratified bootstrap interval.

    Agarwal et al., Deep Reinforcement Learning at the Edge of the Statistical Precipice (NeurIPS 2021): the runs of
    each task are resampled with replacement within that task.

    Args:
        scores: For each task, the success of each training seed (n,).
        generator: Draws the resamples.

    Returns:
        None for a single seed, which has no spread.
    """
    from scipy.stats import bootstrap, trim_mean

    if min(map(len, scores)) < 2:
        return None
    value = interquartile_mean(np.concatenate(scores))
    if all(np.ptp(task) == 0 for task in scores):  # the bootstrap refuses constant scores
        return Estimate(value, value, value)
    result = bootstrap(
        tuple(scores),
        lambda *drawn, axis=-1: trim_mean(np.concatenate(drawn, axis), 0.25, axis),
        n_resamples=RESAMPLES,
        method="percentile",
        rng=generator,
    )
    interval = result.confidence_interval
    return Estimate(value, float(interval.low), float(interval.high))


def mean_interval(scores: Array, generator: np.random.Generator) -> tuple[Array, Array]:
    """Computes bootstrap 95 % intervals of the means over training seeds.

    Args:
        scores: Scores of n training seeds (n,), or at m places (n, m).
        generator: Draws the resamples.

    Returns:
        Lower and upper ends of the intervals (), or (m,).
    """
    from scipy.stats import bootstrap

    result = bootstrap((scores,), np.mean, n_resamples=RESAMPLES, batch=100, method="percentile", rng=generator)
    return np.asarray(result.confidence_interval.low), np.asarray(result.confidence_interval.high)
