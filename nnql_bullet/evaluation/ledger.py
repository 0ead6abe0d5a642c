"""What the paper leaves open, choice by choice: the alternatives, trained and tested over seeds, and what that decides.

Each alternative departs from the preset `paper` in one thing and is trained from the same seeds, in the same worlds; so
the default of every choice is one and the same training. What the paper states is varied too, and marked.
"""

import json
from collections.abc import Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import islice
from typing import Any, Literal

import numpy as np
from scipy.stats import bootstrap

from nnql_bullet.config import parse, to_values
from nnql_bullet.env import FleetNavigation
from nnql_bullet.evaluation.parts import part_name
from nnql_bullet.evaluation.splits import split_seeds
from nnql_bullet.evaluation.statistics import RESAMPLES, Share, seeds_share
from nnql_bullet.experiment import PRESETS, Experiment, RunConfig, SimulatorName, changed, load_config
from nnql_bullet.geometry import Array
from nnql_bullet.rollout import run_episodes
from nnql_bullet.seeding import Stream, rng
from nnql_bullet.task import ENDINGS
from nnql_bullet.training.selection import Candidates, finalists, keep, most_goals

TIERS = {"paper": "5 % cover", "cover_10": "10 % cover"}
"""World files that policies are tested in."""
CONTACT_FLEET = 8
"""Vehicles that are tested at a time in contact physics, where each takes 34 MB."""

Verdict = Literal["default", "better", "worse", "undecided"]


@dataclass(frozen=True)
class Alternative:
    """One way to read the paper."""

    label: str
    changes: Mapping[str, Any]
    """To the preset; none for the default."""


@dataclass(frozen=True)
class Choice:
    """A point that the paper leaves open, or a number that it states."""

    name: str
    question: str
    section: str
    """Of the paper."""
    alternatives: tuple[Alternative, ...]
    """The default among them is the one without changes."""
    stated: bool = False
    """Whether the paper states the default."""


def _drive(**values: Any) -> dict[str, Any]:
    return {"drive": values}


def _task(**values: Any) -> dict[str, Any]:
    return {"task": values}


def _agent(**values: Any) -> dict[str, Any]:
    return {"agent": values}


_DEFAULT: dict[str, Any] = {}


def _alternatives(*pairs: tuple[str, Mapping[str, Any]]) -> tuple[Alternative, ...]:
    return tuple(Alternative(label, changes) for label, changes in pairs)


