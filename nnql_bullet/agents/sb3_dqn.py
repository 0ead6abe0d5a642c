"""The network of a DQN of stable-baselines3, driven without that library; `training.sb3` trains it."""

from math import pi
from typing import Annotated, Literal

import numpy as np
import torch
from numpy.typing import NDArray
from pydantic import Field

from nnql_bullet import paper
from nnql_bullet.agents.base import Memoryless
from nnql_bullet.config import options
from nnql_bullet.env import ACTIONS, Observations, as_numbers
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array
from nnql_bullet.seeding import Stream, fenced, rng

SCALE = np.array([paper.SENSOR_RANGE] * paper.SECTORS + [paper.ARENA_SIDE, pi, 1.0], np.float32)


INPUTS = len(SCALE)


@options
class Sb3DqnOptions:
    kind: Literal["sb3_dqn"] = "sb3_dqn"
    hidden: tuple[Annotated[int, Field(ge=1)], ...] = (64, 64)
    learning_rate: float = 1e-4
    discount: float = 0.99
    buffer_size: int = 1_000_000
    learning_starts: int = 100
    batch_size: int = 32
    steps_per_update: int = 4
    target_update_steps: int = 10_000
    exploration_steps: int = 12_000
    exploration_final: float = 0.05
    scaled: bool = True

    def exploration(self, steps: int) -> float:
        """Share of random actions after so many steps of learning."""
        return max(self.exploration_final, 1.0 - (1.0 - self.exploration_final) * steps / self.exploration_steps)


class Sb3Dqn(Memoryless):
    def __init__(self, options: Sb3DqnOptions, seed: int) -> None:
        self.options = options
        sizes = [len(SCALE), *options.hidden]
        with fenced(rng(seed, Stream.WEIGHTS)):
            layers: list[torch.nn.Module] = []
            for wide, narrow in zip(sizes[:-1], sizes[1:], strict=True):
                layers += [torch.nn.Linear(wide, narrow), torch.nn.ReLU()]
            self.network = torch.nn.Sequential(*layers, torch.nn.Linear(sizes[-1], ACTIONS))

    def exploit(self, observations: Observations) -> NDArray[np.int64]:
        return np.asarray(self._values(observations).argmax(axis=-1))

    def action_values(self, observations: Observations) -> Array:
        return self._values(observations)[:, : len(paper.TURNS)].astype(np.float64)

    def _values(self, observations):
        with torch.no_grad():
            return self.network(torch.from_numpy(inputs(observations, self.options.scaled))).numpy()

    def arrays(self) -> dict[str, Array]:
        return {name: value.numpy().copy() for name, value in self.network.state_dict().items()}

    def load(self, arrays: dict[str, Array]) -> None:
        mine = {name: value.shape for name, value in self.arrays().items()}
        theirs = {name: value.shape for name, value in arrays.items()}
        if mine != theirs or not all(np.isfinite(value).all() for value in arrays.values()):
            raise UserError("these are not the weights")
        self.network.load_state_dict({name: torch.from_numpy(np.array(value)) for name, value in arrays.items()})


def inputs(observations: Observations, scaled=True) -> NDArray[np.float32]:
    return as_numbers(observations) / SCALE if scaled else as_numbers(observations)
