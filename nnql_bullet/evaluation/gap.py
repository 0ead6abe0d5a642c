"""The gap between two simulators: the same policy, worlds and seeds in both, drive by drive."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.evaluation.causes import Explanation, apart, explain, parting
from nnql_bullet.evaluation.policies import Policy
from nnql_bullet.evaluation.splits import Draws
from nnql_bullet.evaluation.statistics import Estimate, mcnemar, proportion
from nnql_bullet.experiment import Experiment
from nnql_bullet.geometry import Array
from nnql_bullet.provenance import made_by
from nnql_bullet.recording import Recorder, Recording
from nnql_bullet.rollout import EpisodeSummary, run_episode
from nnql_bullet.run_config import Conditions, SimulatorName, asked_title
from nnql_bullet.runs import load_policy
from nnql_bullet.setting import Setting
from nnql_bullet.sim.engines import PhysicsName
from nnql_bullet.task import ENDINGS
from nnql_bullet.text import shell_line
from nnql_bullet.worlds.source import World

FAULTS: dict[str, Conditions] = {
    "friction 0.5": Conditions(wheel_friction=0.5),
    "friction 0.6": Conditions(wheel_friction=0.6),
    "friction 0.7": Conditions(wheel_friction=0.7),
    "friction 0.9": Conditions(wheel_friction=0.9),
    "payload 40 kg": Conditions(payload=40.0),
    "payload 80 kg": Conditions(payload=80.0),
    "sensor noise 5 cm": Conditions(sensor_noise=0.05),
    "sensor noise 20 cm": Conditions(sensor_noise=0.20),
    "front sector dead": Conditions(dead_sector=0),
    "front-left sector dead": Conditions(dead_sector=1),
    "left sector dead": Conditions(dead_sector=2),
    "rear sector dead": Conditions(dead_sector=4),
}
"""Conditions that a policy was not trained with, by the name of the fault."""


@dataclass(frozen=True, slots=True)
class Side:
    """One of the two simulators."""

    simulator: SimulatorName
    physics: PhysicsName

    @property
    def name(self) -> str:
        """As it is printed."""
        return self.simulator if self.simulator == "kinematic" else f"{self.simulator}, {self.physics}"

    def notices(self, fault: str) -> bool:
        """Whether a key of `FAULTS` changes anything there."""
        return self.simulator != "kinematic" or FAULTS[fault].sensor_faults.any


@dataclass(frozen=True, slots=True)
class PairTask:
    """One policy through some worlds, in both simulators."""

    policy: Policy
    world: str | World | None
    """Another world than the policy was trained in."""
    seeds: range
    first: Side
    second: Side
    setting: Setting
    """How it drives, in the second simulator."""


@dataclass(frozen=True, slots=True)
class Pair:
    """One world, driven through in both simulators."""

    run: str
    world_seed: int
    first: EpisodeSummary
    second: EpisodeSummary
    times: Array
    """Of the decisions that both came to (m,) [s]."""
    apart: Array
    """How far the vehicles were apart then (m,) [m]."""
    parted: float
    """When they first decided differently [s]; infinite if they never did."""
    explanation: Explanation | None
    """Where they ended differently."""
    recordings: tuple[Recording, ...] = ()
    """Of both drives, where they ended differently."""

    @property
    def flipped(self) -> bool:
        """Whether they ended differently."""
        return self.first.ending != self.second.ending


def drive_pairs(task: PairTask) -> list[Pair]:
    """Drives both sides through each world, and compares them."""
    sides = [_experiment(task, side) for side in (task.first, task.second)]
    pairs = []
    for seed in task.seeds:
        drives = [_drive(experiment, seed) for experiment in sides]
        (first, one), (second, other) = drives
        explanation = None
        if first.ending != second.ending:
            explanation = explain(one, other, sides[0].vehicle, sides[0].config.drive)
        k = parting(one, other)
        times, distances = apart(one, other)
        parted = float(times[k]) if k < len(times) else float("inf")
        kept = (one, other) if explanation else ()
        pairs.append(Pair(task.policy.path, seed, first, second, times, distances, parted, explanation, kept))
    return pairs


def flip_file(folder: Path, run: str, seed: int, side: Side) -> Path:
    """Where the recording of a drive is kept that ended differently on the other side."""
    return folder / f"{run.strip('/').replace('/', '_')}-{seed}-{side.simulator}.npz"


@dataclass(frozen=True, slots=True)
class FaultTask:
    """One policy through some worlds, with something wrong."""

    policy: Policy
    world: str | World | None
    seeds: range
    side: Side
    fault: str
    """A key of `FAULTS`."""
    setting: Setting
    """How it drives, with the fault among its conditions."""


@dataclass(frozen=True, slots=True)
class Trial:
    """One world, driven through with something wrong."""

    run: str
    side: Side
    fault: str
    summary: EpisodeSummary


def drive_faulty(task: FaultTask) -> list[Trial]:
    """Drives through each world with the fault."""
    experiment = _experiment(task, task.side)
    trials = []
    for seed in task.seeds:
        summary = run_episode(experiment.navigation, experiment.world(seed), experiment.policy)
        trials.append(Trial(task.policy.path, task.side, task.fault, summary))
    return trials


def _experiment(task: PairTask | FaultTask, side: Side) -> Experiment:
    return _kept_experiment(task.policy, task.world, side, task.setting)


@lru_cache(maxsize=4)  # so that a worker makes a simulator once, and not again for every few worlds
def _kept_experiment(policy: Policy, world: str | World | None, side: Side, setting: Setting) -> Experiment:
    setting = replace(policy.own(setting), simulator=side.simulator)
    return load_policy(policy.source, {"world": world, **setting.ends, **setting.changes}).experiment


def _drive(experiment: Experiment, seed: int) -> tuple[EpisodeSummary, Recording]:
    recorder = Recorder(experiment.vehicle)
    summary = run_episode(experiment.navigation, experiment.world(seed), experiment.policy, watcher=recorder)
    c = experiment.config
    return summary, recorder.recording(simulator=c.simulator, physics=c.physics, made_by=made_by())


@dataclass(frozen=True, slots=True)
class Gap:
    """Policies, worlds and seeds, in two simulators."""

    runs: tuple[str, ...]
    fingerprints: tuple[str, ...]
    """Of the policies: see `policies.fingerprint`."""
    world: str | None
    """Another world file than the policies were trained in."""
    draws: Draws
    """Which worlds; only the first is driven through where all are the same and nothing is random."""
    first: Side
    second: Side
    pairs: list[Pair]
    trials: list[Trial]
    """With faults; may be empty."""
    setting: Setting
    """How the policies drive, in the second simulator."""
    robots: tuple[str, ...] = ()
    """Names of the vehicles that drive."""

    @property
    def flips(self) -> list[Pair]:
        """What ended differently."""
        return [pair for pair in self.pairs if pair.flipped]

    @property
    def title(self) -> str:
        """The world, and what is asked for in place of the policies' own, in words; empty if that is nothing."""
        return ", ".join(filter(None, (f"world {self.world}" if self.world else "", self.asked)))

    @property
    def asked(self) -> str:
        """What is asked for in place of the policies' own, besides the world."""
        its = self.setting
        shield, plan = "in a shield" if its.shield else "", "with a plan" if its.plan else ""
        return ", ".join(filter(None, (shield, plan, asked_title(its.conditions, its.keys, self.robots))))

    @property
    def command(self) -> str:
        """What measures it again."""
        against = ["--against", self.first.simulator, *([] if self.trials else ["--no-faults"])]
        asked = *self._world, *self.draws.flags, *against, *self.setting.flags
        return shell_line("nnql-bullet", "gap", *self.runs, *asked)

    def replay(self, pair: Pair, side: Side) -> str:
        """The command that drives one side of a pair again, exactly."""
        asked = replace(self.setting, simulator=side.simulator).flags
        return shell_line("nnql-bullet", "drive", pair.run, *self._world, "--seed", str(pair.world_seed), *asked)

    @property
    def _world(self) -> list[str]:
        return ["--world", self.world] if self.world else []


