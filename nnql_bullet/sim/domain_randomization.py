"""Vehicles that are not quite what they should be, each episode in its own way: what a policy is trained against.

Randomising what is uncertain, so that reality is but one more variation, is from Tobin et al., "Domain Randomization
for Transferring Deep Neural Networks from Simulation to the Real World" (IROS 2017).
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from math import pi, radians

import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.config import options
from nnql_bullet.geometry import Array
from nnql_bullet.seeding import Stream, rng
from nnql_bullet.sim.base import Fleet, Motions
from nnql_bullet.sim.faults import SensorFaults, degraded
from nnql_bullet.types import NonNegative, UnitInterval
from nnql_bullet.worlds.spec import WorldSpec


@options
class DomainRandomization:
    """How far things may be off; an episode's own values are drawn up to these. By default nothing is."""

    start_yaw: bool = False
    """Whether episodes begin in any direction."""
    noise: NonNegative = 0.0
    """Largest standard deviation of each ray that meets something [m]."""
    dead_sector: UnitInterval = 0.0
    """Chance that one sensor, the same all through the episode, sees nothing."""
    turn_scale: UnitInterval = 0.0
    """Largest share that all turns of an episode come out too large or too small by, as on poor ground or behind
    drives that lag."""
    turn_noise_degrees: NonNegative = 0.0
    """Largest standard deviation of each turn [degrees]."""

    @property
    def any(self) -> bool:
        """Whether the vehicle is disturbed at all, wherever it begins."""
        return self.noise > 0 or self.dead_sector > 0 or self.turn_scale > 0 or self.turn_noise_degrees > 0


@dataclass(frozen=True, slots=True)
class _Episode:
    """What is wrong with a vehicle in one episode."""

    sensors: SensorFaults
    turn_scale: float
    turn_noise: float
    """[rad]"""
    generator: np.random.Generator
    """Of the noise that is still to come."""


class RandomizedFleet:
    """A fleet of disturbed vehicles. See `sim.base.Fleet` for the contract.

    What disturbs an episode is a function of its world alone.
    """

    def __init__(self, fleet: Fleet, domain_randomization: DomainRandomization) -> None:
        self.size = fleet.size
        self._fleet = fleet
        self._disturbances = domain_randomization
        self._episodes: dict[int, _Episode] = {}

    def reset(self, worlds: Mapping[int, WorldSpec]) -> tuple[Array, Array]:
        """Puts some vehicles on the start of a world each."""
        self._episodes |= {i: _drawn(self._disturbances, world) for i, world in worlds.items()}
        poses, distances = self._fleet.reset(worlds)
        return poses, self._seen(distances, enumerate(worlds))

    def advance(
        self, heading_changes: Array, active: NDArray[np.bool_], speed_scales: Array | None = None
    ) -> tuple[Motions, Array]:
        """Drives one control period."""
        turns = heading_changes.copy()
        driving = np.flatnonzero(active).tolist()
        for i in driving:
            episode = self._episodes[i]
            turns[i] = episode.turn_scale * turns[i] + episode.turn_noise * episode.generator.standard_normal()
        motions, distances = self._fleet.advance(turns, active, speed_scales)
        return motions, self._seen(distances, ((i, i) for i in driving))

    def close(self) -> None:
        """Closes the fleet."""
        self._fleet.close()

    def _seen(self, distances: Array, rows: Iterable[tuple[int, int]]) -> Array:
        """What the sensors make of ray distances, of which these rows are of these vehicles."""
        seen = distances.copy()
        for row, i in rows:
            episode = self._episodes[i]
            seen[row] = degraded(distances[row], episode.sensors, episode.generator)
        return seen


def turned(world: WorldSpec, domain_randomization: DomainRandomization) -> WorldSpec:
    """The world with its start in any direction, if that is to be."""
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
