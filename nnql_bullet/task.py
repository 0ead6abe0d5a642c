"""The paper's task as pure functions: the state property, the reward as a sum of named terms, the end of an episode.

The functions take one vehicle or many: `(...)` in a shape is () or (n,).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from enum import IntEnum
from functools import cached_property
from math import isfinite
from typing import Annotated, Any, Literal, Protocol

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from nnql_bullet import paper
from nnql_bullet.config import options
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array
from nnql_bullet.sensing import (
    FRONT,
    FRONT_LEFT,
    FRONT_RIGHT,
    LONGEST_RANGE,
    middle_readings,
    sector_readings,
    smallest,
)
from nnql_bullet.types import LARGEST, Number, Steps

Properties = int | NDArray[np.int64]
Booleans = bool | NDArray[np.bool_]
Distance = Annotated[float, Field(ge=0, le=LONGEST_RANGE)]


class StateProperty(IntEnum):
    """The state property (II.C)."""

    SAFE = 0
    NON_SAFE = 1
    WINNING = 2
    FAILURE = 3

    @property
    def label(self) -> str:
        """The paper's two letters."""
        return ("SS", "NS", "WS", "FS")[self]


SAFE, NON_SAFE, WINNING, FAILURE = map(int, StateProperty)  # NumPy compares with plain integers faster


@options
class TaskOptions:
    """What the paper leaves open about states, rewards and endings. Distances are those of the shipped vehicle."""

    front_distance: Distance = 5.0
    """A state is non-safe when the front sector reads less than this [m]."""
    front_side_distance: Distance = 3.5
    """A state is non-safe when a sector at +-45 degrees reads less than this [m]."""
    other_distance: Distance = 0.0
    """A state is non-safe when one of the other five sectors reads less than this [m]; 0 ignores them."""
    reward_non_safe_to_safe: Number = 0.4
    """Reward of a step from a non-safe to a safe state. The number is illegible in the paper."""
    max_steps: Steps = paper.STEPS_PER_EPISODE
    """Decisions in an episode (IV.A)."""
    stuck_after: Annotated[float, Field(ge=0, le=LARGEST)] = 30.0
    """Time after which an episode ends as stuck if the vehicle stays about one place [s]; 0 for never."""
    stuck_radius: Annotated[float, Field(gt=0, le=1000)] = 0.5
    """Distance from there up to which a vehicle stays about a place, as a multiple of its length."""

    # Other readings of the paper's text, for ablations.

    sector_reading: Literal["nearest", "middle"] = "nearest"
    """Reading of a sensor that covers "one region of a range of 45 degrees" (II.A): its nearest or its middle ray."""
    hysteresis: Distance = 0.0
    """Distance added to the three above before a non-safe state becomes safe again [m]."""
    closer: Literal["smallest", "mean"] = "smallest"
    """Which of the eight readings falls when the vehicle is "getting closer to the obstacles" (II.C)."""

    @cached_property
    def thresholds(self) -> Array:
        """Distances of the eight sectors (8,) [m]: a state is non-safe when a sector reads less."""
        thresholds = np.full(paper.SECTORS, self.other_distance)
        thresholds[FRONT] = self.front_distance
        thresholds[[FRONT_LEFT, FRONT_RIGHT]] = self.front_side_distance
        return thresholds

    def scaled(self, scale: float, sensor_range: float) -> "TaskOptions":
        """Returns the task of a vehicle whose lengths are so many times as large (see `vehicle.scale`).

        What a sensor does not see is not near, so no threshold exceeds its range [m].
        """
        names = "front_distance", "front_side_distance", "other_distance", "hysteresis"
        return replace(self, **{name: min(scale * getattr(self, name), sensor_range) for name in names})


def readings_of(ray_distances: Array, task: TaskOptions) -> Array:
    """The eight readings (..., 8) [m] of ray distances (..., rays) [m]."""
    return middle_readings(ray_distances) if task.sector_reading == "middle" else sector_readings(ray_distances)


# The state property (II.C)


def is_safe(readings: Array, task: TaskOptions, previous: Properties = SAFE) -> NDArray[np.bool_]:
    """Whether no sector reads less than its threshold: "low or no possibility of collision" (II.C), (...).

    Args:
        readings: The eight readings (..., 8) [m].
        task: The thresholds.
        previous: `StateProperty` of the states before (...), for the hysteresis.
    """
    thresholds = task.thresholds
    if task.hysteresis:
        raised = task.hysteresis * np.equal(previous, NON_SAFE)[..., None]
        thresholds = np.where(thresholds > 0, thresholds + raised, 0.0)
    return np.asarray((readings >= thresholds).all(axis=-1))


