"""Computes metrics of drives: outcomes with intervals, quality of the drives, and tests between methods."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from nnql_bullet.evaluation.drives import Refused, Tier
from nnql_bullet.evaluation.policies import Policy
from nnql_bullet.evaluation.splits import Draws
from nnql_bullet.evaluation.statistics import (
    Estimate,
    crossed_sums,
    mcnemar,
    percentile_interval,
    proportion,
    success_of_seeds,
)
from nnql_bullet.geometry import Array
from nnql_bullet.rollout import EpisodeSummary
from nnql_bullet.setting import Setting
from nnql_bullet.task import ENDINGS
from nnql_bullet.text import shell_line
from nnql_bullet.worlds.paths import Difficulty

EVERYWHERE = "all worlds"
"""Name of all tiers together."""


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Drives of several policies through the same worlds."""

    asked: Sequence[str]
    """Shipped worlds, TOML files and folders that were asked for."""
    draws: Draws
    """Which worlds of each kind."""
    setting: Setting
    policies: Sequence[Policy]
    tiers: Sequence[Tier]
    difficulties: Mapping[str, Sequence[Difficulty]]
    """Difficulties of a tier's worlds, by the tier's name."""
    drives: Mapping[tuple[str, str], Sequence[EpisodeSummary]]
    """Summaries in the order of a tier's worlds, by the names of the policy and the tier."""
    refused: Sequence[Refused] = ()
    """Files that nothing drove through."""
    random: frozenset[str] = frozenset()
    """Names of policies that draw random numbers, or whose sensors do."""

    @property
    def title(self) -> str:
        """Worlds, simulator and conditions, for people."""
        return f"{self.draws.title}, {self.setting.title(policy.robot for policy in self.policies)}"

    @property
    def methods(self) -> list[str]:
        """Methods in the order of their policies."""
        return list(dict.fromkeys(policy.method for policy in self.policies))

    @property
    def command(self) -> str:
        """Command line that repeats the evaluation."""
        policies = [policy.path for policy in self.policies if not policy.shielded]
        worlds = ",".join(self.asked)
        flags = *self.draws.flags, *self.setting.flags
        return shell_line("nnql-bullet", "evaluate", *policies, "--world", worlds, *flags)

    @property
    def shielded(self) -> bool:
        """Whether the policies also drive with a shield."""
        return any(policy.shielded for policy in self.policies)

    @property
    def groups(self) -> list[tuple[str, list[Tier]]]:
        """Names and tiers of each row: every tier and, if there are several, all of them together."""
        everywhere = [(EVERYWHERE, list(self.tiers))] if len(self.tiers) > 1 else []
        return [*((tier.name, [tier]) for tier in self.tiers), *everywhere]

    def of_method(self, method: str) -> list[Policy]:
        """Returns the policies of a method."""
        return [policy for policy in self.policies if policy.method == method]

    def counted(self, policy: Policy, tier: Tier) -> list[int]:
        """Returns the places of those worlds of a tier whose drives count for a policy.

        Copies of a drive do not count. Of drives through equal worlds the first of each seed does; and only the first
        of all if they are equal to the last bit, unless the policy draws random numbers.
        """
        summaries = self.drives[policy.name, tier.name]
        places: dict[str, list[int]] = {}
        for place, world in enumerate(tier.worlds):
            places.setdefault(world.digest, []).append(place)

        def are_copies(its: Sequence[int]) -> bool:
            drives = [replace(summaries[place], world_seed=0) for place in its]
            return all(drive == drives[0] for drive in drives)

        fixed = {
            digest
            for digest, its in places.items()
            if len(its) > 1 and policy.name not in self.random and are_copies(its)
        }
        first: dict[tuple[str, int], int] = {}
        for place, world in enumerate(tier.worlds):
            first.setdefault((world.digest, -1 if world.digest in fixed else world.seed), place)
        return list(first.values())


