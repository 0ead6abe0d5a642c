"""Domain randomization: each training episode disturbs the vehicle in another way.

For a policy trained with many disturbances, reality is just another one (Tobin et al., "Domain Randomization for
Transferring Deep Neural Networks from Simulation to the Real World", IROS 2017).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import pi, radians

import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.config import options
from nnql_bullet.geometry import Array
from nnql_bullet.seeding import Stream, rng
from nnql_bullet.sim.base import Motion, Simulator, Traces, driving
from nnql_bullet.sim.faults import SensorFaults, degraded
from nnql_bullet.types import NonNegative, UnitInterval
from nnql_bullet.worlds.passages import Point
from nnql_bullet.worlds.spec import WorldSpec


@options
class DomainRandomization:
    """Largest disturbances; each episode draws values up to these. By default there are none."""

    start_yaw: bool = False
    """Whether an episode starts at a random yaw."""
    noise: NonNegative = 0.0
    """Largest standard deviation of the noise of each ray that meets something [m]."""
    dead_sector: UnitInterval = 0.0
    """Probability that one sensor sees nothing during the whole episode."""
    turn_scale: UnitInterval = 0.0
    """Largest relative error of all turns of an episode, for example by poor ground or slow drives."""
    turn_noise_degrees: NonNegative = 0.0
    """Largest standard deviation of the noise of each turn [degrees]."""

    @property
    def any(self) -> bool:
        """Whether there is any disturbance besides the random start yaw."""
        return self.noise > 0 or self.dead_sector > 0 or self.turn_scale > 0 or self.turn_noise_degrees > 0


@dataclass(frozen=True, slots=True)
class _Episode:
    """Disturbances of one episode."""

    sensors: SensorFaults
    turn_scale: float
    turn_noise: float
    """[rad]"""
    generator: np.random.Generator
    """Generator of the episode's noise."""


class RandomizedSimulator:
    """A `Simulator` of disturbed vehicles. The disturbance of an episode is a function of its world alone."""

    def __init__(self, simulator: Simulator, domain_randomization: DomainRandomization) -> None:
        self.size, self.vehicle, self.drive = simulator.size, simulator.vehicle, simulator.drive
        self._simulator = simulator
        self._domain_randomization = domain_randomization
        self._episodes: dict[int, _Episode] = {}

    def reset(self, worlds: Mapping[int, WorldSpec]) -> tuple[Array, Array]:
        """See `Simulator.reset`."""
        self._episodes |= {i: _drawn(self._domain_randomization, world) for i, world in worlds.items()}
        poses, ray_distances = self._simulator.reset(worlds)
        for row, i in enumerate(worlds):
            self._degrade(ray_distances, row, i)
        return poses, ray_distances

    def advance(
        self,
        heading_changes: Array,
        active: NDArray[np.bool_] | None = None,
        speed_scales: Array | None = None,
        traces: Traces | None = None,
    ) -> tuple[Motion, Array]:
        """See `Simulator.advance`."""
        turns = heading_changes.copy()
        vehicles = driving(active, self.size)
        for i in vehicles:
            episode = self._episodes[i]
            turns[i] = episode.turn_scale * turns[i] + episode.turn_noise * episode.generator.standard_normal()
        motion, ray_distances = self._simulator.advance(turns, active, speed_scales, traces)
        for i in vehicles:
            self._degrade(ray_distances, i, i)
        return motion, ray_distances

    def retarget(self, targets: Mapping[int, Point]) -> None:
        """See `Simulator.retarget`."""
        self._simulator.retarget(targets)

    def close(self) -> None:
        """Closes the simulator."""
        self._simulator.close()

    def _degrade(self, ray_distances: Array, row: int, vehicle: int) -> None:
        """Applies the vehicle's sensor faults to a row of ray distances."""
        episode = self._episodes[vehicle]
        ray_distances[row] = degraded(ray_distances[row], episode.sensors, episode.generator, self.vehicle.sensor.range)


def turned(world: WorldSpec, domain_randomization: DomainRandomization) -> WorldSpec:
    """Gives the world a random yaw at its start, if the options ask for it."""
    if not domain_randomization.start_yaw:
        return world
    yaw = rng(world.seed, Stream.DOMAIN_RANDOMIZATION, 1).uniform(-pi, pi)
    return replace(world, start=replace(world.start, yaw=round(yaw, 6)))


def _drawn(domain_randomization: DomainRandomization, world: WorldSpec) -> _Episode:
    d, generator = domain_randomization, rng(world.seed, Stream.DOMAIN_RANDOMIZATION)
    noise, scale, turn_noise, dead = generator.random(4).tolist()
    sector = int(generator.integers(paper.SECTORS))
    return _Episode(
        sensors=SensorFaults(noise=d.noise * noise, dead_sector=sector if dead < d.dead_sector else None),
        turn_scale=1.0 + d.turn_scale * (2 * scale - 1),
        turn_noise=radians(d.turn_noise_degrees) * turn_noise,
        generator=generator,
    )