def state_property(
    readings: Array, failed: Booleans, at_target: Booleans, task: TaskOptions, previous: Properties = SAFE
) -> NDArray[np.int64]:
    """`StateProperty` of states (...).

    Args:
        readings: The eight readings (..., 8) [m].
        failed: Whether the vehicle touched an obstacle or wall, or tipped over, on its way to the state (...).
        at_target: Whether it reached the target on its way to the state (...).
        task: The thresholds.
        previous: `StateProperty` of the states before (...); a start counts as coming from a safe state.
    """
    by_readings = np.where(is_safe(readings, task, previous), SAFE, NON_SAFE)
    return np.where(failed, FAILURE, np.where(at_target, WINNING, by_readings))


# The reward (II.C)


class State(Protocol):
    """The part of an observation that the paper's reward needs."""

    @property
    def readings(self) -> Array:
        """The eight readings (..., 8) [m]."""

    @property
    def state_property(self) -> Properties:
        """`StateProperty` (...)."""


@dataclass(frozen=True, slots=True)
class RewardTerm:
    """A named term of the reward: `scale` times the value of `function`."""

    function: Callable[[Any, Any, TaskOptions], Booleans | Array]
    """Value (...) of the steps from observations `s_tm1` to observations `s_t`; its name is the term's."""
    scale: float

    def __post_init__(self) -> None:
        """Refuses a function without a name, such as a `functools.partial`, and a scale that is no number."""
        if not hasattr(self.function, "__name__"):
            raise UserError("a term of the reward needs a function with a name; define it with def")
        if not isinstance(self.scale, int | float) or not isfinite(self.scale):
            raise UserError(f"term '{self.name}' of the reward: its scale must be a finite number, not {self.scale}")

    @property
    def name(self) -> str:
        """The name of the function."""
        return self.function.__name__


def non_safe_to_safe(s_tm1: State, s_t: State, task: TaskOptions) -> Booleans:
    """II.C: "Moving from a Non-Safe State to a Safe State"."""
    return (s_tm1.state_property == NON_SAFE) & (s_t.state_property == SAFE)


def safe_to_non_safe(s_tm1: State, s_t: State, task: TaskOptions) -> Booleans:
    """II.C: "Moving from a Safe State to a Non-Safe State"."""
    return (s_tm1.state_property == SAFE) & (s_t.state_property == NON_SAFE)


def closer(s_tm1: State, s_t: State, task: TaskOptions) -> Booleans:
    """II.C: "Moving from a Non-Safe State to a Non-Safe State but getting closer to the obstacles"."""
    return _stays_non_safe(s_tm1, s_t) & _got_closer(s_tm1, s_t, task)


def away(s_tm1: State, s_t: State, task: TaskOptions) -> Booleans:
    """II.C: "Moving from a Non-Safe State to a Non-Safe State and getting away from the obstacles"."""
    return _stays_non_safe(s_tm1, s_t) & ~_got_closer(s_tm1, s_t, task)


def winning(s_tm1: State, s_t: State, task: TaskOptions) -> Booleans:
    """II.C: "Moving to a Winning State"."""
    return ~is_terminal(s_tm1.state_property) & (s_t.state_property == WINNING)


def failure(s_tm1: State, s_t: State, task: TaskOptions) -> Booleans:
    """II.C: "Moving to a Failure State"."""
    return ~is_terminal(s_tm1.state_property) & (s_t.state_property == FAILURE)


def paper_reward(task: TaskOptions) -> tuple[RewardTerm, ...]:
    """The paper's six terms, in its order (II.C); at most one of them is not zero in a step."""
    return (
        RewardTerm(non_safe_to_safe, task.reward_non_safe_to_safe),
        RewardTerm(safe_to_non_safe, paper.REWARD_SAFE_TO_NON_SAFE),
        RewardTerm(closer, paper.REWARD_CLOSER),
        RewardTerm(away, paper.REWARD_AWAY),
        RewardTerm(winning, paper.REWARD_WINNING),
        RewardTerm(failure, paper.REWARD_FAILURE),
    )


