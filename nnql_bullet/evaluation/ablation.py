"""Trains and tests the variants of a study over seeds, and compares them with the defaults.

Each variant differs from the study's preset in one factor. All variants have the same seeds and worlds, so the defaults
of all factors are one and the same training.
"""

import json
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import islice
from math import inf, nan
from typing import Literal

import numpy as np

from nnql_bullet.config import merged, parse, to_values
from nnql_bullet.evaluation.parts import part_name
from nnql_bullet.evaluation.splits import split_seeds
from nnql_bullet.evaluation.statistics import (
    LEVEL,
    Estimate,
    centre_interval,
    detectable_effect,
    holm,
    least_seeds,
    over_seeds,
    sign_test,
)
from nnql_bullet.evaluation.studies import Factor, Study, Variant
from nnql_bullet.experiment import Experiment
from nnql_bullet.geometry import Array
from nnql_bullet.presets import load_config
from nnql_bullet.rollout import run_episodes
from nnql_bullet.run_config import RunConfig, SimulatorName, changed
from nnql_bullet.sources import files_digest
from nnql_bullet.task import ENDINGS
from nnql_bullet.training.selection import Candidates, finalists, keep, most_goals

CONTACT_VEHICLES = 8
"""Number of vehicles in a test in contact physics; it limits memory."""

Verdict = Literal["default", "better", "worse", "undecided", "exploratory"]
"""What a variant is beside the default; "exploratory" where too few seeds were trained for any verdict."""


@dataclass(frozen=True, slots=True)
class AblationTask:
    """One training and its test."""

    config: str
    """A `RunConfig` as JSON."""
    seed: int
    """Seed of the training."""
    tiers: tuple[str, ...]
    """World files of the test."""
    worlds: int
    """Number of validation worlds in each tier."""
    files: str
    """Hash of what the files say that the configuration names (`files_digest`)."""

    @property
    def size(self) -> int:
        """Number of trainings."""
        return 1

    @property
    def part(self) -> str:
        """See `parts.Piece`."""
        return part_name(__name__, "ablation", self.config, self.worlds, *self.tiers, self.files)


@dataclass(frozen=True, slots=True)
class Counts:
    """Number of drives of a trained policy in a tier by their ending."""

    world: str
    goal: int
    collision: int
    timeout: int
    stuck: int = 0
    overturned: int = 0

    @property
    def drives(self) -> int:
        """Number of all drives."""
        return self.goal + self.collision + self.timeout + self.stuck + self.overturned


@dataclass(frozen=True, slots=True)
class Budget:
    """Amount of training and testing, the same for all variants."""

    simulator: SimulatorName
    seeds: int
    episodes: int
    vehicles: int
    worlds: int


def task_of(study: Study, variant: Variant, seed: int, budget: Budget) -> AblationTask:
    """Makes the task of one variant and training seed."""
    spent = {"simulator": budget.simulator, "vehicles": budget.vehicles, "episodes": budget.episodes, "seed": seed}
    config = load_config(study.preset, merged(merged(spent, study.base), variant.changes))
    tiers, text = tuple(study.tiers), json.dumps(to_values(config), sort_keys=True)
    return AblationTask(text, seed, tiers, budget.worlds, files_digest(config, tiers))


def train_and_test(task: AblationTask) -> list[Counts]:
    """Trains, selects a policy if configured, then drives it through validation worlds in the same simulator."""
    config = parse(RunConfig, json.loads(task.config), "ablation")
    experiment = Experiment(config)
    with closing(experiment.new_training_simulator(workers=1)) as simulator:
        training = experiment.trainer(experiment.new_navigation(simulator))
        agent, selection = experiment.trainable, config.training.selection
        candidates: Candidates = {}
        for done, _ in enumerate(islice(training.episodes(), config.episodes), 1):
            if selection:
                keep(candidates, done, agent, selection)
    if selection:
        candidates = finalists(candidates, config.episodes, agent, selection)
        agent.load_state_dict(candidates[most_goals(experiment.try_out(candidates, workers=1))])
    found = []
    for world in task.tiers:
        vehicles = task.worlds if config.simulator == "kinematic" else min(task.worlds, CONTACT_VEHICLES)
        test = Experiment(changed(config, world=world, vehicles=vehicles))
        differ = test.worlds.is_random or config.conditions.sensor_noise > 0
        worlds = [test.world(seed) for seed in split_seeds("validation", task.worlds if differ else 1)]
        with closing(test.new_simulator(workers=1)) as simulator:
            summaries = run_episodes(experiment.new_navigation(simulator), worlds, experiment.policy)
        endings = [summary.ending for summary in summaries]
        found.append(Counts(world, *(endings.count(ending) for ending in ENDINGS)))
    return found


