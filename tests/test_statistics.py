"""Intervals and tests against closed forms, brute force and simulated studies."""

from collections.abc import Sequence
from itertools import product
from math import isnan

import numpy as np
import pytest
from scipy.stats import norm, permutation_test

from nnql_bullet.evaluation.statistics import (
    Estimate,
    centre_interval,
    crossed_sums,
    detectable_effect,
    holm,
    interquartile_mean,
    least_seeds,
    mean_interval,
    over_seeds,
    percentile_interval,
    proportion,
    sign_test,
    success_of_seeds,
)
from nnql_bullet.geometry import Array


def chance(seed: int = 7) -> np.random.Generator:
    return np.random.default_rng(seed)


def naive_iqm(scores: Sequence[float]) -> float:
    ranked = sorted(scores)
    cut = len(ranked) // 4
    middle = ranked[cut : len(ranked) - cut]
    return sum(middle) / len(middle)


def test_the_interquartile_mean_leaves_a_quarter_out_on_either_side() -> None:
    for count in range(1, 14):
        scores = chance(count).uniform(0, 1, count)
        assert interquartile_mean(scores) == pytest.approx(naive_iqm(scores.tolist()))
    assert interquartile_mean(np.array([0.0, 0.9, 0.9, 0.9, 0.9, 0.9, 0.9, 0.9])) == pytest.approx(0.9)


class TestSignTest:
    @pytest.mark.parametrize("count", [2, 3, 6, 9])
    def test_it_is_scipys_exact_permutation_test_and_the_count_of_all_flips(self, count: int) -> None:
        differences = chance(count).normal(0.4, 1.0, count)
        flips = [abs(float(np.dot(signs, differences))) for signs in product((1, -1), repeat=count)]
        brute = np.mean([flip >= abs(differences.sum()) - 1e-9 for flip in flips])
        scipys = permutation_test((differences,), np.mean, permutation_type="samples", n_resamples=np.inf).pvalue
        assert sign_test(differences) == pytest.approx(brute)
        assert sign_test(differences) == pytest.approx(scipys)

    def test_its_least_p_is_that_of_seeds_that_all_agree(self) -> None:
        for count in (1, 5, 6, 12):
            assert sign_test(np.arange(1.0, count + 1)) == 2.0 ** (1 - count)
        assert sign_test(np.zeros(8)) == 1.0
        assert sign_test(np.full(40, 0.1)) < 0.001  # of so many pairs, patterns are drawn

    def test_six_seeds_are_the_least_for_one_comparison(self) -> None:
        for comparisons in (1, 2, 16, 42):
            least = least_seeds(comparisons)
            assert comparisons * 2.0 ** (1 - least) <= 0.05 < comparisons * 2.0 ** (2 - least)
        assert least_seeds() == 6

    @pytest.mark.parametrize("count", [6, 9])
    def test_the_interval_holds_just_the_centres_that_are_not_rejected(self, count: int) -> None:
        values = chance(count).normal(size=count)
        low, high = centre_interval(values)
        for end, outward in ((low, -1e-6), (high, 1e-6)):
            assert sign_test(values - end - outward) <= 0.05 < sign_test(values - end + outward)
        assert all(map(isnan, centre_interval(values[:5])))
        assert over_seeds(values) == Estimate(interquartile_mean(values), low, high)
        assert str(over_seeds(values[:1] * 0 + 0.5)) == "50.0"

    def test_holm_is_its_definition(self) -> None:
        p_values = [0.01, float("nan"), 0.04, 0.03, 0.005]
        ranked, largest, expected = sorted(p for p in p_values if not isnan(p)), 0.0, {}
        for rank, p in enumerate(ranked):
            largest = max(largest, min(1.0, (len(ranked) - rank) * p))
            expected[p] = largest
        assert [p for p in holm(p_values) if not isnan(p)] == [expected[p] for p in p_values if not isnan(p)]
        assert isnan(holm(p_values)[1])

    def test_studies_without_any_effect_rarely_find_one_where_the_old_verdict_often_did(self) -> None:
        generator, studies, variants, seeds = chance(), 400, 4, 8
        false, old = 0, 0
        for _ in range(studies):
            scores = np.clip(generator.normal(0.9, 0.1, (variants + 1, seeds)), 0, 1)  # skewed, one common default
            corrected = holm([sign_test(its - scores[0]) for its in scores[1:]])
            false += min(corrected) <= 0.05
            three = scores[1, :3] - scores[0, :3]  # a percentile bootstrap over three seeds, as it was once
            low, high = np.quantile(generator.choice(three, (200, 3)).mean(axis=1), (0.025, 0.975))
            old += low > 0 or high < 0
        assert false / studies <= 0.05
        assert 0.18 < old / studies < 0.32  # three signs agree in a quarter of studies

    def test_what_is_detectable_is_found_in_80_percent_of_studies(self) -> None:
        for count, level in ((8, 0.025), (10, 0.05 / 16)):
            effect = detectable_effect(count, level)
            studies = chance(3).normal(effect, 1.0, (600, count))
            assert np.mean([sign_test(study) <= level for study in studies]) == pytest.approx(0.8, abs=0.05)
        six = norm.cdf(detectable_effect(6, 0.05))  # only where all six agree in sign
        assert six**6 + (1 - six) ** 6 == pytest.approx(0.8, abs=0.04)
        assert detectable_effect(5, 0.05) == float("inf")


