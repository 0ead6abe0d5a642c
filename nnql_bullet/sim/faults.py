"""Adds faults of the sensors to any simulator."""

from collections.abc import Mapping
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from nnql_bullet import paper
from nnql_bullet.config import options
from nnql_bullet.geometry import Array
from nnql_bullet.seeding import Stream, rng
from nnql_bullet.sensing import first_ray
from nnql_bullet.sim.base import Motion, Simulator, Traces, driving
from nnql_bullet.types import NonNegative
from nnql_bullet.worlds.passages import Point
from nnql_bullet.worlds.spec import WorldSpec


@options
class SensorFaults:
    """Faults of the sensors."""

    noise: NonNegative = 0.0
    """Standard deviation of the noise of each ray that meets something [m]."""
    dead_sector: Annotated[int, Field(ge=0, lt=paper.SECTORS)] | None = None
    """Number of a sensor that sees nothing; 0 is the front, the others follow counter-clockwise."""

    @property
    def any(self) -> bool:
        """Whether there is any fault."""
        return self.noise > 0 or self.dead_sector is not None


def degraded(
    distances: Array, faults: SensorFaults, generator: np.random.Generator, sensor_range: float = paper.SENSOR_RANGE
) -> Array:
    """Applies faults to ray distances (rays,) [m]; one that meets nothing is `sensor_range` [m]."""
    seen = distances
    if faults.noise > 0:
        noisy = np.clip(distances + generator.normal(0.0, faults.noise, len(distances)), 0.0, sensor_range)
        seen = np.where(distances < sensor_range, noisy, distances)
    if faults.dead_sector is not None:
        seen = seen.copy()
        first, end = (first_ray(sector, len(seen)) for sector in (faults.dead_sector, faults.dead_sector + 1))
        seen[first:end] = sensor_range
    return seen


class FaultySimulator:
    """A `Simulator` whose sensors have faults. The noise of an episode depends on its world alone."""

    def __init__(self, simulator: Simulator, faults: SensorFaults) -> None:
        self.size, self.vehicle, self.drive = simulator.size, simulator.vehicle, simulator.drive
        self._simulator = simulator
        self._faults = faults
        self._noise: dict[int, np.random.Generator] = {}

    def reset(self, worlds: Mapping[int, WorldSpec]) -> tuple[Array, Array]:
        """See `Simulator.reset`."""
        poses, ray_distances = self._simulator.reset(worlds)
        for row, (i, world) in enumerate(worlds.items()):
            self._noise[i] = rng(world.seed, Stream.SENSOR_NOISE)
            ray_distances[row] = degraded(ray_distances[row], self._faults, self._noise[i], self.vehicle.sensor.range)
        return poses, ray_distances

    def advance(
        self,
        heading_changes: Array,
        active: NDArray[np.bool_] | None = None,
        speed_scales: Array | None = None,
        traces: Traces | None = None,
    ) -> tuple[Motion, Array]:
        """See `Simulator.advance`."""
        motion, ray_distances = self._simulator.advance(heading_changes, active, speed_scales, traces)
        for i in driving(active, self.size):
            ray_distances[i] = degraded(ray_distances[i], self._faults, self._noise[i], self.vehicle.sensor.range)
        return motion, ray_distances

    def retarget(self, targets: Mapping[int, Point]) -> None:
        """See `Simulator.retarget`."""
        self._simulator.retarget(targets)

    def close(self) -> None:
        """Closes the simulator."""
        self._simulator.close()