def check(task: PairTask) -> str:
    """Makes each simulator and a world once, so that what is wrong with them shows before anything is driven.

    Returns:
        The robot that will drive.

    Raises:
        UserError: If a simulator or the world cannot be made, or a condition is impossible.
    """
    for side in (task.first, task.second):
        experiment = _kept_experiment.__wrapped__(task.policy, task.world, side, task.setting)
        experiment.simulator.close()
        experiment.world(task.seeds[0])
    return experiment.config.robot


WORLDS_AT_A_TIME = 5


def tasks(
    policies: Sequence[Policy],
    world: str | World | None,
    seeds: Sequence[range],
    first: Side,
    second: Side,
    setting: Setting,
    faults: bool,
) -> list[PairTask | FaultTask]:
    """The work of a comparison, in pieces: every run through every world, on both sides, then with each fault.

    Each policy drives through the worlds of its own seeds. A fault takes the place of the same condition. The kinematic
    model has no friction and no mass: there, only faults of the sensors are tried.
    """
    shares = [
        (policy, its[k : k + WORLDS_AT_A_TIME])
        for policy, its in zip(policies, seeds, strict=True)
        for k in range(0, len(its), WORLDS_AT_A_TIME)
    ]
    pairs = [PairTask(policy, world, chunk, first, second, setting) for policy, chunk in shares]
    wrong = [
        (side, fault, replace(setting, conditions=replace(setting.conditions or Conditions(), **its.changes)))
        for fault, its in FAULTS.items()
        for side in (first, second)
        if faults and side.notices(fault)
    ]
    return [*pairs, *(FaultTask(policy, world, chunk, *its) for its in wrong for policy, chunk in shares)]


