"""The interface of every simulator: n vehicles in lockstep, each in a world of its own."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.geometry import Array, Pose
from nnql_bullet.types import Vector
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.passages import Point
from nnql_bullet.worlds.spec import WorldSpec

SAMPLE_EVERY = 4
"""Wheel commands from one sample of a trace to the next, which makes 30 samples a second. A period that ends early has
a last sample at its end."""


LEVEL: Vector = (0.0, 0.0, 0.0)
"""The tilt of a vehicle that stands on level ground."""


@dataclass(frozen=True, slots=True)
class Sample:
    """The vehicle at one instant between two decisions, for drawing."""

    time: float
    """Time since the reset [s]."""
    pose: Pose
    joint_angles: tuple[float, ...]
    """Angles of left drive, right drive, and of each caster that swivels its swivel and its roll [rad]."""
    wheel_speeds: tuple[float, float]
    """Speeds of the left and right drive wheel [rad/s]."""
    tilt: Vector = LEVEL
    """Rise of the rear-axle centre above its place on level ground [m], roll to the right and pitch nose down [rad]."""


Traces = Mapping[int, list[Sample]]
"""Lists that a simulator appends samples to, by vehicle."""


@dataclass(frozen=True, slots=True)
class Motion:
    """The motion of n vehicles in one control period. It ends early at a contact, inside the target, or at a fall."""

    pose: Array
    """x, y [m] and yaw [rad] of the rear-axle centre at the end (n, 3)."""
    yaw_rate: Array
    """Yaw rate at the end (n,) [rad/s]."""
    speed: Array
    """Speed of the rear-axle centre along the vehicle at the end (n,) [m/s], negative backwards. It is the body's own
    speed over the ground, slip and all, as odometry without slip and an inertial sensor measure it together."""
    duration: Array
    """(n,) [s]"""
    path_length: Array
    """Length of the path of the rear-axle centre (n,) [m], ahead and back."""
    clearance: Array
    """Smallest distance from the footprint to an obstacle or wall (n,) [m], checked at least 30 times a second."""
    heading_error: Array
    """Commanded heading change minus the one that was reached (n,) [rad]."""
    touching: NDArray[np.bool_]
    """Whether the vehicle touched an obstacle or wall (n,)."""
    at_target: NDArray[np.bool_]
    """Whether the rear-axle centre came within the radius of the target or way point (n,)."""
    overturned: NDArray[np.bool_]
    """Whether the vehicle tipped over (n,): `sim.contact.OVERTURNED`. The kinematic model never does."""


def no_motion(size: int) -> Motion:
    """The motion of n vehicles that stand by: all zero."""
    return Motion(np.zeros((size, 3)), *np.zeros((6, size)), *np.zeros((3, size), np.bool_))


def driving(active: NDArray[np.bool_] | None, size: int) -> Sequence[int]:
    """The vehicles that drive, of n: see `Simulator.advance`."""
    return range(size) if active is None else np.flatnonzero(active).tolist()


class Simulator(Protocol):
    """n vehicles in lockstep, each in a world of its own; they do not interact.

    `reset` comes first. What follows is a function of the calls since then. The arrays that are returned belong to the
    caller.
    """

    @property
    def size(self) -> int:
        """Number of vehicles: n."""

    @property
    def vehicle(self) -> VehicleSpec:
        """The vehicle that all n are."""

    @property
    def drive(self) -> DriveOptions:
        """Options of their controllers."""

    def reset(self, worlds: Mapping[int, WorldSpec]) -> tuple[Array, Array]:
        """Puts some vehicles on the start of a world each, whatever happened before.

        They start at rest where the world says so, else at the drive's speed. The first of its targets is theirs.

        Returns:
            Their poses (k, 3) and ray distances (k, rays) [m], in the order of `worlds`.
        """

    def advance(
        self,
        heading_changes: Array,
        active: NDArray[np.bool_] | None = None,
        speed_scales: Array | None = None,
        traces: Traces | None = None,
    ) -> tuple[Motion, Array]:
        """Drives one control period.

        Args:
            heading_changes: Wanted changes from the present yaws (n,) [rad], positive to the left. A vehicle that
                stands turns on the spot, about its rear-axle centre.
            active: Vehicles that drive (n,), all by default. The others stand by, and their rows in the result have no
                meaning.
            speed_scales: Wanted speeds as shares of the drive's (n,), from -1 to 1, which is the default; 0 is to stop,
                and the vehicle reverses below. Its limits say how fast a speed is reached.
            traces: Lists that receive samples between the decisions, by vehicle.

        Returns:
            The motion, and the ray distances (n, rays) [m] at its end.

        Raises:
            WorkerDied: If a process that holds some vehicles is gone.
        """

    def retarget(self, targets: Mapping[int, Point]) -> None:
        """Gives some vehicles another target x, y [m]; its radius stays."""

    def close(self) -> None:
        """Frees all resources. The simulator cannot be used after that."""
