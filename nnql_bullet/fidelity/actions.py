"""The paper's five actions in contact physics, compared with the ideal vehicle that neither slips nor lags."""

from dataclasses import dataclass
from math import ceil

import numpy as np

from nnql_bullet import paper
from nnql_bullet.fidelity.probe import MIDDLE, Bench, open_ground
from nnql_bullet.fidelity.turning import WheelForces, follow_turn, forces_by_command
from nnql_bullet.geometry import Array
from nnql_bullet.vehicle.profiles import Turn, plan_turn, rolled_path, sample_turn


@dataclass(frozen=True, slots=True)
class WatchedTurn:
    """An action in contact physics that starts straight ahead."""

    heading_change: float
    """[rad]"""
    turn: Turn
    """The yaw-rate profile."""
    times: Array
    """Ends of the physics steps (n,) [s]."""
    path: Array
    """x, y of the rear-axle centre relative to the start (n, 2) [m]."""
    ideal: Array
    """x, y of a vehicle that follows the profile without slip or lag (n, 2) [m]."""
    forces: WheelForces

    @property
    def gap(self) -> float:
        """Root mean square of the distance between the two paths [m]."""
        return float(np.sqrt(np.mean(np.sum((self.path - self.ideal) ** 2, axis=1))))


def watch_actions(bench: Bench) -> list[WatchedTurn]:
    """Drives the five actions, each from the start on open ground, in a period that fits the longest one."""
    limits = bench.vehicle.limits
    turns = {change: plan_turn(0.0, change, limits) for change in paper.TURNS}
    longest = max(turn.duration for turn in turns.values())
    watched = []
    with bench.open_engine(decision_period=ceil(10 * longest + 1) / 10) as engine:
        for change, turn in turns.items():
            engine.reset(open_ground())
            instants = follow_turn(engine, change)
            times = np.array([instant.time for instant in instants])
            path = np.array([(instant.pose.x - MIDDLE.x, instant.pose.y - MIDDLE.y) for instant in instants])
            ideal = _ideal(turn, times, engine.drive.speed)
            watched.append(WatchedTurn(change, turn, times, path, ideal, forces_by_command(instants)))
    return watched


def tightest(turns: list[WatchedTurn]) -> WatchedTurn:
    """Returns the turn with the largest heading change to the left."""
    return max(turns, key=lambda turn: turn.heading_change)


def _ideal(turn: Turn, times: Array, speed: float) -> Array:
    """Computes positions of the rear-axle centre of the ideal vehicle (n, 2) [m]."""
    begins = np.concatenate([[0.0], times])
    _, headings = sample_turn(turn, begins)
    return rolled_path(0.0, np.diff(begins) * speed, np.diff(headings))
