"""The symmetry of left and right: which sector, ray, turn and action takes the place of which in a mirror."""

import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.agents.turns import nearest_turns
from nnql_bullet.env import TOWARD_TARGET


def mirrored_directions(count: int) -> NDArray[np.int64]:
    """The mirror images of `count` directions, evenly spaced counter-clockwise from straight ahead (count,)."""
    return -np.arange(count) % count


def mirrored_rays(count: int) -> NDArray[np.int64]:
    """The mirror images of the 72 rays told as `count` readings of neighbouring rays, a divisor of 72 (count,)."""
    return (count // paper.SECTORS - 1 - np.arange(count)) % count


MIRRORED_SECTORS = mirrored_directions(paper.SECTORS)
"""The mirror image of each of the eight sectors (8,)."""
MIRRORED_TURNS = nearest_turns(-np.array(paper.TURNS))
"""The mirror image of each of the paper's turns, by number (5,)."""
MIRRORED_ACTIONS = np.append(MIRRORED_TURNS, TOWARD_TARGET)
"""The mirror image of each action (6,)."""
LEFT_TURNS: tuple[int, ...] = tuple(turn for turn in np.argsort(paper.TURNS).tolist() if paper.TURNS[turn] > 0)
"""Numbers of the paper's turns to the left, the smaller first."""
RIGHT_TURNS: tuple[int, ...] = tuple(MIRRORED_TURNS[list(LEFT_TURNS)].tolist())
"""Their mirror images."""
