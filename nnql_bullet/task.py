"""The paper's task as pure functions: the state property, the reward as named terms, and how an episode ends.

They take one vehicle or many: `(...)` in a shape is () or (n,).
"""

from enum import IntEnum
from functools import cached_property
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from nnql_bullet import paper
from nnql_bullet.config import options
from nnql_bullet.geometry import Array
from nnql_bullet.sensing import FRONT, FRONT_LEFT, FRONT_RIGHT, middle_readings, sector_readings

Properties = int | NDArray[np.int64]
Events = bool | NDArray[np.bool_]
Distance = Annotated[float, Field(ge=0, le=paper.SENSOR_RANGE)]


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


ENDINGS = ("goal", "collision", "timeout")
"""How an episode may end."""
GOES_ON = -1
"""In place of an index into `ENDINGS`: it has not."""


REWARD_TERMS = ("non_safe_to_safe", "safe_to_non_safe", "closer", "away", "winning", "failure")
"""The paper's six rewards (II.C), in its order."""
_NON_SAFE_TO_SAFE, _SAFE_TO_NON_SAFE, _CLOSER, _AWAY, _WINNING, _FAILURE, _NONE = range(7)


@options
class TaskOptions:
    """What the paper leaves open about states, rewards and endings."""

    front_distance: Distance = 5.0
    """A state is non-safe with the front sector below this [m]. Success of NNQL at 10 % cover (kinematic model,
    validation worlds, 4 seeds), with the front-side distance beside it: 5 and 3.5 m gave 74 %, 4 and 3.5 m 73 %, 6 and
    4 m 64 %, 7 and 3.5 m 56 %."""
    front_side_distance: Distance = 3.5
    """... or one of the sectors at +-45 degrees below this [m]. On this vehicle, whose yaw rate takes time to build up,
    2.5 / 3.5 m gave 95 / 97 % at 5 % and 68 / 74 % at 10 % cover (NNQL), 97 / 99 % and 82 / 88 % (a hand rule that
    turns away from the fuller front side)."""
    other_distance: Distance = 0.0
    """... or any other sector below this [m]. Watching all eight alike cost 22 points in a
    kinematic study that came before this program; 0 is off."""
    hysteresis: Distance = 0.0
    """How much farther off things have to be for a non-safe state to become safe again [m]."""
    sector_reading: Literal["nearest", "middle"] = "nearest"
    """What a sensor reads, of "one region of a range of 45 degrees" (II.A): the nearest of its rays, or its middle one,
    which passes obstacles by."""
    closer: Literal["smallest", "mean"] = "smallest"
    """What "getting closer to the obstacles" (II.C) means: this of the eight readings fell."""
    reward_non_safe_to_safe: float = 0.4
    """Illegible in the paper. 0.2 / 0.4 / 1.0 gave 95 / 97 / 96 % in that study: the evidence does not decide."""
    max_steps: Annotated[int, Field(ge=1)] = paper.STEPS_PER_EPISODE
    """Decisions in an episode (IV.A)."""

    @cached_property
    def thresholds(self) -> Array:
        """Of the eight sectors (8,) [m]: a state is non-safe with a reading below."""
        thresholds = np.full(paper.SECTORS, self.other_distance)
        thresholds[FRONT] = self.front_distance
        thresholds[[FRONT_LEFT, FRONT_RIGHT]] = self.front_side_distance
        return thresholds

    @cached_property
    def rewards(self) -> Array:
        """For each of `REWARD_TERMS`, and for none, its reward in its own place (7, 6)."""
        rewards = np.zeros((len(REWARD_TERMS) + 1, len(REWARD_TERMS)))
        rewards[_NON_SAFE_TO_SAFE, _NON_SAFE_TO_SAFE] = self.reward_non_safe_to_safe
        rewards[_SAFE_TO_NON_SAFE, _SAFE_TO_NON_SAFE] = paper.REWARD_SAFE_TO_NON_SAFE
        rewards[_CLOSER, _CLOSER] = paper.REWARD_CLOSER
        rewards[_AWAY, _AWAY] = paper.REWARD_AWAY
        rewards[_WINNING, _WINNING] = paper.REWARD_WINNING
        rewards[_FAILURE, _FAILURE] = paper.REWARD_FAILURE
        return rewards


