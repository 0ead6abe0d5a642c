"""Computes estimates with intervals, and exact tests.

scipy.stats takes long to load, so each function imports what it needs.
"""

from collections.abc import Sequence
from functools import lru_cache
from math import ceil, inf, isnan, log2, nan
from typing import NamedTuple

import numpy as np

from nnql_bullet.geometry import Array
from nnql_bullet.seeding import Stream, rng

RESAMPLES = 2000
"""Number of bootstrap resamples."""
LEVEL = 0.05
"""Chance of a false verdict in a study, and of an interval that misses."""
POWER = 0.8
"""Chance of a verdict on a difference that counts as detectable."""
EXACT = 14
"""Most pairs whose signs are enumerated; of more pairs, as many sign patterns are drawn."""
SIMULATED = 400
"""Number of simulated studies that a detectable difference is found with."""


class Estimate(NamedTuple):
    """An estimate with its 95 % interval; the ends are NaN where there are too few values for one."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        """The estimate and its interval in percent."""
        value = f"{100 * self.value:.1f}"
        return value if isnan(self.low) else f"{value} ({100 * self.low:.1f}-{100 * self.high:.1f})"


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


def least_seeds(comparisons: int = 1) -> int:
    """Computes the fewest pairs of trainings that can carry a verdict, where all of them agree in sign.

    Args:
        comparisons: Number of comparisons in the study, over which Holm's correction is made.
    """
    return 1 + ceil(log2(comparisons / LEVEL))


@lru_cache
def _signs(count: int) -> Array:
    """Sign patterns of so many values (patterns, count): all that begin with +1, as -1 times a pattern tells as much.

    The first is +1 throughout.
    """
    if count <= EXACT:
        flipped = np.arange(2 ** (count - 1))[:, None] >> np.arange(count)[::-1] & 1
        return np.where(flipped, -1.0, 1.0)
    drawn = rng(count, Stream.BOOTSTRAP).choice((-1.0, 1.0), (2 ** (EXACT - 1), count))
    drawn *= drawn[:, :1]
    drawn[0] = 1.0
    return np.asarray(drawn)


def sign_test(differences: Array) -> float:
    """Computes p of the exact two-sided test of paired differences (n,) by flips of their signs.

    Under the null hypothesis each difference is as likely with the other sign (Fisher's randomisation test). As p is
    the share of sign patterns whose mean is at least as far from zero, it is 2 ** (1 - n) at least.
    """
    return float(_sign_tests(np.asarray(differences)[None])[0])


def _sign_tests(differences: Array) -> Array:
    """Computes p of `sign_test` for many studies (studies, n)."""
    sums = np.abs(_signs(differences.shape[1]) @ differences.T)
    return np.asarray((sums >= sums[0] * (1 - 1e-12)).mean(axis=0))


def centre_interval(values: Array) -> tuple[float, float]:
    """Computes the exact 95 % interval of the centre that values (n,) scatter symmetrically about.

    It holds every centre that `sign_test` does not reject: its ends are means of some of the values (Hartigan, Using
    Subsample Values as Typical Values, JASA 64, 1969).

    Returns:
        The ends; NaN if there are fewer than six values.
    """
    values = np.asarray(values)
    if len(values) < least_seeds():
        return nan, nan
    signs = _signs(len(values))
    chosen = np.concatenate([signs > 0, signs[1:] < 0])
    means = np.sort(chosen @ values / chosen.sum(axis=1))
    beyond = int(LEVEL / 2 * (len(means) + 1))
    return float(means[beyond - 1]), float(means[-beyond])


def over_seeds(scores: Array) -> Estimate:
    """Estimates the inter-quartile mean of scores (n,) of training seeds in the same worlds, with `centre_interval`."""
    return Estimate(interquartile_mean(scores), *centre_interval(scores))


def holm(p_values: Sequence[float]) -> list[float]:
    """Corrects p of several tests so that one false rejection among them is rare (Holm, Scand. J. Statist. 6, 1979).

    What is NaN is no test and stays so.
    """
    corrected = np.array(p_values, np.float64)
    tests = np.flatnonzero(~np.isnan(corrected))
    order = tests[np.argsort(corrected[tests], kind="stable")]
    steps = np.maximum.accumulate((len(order) - np.arange(len(order))) * corrected[order])
    corrected[order] = np.minimum(steps, 1.0)
    return [float(p) for p in corrected]


@lru_cache
def detectable_effect(count: int, level: float) -> float:
    """Finds which true difference `sign_test` of so many pairs rejects in 80 % of studies, by simulation.

    Args:
        count: Number of pairs.
        level: Chance of a false rejection.

    Returns:
        The difference in standard deviations of the normal differences; infinite if no study can reject.
    """
    if 1 / len(_signs(count)) > level:
        return inf
    noise = rng(0, Stream.BOOTSTRAP).standard_normal((SIMULATED, count))
    low, high = 0.0, 16.0
    while high - low > 0.01:
        effect = (low + high) / 2
        found = np.mean(_sign_tests(noise + effect) <= level) >= POWER
        low, high = (low, effect) if found else (effect, high)
    return high


@lru_cache(maxsize=8)
def _times_drawn(worlds: int, task: int) -> Array:
    """How often each world of a task is drawn in each resample (RESAMPLES, worlds)."""
    drawn = rng(0, Stream.BOOTSTRAP, 1 + task).multinomial(worlds, np.full(worlds, 1 / worlds), RESAMPLES)
    return drawn.astype(np.float64)


def crossed_sums(tables: Sequence[Array]) -> Array:
    """Sums values over worlds in a bootstrap that draws training seeds and worlds anew, crossed.

    Every seed that is drawn meets every world that is drawn (Owen, The pigeonhole bootstrap, Ann. Appl. Stat. 1, 2007).
    Equal shapes get the same draws, so that ratios of sums and differences of methods are paired.

    Args:
        tables: Of each task the values of each training seed in each world (seeds, worlds).

    Returns:
        (RESAMPLES, tasks, seeds)
    """
    seeds = len(tables[0])
    drawn = rng(0, Stream.BOOTSTRAP).integers(seeds, size=(RESAMPLES, seeds))
    sums = [_times_drawn(table.shape[1], task) @ table.T for task, table in enumerate(tables)]
    return np.stack([np.take_along_axis(its, drawn, axis=1) for its in sums], axis=1)


def percentile_interval(draws: Array) -> tuple[float, float]:
    """Returns the ends of the 95 % interval of a bootstrap; NaN if a resample holds no value, or all are equal."""
    if not np.isfinite(draws).all() or np.ptp(draws) == 0:
        return nan, nan
    low, high = np.quantile(draws, (LEVEL / 2, 1 - LEVEL / 2))
    return float(low), float(high)


def success_of_seeds(arrived: Sequence[Array], drives: Sequence[Array]) -> Estimate | None:
    """Estimates the inter-quartile mean of success over training seeds, with an interval over seeds and worlds.

    Agarwal et al., Deep Reinforcement Learning at the Edge of the Statistical Precipice (NeurIPS 2021), but with the
    worlds drawn anew too. Where all drives end alike there is nothing to draw from: the interval is then Wilson's for
    one drive in each world.

    Args:
        arrived: Of each task the number of drives that arrived, of each seed in each world (seeds, worlds).
        drives: The number of all drives.

    Returns:
        None for a single seed, which has no spread.
    """
    from scipy.stats import trim_mean

    if len(arrived[0]) < 2:
        return None
    shares = [a.sum(axis=1) / d.sum(axis=1) for a, d in zip(arrived, drives, strict=True)]
    value = interquartile_mean(np.concatenate(shares))
    whole = [a.sum() / d.sum() for a, d in zip(arrived, drives, strict=True)]
    if set(whole) in ({0.0}, {1.0}):
        worlds = sum(table.shape[1] for table in arrived)
        return Estimate(value, *proportion(round(value * worlds), worlds)[1:])
    draws = crossed_sums(arrived) / crossed_sums(drives)
    return Estimate(value, *percentile_interval(np.asarray(trim_mean(draws.reshape(len(draws), -1), 0.25, axis=1))))


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
