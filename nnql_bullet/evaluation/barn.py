"""The protocol of the BARN challenge, and its scores of drives.

A drive through a world has `TIME` to come within the target's radius; a collision ends it. Its score is 0 if it does
not arrive, else OT / clip(AT, a OT, b OT): AT is its time, OT the time that the reference path takes at `SPEED`.
Editions of the challenge differ in the bounds a and b, see `CLIPPINGS`.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import ceil
from statistics import fmean, median

import numpy as np

from nnql_bullet.evaluation.drives import Drawn, Tier
from nnql_bullet.evaluation.metrics import Evaluation, quarters
from nnql_bullet.evaluation.policies import Policy
from nnql_bullet.evaluation.statistics import Estimate, mean_interval, proportion
from nnql_bullet.rollout import EpisodeSummary
from nnql_bullet.seeding import Stream, rng
from nnql_bullet.setting import Setting
from nnql_bullet.task import ENDINGS
from nnql_bullet.text import shell_line

SPEED, TIME = 2.0, 100.0
"""Speed of the optimal time [m/s], and the time that a drive may take [s]."""
STEPS = "task.max_steps"
"""The key of a policy's configuration that sets that time."""


@dataclass(frozen=True, slots=True)
class Reference:
    """The reference path of a world."""

    number: int
    """Number of the world."""
    length: float
    """From the start to the target's centre [m]."""
    given: bool
    """Whether it is that of the data set, and not the shortest path of a disc as wide as the vehicle."""

    @property
    def optimal_time(self) -> float:
        """How long it takes at `SPEED` [s]."""
        return self.length / SPEED


@dataclass(frozen=True, slots=True)
class Clipping:
    """Bounds of the time that counts, as multiples of the optimal time."""

    least: float
    """A drive that is faster gains nothing."""
    most: float
    """A drive that arrives later loses nothing more."""
    source: str
    """Where these bounds are in use."""

    @property
    def name(self) -> str:
        """Name for people."""
        return f"{self.least:g}-{self.most:g} OT"

    def score(self, arrived: bool, time: float, optimal: float) -> float:
        """Computes the score of a drive, from 0 to 1 / `least`.

        Args:
            arrived: Whether it reached the target.
            time: How long it took [s].
            optimal: The optimal time [s].
        """
        return optimal / min(max(time, self.least * optimal), self.most * optimal) if arrived else 0.0

    def score_of(self, reference: Reference, drive: EpisodeSummary) -> float:
        """Computes the score of a drive through the world of a reference path."""
        return self.score(drive.ending == "goal", drive.duration, reference.optimal_time)


CLIPPINGS = (
    Clipping(2.0, 8.0, "the challenge's page of 2026; scores above 0.25 are published since 2024"),
    Clipping(4.0, 8.0, "the challenge of 2022, its program run.py and Xiao et al., IEEE RAM 29 (4)"),
)
"""Those in use; scores of different bounds do not compare."""


@dataclass(frozen=True, slots=True)
class BarnRow:
    """Results of a method in all worlds, or in a quarter of them that have similar bottlenecks."""

    method: str
    narrowest: float
    """Smallest bottleneck [m]."""
    widest: float
    """Largest bottleneck [m]."""
    middle: float
    """Median bottleneck [m]."""
    worlds: int
    drives: int
    outcomes: dict[str, Estimate]
    """Proportion of each ending, with its Wilson interval."""
    time: float
    """Time to the target [s], mean over the drives that reach it; NaN if none does."""
    scores: dict[str, Estimate]
    """Mean score with its bootstrap interval, by the name of the clipping."""


@dataclass(frozen=True, slots=True)
class Barn:
    """Drives of several policies through the worlds of the challenge, which are one tier."""

    folder: str
    """The folder of BARN."""
    asked: int | None
    """How many worlds were asked for; None for all."""
    evaluation: Evaluation
    references: Mapping[str, Reference]
    """Reference paths by the files of the worlds."""

    @property
    def title(self) -> str:
        """Simulator, robot and conditions, for people."""
        return self._asked.title(policy.robot for policy in self.evaluation.policies)

    @property
    def tier(self) -> Tier:
        """The worlds."""
        (tier,) = self.evaluation.tiers
        return tier

    @property
    def command(self) -> str:
        """Command line that repeats it."""
        e = self.evaluation
        policies = [policy.path for policy in e.policies if not policy.shielded]
        number = [] if self.asked is None else ["--worlds", str(self.asked)]
        return shell_line("nnql-bullet", "barn", self.folder, *policies, *number, *self._asked.flags)

    @property
    def _asked(self) -> Setting:
        """The setting without what the protocol sets."""
        setting = self.evaluation.setting
        keys = tuple(key for key in setting.keys if key[0] != STEPS)
        return replace(setting, allow_impassable=False, keys=keys)

    def drives(self, policy: Policy) -> list[tuple[Drawn, Reference, EpisodeSummary]]:
        """Returns the drives of a policy that count, each with its world."""
        tier, summaries = self.tier, self.evaluation.drives[policy.name, self.tier.name]
        return [
            (tier.worlds[place], self.references[tier.worlds[place].file], summaries[place])
            for place in self.evaluation.counted(policy, tier)
        ]

    def rows(self, by_bottleneck: bool = False) -> list[BarnRow]:
        """Computes the rows of every method.

        Args:
            by_bottleneck: Whether to split the worlds into quarters, from the narrowest bottlenecks to the widest.
        """
        widths = self._bottlenecks
        everything = (min(widths.values()), max(widths.values()), frozenset(widths))
        parts = quarters(self.evaluation, self.tier) if by_bottleneck else [everything]
        return [self._row(method, *part) for method in self.evaluation.methods for part in parts]

    @property
    def _bottlenecks(self) -> dict[str, float]:
        """Bottlenecks by the hashes of worlds [m]."""
        surveyed = zip(self.tier.worlds, self.evaluation.difficulties[self.tier.name], strict=True)
        return {world.digest: its.bottleneck for world, its in surveyed}

    def _row(self, method: str, narrowest: float, widest: float, digests: frozenset[str]) -> BarnRow:
        drives = [
            (reference, summary)
            for policy in self.evaluation.of_method(method)
            for world, reference, summary in self.drives(policy)
            if world.digest in digests
        ]
        endings = [summary.ending for _, summary in drives]
        times = [summary.duration for _, summary in drives if summary.ending == "goal"]
        return BarnRow(
            method=method,
            narrowest=narrowest,
            widest=widest,
            middle=median(self._bottlenecks[digest] for digest in digests),
            worlds=len(digests),
            drives=len(drives),
            outcomes={ending: proportion(endings.count(ending), len(endings)) for ending in ENDINGS},
            time=fmean(times) if times else float("nan"),
            scores={
                clipping.name: mean_score([clipping.score_of(*drive) for drive in drives], clipping)
                for clipping in CLIPPINGS
            },
        )


def most_steps(decision_period: float) -> int:
    """Computes the number of decisions in the time that a drive may take."""
    return ceil(TIME / decision_period - 1e-9)


def mean_score(scores: Sequence[float], clipping: Clipping) -> Estimate:
    """Estimates the mean score over worlds with its bootstrap interval; that of one drive is all that is possible."""
    value = fmean(scores)
    if len(scores) < 2:
        return Estimate(value, 0.0, 1 / clipping.least)
    if np.ptp(scores) == 0.0:  # the bootstrap refuses constant scores
        return Estimate(value, value, value)
    low, high = mean_interval(np.array(scores), rng(0, Stream.BOOTSTRAP))
    return Estimate(value, float(low), float(high))