@dataclass(frozen=True, slots=True)
class Row:
    """Metrics of a method in the worlds of one tier or of all tiers."""

    method: str
    world: str
    """Name of the tier, or `EVERYWHERE`."""
    policies: int
    """Number of policies, one for each training seed."""
    drives: int
    """Number of drives; copies of one another count once."""
    outcomes: dict[str, Estimate]
    """Proportion of each ending, over all drives."""
    over_seeds: Estimate | None
    """Inter-quartile mean of success over training seeds, with its interval over seeds and worlds; None for a single
    seed."""
    by_seed: tuple[float, ...]
    """Success of each policy."""
    spl: float
    """Success weighted by path length (Anderson et al., arXiv 1807.06757), from 0 to 1: mean of success x shortest /
    max(driven, shortest)."""
    path_ratio: float
    """Driven over shortest path length, mean over the drives that reach the target; NaN if none does."""
    time: float
    """Time to the target [s], mean over the drives that reach it; NaN if none does."""
    clearance: float
    """Smallest clearance of a drive [m], mean over the drives that reach the target; NaN if none does."""
    mean_clearance: float
    """Mean clearance of a drive, mean over all drives [m]."""
    lateral_acceleration: float
    """Largest lateral acceleration of a drive, mean over all drives [m/s2]."""
    heading_error: float
    """Root mean square heading error of a drive, mean over all drives [rad]."""
    non_safe: float
    """Share of decisions made in non-safe states."""
    overridden: float
    """Share of all decisions that a shield replaced; a few long drives may make most of it."""
    overridden_by_drive: float
    """Share of a drive's decisions that a shield replaced, mean over all drives."""
    stops: float
    """Share of decisions to stop or to turn on the spot."""
    reverses: float
    """Share of decisions to drive backwards."""
    standing: float
    """Time at a standstill in a drive, mean over all drives [s]."""
    waypoints: float
    """Number of way points that were reached, mean over all drives."""
    intervals: dict[str, tuple[float, float]]
    """95 % intervals of the quantities above, by their names: of a bootstrap over training seeds and worlds, crossed.
    NaN where too few drives arrive for one, or all are equal."""


def rows(evaluation: Evaluation) -> list[Row]:
    """Computes rows of every method in every tier and, if there are several, in all of them together."""
    e = evaluation
    return [_row(e, method, name, tiers) for method in e.methods for name, tiers in e.groups]


def _row(e: Evaluation, method: str, world: str, tiers: Sequence[Tier]) -> Row:
    policies, drives = e.of_method(method), _drives(e, method, tiers)
    endings = [drive.summary.ending for its in drives for drive in its]
    count, goals = _tables(drives, _each), _tables(drives, _arrived)
    quantities = {name: _estimate(drives, *parts) for name, parts in QUANTITIES.items()}
    shares = [its.sum(axis=1) / all_.sum(axis=1) for its, all_ in zip(goals, count, strict=True)]
    return Row(
        method=method,
        world=world,
        policies=len(policies),
        drives=len(endings),
        outcomes={ending: proportion(endings.count(ending), len(endings)) for ending in ENDINGS},
        over_seeds=success_of_seeds(goals, count),
        by_seed=tuple(np.mean(shares, axis=0).tolist()),
        **{name: estimate.value for name, estimate in quantities.items()},
        intervals={name: (estimate.low, estimate.high) for name, estimate in quantities.items()},
    )


@dataclass(frozen=True, slots=True)
class _Drive:
    """A drive that counts."""

    task: int
    """Number of its tier in the row."""
    seed: int
    """Number of its policy in the method."""
    world: int
    """Number of its world among the different ones of the tier."""
    summary: EpisodeSummary
    shortest: float
    """Length of the shortest path [m]."""

    @property
    def arrived(self) -> float:
        """1 if it reached the target, else 0."""
        return float(self.summary.ending == "goal")

    @property
    def directness(self) -> float:
        """The shortest over the driven path if it arrived: 1 if it drove no farther than that."""
        driven = self.summary.path_length
        return self.arrived * (self.shortest / driven if driven > self.shortest else 1.0)


_Quantity = Callable[[_Drive], float]


def _each(_: _Drive) -> float:
    return 1.0


def _arrived(drive: _Drive) -> float:
    return drive.arrived


def _steps(drive: _Drive) -> float:
    return drive.summary.steps


