"""A DQN of stable-baselines3, driven without that library; `sb3_training` trains it, and retrains it on resuming."""

from collections.abc import Callable
from itertools import pairwise
from math import pi

import numpy as np
import torch
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.agents.base import NoMemory
from nnql_bullet.agents.learning import weights
from nnql_bullet.agents.learning.options import SB3_INPUTS, Sb3DqnOptions
from nnql_bullet.env import ACTIONS, Navigation, Observation, as_numbers
from nnql_bullet.errors import missing_library
from nnql_bullet.geometry import Array
from nnql_bullet.rollout import Actions
from nnql_bullet.seeding import Stream, fenced, rng
from nnql_bullet.training.base import Trainer
from nnql_bullet.worlds.spec import WorldSpec

SCALE = np.array([*[paper.SENSOR_RANGE] * paper.SECTORS, paper.ARENA_SIDE, pi, 1.0], np.float32)
"""What the environment's 11 numbers are divided by, so that all inputs are of order one."""
DISTANCES = paper.SECTORS + 1
"""How many of them, the first, are distances."""


class Sb3Dqn(NoMemory):
    """Chooses among all six actions at every step, by what the environment's 11 numbers are worth to the network."""

    def __init__(self, options: Sb3DqnOptions, seed: int, scale: float = 1.0) -> None:
        self.options, self.scale = options, scale
        widths = [SB3_INPUTS, *options.hidden]
        with fenced(rng(seed, Stream.WEIGHTS)):
            hidden = [layer for sizes in pairwise(widths) for layer in (torch.nn.Linear(*sizes), torch.nn.ReLU())]
            self.network = torch.nn.Sequential(*hidden, torch.nn.Linear(widths[-1], ACTIONS))
        self.start: dict[str, Array] | None = None
        """Weights that it was given last, which a training begins with; by default with the library's."""

    def act(self, observations: Observation, state: None) -> tuple[Actions, None]:
        """Chooses the action with the largest Q-value."""
        return np.asarray(self._values(observations).argmax(axis=-1)), None

    def action_values(self, observations: Observation, state: None) -> Array:
        """Q(s, a) of the five turns (n, 5), the turn toward the target left out."""
        return self._values(observations)[:, : len(paper.TURNS)]

    def state_dict(self) -> dict[str, Array]:
        """Weights and biases, layer by layer."""
        return weights.state_dict(self.network)

    def load_state_dict(self, arrays: dict[str, Array]) -> None:
        """Replaces weights and biases."""
        weights.load_state_dict(self.network, arrays, "a network", (SB3_INPUTS, *self.options.hidden, ACTIONS))
        self.start = arrays

    def make_trainer(self, navigation: Navigation, world_of: Callable[[int], WorldSpec], seed: int) -> Trainer:
        """Builds the training.

        Raises:
            UserError: If stable-baselines3 is not installed.
        """
        try:
            from nnql_bullet.agents.learning.sb3_training import DqnTraining
        except ImportError:
            raise missing_library("stable-baselines3", "sb3") from None
        return DqnTraining(self, navigation, world_of, seed)

    def _values(self, observations: Observation) -> Array:
        """Q(s, a) of the six actions (n, 6)."""
        with torch.no_grad():
            values: Array = self.network(torch.from_numpy(inputs(observations, self.scale))).numpy().astype(np.float64)
        return values


def inputs(observations: Observation, scale: float) -> NDArray[np.float32]:
    """What the network of a vehicle of a scale sees (n, 11)."""
    numbers = as_numbers(observations) / SCALE
    numbers[:, :DISTANCES] /= scale
    return numbers
