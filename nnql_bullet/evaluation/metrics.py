"""Computes metrics of drives: outcomes with intervals, quality of the drives, and tests between methods."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from statistics import fmean

import numpy as np

from nnql_bullet.evaluation.drives import Refused, Tier
from nnql_bullet.evaluation.policies import Policy
from nnql_bullet.evaluation.splits import Draws
from nnql_bullet.evaluation.statistics import Estimate, mcnemar, proportion, success_over_seeds
from nnql_bullet.rollout import EpisodeSummary
from nnql_bullet.seeding import Stream, rng
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
        drives: dict[str, list[EpisodeSummary]] = {}
        for world, summary in zip(tier.worlds, self.drives[policy.name, tier.name], strict=True):
            drives.setdefault(world.digest, []).append(replace(summary, world_seed=0))
        alike = {digest for digest, its in drives.items() if all(one == its[0] for one in its)}
        fixed = alike if policy.name not in self.random else set()
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
    """Inter-quartile mean of success over training seeds; None for a single seed."""
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
    """Share of decisions that a shield replaced."""
    stops: float
    """Share of decisions to stop or to turn on the spot."""
    reverses: float
    """Share of decisions to drive backwards."""
    standing: float
    """Time at a standstill in a drive, mean over all drives [s]."""
    waypoints: float
    """Number of way points that were reached, mean over all drives."""


def rows(evaluation: Evaluation) -> list[Row]:
    """Computes rows of every method in every tier and, if there are several, in all of them together."""
    e = evaluation
    return [_row(e, method, name, tiers) for method in e.methods for name, tiers in e.groups]


def _row(e: Evaluation, method: str, world: str, tiers: Sequence[Tier]) -> Row:
    policies = e.of_method(method)
    drives = [
        (e.drives[policy.name, tier.name][place], e.difficulties[tier.name][place].shortest_path)
        for tier in tiers
        for policy in policies
        for place in e.counted(policy, tier)
    ]
    summaries = [summary for summary, _ in drives]
    endings, steps = [summary.ending for summary in summaries], sum(summary.steps for summary in summaries)
    arrived = [(summary, shortest) for summary, shortest in drives if summary.ending == "goal"]
    scores = [np.array([_success(e, policy, tier) for policy in policies]) for tier in tiers]
    return Row(
        method=method,
        world=world,
        policies=len(policies),
        drives=len(drives),
        outcomes={ending: proportion(endings.count(ending), len(endings)) for ending in ENDINGS},
        over_seeds=success_over_seeds(scores, rng(0, Stream.BOOTSTRAP)),
        by_seed=tuple(np.mean(scores, axis=0).tolist()),
        spl=sum(_directness(summary.path_length, shortest) for summary, shortest in arrived) / len(drives),
        path_ratio=_mean([summary.path_length / shortest for summary, shortest in arrived]),
        time=_mean([summary.duration for summary, _ in arrived]),
        clearance=_mean([summary.clearance for summary, _ in arrived]),
        mean_clearance=_mean([summary.mean_clearance for summary in summaries]),
        lateral_acceleration=_mean([summary.lateral_acceleration for summary in summaries]),
        heading_error=_mean([summary.heading_error for summary in summaries]),
        non_safe=sum(summary.non_safe_steps for summary in summaries) / steps,
        overridden=sum(summary.overridden_steps for summary in summaries) / steps,
        stops=sum(summary.stop_steps for summary in summaries) / steps,
        reverses=sum(summary.reverse_steps for summary in summaries) / steps,
        standing=_mean([summary.standing_time for summary in summaries]),
        waypoints=_mean([len(summary.waypoint_times) for summary in summaries]),
    )


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


def _success(e: Evaluation, policy: Policy, tier: Tier) -> float:
    summaries = e.drives[policy.name, tier.name]
    return fmean(summaries[place].ending == "goal" for place in e.counted(policy, tier))


def _directness(driven: float, shortest: float) -> float:
    """The shortest over the driven path of a drive that arrived: 1 if it drove no farther than that."""
    return shortest / driven if driven > shortest else 1.0


def _mean(values: Sequence[float]) -> float:
    return fmean(values) if values else float("nan")


@dataclass(frozen=True, slots=True)
class Comparison:
    """Test of two methods in the worlds of one tier or of all tiers.

    The policies of both methods are paired in order; a single policy is paired with every policy of the other method.
    Drives of several policies through one world are not independent, so p is too small for several pairs.
    """

    world: str
    first: str
    second: str
    pairs: int
    only_first: int
    """Number of pairs in which only the first method reached the target."""
    only_second: int
    """Number of pairs in which only the second method reached the target."""
    p_value: float
    """p of McNemar's exact test."""


def comparisons(evaluation: Evaluation) -> list[Comparison]:
    """Tests every method against every other, in every tier and in all of them together."""
    e, found = evaluation, []
    for world, tiers in e.groups:
        for first, second in combinations(e.methods, 2):
            pairs = [
                tuple(e.drives[policy.name, tier.name][place].ending == "goal" for policy in pair)
                for tier in tiers
                for pair in _paired(e.of_method(first), e.of_method(second))
                for place in sorted({place for policy in pair for place in e.counted(policy, tier)})
            ]
            only_first, only_second = pairs.count((True, False)), pairs.count((False, True))
            p_value = mcnemar(only_first, only_second)
            found.append(Comparison(world, first, second, len(pairs), only_first, only_second, p_value))
    return found


def _paired(first: Sequence[Policy], second: Sequence[Policy]) -> list[tuple[Policy, Policy]]:
    if len(first) == 1:
        return [(first[0], other) for other in second]
    if len(second) == 1:
        return [(one, second[0]) for one in first]
    return list(zip(first, second, strict=False))
