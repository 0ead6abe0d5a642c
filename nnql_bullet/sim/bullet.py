"""Contact physics in PyBullet. The only module that imports pybullet.

Collision groups separate the contacts: the wheels, which are spheres with one contact point each, touch only the
ground; the chassis, a box over the whole footprint, touches only obstacles and walls; rays meet only these.
"""

import weakref
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from math import ceil, cos, sin
from tempfile import NamedTemporaryFile
from threading import Lock
from typing import Any

import numpy as np

from nnql_bullet import paper
from nnql_bullet.constants import GRAVITY
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array, Circle, OrientedBox, Pose, Shape, as_rows, meet_circle
from nnql_bullet.jit import njit
from nnql_bullet.machine import pybullet_package
from nnql_bullet.sim.base import Sample
from nnql_bullet.sim.bullet_state import (
    DynamicsInfo,
    JointInfo,
    JointState,
    LinkState,
    contact_force,
    hit_fractions,
)
from nnql_bullet.sim.c_library import decimal_points, silenced
from nnql_bullet.sim.contact import ContactEngine, VehicleMotion
from nnql_bullet.sim.physics import CONTACT_MARGIN, ContactForce, LinkDynamics, Quaternion
from nnql_bullet.types import Vector
from nnql_bullet.vehicle.controller import DriveOptions, own_speed
from nnql_bullet.vehicle.payload import physics_text
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.spec import WorldSpec, track_velocities

with silenced():  # it prints its build time
    try:
        import pybullet as bullet
    except ImportError as error:
        package = pybullet_package()
        advice = f"pip install {package}" if package else "PyPI has no wheel of it for this Python"
        others = "where there is none: conda install -c conda-forge pybullet, or --sim kinematic or mujoco"
        raise UserError(f"PyBullet is not installed, or does not load ({error}): {advice}; {others}") from None

CHASSIS, OBSTACLE, WHEEL, GROUND, POLE = 1, 2, 4, 8, 16
"""Collision groups, one bit each."""

SHAPES_PER_COMPOUND = 16
"""Largest number of shapes that `createCollisionShapeArray` takes."""

FASTEST_JOINT = 1e4
"""Limit on the speed of joints [rad/s]."""

BREAKING_THRESHOLD = 0.02
"""PyBullet's default of the distance at which a contact breaks [m]."""
ORIGIN: Vector = (0.0, 0.0, 0.0)
STRAIGHT: Quaternion = (0.0, 0.0, 0.0, 1.0)
"""The orientation that is no rotation."""

USUAL_SUPPORTS, USUAL_BURDEN = 3, 23.0
"""Wheels and casters of the vehicles that `PHYSICS` is stated for, and the most mass that a drive wheel of theirs
carries, over what its own inertia counts for as it rolls."""
MOST_BURDENED = 4.0
"""Largest factor of the solver's rounds for light wheels."""

LOCK = 1e4
"""Torque that holds a locked joint [N m]."""


@dataclass(frozen=True, slots=True)
class Physics:
    """Settings of the engine's solver."""

    time_step: float
    """[s]"""
    iterations: int
    """Largest number of the solver's iterations in a step."""
    residual: float
    """Squared residual below which the solver stops."""
    resists_driven: bool
    """Whether rolling resistance also acts on driven wheels; it always acts on free wheels. On driven wheels it only
    reduces the available torque, and costs the solver time."""


PHYSICS = {
    "reference": Physics(time_step=1 / 240, iterations=200, residual=1e-7, resists_driven=True),
    "fast": Physics(time_step=1 / 120, iterations=80, residual=1e-7, resists_driven=False),
}


