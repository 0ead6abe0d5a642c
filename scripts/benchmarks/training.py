"""Trainings: the paper's 1000 episodes with many vehicles, and NNQL against the DQN of stable-baselines3."""

import sys
import time
from collections.abc import Iterator
from contextlib import closing
from itertools import islice
from typing import Literal

import gymnasium

from nnql_bullet.env import Navigation
from nnql_bullet.experiment import Experiment
from nnql_bullet.run_config import RunConfig

VEHICLES = 64
WARM_UP = 300
"""Steps before the clock starts: DQN learns from its 101st on."""


def paper_training_s(simulator: Literal["kinematic", "bullet"], cores: int) -> float:
    """Wall time of a whole training, worker processes and the drawing of its worlds included [s]."""
    config = RunConfig(simulator=simulator, vehicles=VEHICLES)
    begin = time.perf_counter()
    experiment = Experiment(config)
    with closing(experiment.new_simulator(cores)) as simulator:
        navigation = Navigation(simulator, config.task)
        training = experiment.trainer(navigation)
        for _ in islice(training.episodes(), config.episodes):
            pass
    return time.perf_counter() - begin


def nnql_over_sb3(slices: int, steps: int) -> float:
    """Training steps a second of NNQL with one vehicle over those of DQN with an update a step (train_freq 1).

    Both act as they learn, in the same contact environment, slices of some steps in turn.
    """
    try:
        from stable_baselines3 import DQN
    except ImportError:
        sys.exit("stable-baselines3 is not installed; install it with: pip install 'nnql-bullet[sb3]'")
    environment = gymnasium.make("nnql_bullet/Tricycle-v0")
    dqn = DQN("MlpPolicy", environment, train_freq=1, seed=0)
    dqn.learn(WARM_UP)
    nnql = nnql_steps()
    total = _until(nnql, WARM_UP)
    taken, spent = {"dqn": 0, "nnql": 0}, {"dqn": 0.0, "nnql": 0.0}
    for _ in range(slices):
        begin, before = time.perf_counter(), dqn.num_timesteps
        dqn.learn(steps, reset_num_timesteps=False)
        between = time.perf_counter()
        done = _until(nnql, total + steps)
        spent["dqn"] += between - begin
        spent["nnql"] += time.perf_counter() - between
        taken["dqn"] += dqn.num_timesteps - before
        taken["nnql"] += done - total
        total = done
    environment.close()
    return (taken["nnql"] / spent["nnql"]) / (taken["dqn"] / spent["dqn"])


def _until(steps: Iterator[int], enough: int) -> int:
    return next(total for total in steps if total >= enough)


def nnql_steps() -> Iterator[int]:
    """Trains NNQL for ever, and yields the number of steps so far after each episode."""
    experiment = Experiment(RunConfig())
    config = experiment.config
    navigation = Navigation(experiment.new_simulator(1), config.task)
    taken = 0
    for episode in experiment.trainer(navigation).episodes():
        taken += episode.summary.steps
        yield taken