QUANTITIES: dict[str, tuple[_Quantity, _Quantity]] = {
    "spl": (lambda d: d.directness, _each),
    "path_ratio": (lambda d: d.arrived * d.summary.path_length / d.shortest, _arrived),
    "time": (lambda d: d.arrived * d.summary.duration, _arrived),
    "clearance": (lambda d: d.arrived * d.summary.clearance, _arrived),
    "mean_clearance": (lambda d: d.summary.mean_clearance, _each),
    "lateral_acceleration": (lambda d: d.summary.lateral_acceleration, _each),
    "heading_error": (lambda d: d.summary.heading_error, _each),
    "non_safe": (lambda d: d.summary.non_safe_steps, _steps),
    "overridden": (lambda d: d.summary.overridden_steps, _steps),
    "overridden_by_drive": (lambda d: d.summary.overridden_steps / max(d.summary.steps, 1), _each),
    "stops": (lambda d: d.summary.stop_steps, _steps),
    "reverses": (lambda d: d.summary.reverse_steps, _steps),
    "standing": (lambda d: d.summary.standing_time, _each),
    "waypoints": (lambda d: len(d.summary.waypoint_times), _each),
}
"""Quantities of a row, each the sum of the first over the sum of the second over its drives."""


def _drives(e: Evaluation, method: str, tiers: Sequence[Tier]) -> list[list[_Drive]]:
    """The drives that count of a method in each tier."""
    found: list[list[_Drive]] = []
    for task, tier in enumerate(tiers):
        numbers = {digest: number for number, digest in enumerate(dict.fromkeys(w.digest for w in tier.worlds))}
        lengths = [difficulty.shortest_path for difficulty in e.difficulties[tier.name]]
        found.append(
            [
                _Drive(task, seed, numbers[tier.worlds[place].digest], summaries[place], lengths[place])
                for seed, policy in enumerate(e.of_method(method))
                for summaries in [e.drives[policy.name, tier.name]]
                for place in e.counted(policy, tier)
            ]
        )
    return found


def _tables(drives: Sequence[Sequence[_Drive]], quantity: _Quantity) -> list[Array]:
    """Sums a quantity of each seed in each world: of each tier a table (seeds, worlds)."""
    tables = []
    for its in drives:
        worlds = 1 + max([drive.world for drive in its])
        sums = np.bincount([drive.seed * worlds + drive.world for drive in its], [quantity(drive) for drive in its])
        tables.append(np.asarray(sums, np.float64).reshape(-1, worlds))
    return tables


def _estimate(drives: Sequence[Sequence[_Drive]], above: _Quantity, below: _Quantity) -> Estimate:
    """Estimates a ratio of sums over drives."""
    tops, bottoms = _tables(drives, above), _tables(drives, below)
    top, bottom = sum(table.sum() for table in tops), sum(table.sum() for table in bottoms)
    if not bottom:
        return Estimate(float("nan"), float("nan"), float("nan"))
    with np.errstate(invalid="ignore"):  # no drive of a resample arrives
        draws = crossed_sums(tops).sum(axis=(1, 2)) / crossed_sums(bottoms).sum(axis=(1, 2))
    return Estimate(float(top / bottom), *percentile_interval(draws))


@dataclass(frozen=True, slots=True)
class Quarter:
    """Success in a quarter of a tier's worlds that have similar bottlenecks."""

    world: str
    """Name of the tier."""
    narrowest: float
    """Smallest bottleneck [m]."""
    widest: float
    """Largest bottleneck [m]."""
    worlds: int
    """Number of worlds."""
    success: dict[str, Estimate]
    """Proportion of drives that reach the target, by method."""


def by_bottleneck(evaluation: Evaluation) -> list[Quarter]:
    """Computes success in each quarter of every tier, from the narrowest bottlenecks to the widest.

    Equal worlds count once. A tier whose worlds are fewer than four, or have the same bottleneck, has no quarters.
    """
    e, found = evaluation, []
    for tier in e.tiers:
        for narrowest, widest, its_worlds in quarters(e, tier):
            success = {}
            for method in e.methods:
                endings = [
                    e.drives[policy.name, tier.name][place].ending
                    for policy in e.of_method(method)
                    for place in e.counted(policy, tier)
                    if tier.worlds[place].digest in its_worlds
                ]
                success[method] = proportion(endings.count("goal"), len(endings))
            found.append(Quarter(tier.name, narrowest, widest, len(its_worlds), success))
    return found