REWARD_TERMS = tuple(term.name for term in paper_reward(TaskOptions()))
"""Names of the paper's six terms, in its order."""


def reward_terms(s_tm1: State, s_t: State, task: TaskOptions, reward: tuple[RewardTerm, ...]) -> Array:
    """Each term's part of the reward (..., number of terms) of steps from `s_tm1` to `s_t`; the reward is their sum."""
    terms = np.empty((*s_t.readings.shape[:-1], len(reward)))
    for k, term in enumerate(reward):
        values = np.asarray(term.function(s_tm1, s_t, task))
        if values.shape != terms.shape[:-1] or values.dtype.kind not in "fiub" or not np.isfinite(values).all():
            raise UserError(f"term '{term.name}' of the reward must be finite numbers {terms.shape[:-1]}, not {values}")
        terms[..., k] = values
    return terms * [term.scale for term in reward] + 0.0  # adding 0.0 makes 0.0 of a -0.0


@dataclass(frozen=True, slots=True)
class _Case:
    """A `State` of a case that `paper_table` lists."""

    readings: Array
    state_property: NDArray[np.int64]


def paper_table(task: TaskOptions) -> Array:
    """The paper's terms of a step by its properties before and after, and by whether it got closer (4, 4, 2, 6)."""
    before, after, got_closer = np.indices((len(StateProperty), len(StateProperty), 2))
    far = np.ones((*before.shape, paper.SECTORS))
    s_tm1, s_t = _Case(far, before), _Case(far - got_closer[..., None], after)
    return reward_terms(s_tm1, s_t, task, paper_reward(task))


def look_up(s_tm1: State, s_t: State, task: TaskOptions, table: Array) -> Array:
    """What `reward_terms` gives for the paper's terms (..., 6), from their `paper_table`: faster."""
    terms: Array = table[s_tm1.state_property, s_t.state_property, np.asarray(_got_closer(s_tm1, s_t, task), np.int64)]
    return terms


def _stays_non_safe(s_tm1: State, s_t: State) -> Booleans:
    return (s_tm1.state_property == NON_SAFE) & (s_t.state_property == NON_SAFE)


def _got_closer(s_tm1: State, s_t: State, task: TaskOptions) -> NDArray[np.bool_]:
    """Whether the distance to the obstacles fell (...)."""
    if task.closer == "smallest":
        return np.less(smallest(s_t.readings), smallest(s_tm1.readings))
    return np.asarray(s_t.readings.mean(axis=-1) < s_tm1.readings.mean(axis=-1))


# The end of an episode (IV.A)

ENDINGS = ("goal", "collision", "timeout", "stuck", "overturned")
"""How an episode may end."""
GOAL, COLLISION, TIMEOUT, STUCK, OVERTURNED = range(5)
TRUNCATIONS = ("timeout", "stuck")
"""Endings that are no part of the task: the world would go on, and so would the discounted return. A vehicle that is
stuck has not failed by the paper's rewards (II.C); it only wastes what is left of the time limit."""
NO_ENDING = -1
"""Stands for an index into `ENDINGS` while an episode goes on."""


def is_terminal(state_property: Properties) -> NDArray[np.bool_]:
    """Whether states are winning or failure states, "one of the terminate states" (II.C), (...)."""
    return np.greater_equal(state_property, WINNING)


def ending(
    state_property: Properties,
    steps: int | NDArray[np.int64],
    task: TaskOptions,
    staying: float | Array = 0.0,
    overturned: Booleans = False,
) -> NDArray[np.int64]:
    """How episodes ended: indices into `ENDINGS` or `NO_ENDING` (...).

    Args:
        state_property: `StateProperty` of the states that they came to (...).
        steps: Number of steps so far (...).
        task: The limits.
        staying: Time for which the vehicles have stayed about one place (...) [s].
        overturned: Whether what failed is that they tipped over (...).
    """
    ends = np.where(np.greater_equal(steps, task.max_steps), TIMEOUT, NO_ENDING)
    if task.stuck_after > 0:
        ends = np.where(np.greater_equal(staying, task.stuck_after), STUCK, ends)
    ends = np.where(np.equal(state_property, FAILURE), np.where(overturned, OVERTURNED, COLLISION), ends)
    return np.where(np.equal(state_property, WINNING), GOAL, ends)