def suited(physics: Physics, vehicle: VehicleSpec) -> Physics:
    """Returns the settings, which are stated for the shipped vehicle, for another one.

    The solver goes from contact to contact and stops when none misses its speed by more than the root of the residual.
    The misses of all add up in the vehicle's speed, and are to be small against it; more contacts need more rounds. So
    do light wheels under a heavy body, of whose speed a round puts right only the share that a wheel's inertia has. A
    payload changes none of that, so that drives with one and without compare.
    """
    supports, pace = len(vehicle.contacts) / USUAL_SUPPORTS, min(own_speed(vehicle) / paper.SPEED, 1.0)
    own = vehicle.mass - (vehicle.payload.mass if vehicle.payload else 0.0)
    carried, wheel = own * vehicle.rear_share / 2, vehicle.wheel_spin_inertia / vehicle.wheel_radius**2
    burden = min(carried / USUAL_BURDEN / wheel, MOST_BURDENED) if wheel else MOST_BURDENED
    return replace(
        physics,
        iterations=ceil(physics.iterations * supports * max(burden, 1.0)),
        residual=physics.residual * (pace / supports) ** 2,
    )


class _Stepping:
    """Counts the engines that step now, in any thread, and keeps PyBullet's threshold for them."""

    def __init__(self) -> None:
        self._engines = 0
        self._lock = Lock()

    def enter(self, client: int) -> None:
        with self._lock:
            self._engines += 1
            bullet.setPhysicsEngineParameter(contactBreakingThreshold=CONTACT_MARGIN, physicsClientId=client)

    def leave(self, client: int) -> None:
        with self._lock:
            self._engines -= 1
            if not self._engines:
                bullet.setPhysicsEngineParameter(contactBreakingThreshold=BREAKING_THRESHOLD, physicsClientId=client)


_STEPPING = _Stepping()


