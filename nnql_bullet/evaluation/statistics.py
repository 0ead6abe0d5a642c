"""Intervals and tests, by SciPy."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from scipy.stats import binomtest, bootstrap, trim_mean

from nnql_bullet.geometry import Array


class Share(NamedTuple):
    """A share of trials with its Wilson 95 % interval (Wilson, JASA 22, 1927)."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        """In percent."""
        return f"{100 * self.value:.1f} ({100 * self.low:.1f}-{100 * self.high:.1f})"


def share(count: int, total: int) -> Share:
    """What share `count` of `total` trials is.

    Raises:
        ValueError: If there is no trial.
    """
    interval = binomtest(count, total).proportion_ci(method="wilson")
    return Share(count / total, float(interval.low), float(interval.high))


def mcnemar(only_first: int, only_second: int) -> float:
    """McNemar's exact test of paired trials (Psychometrika 12, 1947): p of a difference so large by chance.

    Args:
        only_first: Trials in which the first alone succeeded.
        only_second: Trials in which the second alone did.
    """
    discordant = only_first + only_second
    return float(binomtest(only_first, discordant).pvalue) if discordant else 1.0


RESAMPLES = 2000


def interquartile_mean(scores: Array) -> float:
    """Mean of the middle half of scores (n,); with fewer than four of them, of all."""
    return float(trim_mean(scores, 0.25))


def seeds_share(scores: Sequence[Array], generator: np.random.Generator) -> Share | None:
    """Inter-quartile mean of success over training seeds, with a stratified bootstrap 95 % interval.

    Agarwal et al., Deep Reinforcement Learning at the Edge of the Statistical Precipice (NeurIPS 2021): the runs of
    each task are drawn anew, with replacement, within that task.

    Args:
        scores: Of each task, the share of successes of every training seed (n,).
        generator: Of the bootstrap.

    Returns:
        Nothing for a single seed, which says nothing of the spread.
    """
    if min(map(len, scores)) < 2:
        return None
    value = interquartile_mean(np.concatenate(scores))
    if all(np.ptp(task) == 0 for task in scores):  # nothing that could vary
        return Share(value, value, value)
    result = bootstrap(
        tuple(scores),
        lambda *drawn, axis=-1: trim_mean(np.concatenate(drawn, axis), 0.25, axis),
        n_resamples=RESAMPLES,
        method="percentile",
        rng=generator,
    )
    interval = result.confidence_interval
    return Share(value, float(interval.low), float(interval.high))


def mean_interval(scores: Array, generator: np.random.Generator) -> tuple[Array, Array]:
    """Bootstrap 95 % intervals of means.

    Args:
        scores: Of each training seed, at some places (n, m).
        generator: Of the bootstrap.

    Returns:
        Their lower and upper ends (m,).
    """
    result = bootstrap((scores,), np.mean, n_resamples=RESAMPLES, batch=100, method="percentile", rng=generator)
    return np.asarray(result.confidence_interval.low), np.asarray(result.confidence_interval.high)
