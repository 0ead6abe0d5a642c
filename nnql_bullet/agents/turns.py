"""From a heading change that is wanted to the one on offer that comes nearest to it."""

import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.env import ACTIONS, heading_change
from nnql_bullet.geometry import Array


def nearest_turns(heading_changes: Array) -> NDArray[np.int64]:
    """The paper's turns closest to heading changes (n,) [rad], by number (n,)."""
    return np.asarray(np.abs(np.array(paper.TURNS) - heading_changes[:, None]).argmin(axis=-1))


def offered_turns(target_bearing: Array) -> Array:
    """What each of the six actions turns by (n, 6) [rad], for targets at these bearings (n,) [rad]."""
    return heading_change(np.arange(ACTIONS), target_bearing[:, None])


def nearest_actions(heading_changes: Array, target_bearing: Array) -> NDArray[np.int64]:
    """The actions closest to heading changes (n,) [rad], for targets at these bearings (n,) [rad]."""
    return np.asarray(np.abs(offered_turns(target_bearing) - heading_changes[:, None]).argmin(axis=-1))