class BulletEngine(ContactEngine):
    """One vehicle in one world, in a DIRECT client of its own.

    PyBullet has one distance at which contacts break for the whole process, and does not tell it. It is set while the
    engine steps, and is PyBullet's default at other times: bodies of other code in the process keep their contacts as
    by default. Code that sets another distance sets it again after the engine has stepped.

    Attributes:
        client: PyBullet's number of the client.
        body: PyBullet's number of the vehicle.
        left: PyBullet's number of the left drive joint.
        right: PyBullet's number of the right drive joint.
    """

    def __init__(self, vehicle: VehicleSpec, drive: DriveOptions, physics: Physics) -> None:
        super().__init__(vehicle, drive, physics.time_step)
        self.physics = suited(physics, vehicle)
        self.client = bullet.connect(bullet.DIRECT)
        if self.client < 0:
            raise UserError("PyBullet gives no more simulators in this process; close some first")
        self._finalizer = weakref.finalize(self, _release, self.client)
        self._urdf = physics_text(vehicle)

    def close(self) -> None:
        """Disconnects the client."""
        self._finalizer()

    def advance(
        self,
        heading_change: float,
        trace: list[Sample] | None = None,
        speed_scale: float = 1.0,
        look: Callable[[], None] | None = None,
    ) -> VehicleMotion:
        """See `ContactEngine.advance`."""
        with self.own_threshold():
            return super().advance(heading_change, trace, speed_scale, look)

    def run(self, seconds: float) -> None:
        """See `VehiclePhysics.run`."""
        with self.own_threshold():
            super().run(seconds)

    def step(self) -> None:
        """See `VehiclePhysics.step`."""
        with self.own_threshold():
            super().step()

    @contextmanager
    def own_threshold(self) -> Iterator[None]:
        """Sets the distance at which contacts break, for one contact of each wheel, while this or another engine steps.

        With the default a rolling wheel keeps old contacts, which cost the solver time.
        """
        _STEPPING.enter(self.client)
        try:
            yield
        finally:
            _STEPPING.leave(self.client)

    # Quantities for probes

    def release_wheels(self) -> None:
        """Lets the drive wheels roll freely."""
        self._resist(self.vehicle.contact.rolling_friction)
        for joint in (self.left, self.right):
            self._hold(joint, 0.0)

    def lock_joints(self) -> None:
        """Stops every joint and holds its angle."""
        for joint in self._joints:
            angle = JointState(*bullet.getJointState(self.body, joint, self.client)).position
            bullet.resetJointState(self.body, joint, angle, 0.0, self.client)
            self._hold(joint, LOCK)

    def set_gravity(self, gravity: Vector) -> None:
        """Sets the acceleration of gravity [m/s2]; `place` sets it pointing down."""
        bullet.setGravity(*gravity, self.client)

    def set_velocity(self, x: float, y: float) -> None:
        """Sets the velocity of the chassis [m/s] and a yaw rate of zero; the joints keep their speeds."""
        bullet.resetBaseVelocity(self.body, [x, y, 0.0], [0.0, 0.0, 0.0], self.client)

    def set_swivel(self, angle: float, rate: float = 0.0) -> None:
        """See `VehiclePhysics.set_swivel`."""
        for swivel in self._swivels:
            bullet.resetJointState(self.body, swivel, angle, rate, self.client)

    def twist(self, torque: float) -> None:
        """Applies a torque about the vertical to the chassis during the next physics step [N m]."""
        bullet.applyExternalTorque(self.body, -1, [0.0, 0.0, torque], bullet.WORLD_FRAME, self.client)

    def touching(self) -> bool:
        """Whether the chassis touches an obstacle or wall; it cannot touch anything else."""
        return bool(bullet.getContactPoints(bodyA=self.body, linkIndexA=-1, physicsClientId=self.client))

    def obstacle_force(self) -> float:
        """Normal force of obstacles and walls on the chassis, summed over all contacts [N]."""
        return self._contact_force(-1).normal

    def wheel_forces(self) -> tuple[ContactForce, ...]:
        """Forces of the ground on the left and right wheel and on each caster."""
        return tuple(self._contact_force(link) for link in self._supports)

    def wheel_speeds(self) -> tuple[float, float]:
        """Speeds of the left and right drive wheel [rad/s]."""
        left, right = self._joint_states(self.left, self.right)
        return left.velocity, right.velocity

    def wheel_heights(self) -> tuple[float, ...]:
        """Heights of the centres of the left and right wheel and of each caster above the ground [m]."""
        return tuple(self._link_height(link) for link in self._supports)

    def sample(self) -> Sample:
        """The vehicle at the present time."""
        states = self._joint_states(*self._joints)
        left, right, *_ = states
        angles = tuple(state.position for state in states)
        return Sample(self.time(), self.pose(), angles, (left.velocity, right.velocity), self.tilt())

    def link_dynamics(self) -> dict[str, LinkDynamics]:
        """Properties of every link in the engine, by the link's name."""
        base, _ = bullet.getBodyInfo(self.body, self.client)
        names = {base.decode(): -1, **{joint.link_name: joint.number for joint in self._joint_infos()}}
        return {name: self._dynamics(index).dynamics for name, index in names.items()}

    # Construction

    def _build(self, world: WorldSpec, pose: Pose, speed: float, height: float, ground: bool) -> None:
        bullet.resetSimulation(physicsClientId=self.client)
        self._set_solver()
        bullet.setGravity(0.0, 0.0, -GRAVITY, self.client)
        if ground:
            self._add_ground()
        self._loaded, self._circles = np.zeros_like(self._near), as_rows(())
        self._load()
        self._half_height = world.obstacle_height / 2
        self._patrols = [self._add_patrol(patrol.box) for patrol in world.patrols]
        self._add_vehicle(pose, speed, height)

    def _load(self) -> None:
        """Adds the near blocks that are not there yet; none is removed, because that could disturb the solver."""
        shapes = self._shapes_in(self._near & ~self._loaded)
        self._loaded |= self._near
        circles = tuple(its for its in shapes if isinstance(its, Circle))
        boxes = tuple(its for its in shapes if isinstance(its, OrientedBox))
        for some, group in ((boxes, OBSTACLE), (circles, POLE)):
            for first in range(0, len(some), SHAPES_PER_COMPOUND):
                self._add_solids(some[first : first + SHAPES_PER_COMPOUND], self._world.obstacle_height, group)
        self._circles = np.concatenate([self._circles, as_rows(circles)])

    def _set_solver(self) -> None:
        bullet.setPhysicsEngineParameter(
            fixedTimeStep=self.physics.time_step,
            numSubSteps=0,
            numSolverIterations=self.physics.iterations,
            solverResidualThreshold=self.physics.residual,
            deterministicOverlappingPairs=1,
            physicsClientId=self.client,
        )

    def _add_ground(self) -> None:
        shape = bullet.createCollisionShape(bullet.GEOM_PLANE, physicsClientId=self.client)
        ground = bullet.createMultiBody(0.0, shape, useMaximalCoordinates=True, physicsClientId=self.client)
        bullet.changeDynamics(ground, -1, lateralFriction=1.0, physicsClientId=self.client)
        bullet.setCollisionFilterGroupMask(ground, -1, GROUND, WHEEL, self.client)

    def _add_solids(self, solids: tuple[Shape, ...], height: float, group: int) -> None:
        """Adds static boxes or upright cylinders as one compound body, which costs the solver less than many bodies.

        Like the ground it is a plain rigid body ("maximal coordinates"), which costs less than a multibody.
        """
        rows, kind = as_rows(solids).tolist(), bullet.GEOM_CYLINDER if group == POLE else bullet.GEOM_BOX
        half_yaws = [0.0 if isinstance(its, Circle) else its.yaw / 2 for its in solids]
        shape = bullet.createCollisionShapeArray(
            shapeTypes=[kind] * len(rows),
            halfExtents=[[*row[2:4], height / 2] for row in rows],
            radii=[row[6] for row in rows],
            lengths=[height] * len(rows),
            collisionFramePositions=[[*row[:2], height / 2] for row in rows],
            collisionFrameOrientations=[[0.0, 0.0, sin(its), cos(its)] for its in half_yaws],
            physicsClientId=self.client,
        )
        body = bullet.createMultiBody(0.0, shape, useMaximalCoordinates=True, physicsClientId=self.client)
        bullet.setCollisionFilterGroupMask(body, -1, group, CHASSIS, self.client)

    def _add_patrol(self, box: OrientedBox) -> tuple[int, Quaternion]:
        """Adds a moving box; returns the engine's number of it, and its orientation.

        It is a multibody, because the engine ignores the velocity of a plain rigid body without mass.
        """
        halves = [box.half_length, box.half_width, self._half_height]
        shape = bullet.createCollisionShape(bullet.GEOM_BOX, halfExtents=halves, physicsClientId=self.client)
        body = bullet.createMultiBody(0.0, shape, physicsClientId=self.client)
        bullet.setCollisionFilterGroupMask(body, -1, OBSTACLE, CHASSIS, self.client)
        return body, (0.0, 0.0, sin(box.yaw / 2), cos(box.yaw / 2))

    def _add_vehicle(self, pose: Pose, speed: float, height: float) -> None:
        vehicle = self.vehicle
        self.body = load_text(
            self._urdf,
            self.client,
            basePosition=[pose.x, pose.y, vehicle.wheel_radius + height],
            baseOrientation=[0.0, 0.0, sin(pose.yaw / 2), cos(pose.yaw / 2)],
            flags=bullet.URDF_USE_INERTIA_FROM_FILE,
        )
        infos = self._joint_infos()
        joints = {joint.name: joint.number for joint in infos if joint.joint_type != bullet.JOINT_FIXED}
        for joint in joints.values():
            self._hold(joint, 0.0)  # initially every joint has a motor that holds it
        self._joints = tuple(joints[name] for name in vehicle.joints.values())
        self.left, self.right, *_ = self._joints
        self._wheels, self._torques = (self.left, self.right), (vehicle.wheel_torque,) * 2
        self._swivels = [joints[its.swivel] for its in vehicle.casters if its.swivels]
        numbers = {joint.link_name: joint.number for joint in infos}
        self._supports = (self.left, self.right, *(numbers[its.link] for its in vehicle.casters))
        inertial = self._dynamics(-1)
        self._com = inertial.inertia_position
        x, y, z, w = inertial.inertia_orientation
        self._turned_back = None if inertial.inertia_orientation == STRAIGHT else (-x, -y, -z, w)
        wheels = self._supports
        for link in range(-1, len(infos)):
            # Damping, which applies to the whole body, needs a separate call; so does friction.
            bullet.changeDynamics(self.body, link, linearDamping=0.0, angularDamping=0.0, physicsClientId=self.client)
            group, mask = (CHASSIS, OBSTACLE | POLE) if link == -1 else (WHEEL, GROUND) if link in wheels else (0, 0)
            bullet.setCollisionFilterGroupMask(self.body, link, group, mask, self.client)
        # By default the engine limits joints to 100 rad/s; a small caster would drag at high speed.
        bullet.changeDynamics(self.body, -1, maxJointVelocity=FASTEST_JOINT, physicsClientId=self.client)
        contact = vehicle.contact
        balls = [not its.swivels for its in vehicle.casters]
        for wheel, ball in zip(wheels, [False, False, *balls], strict=True):
            friction = contact.ball_friction if ball else contact.wheel_friction
            bullet.changeDynamics(self.body, wheel, lateralFriction=friction, physicsClientId=self.client)
        for wheel in (self.left, self.right):
            friction = contact.spinning_friction
            bullet.changeDynamics(self.body, wheel, spinningFriction=friction, physicsClientId=self.client)
        self._resist(contact.rolling_friction)
        velocity = [speed * cos(pose.yaw), speed * sin(pose.yaw), 0.0]
        bullet.resetBaseVelocity(self.body, velocity, [0.0, 0.0, 0.0], self.client)
        rolling = {wheel: vehicle.wheel_radius for wheel in (self.left, self.right)}
        rolling |= {joints[its.roll]: its.radius for its in vehicle.casters if its.swivels}
        for wheel, radius in rolling.items():
            bullet.resetJointState(self.body, wheel, 0.0, speed / radius, self.client)

    def _resist(self, rolling_friction: float) -> None:
        """Sets the drive wheels' rolling friction [m]."""
        for wheel in (self.left, self.right):
            bullet.changeDynamics(self.body, wheel, rollingFriction=rolling_friction, physicsClientId=self.client)
        self._resisted = rolling_friction > 0

    def _hold(self, joint: int, torque: float) -> None:
        """Lets a joint's motor hold its angle within a torque limit [N m]; with a limit of 0 the joint is free."""
        bullet.setJointMotorControl2(
            self.body, joint, bullet.VELOCITY_CONTROL, targetVelocity=0.0, force=torque, physicsClientId=self.client
        )

    def _engage_motors(self) -> None:
        if self._resisted and not self.physics.resists_driven:
            self._resist(0.0)

    def _command(self, speeds: list[float]) -> None:
        bullet.setJointMotorControlArray(
            self.body,
            self._wheels,
            bullet.VELOCITY_CONTROL,
            targetVelocities=speeds,
            forces=self._torques,
            physicsClientId=self.client,
        )

    def _step(self) -> None:
        bullet.stepSimulation(self.client)
        self._steps += 1

    def _drive_freely(self, speeds: list[list[float]]) -> None:
        client, step, command, steps = self.client, bullet.stepSimulation, self._command, range(self._steps_per_command)
        for pair in speeds:
            command(pair)
            for _ in steps:
                step(client)
        self._steps += len(speeds) * len(steps)

    def _place_patrols(self) -> None:
        """Sets positions and then velocities, which the impact depends on; setting a position clears the velocity."""
        places, velocities = self._movers[:, :2].tolist(), track_velocities(self._tracks, self.time()).tolist()
        for (body, turned), (x, y), (vx, vy) in zip(self._patrols, places, velocities, strict=True):
            bullet.resetBasePositionAndOrientation(body, [x, y, self._half_height], turned, self.client)
            bullet.resetBaseVelocity(body, [vx, vy, 0.0], [0.0, 0.0, 0.0], self.client)

    def _frame(self) -> tuple[Vector, Quaternion]:
        position, orientation = bullet.getBasePositionAndOrientation(self.body, self.client)
        if self._turned_back:  # the engine tells that of the principal axes of inertia
            _, orientation = bullet.multiplyTransforms(ORIGIN, orientation, ORIGIN, self._turned_back)
        return position, orientation

    def _velocities(self) -> tuple[Vector, Vector]:
        velocities: tuple[Vector, Vector] = bullet.getBaseVelocity(self.body, self.client)
        return velocities

    def _cast(self, begins: Array, ends: Array) -> Array:
        hits = bullet.rayTestBatch(begins, ends, collisionFilterMask=OBSTACLE, physicsClientId=self.client)
        fractions, furthest = np.array(hit_fractions(hits)), self.vehicle.sensor.range
        if len(self._circles):  # the engine finds cylinders by iteration, not exactly
            _meet_circles(begins, ends, self._circles, furthest, fractions)
        return fractions * furthest

    def _link_height(self, joint: int) -> float:
        return LinkState(*bullet.getLinkState(self.body, joint, physicsClientId=self.client)).position[2]

    def _contact_force(self, link: int) -> ContactForce:
        return contact_force(bullet.getContactPoints(bodyA=self.body, linkIndexA=link, physicsClientId=self.client))

    def _joint_infos(self) -> list[JointInfo]:
        joints = range(bullet.getNumJoints(self.body, self.client))
        return [JointInfo(*bullet.getJointInfo(self.body, joint, self.client)) for joint in joints]

    def _joint_states(self, *joints: int) -> list[JointState]:
        return [JointState(*state) for state in bullet.getJointStates(self.body, joints, self.client)]

    def _dynamics(self, link: int) -> DynamicsInfo:
        return DynamicsInfo(*bullet.getDynamicsInfo(self.body, link, self.client))


