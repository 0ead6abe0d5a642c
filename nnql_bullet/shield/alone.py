"""The shield's choice for one vehicle that it does not lead, in the part of Python that `exports.translation` writes.

It chooses as `shield.Shield` does that leads no vehicle (`ShieldOptions.recovers` off) and follows no plan, around an
agent that chooses among the six actions and is not told what it did instead. A decision is `perception.perceive`, then
the agent by the readings and rays that it gives, then `choose`.
"""

import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.env import ACTIONS, LARGEST_TURN
from nnql_bullet.geometry import Array
from nnql_bullet.shield.fallback import first_choice
from nnql_bullet.shield.prediction import clear_by_margin, foresee, sort
from nnql_bullet.shield.setting import Memory, Setting


def choose(
    p: Setting,
    m: Memory,
    values: Array,
    valued: bool,
    wanted: int,
    target_bearing: float,
    yaw_rate: float,
    speed: float,
) -> int:
    """The manoeuvre in place of what an agent wants, as `Shield.act`.

    Args:
        p: The setting.
        m: The memory; it is changed.
        values: The agent's values of the five turns (5,).
        valued: Whether it has them here.
        wanted: The action that it wants.
        target_bearing: Bearing of the target [rad].
        yaw_rate: Of the vehicle [rad/s].
        speed: Of the vehicle [m/s].
    """
    turns = np.empty(ACTIONS)
    for a in range(len(paper.TURNS)):
        turns[a] = paper.TURNS[a]
    turns[ACTIONS - 1] = min(max(target_bearing, -LARGEST_TURN), LARGEST_TURN)
    order = np.empty(ACTIONS, np.int64)
    rank(order, values, valued, wanted, turns)
    clear = np.empty(ACTIONS, np.bool_)
    margin = clear_by_margin(p, m, turns, yaw_rate, speed, clear)
    chosen = first_choice(p, m, turns, order, clear, clear, target_bearing, yaw_rate, speed, margin, 0)
    foresee(p, m, chosen, turns[chosen % ACTIONS], yaw_rate, speed)
    return chosen


def rank(order: NDArray[np.int64], values: Array, valued: bool, wanted: int, turns: Array) -> None:
    """The six actions, the best first (6,); see `shield.action_ranks`."""
    toward, least = 0, abs(paper.TURNS[0] - turns[ACTIONS - 1])
    for a in range(1, len(paper.TURNS)):
        off = abs(paper.TURNS[a] - turns[ACTIONS - 1])
        if off < least:
            toward, least = a, off
    ranks = np.empty(ACTIONS)
    for a in range(ACTIONS):
        if valued:
            ranks[a] = values[a] if a < ACTIONS - 1 else values[toward]
        else:
            ranks[a] = -abs(turns[a] - turns[wanted])
    ranks[wanted] = np.inf
    sort(order, ranks)
