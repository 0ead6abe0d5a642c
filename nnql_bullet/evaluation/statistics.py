"""Intervals and tests, by SciPy."""

from typing import NamedTuple

from scipy.stats import binomtest


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
