"""Intervals over training seeds against formulas and a bootstrap written down anew."""

from collections.abc import Sequence

import numpy as np
import pytest

from nnql_bullet.evaluation.statistics import interquartile_mean, mean_interval, success_over_seeds
from nnql_bullet.geometry import Array


def generator() -> np.random.Generator:
    return np.random.default_rng(7)


def naive_iqm(scores: Sequence[float]) -> float:
    ranked = sorted(scores)
    cut = len(ranked) // 4
    middle = ranked[cut : len(ranked) - cut]
    return sum(middle) / len(middle)


def test_the_interquartile_mean_leaves_a_quarter_out_on_either_side() -> None:
    for count in range(1, 14):
        scores = np.random.default_rng(count).uniform(0, 1, count)
        assert interquartile_mean(scores) == pytest.approx(naive_iqm(scores.tolist()))
    assert interquartile_mean(np.array([0.0, 0.9, 0.9, 0.9, 0.9, 0.9, 0.9, 0.9])) == pytest.approx(0.9)


def naive_interval(scores: Sequence[Array], draws: int) -> tuple[float, float]:
    """Each task's runs are drawn anew within that task."""
    chance = np.random.default_rng(1)
    means = [
        naive_iqm([float(score) for task in scores for score in chance.choice(task, len(task))]) for _ in range(draws)
    ]
    low, high = np.quantile(means, (0.025, 0.975))
    return float(low), float(high)


@pytest.mark.parametrize("tasks", [1, 3])
def test_the_interval_is_that_of_a_stratified_bootstrap(tasks: int) -> None:
    chance = np.random.default_rng(3)
    scores = [np.clip(chance.normal(0.9 - 0.3 * task, 0.05, 10), 0, 1) for task in range(tasks)]
    found = success_over_seeds(scores, generator())
    assert found is not None
    assert found.value == pytest.approx(naive_iqm(np.concatenate(scores).tolist()))
    low, high = naive_interval(scores, 4000)
    assert (found.low, found.high) == pytest.approx((low, high), abs=0.01)


def test_a_single_seed_says_nothing_of_the_spread() -> None:
    assert success_over_seeds([np.array([0.9])], generator()) is None


def test_seeds_that_all_do_alike_have_no_spread() -> None:
    assert success_over_seeds([np.ones(5)], generator()) == (1.0, 1.0, 1.0)


def test_the_same_generator_gives_the_same_interval() -> None:
    scores = [np.linspace(0.2, 0.9, 10)]
    assert success_over_seeds(scores, generator()) == success_over_seeds(scores, generator())


def test_an_interval_of_means_is_worked_out_place_by_place() -> None:
    scores = np.random.default_rng(4).uniform(0, 1, (6, 3))
    low, high = mean_interval(scores, generator())
    # 0.03 is four standard errors of such a quantile of 2000 draws; an interval of 90 % would be 0.04 off.
    chance = np.random.default_rng(5)
    means = np.array([scores[chance.integers(6, size=6)].mean(axis=0) for _ in range(20_000)])
    assert low == pytest.approx(np.quantile(means, 0.025, axis=0), abs=0.03)
    assert high == pytest.approx(np.quantile(means, 0.975, axis=0), abs=0.03)