CHOICES = (
    Choice(
        "period",
        "how long is one step",
        "II.C",
        _alternatives(
            ("0.25 s", _drive(decision_period=0.25)),
            ("0.5 s", _DEFAULT),
            ("0.75 s", _drive(decision_period=0.75)),
            ("1 s", _drive(decision_period=1.0)),
        ),
    ),
    Choice(
        "front",
        "non-safe: front sector below",
        "II.C",
        _alternatives(
            ("3.5 m", _task(front_distance=3.5)),
            ("4.25 m", _task(front_distance=4.25)),
            ("5 m", _DEFAULT),
            ("6 m", _task(front_distance=6.0)),
            ("7 m", _task(front_distance=7.0)),
        ),
    ),
    Choice(
        "front_sides",
        "non-safe: front sides below",
        "II.C",
        _alternatives(
            ("1.75 m", _task(front_side_distance=1.75)),
            ("2.5 m", _task(front_side_distance=2.5)),
            ("3.5 m", _DEFAULT),
            ("4.25 m", _task(front_side_distance=4.25)),
            ("5 m", _task(front_side_distance=5.0)),
        ),
    ),
    Choice(
        "others",
        "non-safe: other sectors below",
        "II.C",
        _alternatives(
            ("not asked", _DEFAULT),
            ("2 m", _task(other_distance=2.0)),
            ("all eight 4 m", _task(front_distance=4.0, front_side_distance=4.0, other_distance=4.0)),
        ),
    ),
    Choice(
        "hysteresis",
        "safe again: farther by",
        "II.C",
        _alternatives(("0 m", _DEFAULT), ("1 m", _task(hysteresis=1.0))),
    ),
    Choice(
        "reading",
        "a sensor reads",
        "II.A",
        _alternatives(("the nearest of 9 rays", _DEFAULT), ("its middle ray", _task(sector_reading="middle"))),
    ),
    Choice(
        "encoding",
        "no obstacle is d = 0",
        "II.B",
        _alternatives(("1 - d/10", _DEFAULT), ("d/10, 0 if none", _agent(encoding="distance"))),
    ),
    Choice(
        "reward",
        "reward, non-safe to safe (illegible)",
        "II.C",
        _alternatives(
            ("0.2", _task(reward_non_safe_to_safe=0.2)),
            ("0.4", _DEFAULT),
            ("1", _task(reward_non_safe_to_safe=1.0)),
        ),
    ),
    Choice(
        "closer",
        "closer to the obstacles: what fell",
        "II.C",
        _alternatives(("the smallest reading", _DEFAULT), ("the mean reading", _task(closer="mean"))),
    ),
    Choice(
        "step",
        "step of gradient descent",
        "III.B",
        _alternatives(
            ("0.1", _agent(gradient_step=0.1)),
            ("0.4", _DEFAULT),
            ("1.5", _agent(gradient_step=1.5)),
            ("5", _agent(gradient_step=5.0)),
            ("15", _agent(gradient_step=15.0)),
        ),
    ),
    Choice(
        "schedule",
        "how the temperature falls",
        "II.E",
        _alternatives(
            ("linearly", _DEFAULT),
            ("linearly, by episode 600", _agent(schedule_episodes=600)),
            ("exponentially", _agent(schedule="exponential")),
        ),
    ),
    Choice(
        "safe_steps",
        "safe steps teach the network",
        "III.C",
        _alternatives(("no", _DEFAULT), ("yes", _agent(learn_in_safe_states=True))),
    ),
    Choice(
        "weights",
        "initial weights: hidden, output",
        "III.B",
        _alternatives(
            ("1, 0.1", _DEFAULT),
            ("0.3, 0.1", _agent(hidden_weights=0.3)),
            ("3, 0.1", _agent(hidden_weights=3.0)),
            ("1, 1", _agent(output_weights=1.0)),
        ),
    ),
    Choice(
        "cover",
        "boxes in training",
        "IV",
        _alternatives(
            ("2.5 % cover", {"world": "cover_2.5"}),
            ("5 % cover", _DEFAULT),
            ("7.5 % cover", {"world": "cover_7.5"}),
            ("10 % cover", {"world": "cover_10"}),
        ),
    ),
    Choice(
        "vehicles",
        "vehicles that learn at once",
        "-",
        _alternatives(("1", {"vehicles": 1}), ("8", {"vehicles": 8}), ("64", _DEFAULT)),
    ),
    Choice(
        "discount",
        "discount",
        "IV",
        _alternatives(
            ("0", _agent(discount=0.0)),
            ("0.15", _DEFAULT),
            ("0.5", _agent(discount=0.5)),
            ("0.9", _agent(discount=0.9)),
        ),
        stated=True,
    ),
    Choice(
        "temperature",
        "temperature",
        "IV",
        _alternatives(
            ("0.8 to 0.01", _DEFAULT),
            (
                "0.2 to 0.03, exponentially, by episode 600",
                _agent(temperature_max=0.2, temperature_min=0.03, schedule="exponential", schedule_episodes=600),
            ),
        ),
        stated=True,
    ),
    Choice(
        "hidden",
        "hidden units",
        "IV",
        _alternatives(("3", _agent(hidden_units=3)), ("6", _DEFAULT), ("12", _agent(hidden_units=12))),
        stated=True,
    ),
    Choice(
        "steps",
        "steps in an episode",
        "IV.A",
        _alternatives(("250", _task(max_steps=250)), ("500", _DEFAULT)),
        stated=True,
    ),
    Choice(
        "letter",
        "all open points at once",
        "-",
        _alternatives(("preset paper", _DEFAULT), ("preset literal", PRESETS["literal"])),
    ),
)
"""In the order of the table."""


@dataclass(frozen=True, slots=True)
class LedgerTask:
    """One training and its test."""

    config: str
    """A `RunConfig` as JSON."""
    seed: int
    """Of the training."""
    worlds: int
    """Validation worlds of each tier."""

    @property
    def size(self) -> int:
        """One training."""
        return 1

    @property
    def part(self) -> str:
        """See `parts.Piece`."""
        return part_name("ledger", self.config, self.worlds, *TIERS)


@dataclass(frozen=True, slots=True)
class Counts:
    """How drives of a trained policy ended in a tier, as counts."""

    world: str
    goal: int
    collision: int
    timeout: int


@dataclass(frozen=True, slots=True)
class Budget:
    """How much is trained and tested, the same for every alternative."""

    simulator: SimulatorName
    seeds: int
    episodes: int
    vehicles: int
    worlds: int