def quarters(evaluation: Evaluation, tier: Tier) -> list[tuple[float, float, frozenset[str]]]:
    """Splits the worlds of a tier into quarters, from the narrowest bottlenecks to the widest.

    Returns:
        The smallest and largest bottleneck [m] and the hashes of the worlds of each quarter; none if there are fewer
        than four worlds, or all have the same bottleneck. Equal worlds count once.
    """
    surveyed = zip(tier.worlds, evaluation.difficulties[tier.name], strict=True)
    by_digest = {world.digest: its.bottleneck for world, its in surveyed}
    digests, widths = np.array(list(by_digest)), np.array(list(by_digest.values()))
    if len(widths) < 4 or np.ptp(widths) == 0.0:
        return []
    parts = np.array_split(np.argsort(widths, kind="stable"), 4)
    return [(*widths[part[[0, -1]]].tolist(), frozenset(digests[part].tolist())) for part in parts]


@dataclass(frozen=True, slots=True)
class Comparison:
    """Test of two methods in the worlds of one tier or of all tiers.

    The policies of both methods are paired in order; a single policy is paired with every policy of the other method.
    """

    world: str
    first: str
    second: str
    pairs: int
    only_first: int
    """Number of pairs in which only the first method reached the target."""
    only_second: int
    """Number of pairs in which only the second method reached the target."""
    difference: Estimate
    """Mean success of the second method over seeds, tiers and worlds less that of the first, with its interval of a
    bootstrap over seeds and worlds, crossed."""
    p_value: float | None
    """p of McNemar's exact test; None unless both methods are single policies, as drives of several policies through
    one world are not independent."""


def comparisons(evaluation: Evaluation) -> list[Comparison]:
    """Tests every method against every other, in every tier and in all of them together."""
    e, found = evaluation, []
    counted = {(policy.name, tier.name): set(e.counted(policy, tier)) for policy in e.policies for tier in e.tiers}
    for world, tiers in e.groups:
        means = {method: _mean_success(e, method, tiers) for method in e.methods}
        for first, second in combinations(e.methods, 2):
            pairs = [
                tuple(e.drives[policy.name, tier.name][place].ending == "goal" for policy in pair)
                for tier in tiers
                for pair in _paired(e.of_method(first), e.of_method(second))
                for place in sorted(counted[pair[0].name, tier.name] | counted[pair[1].name, tier.name])
            ]
            only_first, only_second = pairs.count((True, False)), pairs.count((False, True))
            (a, draws_a), (b, draws_b) = means[first], means[second]
            difference = Estimate(b - a, *percentile_interval(draws_b - draws_a))
            single = len(e.of_method(first)) == len(e.of_method(second)) == 1
            p_value = mcnemar(only_first, only_second) if single else None
            found.append(Comparison(world, first, second, len(pairs), only_first, only_second, difference, p_value))
    return found


def _mean_success(e: Evaluation, method: str, tiers: Sequence[Tier]) -> tuple[float, Array]:
    """Mean success over seeds and tiers, and its resamples, which are drawn in the same worlds for all methods."""
    drives = _drives(e, method, tiers)
    goals, count = _tables(drives, _arrived), _tables(drives, _each)
    shares = [its.sum(axis=1) / all_.sum(axis=1) for its, all_ in zip(goals, count, strict=True)]
    return float(np.mean(shares)), (crossed_sums(goals) / crossed_sums(count)).mean(axis=(1, 2))


def _paired(first: Sequence[Policy], second: Sequence[Policy]) -> list[tuple[Policy, Policy]]:
    if len(first) == 1:
        return [(first[0], other) for other in second]
    if len(second) == 1:
        return [(one, second[0]) for one in first]
    return list(zip(first, second, strict=False))