def work(task: PairTask | FaultTask) -> list[Pair] | list[Trial]:
    """One piece of it."""
    return drive_pairs(task) if isinstance(task, PairTask) else drive_faulty(task)


def outcome_matrix(pairs: Sequence[Pair]) -> NDArray[np.int64]:
    """How many drives ended how, (5, 5) in the order of `task.ENDINGS`: rows the first side, columns the second."""
    matrix = np.zeros((len(ENDINGS), len(ENDINGS)), np.int64)
    for pair in pairs:
        matrix[ENDINGS.index(pair.first.ending), ENDINGS.index(pair.second.ending)] += 1
    return matrix


def success_p_value(pairs: Sequence[Pair]) -> float:
    """McNemar's exact test of whether one side reaches the target more often."""
    goals = [(pair.first.ending == "goal", pair.second.ending == "goal") for pair in pairs]
    return mcnemar(goals.count((True, False)), goals.count((False, True)))


@dataclass(frozen=True, slots=True)
class Divergence:
    """How far two drives through one world are apart as time goes on, over all pairs that still drive."""

    time: Array
    """(m,) [s]"""
    median: Array
    """(m,) [m]"""
    ninetieth: Array
    """90 % of the pairs are no farther apart (m,) [m]."""
    parted: Array
    """Share of all pairs that have decided differently by then (m,)."""
    driving: NDArray[np.int64]
    """Pairs in which both still drive (m,)."""


def divergence(pairs: Sequence[Pair]) -> Divergence:
    """At every decision, as long as half of the pairs still drive."""
    steps = max(len(pair.times) for pair in pairs)
    distances = np.full((len(pairs), steps), np.nan)
    for row, pair in zip(distances, pairs, strict=True):
        row[: len(pair.apart)] = pair.apart
    driving = np.sum(np.isfinite(distances), axis=0)
    m = int(np.sum(driving >= 0.5 * len(pairs)))
    quantiles: Array = np.asarray(np.nanquantile(distances[:, :m], (0.5, 0.9), axis=0), np.float64)
    time = max((pair.times for pair in pairs), key=len)[:m]
    parted: Array = np.mean(np.array([pair.parted for pair in pairs])[:, None] <= time + 1e-9, axis=0, dtype=np.float64)
    return Divergence(time, quantiles[0], quantiles[1], parted, driving[:m])


@dataclass(frozen=True, slots=True)
class Difference:
    """Second side less first, over drives that reached the target in both."""

    quantity: str
    unit: str
    mean: float
    low: float
    """A tenth of the drives differ by less than this."""
    high: float
    """A tenth of the drives differ by more than this."""


def differences(pairs: Sequence[Pair]) -> list[Difference]:
    """In time, path and smallest clearance."""
    both = [pair for pair in pairs if pair.first.ending == pair.second.ending == "goal"]
    if not both:
        return []
    rows = []
    for quantity, unit, name in (
        ("time to the target", "s", "duration"),
        ("path length", "m", "path_length"),
        ("smallest clearance", "m", "clearance"),
    ):
        values = [getattr(pair.second, name) - getattr(pair.first, name) for pair in both]
        low, high = np.quantile(values, (0.1, 0.9))
        rows.append(Difference(quantity, unit, float(np.mean(values)), float(low), float(high)))
    return rows


@dataclass(frozen=True, slots=True)
class FaultRow:
    """What a policy makes of a fault."""

    fault: str
    """Empty for none."""
    shares: dict[str, Estimate]
    """Of each ending, on the second side."""
    p_value: float
    """McNemar's, against the same drives without the fault."""
    first_goal: Estimate | None
    """Success on the first side; None where the fault changes nothing there."""


def fault_rows(gap: Gap) -> list[FaultRow]:
    """Success by fault; the first row is without one."""
    sound = {(pair.run, pair.world_seed): pair.second.ending for pair in gap.pairs}
    rows = [FaultRow("", _shares(list(sound.values())), 1.0, _goals([pair.first.ending for pair in gap.pairs]))]
    for fault in dict.fromkeys(trial.fault for trial in gap.trials):
        trials = [trial for trial in gap.trials if trial.fault == fault]
        first = [trial.summary.ending for trial in trials if trial.side == gap.first]
        endings = {(t.run, t.summary.world_seed): t.summary.ending for t in trials if t.side == gap.second}
        goals = [(sound[key] == "goal", ending == "goal") for key, ending in endings.items()]
        p_value = mcnemar(goals.count((True, False)), goals.count((False, True)))
        rows.append(FaultRow(fault, _shares(list(endings.values())), p_value, _goals(first)))
    return rows


def _goals(endings: Sequence[str]) -> Estimate | None:
    return proportion(endings.count("goal"), len(endings)) if endings else None


def _shares(endings: Sequence[str]) -> dict[str, Estimate]:
    return {ending: proportion(endings.count(ending), len(endings)) for ending in ENDINGS}
