"""The seam between the task and what moves the vehicle: what every simulator is."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.geometry import Array, Pose
from nnql_bullet.sensing import Scan
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.spec import WorldSpec

SAMPLE_EVERY = 4
"""Commands from one sample of a trace to the next: 30 samples a second. The moment an episode ends is sampled too."""


@dataclass(frozen=True, slots=True)
class Sample:
    """The vehicle at one instant between two decisions, for drawing."""

    time: float
    """Since the reset [s]."""
    pose: Pose
    joint_angles: tuple[float, float, float, float]
    """Left and right drive, swivel, caster roll [rad]."""
    wheel_speeds: tuple[float, float]
    """Left and right [rad/s]."""


@dataclass(frozen=True, slots=True)
class Motion:
    """What one control period did to the vehicle. It ends early at the first contact, or inside the target."""

    pose: Pose
    """At its end."""
    speed: float
    """Of the rear-axle centre along the vehicle, at its end [m/s]."""
    yaw_rate: float
    """At its end [rad/s]."""
    wheel_speeds: tuple[float, float]
    """Left and right, at its end [rad/s]."""
    duration: float
    """[s]"""
    path_length: float
    """Of the rear-axle centre [m]."""
    clearance: float
    """Smallest distance from the footprint to an obstacle or wall, looked at 30 times a second or more [m]."""
    heading_error: float
    """Commanded heading change less the one reached, at its end [rad]."""
    touching: bool
    """Whether the vehicle touched an obstacle or wall."""
    at_target: bool
    """Whether the rear-axle centre came within the target's radius."""


class Simulator(Protocol):
    """A vehicle in a world. `reset` comes first; what follows is a function of the calls since then."""

    @property
    def vehicle(self) -> VehicleSpec:
        """The vehicle it moves."""

    @property
    def control_period(self) -> float:
        """Time from one decision to the next [s]."""

    def reset(self, world: WorldSpec) -> None:
        """Puts the vehicle on the world's start, already at speed, whatever happened before."""

    def advance(self, heading_change: float, trace: list[Sample] | None = None, speed_scale: float = 1.0) -> Motion:
        """Drives one control period.

        Args:
            heading_change: Wanted change from the present yaw [rad], positive to the left. A standing vehicle turns on
                the spot, about its rear-axle centre.
            trace: Where samples between the decisions are appended, if wanted.
            speed_scale: Wanted speed as a share of the drive's, from 0, which is to stand. It is reached as fast as the
                vehicle's limits let it.
        """

    def pose(self) -> Pose:
        """Where the vehicle is."""

    def scan(self) -> Scan:
        """What its sensors read."""

    def close(self) -> None:
        """Frees what it holds. It cannot be used after that."""


@dataclass(frozen=True, slots=True)
class Motions:
    """What one control period did to each of n vehicles: see `Motion`."""

    pose: Array
    """x, y [m], yaw [rad] at its end (n, 3)."""
    yaw_rate: Array
    """(n,) [rad/s]"""
    duration: Array
    """(n,) [s]"""
    path_length: Array
    """(n,) [m]"""
    clearance: Array
    """(n,) [m]"""
    heading_error: Array
    """(n,) [rad]"""
    touching: NDArray[np.bool_]
    """(n,)"""
    at_target: NDArray[np.bool_]
    """(n,)"""


class Fleet(Protocol):
    """n vehicles in lockstep, each in a world of its own, none of which the others notice."""

    @property
    def size(self) -> int:
        """How many vehicles: n."""

    def reset(self, worlds: Mapping[int, WorldSpec]) -> tuple[Array, Array]:
        """Puts some vehicles on the start of a world each, as `Simulator.reset` does.

        Returns:
            Their poses (k, 3) and ray distances (k, 72) [m], in the order of `worlds`.
        """

    def advance(
        self, heading_changes: Array, active: NDArray[np.bool_], speed_scales: Array | None = None
    ) -> tuple[Motions, Array]:
        """Drives one control period, as `Simulator.advance` does.

        The arrays returned may be overwritten by the next call.

        Args:
            heading_changes: Wanted changes from the present yaws (n,) [rad].
            active: Which vehicles drive (n,); the others stand by, and their rows in the result mean nothing.
            speed_scales: Wanted speeds as shares of the drive's (n,); the drive's speed if they are not given.

        Returns:
            The motions, and the ray distances (n, 72) [m] at their end.

        Raises:
            WorkerDied: If a process that holds some of them is gone.
        """

    def close(self) -> None:
        """Frees what it holds. It cannot be used after that."""


class WorkerDied(Exception):
    """A worker process is gone; the message names it."""
