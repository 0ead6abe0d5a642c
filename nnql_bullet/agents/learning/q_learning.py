"""The paper's Q-learning (II.D, III), whatever holds the Q-values: its options, its error and its exploration."""

from dataclasses import dataclass
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from nnql_bullet import paper
from nnql_bullet.agents.base import NoTrainingState, TurnChooser
from nnql_bullet.agents.symmetry import MIRRORED_SECTORS, MIRRORED_TURNS
from nnql_bullet.agents.turns import nearest_turns
from nnql_bullet.config import options
from nnql_bullet.env import TOWARD_TARGET, Observation, Transition, heading_change
from nnql_bullet.geometry import Array
from nnql_bullet.rollout import Actions
from nnql_bullet.types import Positive, UnitInterval


@options
class QLearningOptions:
    """Options of eqs. (2) and (3)."""

    kind: str
    """Kind of the agent."""
    learning_rate: UnitInterval = paper.LEARNING_RATE
    """alpha of eq. (2)."""
    discount: UnitInterval = paper.DISCOUNT
    """gamma of eq. (2)."""
    temperature_max: Positive = paper.TEMPERATURE_MAX
    """T of eq. (3) in the first episode."""
    temperature_min: Positive = paper.TEMPERATURE_MIN
    """T of eq. (3) from the last scheduled episode on."""
    schedule: Literal["linear", "exponential"] = "linear"
    """How the temperature falls: the paper gives only its ends."""
    schedule_episodes: Annotated[int, Field(ge=2, le=1_000_000_000)] = paper.EPISODES
    """Episodes over which it falls. It does not follow the number of training episodes, so that a run can be stopped
    and resumed."""

    def __post_init__(self) -> None:
        """Refuses temperatures in the wrong order."""
        if self.temperature_min > self.temperature_max:
            raise ValueError(
                f"temperature_min {self.temperature_min:g} is above temperature_max {self.temperature_max:g}"
            )

    def temperature(self, episodes: NDArray[np.int64]) -> Array:
        """T of eq. (3) in training episodes (n,), counted from 0."""
        progress = np.minimum(episodes / (self.schedule_episodes - 1), 1.0)
        if self.schedule == "exponential":
            return np.asarray(self.temperature_max * (self.temperature_min / self.temperature_max) ** progress)
        return np.asarray(self.temperature_max + (self.temperature_min - self.temperature_max) * progress)


class QLearning(TurnChooser, NoTrainingState):
    """The parts of an agent that explores by the Boltzmann distribution over its Q-values."""

    options: QLearningOptions

    def act_exploring(
        self, observations: Observation, state: None, episodes: NDArray[np.int64], uniforms: Array
    ) -> tuple[Actions, None]:
        """Chooses the turn toward the target in a safe state (III.C), else draws from the Boltzmann distribution."""
        actions = np.full(len(uniforms), TOWARD_TARGET)
        asked = self.asks(observations)
        if asked.any():
            probabilities = boltzmann(self.values(observations, asked), self.options.temperature(episodes[asked]))
            cumulated = probabilities.cumsum(axis=-1)
            actions[asked] = (cumulated / cumulated[:, -1:] <= uniforms[asked, None]).sum(axis=-1)
        return actions, None

    def diagnostics(self, episode: int) -> dict[str, float]:
        """The temperature."""
        return {"temperature": float(self.options.temperature(np.array(episode)))}


def boltzmann(values: Array, temperature: Array) -> Array:
    """Probabilities (n, 5) of eq. (3) for values (n, 5) and temperatures (n,)."""
    weights = np.exp((values - values.max(axis=-1, keepdims=True)) / temperature[:, None])
    return np.asarray(weights / weights.sum(axis=-1, keepdims=True))


def td_errors(q_tm1: Array, a_tm1: NDArray[np.int64], r_t: Array, discount_t: Array, q_t: Array) -> Array:
    """Temporal-difference errors of eq. (2) (m,): r_t + discount_t max_a q_t(a) - q_tm1(a_tm1).

    Eq. (2) moves q_tm1(a_tm1) by the learning rate times its error.

    Args:
        q_tm1: Q-values of the turns before the steps (m, 5).
        a_tm1: Turns taken, by number (m,).
        r_t: Rewards (m,).
        discount_t: gamma (m,); 0 where the episode ended for good.
        q_t: Q-values of the turns after the steps (m, 5).
    """
    return np.asarray(r_t + discount_t * q_t.max(axis=-1) - q_tm1[np.arange(len(a_tm1)), a_tm1])


@dataclass(frozen=True, slots=True)
class TurnSteps:
    """m steps to learn from, as the paper's agent sees them: readings and turns."""

    s_tm1: Array
    """Readings before the steps (m, 8) [m]."""
    a_tm1: NDArray[np.int64]
    """Turns taken, by number (m,)."""
    r_t: Array
    """Rewards (m,)."""
    discount_t: Array
    """gamma (m,); 0 where the episode ended for good."""
    s_t: Array
    """Readings after the steps (m, 8) [m]."""

    def with_mirror_images(self) -> "TurnSteps":
        """The steps, and the same with left and right exchanged (2 m)."""
        return TurnSteps(
            s_tm1=np.concatenate([self.s_tm1, self.s_tm1[:, MIRRORED_SECTORS]]),
            a_tm1=np.concatenate([self.a_tm1, MIRRORED_TURNS[self.a_tm1]]),
            r_t=np.tile(self.r_t, 2),
            discount_t=np.tile(self.discount_t, 2),
            s_t=np.concatenate([self.s_t, self.s_t[:, MIRRORED_SECTORS]]),
        )


def turn_steps(transitions: Transition, vehicles: NDArray[np.int64], discount: float) -> TurnSteps:
    """The steps of some vehicles (m,); the turn toward the target counts as the nearest of the five.

    Args:
        transitions: Steps of all vehicles.
        vehicles: Indices of those to learn from (m,).
        discount: gamma.
    """
    t, v = transitions, vehicles
    return TurnSteps(
        s_tm1=t.s_tm1.readings[v],
        a_tm1=nearest_turns(heading_change(t.a_tm1[v], t.s_tm1.target_bearing[v])),
        r_t=t.r_t[v],
        discount_t=t.discount_t[v] * discount,
        s_t=t.s_t.readings[v],
    )


def encode(readings: Array, encoding: str) -> Array:
    """Network inputs (..., 8) for readings (..., 8), in metres of the shipped vehicle: see `NnqlOptions.encoding`."""
    nearness = 1.0 - np.minimum(readings, paper.SENSOR_RANGE) / paper.SENSOR_RANGE
    if encoding == "proximity":
        return nearness
    return np.where(readings < paper.SENSOR_RANGE, 1.0 - nearness, 0.0)
