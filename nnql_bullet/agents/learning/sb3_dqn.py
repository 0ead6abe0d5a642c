"""A DQN of stable-baselines3, driven without that library; `sb3_training` trains it, and retrains it on resuming."""

from collections.abc import Callable
from itertools import pairwise
from math import pi
from typing import Annotated, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field

from nnql_bullet import paper
from nnql_bullet.agents.base import NoMemory
from nnql_bullet.agents.learning import weights
from nnql_bullet.config import options
from nnql_bullet.env import ACTIONS, Navigation, Observation, as_numbers
from nnql_bullet.errors import missing_library
from nnql_bullet.geometry import Array
from nnql_bullet.rollout import Actions
from nnql_bullet.seeding import Stream, fenced, rng
from nnql_bullet.training.base import Trainer
from nnql_bullet.types import BatchSize, BufferSize, Count, Layers, Positive, UnitInterval
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.scale import length_scale
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.spec import WorldSpec

SCALE = np.array([*[paper.SENSOR_RANGE] * paper.SECTORS, paper.ARENA_SIDE, pi, 1.0], np.float32)
"""What the environment's 11 numbers are divided by, so that all inputs are of order one."""
INPUTS = len(SCALE)
DISTANCES = paper.SECTORS + 1
"""How many of them, the first, are distances."""


@options
class Sb3DqnOptions:
    """The hyper-parameters that differ from the library's defaults, or matter most; they were hardly tuned."""

    kind: Literal["sb3_dqn"] = "sb3_dqn"
    hidden: Layers = (64, 64)
    """Units of the hidden layers."""
    learning_rate: Positive = 5e-4
    """Learning rate of Adam; the library's default is 1e-4."""
    discount: UnitInterval = 0.9
    """gamma; the library's default is 0.99."""
    buffer_size: BufferSize = 1_000_000
    """Steps in the replay buffer."""
    learning_starts: Annotated[int, Field(ge=0, le=1_000_000_000)] = 100
    """Steps before the first update."""
    batch_size: BatchSize = 32
    """Steps that an update learns from."""
    steps_per_update: Count = 4
    """Steps, of all vehicles together, from one update to the next."""
    target_update_steps: Count = 500
    """Steps after which the target network is renewed; the library's default is 10 000."""
    exploration_steps: Count = 12_000
    """Steps over which the probability of a random action falls from 1, linearly. They do not follow the number of
    training episodes, so that a run can be resumed."""
    exploration_final: UnitInterval = 0.05
    """Probability of a random action after that."""

    def training_memory(self, vehicles: int) -> int:
        """Memory that a training needs at least: its buffer, which keeps what is seen twice, and weights [bytes]."""
        del vehicles
        weights = sum(one * other for one, other in pairwise((INPUTS, *self.hidden, ACTIONS)))
        return self.buffer_size * (2 * 4 * INPUTS + 16) + 16 * weights

    def exploration(self, steps: int) -> float:
        """Probability of a random action after so many steps."""
        progress = min(steps / self.exploration_steps, 1.0)
        return 1.0 + (self.exploration_final - 1.0) * progress

    def make_agent(self, seed: int, vehicle: VehicleSpec, drive: DriveOptions) -> "Sb3Dqn":
        """Builds the agent."""
        return Sb3Dqn(self, seed, length_scale(vehicle.footprint))


class Sb3Dqn(NoMemory):
    """Chooses among all six actions at every step, by what the environment's 11 numbers are worth to the network."""

    def __init__(self, options: Sb3DqnOptions, seed: int, scale: float = 1.0) -> None:
        self.options, self.scale = options, scale
        widths = [INPUTS, *options.hidden]
        with fenced(rng(seed, Stream.WEIGHTS)):
            hidden = [layer for sizes in pairwise(widths) for layer in (torch.nn.Linear(*sizes), torch.nn.ReLU())]
            self.network = torch.nn.Sequential(*hidden, torch.nn.Linear(widths[-1], ACTIONS))

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
        weights.load_state_dict(self.network, arrays, "a network", (INPUTS, *self.options.hidden, ACTIONS))

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
