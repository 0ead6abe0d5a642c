"""What several benchmarks share: a rule that drives well enough, and timing side by side."""

from collections.abc import Callable, Mapping
from math import radians

import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.env import TOWARD_TARGET
from nnql_bullet.geometry import Array
from nnql_bullet.sensing import FRONT, FRONT_LEFT, FRONT_RIGHT

LEFT_60, RIGHT_60 = paper.TURNS.index(radians(60.0)), paper.TURNS.index(radians(-60.0))


def hand_rule(readings: Array) -> NDArray[np.int64]:
    """Toward the target, but 60 degrees away from the fuller front side when something is near ahead (...)."""
    front, left, right = readings[..., FRONT], readings[..., FRONT_LEFT], readings[..., FRONT_RIGHT]
    free = (front >= 5.0) & (np.minimum(left, right) >= 3.5)
    return np.where(free, TOWARD_TARGET, np.where(left < right, RIGHT_60, LEFT_60))


def quickest(sides: Mapping[str, Callable[[], float]], rounds: int) -> dict[str, float]:
    """The shortest time [s] of each side over some rounds, in each of which all sides take their turn."""
    best = dict.fromkeys(sides, float("inf"))
    for _ in range(rounds):
        for name, side in sides.items():
            best[name] = min(best[name], side())
    return best
