"""One vehicle in one world of contact physics, as quantities that probes can set and read.

An engine implements the abstract methods; `sim.contact` adds the control of the wheels. Engines differ in nothing else.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from math import asin, atan2, cos, hypot, inf, sin

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.blocks import MANY_SHAPES, SHAPES_PER_BLOCK, blocks_within, bounds_of
from nnql_bullet.geometry import Array, Pose, Shape
from nnql_bullet.jit import njit
from nnql_bullet.types import Vector
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.spec import WorldSpec, follow_tracks

CONTACT_MARGIN = 0.0005
"""Distance below which an engine may report a contact [m]."""

ROOM = 10.0
"""How far the vehicle goes before an engine takes up other blocks of many shapes [m]."""

Quaternion = tuple[float, float, float, float]
"""x, y, z, w."""


@dataclass(frozen=True, slots=True)
class LinkDynamics:
    """Properties of a link in the engine."""

    mass: float
    """[kg]"""
    inertia: Vector
    """Moments about the principal axes [kg m2]."""
    friction: float
    rolling_friction: float
    """[m]"""
    spinning_friction: float
    """[m]"""


@dataclass(frozen=True, slots=True)
class ContactForce:
    """Force of the ground on a wheel, or of obstacles on the chassis [N]."""

    normal: float
    friction: float
    """Part in the plane of contact."""


class VehiclePhysics(ABC):
    """One vehicle in one world of contact physics. Probes use its methods."""

    _com: Vector
    """Origin of `_frame` in the chassis frame [m]."""
    _tracks: Array
    """Tracks of the patrols: rows (m, 6) of `WorldSpec.tracks`."""
    _solids: Array
    """Obstacles, walls and patrols at the present time: rows (n, 7) of `geometry.as_rows`."""
    _movers: Array
    """Rows of the patrols: a view into `_solids` (m, 7)."""
    _bounds: Array
    """Bounds of the blocks of `_solids` (k, 4) [m]."""
    _near: NDArray[np.bool_]
    """The blocks that have to be in the engine (k,)."""

    def __init__(self, vehicle: VehicleSpec, time_step: float, horizon: float) -> None:
        """Makes the vehicle, in no world yet.

        Args:
            vehicle: The vehicle.
            time_step: Duration of a physics step [s].
            horizon: Distance from the rear-axle centre within which the vehicle may touch or see anything in a control
                period [m].
        """
        self.vehicle = vehicle
        self.time_step = time_step
        self._horizon = horizon
        self._steps = 0

    def place(self, world: WorldSpec, pose: Pose, speed: float, height: float = 0.0, ground: bool = True) -> None:
        """Builds a new world and places the vehicle in it; nothing of an earlier world remains.

        Args:
            world: The obstacles, walls and patrols.
            pose: Pose of the rear-axle centre.
            speed: Speed straight ahead, with all wheels rolling [m/s].
            height: Height of the wheels above the ground [m].
            ground: Whether there is a ground.
        """
        self._steps = 0
        self._tracks, self._solids = world.tracks, world.solids_at(0.0)
        self._movers = self._solids[len(world.solids) :]
        self._world, self._bounds = world, bounds_of(self._solids, len(world.tracks))
        self._look_around(pose.x, pose.y)
        self._build(world, pose, speed, height, ground)
        self._move_patrols()

    def run(self, seconds: float) -> None:
        """Runs physics steps for a time [s], rounded to whole steps."""
        for _ in range(round(seconds / self.time_step)):
            self.step()

    def step(self) -> None:
        """Runs one physics step, then moves the patrols."""
        if self._room < inf:
            self._keep_near(self.pose())
        self._step_and_move()

    def command_wheels(self, left: float, right: float) -> None:
        """Sets the wheel speeds [rad/s] that the motors hold within the torque limit, until the next command."""
        self._engage_motors()
        self._command([left, right])

    @abstractmethod
    def close(self) -> None:
        """Frees the engine."""

    @abstractmethod
    def release_wheels(self) -> None:
        """Lets the drive wheels roll freely."""

    @abstractmethod
    def lock_joints(self) -> None:
        """Stops every joint and holds its angle."""

    @abstractmethod
    def set_gravity(self, gravity: Vector) -> None:
        """Sets the acceleration of gravity [m/s2]; `place` sets it pointing down."""

    @abstractmethod
    def set_velocity(self, x: float, y: float) -> None:
        """Sets the velocity of the chassis [m/s] and a yaw rate of zero; the joints keep their speeds."""

    @abstractmethod
    def set_swivel(self, angle: float, rate: float = 0.0) -> None:
        """Turns the casters that swivel to an angle from trailing [rad], where they swivel at a rate [rad/s]."""

    @abstractmethod
    def twist(self, torque: float) -> None:
        """Applies a torque about the vertical to the chassis during the next physics step [N m]."""

    @abstractmethod
    def touching(self) -> bool:
        """Whether the chassis touches an obstacle or wall; it cannot touch anything else."""

    @abstractmethod
    def obstacle_force(self) -> float:
        """Normal force of obstacles and walls on the chassis, summed over all contacts [N]."""

    @abstractmethod
    def wheel_forces(self) -> tuple[ContactForce, ...]:
        """Forces of the ground on the left and right wheel and on each caster."""

    @abstractmethod
    def wheel_speeds(self) -> tuple[float, float]:
        """Speeds of the left and right drive wheel [rad/s]."""

    @abstractmethod
    def wheel_heights(self) -> tuple[float, ...]:
        """Heights of the centres of the left and right wheel and of each caster above the ground [m]."""

    @abstractmethod
    def link_dynamics(self) -> dict[str, LinkDynamics]:
        """Properties of every link in the engine, by the link's name."""

    def wheel_loads(self) -> tuple[float, ...]:
        """Normal force of the ground on the left and right wheel and on each caster [N]."""
        return tuple(force.normal for force in self.wheel_forces())

    def time(self) -> float:
        """Time since the vehicle was placed [s]."""
        return self._steps * self.time_step

    def pose(self) -> Pose:
        """Pose of the rear-axle centre, seen from above."""
        position, orientation = self._frame()
        return Pose(*rear_axle(position, orientation, *self._com))

    def tilt(self) -> Vector:
        """Rise and tilt of the vehicle: see `sim.base.Sample`."""
        position, (x, y, z, w) = self._frame()
        upward = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)  # z of ahead, left and up
        height = position[2] - float(np.dot(self._com, upward))
        pitch = -asin(min(max(upward[0], -1.0), 1.0))
        return height - self.vehicle.wheel_radius, atan2(upward[1], upward[2]), pitch

    def velocity(self) -> Vector:
        """Velocity of the chassis [m/s]."""
        return self._velocities()[0]

    def velocity_at(self, point: Vector) -> Vector:
        """Velocity of a point of the chassis, which is given in the chassis frame [m/s]."""
        _, (x, y, z, w) = self._frame()
        linear, angular = self._velocities()
        axis, arm = np.array([x, y, z]), np.subtract(point, self._com)
        turned = arm + 2 * np.cross(axis, np.cross(axis, arm) + w * arm)
        vx, vy, vz = (np.asarray(linear) + np.cross(angular, turned)).tolist()
        return vx, vy, vz

    def speed(self) -> float:
        """Speed of the rear-axle centre along the vehicle [m/s]."""
        (vx, vy, _), (_, _, yaw_rate) = self._velocities()
        yaw, left = self.pose().yaw, self._com[1]
        return float(vx * cos(yaw) + vy * sin(yaw) + yaw_rate * left)

    def yaw_rate(self) -> float:
        """Yaw rate [rad/s]."""
        return float(self._velocities()[1][2])

    # Further methods that an engine implements

    @abstractmethod
    def _build(self, world: WorldSpec, pose: Pose, speed: float, height: float, ground: bool) -> None:
        """Builds the near blocks of the world and the vehicle in the engine (see `place`) and sets `_com`."""

    @abstractmethod
    def _load(self) -> None:
        """Puts the near blocks into the engine; the state of the vehicle stays as it is."""

    @abstractmethod
    def _step(self) -> None:
        """Runs and counts one physics step, without moving the patrols."""

    @abstractmethod
    def _engage_motors(self) -> None:
        """Prepares the drive wheels for `_command`, for example after a release."""

    @abstractmethod
    def _command(self, speeds: list[float]) -> None:
        """Sets the speeds of the left and right wheel [rad/s] that the motors hold."""

    @abstractmethod
    def _place_patrols(self) -> None:
        """Moves each patrol to the position in its row of `_movers`."""

    @abstractmethod
    def _frame(self) -> tuple[Vector, Quaternion]:
        """Position of a point fixed to the chassis [m], and the orientation of the chassis."""

    @abstractmethod
    def _velocities(self) -> tuple[Vector, Vector]:
        """Linear velocity of the origin of `_frame` [m/s], and angular velocity [rad/s]."""

    @abstractmethod
    def _cast(self, begins: Array, ends: Array) -> Array:
        """Computes the distances (n,) [m] at which rays from `begins` to `ends` (n, 3) meet an obstacle or wall."""

    def _keep_near(self, pose: Pose) -> None:
        """Puts into the engine what the vehicle may touch or see in a control period from here."""
        if hypot(pose.x - self._centre[0], pose.y - self._centre[1]) > self._room:
            self._look_around(pose.x, pose.y)
            self._load()

    def _look_around(self, x: float, y: float) -> None:
        """Finds the near blocks of a place [m]. An engine's step takes the longer, the more shapes it holds."""
        self._centre, self._room = (x, y), ROOM
        self._near = blocks_within(x, y, self._horizon + ROOM, self._bounds)
        if len(self._world.shapes) < MANY_SHAPES:
            self._near[:] = True
        if self._near.all():
            self._room = inf

    def _shapes_in(self, blocks: NDArray[np.bool_]) -> tuple[Shape, ...]:
        """The obstacles and walls of some blocks (k,)."""
        firsts = (SHAPES_PER_BLOCK * np.flatnonzero(blocks)).tolist()
        return tuple(shape for first in firsts for shape in self._world.shapes[first : first + SHAPES_PER_BLOCK])

    def _step_and_move(self) -> None:
        self._step()
        self._move_patrols()

    def _move_patrols(self) -> None:
        """Moves the patrols to their positions at the present time."""
        if len(self._tracks):
            follow_tracks(self._tracks, self.time(), self._movers)
            self._place_patrols()


@njit()
def rear_axle(
    position: tuple[float, float, float],
    orientation: tuple[float, float, float, float],
    ahead: float,
    left: float,
    up: float,
) -> tuple[float, float, float]:
    """Computes x, y [m] and yaw [rad] of the rear-axle centre from a frame fixed to the chassis.

    Args:
        position: Origin of the frame in the world [m].
        orientation: Its quaternion: x, y, z, w.
        ahead: Distance of that origin ahead of the rear axle, in the chassis frame [m].
        left: Its distance to the left of the rear-axle centre [m].
        up: Its distance above the rear axle [m].
    """
    qx, qy, qz, qw = orientation
    forward_x, forward_y = 1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy + qw * qz)
    x = position[0] - (ahead * forward_x + left * 2 * (qx * qy - qw * qz) + up * 2 * (qx * qz + qw * qy))
    y = position[1] - (ahead * forward_y + left * (1 - 2 * (qx * qx + qz * qz)) + up * 2 * (qy * qz - qw * qx))
    return x, y, np.arctan2(forward_y, forward_x)
