"""Factor by factor: the variants, trained and tested over seeds, and what that decides.

Each variant departs from the preset of its study in one thing and is trained from the same seeds, in the same
worlds; so the default of every factor is one and the same training.
"""

import json
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import islice
from typing import Literal

import numpy as np
from scipy.stats import bootstrap

from nnql_bullet.config import merged, parse, to_values
from nnql_bullet.env import Navigation
from nnql_bullet.evaluation.parts import part_name
from nnql_bullet.evaluation.splits import split_seeds
from nnql_bullet.evaluation.statistics import RESAMPLES, Estimate, success_over_seeds
from nnql_bullet.evaluation.studies import Factor, Study, Variant
from nnql_bullet.experiment import Experiment
from nnql_bullet.geometry import Array
from nnql_bullet.presets import load_config
from nnql_bullet.rollout import run_episodes
from nnql_bullet.run_config import RunConfig, SimulatorName, changed
from nnql_bullet.seeding import Stream, rng
from nnql_bullet.task import ENDINGS
from nnql_bullet.training.selection import Candidates, finalists, keep, most_goals

CONTACT_VEHICLES = 8
"""Vehicles that are tested at a time in contact physics, where each takes 34 MB."""

Verdict = Literal["default", "better", "worse", "undecided"]


@dataclass(frozen=True, slots=True)
class AblationTask:
    """One training and its test."""

    config: str
    """A `RunConfig` as JSON."""
    seed: int
    """Of the training."""
    tiers: tuple[str, ...]
    """World files that it is tested in."""
    worlds: int
    """Validation worlds of each tier."""

    @property
    def size(self) -> int:
        """One training."""
        return 1

    @property
    def part(self) -> str:
        """See `parts.Piece`."""
        return part_name("ablation", self.config, self.worlds, *self.tiers)


@dataclass(frozen=True, slots=True)
class Counts:
    """How drives of a trained policy ended in a tier, as counts."""

    world: str
    goal: int
    collision: int
    timeout: int


@dataclass(frozen=True, slots=True)
class Budget:
    """How much is trained and tested, the same for every variant."""

    simulator: SimulatorName
    seeds: int
    episodes: int
    vehicles: int
    worlds: int


def task_of(study: Study, variant: Variant, seed: int, budget: Budget) -> AblationTask:
    """The work of one variant and training seed."""
    spent = {"simulator": budget.simulator, "vehicles": budget.vehicles, "episodes": budget.episodes, "seed": seed}
    config = load_config(study.preset, merged(merged(spent, study.base), variant.changes))
    return AblationTask(json.dumps(to_values(config), sort_keys=True), seed, tuple(study.tiers), budget.worlds)


def train_and_test(task: AblationTask) -> list[Counts]:
    """Trains, selects if so configured, then drives greedily through validation worlds, in the same simulator."""
    config = parse(RunConfig, json.loads(task.config), "ablation")
    experiment = Experiment(config)
    with closing(experiment.new_training_simulator(workers=1)) as simulator:
        training = experiment.trainer(Navigation(simulator, config.task))
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
        worlds = [test.world(seed) for seed in split_seeds("validation", task.worlds)]
        with closing(test.new_simulator(workers=1)) as simulator:
            summaries = run_episodes(Navigation(simulator, config.task), worlds, experiment.agent)
        endings = [summary.ending for summary in summaries]
        found.append(Counts(world, *(endings.count(ending) for ending in ENDINGS)))
    return found


@dataclass(frozen=True, slots=True)
class Entry:
    """An variant, and what came of it."""

    factor: Factor
    variant: Variant
    success: dict[str, Estimate | None]
    """In each tier: inter-quartile mean over seeds with its interval; None with a single seed."""
    by_seed: dict[str, tuple[float, ...]]
    """In each tier, of each training seed."""
    difference: Estimate
    """Of success against the default: mean over seeds and tiers of paired differences, with a bootstrap interval."""
    verdict: Verdict


def entries(study: Study, results: Mapping[tuple[str, str], Sequence[Sequence[Counts]]]) -> list[Entry]:
    """The ablation.

    Args:
        study: Its factors, in order.
        results: Of each variant, by the names of factor and variant: what each training seed came to.
    """
    found = []
    for factor in study.factors:
        (default,) = [variant for variant in factor.variants if not variant.changes]
        base = _scores(results[factor.name, default.label])
        for variant in factor.variants:
            scores = _scores(results[factor.name, variant.label])
            difference = _difference(scores - base)
            found.append(
                Entry(
                    factor=factor,
                    variant=variant,
                    success={
                        world: success_over_seeds([row], rng(0, Stream.BOOTSTRAP))
                        for world, row in zip(study.tiers, scores, strict=True)
                    },
                    by_seed={world: tuple(row.tolist()) for world, row in zip(study.tiers, scores, strict=True)},
                    difference=difference,
                    verdict=_verdict(variant is default, difference),
                )
            )
    return found


def _scores(trainings: Sequence[Sequence[Counts]]) -> Array:
    """Success of each training seed in each tier (tiers, seeds)."""
    return np.array([[t.goal / (t.goal + t.collision + t.timeout) for t in training] for training in trainings]).T


def _difference(differences: Array) -> Estimate:
    """The mean of paired differences (tiers, seeds), with a bootstrap interval over seeds."""
    by_seed = differences.mean(axis=0)
    value = float(by_seed.mean())
    if len(by_seed) < 2 or np.ptp(by_seed) == 0:
        return Estimate(value, value, value)
    generator = rng(0, Stream.BOOTSTRAP)
    result = bootstrap((by_seed,), np.mean, n_resamples=RESAMPLES, method="percentile", rng=generator)
    return Estimate(value, float(result.confidence_interval.low), float(result.confidence_interval.high))


def _verdict(is_default: bool, difference: Estimate) -> Verdict:
    if is_default:
        return "default"
    if difference.low > 0:
        return "better"
    return "worse" if difference.high < 0 else "undecided"
