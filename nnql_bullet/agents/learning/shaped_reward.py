"""The reward that `double_dqn` learns from, in named terms; its weights are among the agent's options."""

import numpy as np

from nnql_bullet.agents.learning.options import DoubleDqnOptions
from nnql_bullet.env import Transition
from nnql_bullet.geometry import Array
from nnql_bullet.sensing import FRONT
from nnql_bullet.task import StateProperty

FRONT_DISTANCE = 5.0
"""Readings of the front sensor below this cost reward [m]."""


def reward(t: Transition, o: DoubleDqnOptions, scale: float = 1.0) -> Array:
    """Rewards of steps (n,) of vehicles of a scale, except for the progress, which is known at the next decision."""
    return np.asarray(sum(reward_terms(t, o, scale).values()))


def reward_terms(t: Transition, o: DoubleDqnOptions, scale: float = 1.0) -> dict[str, Array]:
    """The parts of `reward` (n,), by name."""
    nearness = np.maximum(1 - t.s_t.readings[:, FRONT] / (FRONT_DISTANCE * scale), 0.0)
    won, failed = t.s_t.state_property == StateProperty.WINNING, t.s_t.state_property == StateProperty.FAILURE
    return {
        "step": np.full(len(won), o.reward_step),
        "turn": o.reward_turn * np.abs(t.heading_command),
        "near": o.reward_near * nearness,
        "winning": o.reward_winning * won,
        "failure": o.reward_failure * failed,
    }
