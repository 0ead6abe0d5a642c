"""What an agent is to the loop that runs it."""

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.env import Observations, Transitions
from nnql_bullet.geometry import Array


class Agent(Protocol):
    """Chooses among the environment's six actions for each of n vehicles, and learns from what comes of it."""

    def explore(self, observations: Observations, episodes: NDArray[np.int64], uniforms: Array) -> NDArray[np.int64]:
        """Actions (n,) for learning.

        Args:
            observations: Of n vehicles.
            episodes: Which training episode each is in (n,), counted from 0.
            uniforms: All the chance there is: a number in [0, 1) for each (n,).
        """

    def exploit(self, observations: Observations) -> NDArray[np.int64]:
        """The actions (n,) that the agent holds best."""

    def action_values(self, observations: Observations) -> Array:
        """What it expects of the paper's five turns (n, 5); NaN where it did not ask itself."""

    def learn(self, transitions: Transitions) -> Array:
        """Learns from one step of n vehicles, at once.

        Returns:
            Temporal-difference errors (n,); NaN where there was nothing to learn.
        """

    def diagnostics(self, episode: int) -> dict[str, float]:
        """Named numbers of a training episode for the log."""

    def arrays(self) -> dict[str, Array]:
        """Everything that learning changes, by name: what a checkpoint keeps."""

    def load(self, arrays: dict[str, Array]) -> None:
        """Takes back what `arrays` gave.

        Raises:
            UserError: If these are not arrays of such an agent.
        """
