"""What an environment rewards: a registry of rewards by name, and the rewards of a user."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from nnql_bullet.agents.learning.frames import Look
from nnql_bullet.agents.learning.shaped_reward import reward_terms
from nnql_bullet.env import Reward, Transition
from nnql_bullet.experiment import Experiment
from nnql_bullet.geometry import Array
from nnql_bullet.gym_env.observations import frame_options
from nnql_bullet.task import NO_ENDING, RewardTerm, failure, winning
from nnql_bullet.vehicle.scale import length_scale

RewardName = Literal["paper", "progress", "sparse"]


@dataclass(frozen=True, slots=True)
class RewardKind:
    """A reward that an environment may give."""

    navigation: Reward | None = None
    """The reward of the task itself; None is the paper's."""
    score: Callable[[Experiment, Transition, Look], dict[str, Array]] | None = None
    """Terms (n,), by name, whose sum takes the place of the task's own reward; they need the vehicles' memory."""


def _progress(experiment: Experiment, t: Transition, look: Look) -> dict[str, Array]:
    """What `double_dqn` learns from: `look` is what the vehicles know after the step.

    The last step of an episode makes no progress, as the agent decides nothing after it.
    """
    o = frame_options(experiment)
    progress = np.where(t.ending == NO_ENDING, o.reward_progress * look.progress, 0.0)
    return {"progress": progress, **reward_terms(t, o, length_scale(experiment.vehicle.footprint))}


REWARDS: dict[RewardName, RewardKind] = {
    "paper": RewardKind(),
    "progress": RewardKind(score=_progress),
    "sparse": RewardKind((RewardTerm(winning, 1.0), RewardTerm(failure, -1.0))),
}
"""The rewards that an environment may give, by name."""


def reward_kind(reward: RewardName | Reward) -> RewardKind:
    """A reward by its name, or that of a user."""
    return REWARDS[reward] if isinstance(reward, str) else RewardKind(reward)


def goal_reward(achieved: ArrayLike, desired: ArrayLike, radius: float) -> Array:
    """The reward `sparse` as a function of goals (..., 3) alone: 1 at the target, -1 after a collision, else 0 (...).

    Args:
        achieved: x, y [m] of the rear-axle centre, and 1 if the vehicle touches something, else 0.
        desired: x, y [m] of the target; its third number is of no account.
        radius: Distance at which the target is reached [m].
    """
    is_at, should_be = np.asarray(achieved, np.float64), np.asarray(desired, np.float64)
    away = np.hypot(*np.moveaxis(is_at - should_be, -1, 0)[:2])
    return np.where(is_at[..., 2] > 0.5, -1.0, np.where(away <= radius, 1.0, 0.0))
