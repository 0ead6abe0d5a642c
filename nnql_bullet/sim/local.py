"""A fleet of single simulators in this process."""

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.geometry import Array
from nnql_bullet.sensing import RAYS
from nnql_bullet.sim.base import Motion, Motions, Simulator
from nnql_bullet.worlds.spec import WorldSpec


class LocalFleet:
    """Simulators that are driven one after another. See `sim.base.Fleet` for the contract."""

    def __init__(self, simulators: Sequence[Simulator]) -> None:
        self.size = len(simulators)
        self._simulators = simulators

    def reset(self, worlds: Mapping[int, WorldSpec]) -> tuple[Array, Array]:
        """Puts some vehicles on the start of a world each."""
        poses, distances = np.empty((len(worlds), 3)), np.empty((len(worlds), RAYS))
        for row, (i, world) in enumerate(worlds.items()):
            simulator = self._simulators[i]
            simulator.reset(world)
            pose = simulator.pose()
            poses[row] = pose.x, pose.y, pose.yaw
            distances[row] = simulator.scan().distances
        return poses, distances

    def advance(
        self, heading_changes: Array, active: NDArray[np.bool_], speed_scales: Array | None = None
    ) -> tuple[Motions, Array]:
        """Drives one control period."""
        speed_scales = np.ones(self.size) if speed_scales is None else speed_scales
        motions: dict[int, Motion] = {}
        distances = np.zeros((self.size, RAYS))
        for i in np.flatnonzero(active).tolist():
            motions[i] = self._simulators[i].advance(float(heading_changes[i]), None, float(speed_scales[i]))
            distances[i] = self._simulators[i].scan().distances
        return as_motions(motions, self.size), distances

    def close(self) -> None:
        """Closes the simulators."""
        for simulator in self._simulators:
            simulator.close()


def local_fleet(make: Callable[[], Simulator], size: int) -> LocalFleet:
    """So many new simulators, in this process."""
    return LocalFleet([make() for _ in range(size)])


def as_motions(motions: Mapping[int, Motion], size: int) -> Motions:
    """Motions of single vehicles as one record of `size` rows; those of vehicles that stood by are zero."""
    pose, numbers, events = np.zeros((size, 3)), np.zeros((5, size)), np.zeros((2, size), np.bool_)
    for i, m in motions.items():
        pose[i] = m.pose.x, m.pose.y, m.pose.yaw
        numbers[:, i] = m.yaw_rate, m.duration, m.path_length, m.clearance, m.heading_error
        events[:, i] = m.touching, m.at_target
    return Motions(pose, *numbers, *events)
