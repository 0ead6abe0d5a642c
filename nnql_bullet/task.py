"""The paper's task as pure functions: the state property, the reward as named terms, and how an episode ends."""

from enum import Enum
from typing import Annotated, Literal

from pydantic import Field

from nnql_bullet import paper
from nnql_bullet.config import options
from nnql_bullet.geometry import Array
from nnql_bullet.sensing import FRONT, FRONT_LEFT, FRONT_RIGHT
from nnql_bullet.sim.base import Motion

Distance = Annotated[float, Field(ge=0, le=paper.SENSOR_RANGE)]


class Property(str, Enum):
    """The state property (II.C)."""

    SAFE = "SS"
    NON_SAFE = "NS"
    WINNING = "WS"
    FAILURE = "FS"


Ending = Literal["goal", "collision", "timeout"]


@options
class TaskOptions:
    """What the paper leaves open about states, rewards and endings."""

    front_distance: Distance = 5.0
    """A state is non-safe with the front sector below this [m]. Success of NNQL at 10 % cover (twin, validation worlds,
    4 seeds), with the front-side distance beside it: 5 and 3.5 m gave 74 %, 4 and 3.5 m 73 %, 6 and 4 m 64 %, 7 and
    3.5 m 56 %."""
    front_side_distance: Distance = 3.5
    """... or one of the sectors at +-45 degrees below this [m]. On this vehicle, whose yaw rate takes time to build up,
    2.5 / 3.5 m gave 95 / 97 % at 5 % and 68 / 74 % at 10 % cover (NNQL), 97 / 99 % and 82 / 88 % (a hand rule that
    turns away from the fuller front side)."""
    other_distance: Distance = 0.0
    """... or any other sector below this [m]. Watching all eight alike cost 22 points in a
    kinematic study that came before this program; 0 is off."""
    reward_non_safe_to_safe: float = 0.4
    """Illegible in the paper. 0.2 / 0.4 / 1.0 gave 95 / 97 / 96 % in that study: the evidence does not decide."""
    max_steps: Annotated[int, Field(ge=1)] = paper.STEPS_PER_EPISODE
    """Decisions in an episode (IV.A)."""


def is_safe(readings: Array, task: TaskOptions) -> bool:
    """Whether the eight readings (8,) [m] are those of a safe state (II.C)."""
    thresholds = [task.other_distance] * paper.SECTORS
    thresholds[FRONT] = task.front_distance
    thresholds[FRONT_LEFT] = thresholds[FRONT_RIGHT] = task.front_side_distance
    return all(reading >= threshold for reading, threshold in zip(readings.tolist(), thresholds, strict=True))


def state_property(readings: Array, motion: Motion | None, task: TaskOptions) -> Property:
    """The property of the state with these readings (8,) [m], reached by `motion` (None at the start)."""
    if motion is not None and motion.touching:
        return Property.FAILURE
    if motion is not None and motion.at_target:
        return Property.WINNING
    return Property.SAFE if is_safe(readings, task) else Property.NON_SAFE


REWARD_TERMS = ("non_safe_to_safe", "safe_to_non_safe", "closer", "away", "winning", "failure")
"""The paper's six rewards (II.C), in its order."""


def reward_terms(
    before: Property, after: Property, readings_before: Array, readings_after: Array, task: TaskOptions
) -> dict[str, float]:
    """The reward of one step as named terms, of which at most one is not zero (II.C).

    "Getting closer to the obstacles" is read as: the smallest of the eight readings fell.
    """
    terms = dict.fromkeys(REWARD_TERMS, 0.0)
    match before, after:
        case _, Property.WINNING:
            terms["winning"] = paper.REWARD_WINNING
        case _, Property.FAILURE:
            terms["failure"] = paper.REWARD_FAILURE
        case Property.NON_SAFE, Property.SAFE:
            terms["non_safe_to_safe"] = task.reward_non_safe_to_safe
        case Property.SAFE, Property.NON_SAFE:
            terms["safe_to_non_safe"] = paper.REWARD_SAFE_TO_NON_SAFE
        case Property.NON_SAFE, Property.NON_SAFE:
            closer = readings_after.min() < readings_before.min()
            terms["closer" if closer else "away"] = paper.REWARD_CLOSER if closer else paper.REWARD_AWAY
    return terms


def ending(after: Property, steps: int, task: TaskOptions) -> Ending | None:
    """How the episode has ended after this many steps (IV.A), or None while it goes on."""
    if after is Property.WINNING:
        return "goal"
    if after is Property.FAILURE:
        return "collision"
    return "timeout" if steps >= task.max_steps else None
