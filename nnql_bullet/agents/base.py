"""What an agent is to the loop that runs it."""

from typing import Protocol

import numpy as np

from nnql_bullet.env import Observation, Transition
from nnql_bullet.geometry import Array


class Agent(Protocol):
    """Chooses among the environment's six actions, and learns from what comes of it."""

    def begin_episode(self, episode: int) -> None:
        """Told before each training episode, counted from 0."""

    def explore(self, observation: Observation, rng: np.random.Generator) -> int:
        """An action for learning."""

    def exploit(self, observation: Observation) -> int:
        """The action the agent holds best."""

    def action_values(self, observation: Observation) -> Array:
        """What it expects of the paper's five turns (5,); NaN where it did not ask itself."""

    def learn(self, transition: Transition) -> float | None:
        """Learns from one step; the temporal-difference error, or None where there was nothing to learn."""

    def diagnostics(self) -> dict[str, float]:
        """Named numbers of the present episode for the log."""

    def arrays(self) -> dict[str, Array]:
        """Everything that learning changes, by name: what a checkpoint keeps."""

    def load(self, arrays: dict[str, Array]) -> None:
        """Takes back what `arrays` gave.

        Raises:
            UserError: If these are not arrays of such an agent.
        """