def task_of(alternative: Alternative, seed: int, budget: Budget) -> LedgerTask:
    """The work of one alternative and training seed."""
    base = {"simulator": budget.simulator, "vehicles": budget.vehicles, "episodes": budget.episodes}
    config = load_config("paper", {**base, **alternative.changes, "seed": seed})
    return LedgerTask(json.dumps(to_values(config), sort_keys=True), seed, budget.worlds)


def train_and_test(task: LedgerTask) -> list[Counts]:
    """Trains, selects if so configured, then drives greedily through validation worlds, in the same simulator."""
    config = parse(RunConfig, json.loads(task.config), "ledger")
    experiment = Experiment(config)
    with closing(experiment.training_fleet(workers=1)) as fleet:
        training = experiment.trainer(FleetNavigation(fleet, config.task))
        agent, selection = experiment.taught, config.training.selection
        candidates: Candidates = {}
        for done, _ in enumerate(islice(training.episodes(), config.episodes), 1):
            if selection:
                keep(candidates, done, agent, selection)
    if selection:
        candidates = finalists(candidates, config.episodes, agent, selection)
        agent.load(candidates[most_goals(experiment.try_out(candidates, workers=1))])
    found = []
    for world in TIERS:
        vehicles = task.worlds if config.simulator == "twin" else min(task.worlds, CONTACT_FLEET)
        test = Experiment(changed(config, world=world, vehicles=vehicles))
        worlds = [test.world(seed) for seed in split_seeds("validation", task.worlds)]
        with closing(test.fleet(workers=1)) as fleet:
            summaries = run_episodes(FleetNavigation(fleet, config.task), worlds, experiment.agent)
        endings = [summary.ending for summary in summaries]
        found.append(Counts(world, *(endings.count(ending) for ending in ENDINGS)))
    return found


@dataclass(frozen=True, slots=True)
class Entry:
    """An alternative, and what came of it."""

    choice: Choice
    alternative: Alternative
    success: dict[str, Share | None]
    """In each tier: inter-quartile mean over seeds with its interval; None with a single seed."""
    by_seed: dict[str, tuple[float, ...]]
    """In each tier, of each training seed."""
    difference: Share
    """Of success against the default: mean over seeds and tiers of paired differences, with a bootstrap interval."""
    verdict: Verdict


def entries(choices: Sequence[Choice], results: Mapping[tuple[str, str], Sequence[Sequence[Counts]]]) -> list[Entry]:
    """The ledger.

    Args:
        choices: In order.
        results: Of each alternative, by the names of choice and alternative: what each training seed came to.
    """
    found = []
    for choice in choices:
        (default,) = [alternative for alternative in choice.alternatives if not alternative.changes]
        base = _scores(results[choice.name, default.label])
        for alternative in choice.alternatives:
            scores = _scores(results[choice.name, alternative.label])
            difference = _difference(scores - base)
            found.append(
                Entry(
                    choice=choice,
                    alternative=alternative,
                    success={
                        world: seeds_share([row], rng(0, Stream.BOOTSTRAP))
                        for world, row in zip(TIERS, scores, strict=True)
                    },
                    by_seed={world: tuple(row.tolist()) for world, row in zip(TIERS, scores, strict=True)},
                    difference=difference,
                    verdict=_verdict(alternative is default, difference),
                )
            )
    return found


def _scores(trainings: Sequence[Sequence[Counts]]) -> Array:
    """Success of each training seed in each tier (tiers, seeds)."""
    return np.array([[t.goal / (t.goal + t.collision + t.timeout) for t in training] for training in trainings]).T


def _difference(differences: Array) -> Share:
    """The mean of paired differences (tiers, seeds), with a bootstrap interval over seeds."""
    by_seed = differences.mean(axis=0)
    value = float(by_seed.mean())
    if len(by_seed) < 2 or np.ptp(by_seed) == 0:
        return Share(value, value, value)
    generator = rng(0, Stream.BOOTSTRAP)
    result = bootstrap((by_seed,), np.mean, n_resamples=RESAMPLES, method="percentile", rng=generator)
    return Share(value, float(result.confidence_interval.low), float(result.confidence_interval.high))


def _verdict(is_default: bool, difference: Share) -> Verdict:
    if is_default:
        return "default"
    if difference.low > 0:
        return "better"
    return "worse" if difference.high < 0 else "undecided"