def two_way(generator: np.random.Generator, seeds: int, worlds: int, of_seed: float, of_world: float) -> Array:
    noise = generator.normal(size=(seeds, worlds))
    return noise + generator.normal(0, of_seed, (seeds, 1)) + generator.normal(0, of_world, (1, worlds))


class TestCrossed:
    @pytest.mark.parametrize(("of_seed", "of_world"), [(0.1, 1.0), (0.5, 0.5)])
    def test_it_covers_the_mean_where_seeds_and_worlds_both_vary(self, of_seed: float, of_world: float) -> None:
        generator, hits, fixed, studies = chance(), 0, 0, 200
        for _ in range(studies):
            table = two_way(generator, 8, 40, of_seed, of_world)
            low, high = percentile_interval(crossed_sums([table]).mean(axis=(1, 2)))
            hits += low <= 0 <= high
            old = generator.choice(table.mean(axis=1), (400, 8)).mean(axis=1)  # the worlds held fixed, as it was once
            fixed += np.quantile(old, 0.025) <= 0 <= np.quantile(old, 0.975)
        assert 0.91 <= hits / studies <= 0.99
        assert fixed / studies < 0.9

    def test_its_variance_is_that_of_seeds_and_worlds_drawn_one_by_one(self) -> None:
        generator = chance()
        tables = [two_way(generator, 4, worlds, 1.0, 1.0) for worlds in (6, 9)]
        naive = []
        for _ in range(4000):
            seeds = generator.integers(4, size=4)
            naive.append([tables[t][seeds][:, generator.integers(n, size=n)].sum() for t, n in ((0, 6), (1, 9))])
        found = crossed_sums(tables).sum(axis=2)
        assert np.cov(found.T) == pytest.approx(np.cov(np.transpose(naive)), rel=0.15)

    def test_success_is_the_interquartile_mean_over_seeds_and_tasks(self) -> None:
        goals = [(chance(task).uniform(size=(8, 30)) < 0.9 - 0.3 * task).astype(float) for task in (0, 1)]
        found = success_of_seeds(goals, [np.ones((8, 30))] * 2)
        assert found is not None
        assert found.value == pytest.approx(naive_iqm(np.concatenate([its.mean(axis=1) for its in goals]).tolist()))
        assert found.low < found.value < found.high

    def test_a_single_seed_says_nothing_of_the_spread(self) -> None:
        assert success_of_seeds([np.ones((1, 9))], [np.ones((1, 9))]) is None

    def test_where_all_arrive_the_interval_is_wilsons_for_one_drive_a_world(self) -> None:
        assert success_of_seeds([np.ones((5, 25))], [np.ones((5, 25))]) == proportion(25, 25)
        assert success_of_seeds([np.zeros((5, 25))] * 2, [np.ones((5, 25))] * 2) == proportion(0, 50)

    def test_equal_draws_have_no_interval(self) -> None:
        assert all(map(isnan, percentile_interval(np.ones(9))))
        assert all(map(isnan, percentile_interval(np.array([1.0, np.nan]))))


def test_an_interval_of_means_is_worked_out_place_by_place() -> None:
    scores = chance(4).uniform(0, 1, (6, 3))
    low, high = mean_interval(scores, chance())
    # 0.03 is four standard errors of such a quantile of 2000 draws; an interval of 90 % would be 0.04 off.
    draws = chance(5)
    means = np.array([scores[draws.integers(6, size=6)].mean(axis=0) for _ in range(20_000)])
    assert low == pytest.approx(np.quantile(means, 0.025, axis=0), abs=0.03)
    assert high == pytest.approx(np.quantile(means, 0.975, axis=0), abs=0.03)
