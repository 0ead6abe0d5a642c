"""The paper's Q-learning (II.D, III), whatever holds the Q-values: its numbers, and how it explores."""

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from nnql_bullet import paper
from nnql_bullet.agents.base import NoTrainingState, TurnChooser
from nnql_bullet.config import options
from nnql_bullet.env import TOWARD_TARGET, Observation
from nnql_bullet.geometry import Array
from nnql_bullet.types import Positive, UnitInterval


@options
class QLearningOptions:
    """The numbers of eqs. (2) and (3)."""

    kind: str
    """Of the agent."""
    learning_rate: UnitInterval = paper.LEARNING_RATE
    """alpha of eq. (2)."""
    discount: UnitInterval = paper.DISCOUNT
    """gamma of eq. (2)."""
    temperature_max: Positive = paper.TEMPERATURE_MAX
    """T of eq. (3) in the first episode."""
    temperature_min: Positive = paper.TEMPERATURE_MIN
    """T of eq. (3) from the last scheduled episode on."""
    schedule: Literal["linear", "exponential"] = "linear"
    """How the temperature falls: only its ends are given."""
    schedule_episodes: Annotated[int, Field(ge=2)] = paper.EPISODES
    """Episodes over which it falls. It does not follow the number of episodes asked for, so that a run can be stopped
    and gone on with."""

    def __post_init__(self) -> None:
        """Refuses temperatures in the wrong order."""
        if self.temperature_min > self.temperature_max:
            raise ValueError(
                f"temperature_min {self.temperature_min:g} is above temperature_max {self.temperature_max:g}"
            )


class QLearning(TurnChooser, NoTrainingState):
    """The parts of an agent that explores by the Boltzmann distribution over its Q-values."""

    options: QLearningOptions

    def temperature(self, episodes: NDArray[np.int64]) -> Array:
        """T of eq. (3) in training episodes (n,), counted from 0."""
        o = self.options
        progress = np.minimum(episodes / (o.schedule_episodes - 1), 1.0)
        if o.schedule == "exponential":
            return np.asarray(o.temperature_max * (o.temperature_min / o.temperature_max) ** progress)
        return np.asarray(o.temperature_max + (o.temperature_min - o.temperature_max) * progress)

    def act_exploring(
        self, observations: Observation, episodes: NDArray[np.int64], uniforms: Array
    ) -> NDArray[np.int64]:
        """Toward the target in a safe state (III.C), else by the Boltzmann distribution."""
        actions = np.full(len(uniforms), TOWARD_TARGET)
        asked = self.asks(observations)
        if asked.any():
            probabilities = boltzmann(self.values(observations, asked), self.temperature(episodes[asked]))
            cumulated = probabilities.cumsum(axis=-1)
            actions[asked] = (cumulated / cumulated[:, -1:] <= uniforms[asked, None]).sum(axis=-1)
        return actions

    def diagnostics(self, episode: int) -> dict[str, float]:
        """The temperature."""
        return {"temperature": float(self.temperature(np.array(episode)))}


def boltzmann(values: Array, temperature: Array) -> Array:
    """Probabilities (n, 5) of eq. (3) for values (n, 5) and temperatures (n,)."""
    weights = np.exp((values - values.max(axis=-1, keepdims=True)) / temperature[:, None])
    return np.asarray(weights / weights.sum(axis=-1, keepdims=True))