def readings_of(ray_distances: Array, task: TaskOptions) -> Array:
    """The eight readings (..., 8) [m] of ray distances (..., 72) [m]."""
    return middle_readings(ray_distances) if task.sector_reading == "middle" else sector_readings(ray_distances)


def is_safe(readings: Array, task: TaskOptions, before: Properties = StateProperty.SAFE) -> NDArray[np.bool_]:
    """Whether the eight readings (..., 8) [m] are those of a safe state (II.C), (...).

    Args:
        readings: [m]
        task: Says below what a reading is not.
        before: `StateProperty` (...) of the states before, for the hysteresis.
    """
    raised = task.hysteresis * np.equal(before, StateProperty.NON_SAFE)[..., None]
    return np.asarray((readings >= np.where(task.thresholds > 0, task.thresholds + raised, 0.0)).all(axis=-1))


_PROPERTY = np.array(
    [[StateProperty.NON_SAFE, StateProperty.SAFE], [StateProperty.WINNING] * 2, [StateProperty.FAILURE] * 2]
)


def state_property(
    readings: Array, touching: Events, at_target: Events, task: TaskOptions, before: Properties = StateProperty.SAFE
) -> NDArray[np.int64]:
    """`StateProperty` (...) of states with these readings (..., 8) [m] and these events (...) on the way there.

    Args:
        readings: [m]
        touching: Whether an obstacle or wall was touched.
        at_target: Whether the target was reached.
        task: Says what is safe.
        before: `StateProperty` (...) of the states that they come from; that of a start is as good as safe.
    """
    event = np.maximum(np.multiply(touching, 2), at_target)
    return np.asarray(_PROPERTY[event, is_safe(readings, task, before).astype(np.int64)])


_TERM = np.array(
    [  # to SAFE, NON_SAFE, WINNING, FAILURE
        [_NONE, _SAFE_TO_NON_SAFE, _WINNING, _FAILURE],  # from SAFE
        [_NON_SAFE_TO_SAFE, _AWAY, _WINNING, _FAILURE],  # from NON_SAFE
        [_NONE] * 4,  # from WINNING and FAILURE nothing goes on
        [_NONE] * 4,
    ]
)
_TERM = np.stack([_TERM, np.where(_TERM == _AWAY, _CLOSER, _TERM)], axis=-1)  # by whether it got closer


def reward_terms(
    before: Properties, after: Properties, readings_before: Array, readings_after: Array, task: TaskOptions
) -> Array:
    """The reward of steps as the terms `REWARD_TERMS` (..., 6), of which at most one is not zero (II.C)."""
    near = np.min if task.closer == "smallest" else np.mean
    closer = np.less(near(readings_after, axis=-1), near(readings_before, axis=-1)).astype(np.int64)
    return np.asarray(task.rewards[_TERM[before, after, closer]])


_ENDING = np.array(
    [  # in time, and too late
        [GOES_ON, ENDINGS.index("timeout")],  # SAFE
        [GOES_ON, ENDINGS.index("timeout")],  # NON_SAFE
        [ENDINGS.index("goal")] * 2,  # WINNING
        [ENDINGS.index("collision")] * 2,  # FAILURE
    ]
)


def ending(after: Properties, steps: int | NDArray[np.int64], task: TaskOptions) -> NDArray[np.int64]:
    """How episodes have ended after this many steps (IV.A), as an index into `ENDINGS` or `GOES_ON` (...)."""
    return np.asarray(_ENDING[after, np.greater_equal(steps, task.max_steps).astype(np.int64)])
