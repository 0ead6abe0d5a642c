"""Trainings: the paper's 1000 episodes from the command line, and NNQL against the DQN of stable-baselines3."""

import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import gymnasium

from nnql_bullet.env import FleetNavigation
from nnql_bullet.experiment import Experiment, RunConfig
from nnql_bullet.training.loop import Training

VEHICLES = {"twin": 64, "bullet": 32}
WARM_UP = 300
"""Steps before the clock starts: DQN learns from its 101st on."""


def paper_training_s(simulator: str, cores: int) -> float:
    """Wall time of the whole command, from typing it to its learning curve [s]."""
    with TemporaryDirectory() as folder:
        command = [sys.executable, "-m", "nnql_bullet", "train", "--sim", simulator, "--out", str(Path(folder, "run"))]
        command += ["--vehicles", str(VEHICLES[simulator]), "--workers", str(cores)]
        begin = time.perf_counter()
        subprocess.run(command, check=True, capture_output=True)
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
    navigation = FleetNavigation(experiment.fleet(1), config.task)
    taken = 0
    for episode in Training(experiment.agent, navigation, experiment.training_world, config.seed).episodes():
        taken += episode.summary.steps
        yield taken
