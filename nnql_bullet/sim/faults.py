"""Sensors that are not what they were: any simulator or fleet, seen through them."""

from collections.abc import Mapping
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from nnql_bullet import paper
from nnql_bullet.config import options
from nnql_bullet.geometry import Array, Pose
from nnql_bullet.seeding import Stream, rng
from nnql_bullet.sensing import RAYS_PER_SECTOR, Scan, scan_from
from nnql_bullet.sim.base import Fleet, Motion, Motions, Sample, Simulator
from nnql_bullet.types import NonNegative
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.spec import WorldSpec


@options
class SensorFaults:
    """What is wrong with the sensors."""

    noise: NonNegative = 0.0
    """Standard deviation of each ray that meets something [m]."""
    dead_sector: Annotated[int, Field(ge=0, lt=paper.SECTORS)] | None = None
    """The sensor that sees nothing, whatever is there; 0 is the front, counted counter-clockwise."""

    @property
    def any(self) -> bool:
        """Whether anything is."""
        return self.noise > 0 or self.dead_sector is not None


def degraded(distances: Array, faults: SensorFaults, generator: np.random.Generator) -> Array:
    """What faulty sensors make of ray distances (72,) [m]."""
    seen = distances
    if faults.noise > 0:
        noisy = np.clip(distances + generator.normal(0.0, faults.noise, len(distances)), 0.0, paper.SENSOR_RANGE)
        seen = np.where(distances < paper.SENSOR_RANGE, noisy, distances)
    if faults.dead_sector is not None:
        first = faults.dead_sector * RAYS_PER_SECTOR
        seen = seen.copy()
        seen[first : first + RAYS_PER_SECTOR] = paper.SENSOR_RANGE
    return seen


def _generator(world: WorldSpec) -> np.random.Generator:
    """The noise of an episode is a function of its world alone."""
    return rng(world.seed, Stream.SENSOR_NOISE)


class FaultySimulator:
    """A simulator with faulty sensors. See `sim.base.Simulator` for the contract."""

    def __init__(self, simulator: Simulator, faults: SensorFaults) -> None:
        self._simulator = simulator
        self._faults = faults

    @property
    def vehicle(self) -> VehicleSpec:
        """The vehicle it moves."""
        return self._simulator.vehicle

    @property
    def control_period(self) -> float:
        """Time from one decision to the next [s]."""
        return self._simulator.control_period

    def reset(self, world: WorldSpec) -> None:
        """Puts the vehicle on the world's start."""
        self._simulator.reset(world)
        self._noise = _generator(world)
        self._look()

    def advance(self, heading_change: float, trace: list[Sample] | None = None, speed_scale: float = 1.0) -> Motion:
        """Drives one control period."""
        motion = self._simulator.advance(heading_change, trace, speed_scale)
        self._look()
        return motion

    def pose(self) -> Pose:
        """Where the vehicle is."""
        return self._simulator.pose()

    def scan(self) -> Scan:
        """What its sensors read."""
        return self._scan

    def close(self) -> None:
        """Closes the simulator."""
        self._simulator.close()

    def _look(self) -> None:
        self._scan = scan_from(degraded(self._simulator.scan().distances, self._faults, self._noise))


class FaultyFleet:
    """A fleet with faulty sensors. See `sim.base.Fleet` for the contract."""

    def __init__(self, fleet: Fleet, faults: SensorFaults) -> None:
        self.size = fleet.size
        self._fleet = fleet
        self._faults = faults
        self._noise: dict[int, np.random.Generator] = {}

    def reset(self, worlds: Mapping[int, WorldSpec]) -> tuple[Array, Array]:
        """Puts some vehicles on the start of a world each."""
        poses, distances = self._fleet.reset(worlds)
        self._noise |= {i: _generator(world) for i, world in worlds.items()}
        seen = distances.copy()
        for row, i in enumerate(worlds):
            seen[row] = degraded(distances[row], self._faults, self._noise[i])
        return poses, seen

    def advance(
        self, heading_changes: Array, active: NDArray[np.bool_], speed_scales: Array | None = None
    ) -> tuple[Motions, Array]:
        """Drives one control period."""
        motions, distances = self._fleet.advance(heading_changes, active, speed_scales)
        seen = distances.copy()
        for i in np.flatnonzero(active).tolist():
            seen[i] = degraded(distances[i], self._faults, self._noise[i])
        return motions, seen

    def close(self) -> None:
        """Closes the fleet."""
        self._fleet.close()