@njit()
def _meet_circles(begins: Array, ends: Array, circles: Array, sensor_range: float, fractions: Array) -> None:
    """Shortens rays that meet circles.

    Args:
        begins: Where the rays begin, all in one place (m, 3) [m].
        ends: Where they end (m, 3) [m].
        circles: Rows (n, 7) of `as_rows`.
        sensor_range: Length of the rays [m].
        fractions: Shares of the length at which the rays meet something (m,); shortened.
    """
    directions = (ends - begins)[:, :2]
    for i in range(len(circles)):
        x, y, radius = circles[i, 0] - begins[0, 0], circles[i, 1] - begins[0, 1], circles[i, 6]
        if np.hypot(x, y) - radius < sensor_range:
            meet_circle(x, y, radius, directions, fractions)


def load_text(urdf: str, client: int, **options: Any) -> int:
    """Loads a URDF from its text, because the engine reads only files; returns the engine's number of the body.

    Args:
        urdf: The text.
        client: The engine's number of the client.
        options: Further arguments of `loadURDF`.

    Raises:
        UserError: If the engine cannot load it.
    """
    with NamedTemporaryFile("w", encoding="utf-8", prefix="nnql-bullet-", suffix=".urdf") as file:
        file.write(urdf)
        file.flush()
        try:
            with decimal_points():
                return int(bullet.loadURDF(file.name, physicsClientId=client, **options))
        except bullet.error as error:
            raise UserError(f"PyBullet cannot load the vehicle: {error}") from None


def _release(client: int) -> None:
    if bullet.isConnected(client):
        bullet.disconnect(client)


def has_numpy() -> bool:
    """Whether this build of PyBullet supports NumPy arrays."""
    return bool(bullet.isNumpyEnabled())


__all__ = [
    "ORIGIN",
    "PHYSICS",
    "STRAIGHT",
    "BulletEngine",
    "Physics",
    "bullet",
    "has_numpy",
    "load_text",
]