@dataclass(frozen=True, slots=True)
class Entry:
    """A variant and its results."""

    factor: Factor
    variant: Variant
    success: dict[str, Estimate]
    """Inter-quartile mean of success over seeds in each tier, with its interval over seeds."""
    by_seed: dict[str, tuple[float, ...]]
    """Success of each training seed in each tier."""
    difference: Estimate
    """Difference of success from the default, paired: mean over seeds and tiers, with its exact interval."""
    verdict: Verdict
    p_value: float
    """p of the exact paired test over seeds; NaN for the default."""
    corrected: float
    """That p after Holm's correction over the study; NaN for the default."""
    detectable: float
    """True difference that such a study would find in 80 % of repetitions, at the level of its strictest comparison;
    infinite where it is too small for any verdict, NaN for the default."""


def entries(study: Study, results: Mapping[tuple[str, str], Sequence[Sequence[Counts]]]) -> list[Entry]:
    """Compares every variant of a study with the default of its factor.

    Args:
        study: The study.
        results: Counts of each training seed in each tier, by the names of factor and variant.
    """
    return compared(study, {place: _scores(trainings) for place, trainings in results.items()})


def compared(study: Study, scores: Mapping[tuple[str, str], Array]) -> list[Entry]:
    """Compares every variant of a study with the default of its factor.

    Args:
        study: The study.
        scores: Success of each training seed in each tier (tiers, seeds), by the names of factor and variant.
    """
    pairs = [(factor, variant) for factor in study.factors for variant in factor.variants]
    defaults = {factor.name: scores[factor.name, variant.label] for factor, variant in pairs if not variant.changes}
    differences = [
        (scores[factor.name, variant.label] - defaults[factor.name]).mean(axis=0) for factor, variant in pairs
    ]
    p_values = [
        sign_test(its) if variant.changes else nan for (_, variant), its in zip(pairs, differences, strict=True)
    ]
    corrected = holm(p_values)
    comparisons, seeds = len(pairs) - len(study.factors), len(differences[0])
    enough = seeds >= least_seeds(comparisons)
    effect = detectable_effect(seeds, LEVEL / comparisons) if enough else inf
    found = []
    for (factor, variant), its, p_value, p in zip(pairs, differences, p_values, corrected, strict=True):
        scored, value = dict(zip(study.tiers, scores[factor.name, variant.label], strict=True)), float(its.mean())
        found.append(
            Entry(
                factor=factor,
                variant=variant,
                success={world: over_seeds(row) for world, row in scored.items()},
                by_seed={world: tuple(row.tolist()) for world, row in scored.items()},
                difference=Estimate(value, *centre_interval(its)) if variant.changes else Estimate(0.0, 0.0, 0.0),
                verdict=_verdict(value, p, enough) if variant.changes else "default",
                p_value=p_value,
                corrected=p,
                detectable=(effect * float(np.std(its, ddof=1)) if enough else inf) if variant.changes else nan,
            )
        )
    return found


def _verdict(difference: float, corrected: float, enough: bool) -> Verdict:
    if not enough:
        return "exploratory"
    if corrected > LEVEL:
        return "undecided"
    return "better" if difference > 0 else "worse"


def _scores(trainings: Sequence[Sequence[Counts]]) -> Array:
    """Computes the success of each training seed in each tier (tiers, seeds)."""
    return np.array([[t.goal / t.drives for t in its] for its in trainings]).T
