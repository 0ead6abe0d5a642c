"""Contact physics: the vehicle in PyBullet. The only module that imports pybullet.

Collision groups keep apart what must not meet: the wheels, which are spheres with one true contact point each, touch
only the ground; the chassis, a box over the whole footprint, touches only obstacles and walls; rays see only these.
"""

import importlib.util
import os
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from math import cos, hypot, sin
from typing import Any

import numba
import numpy as np

from nnql_bullet import paper
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array, OrientedBox, Pose, as_rows, clearance_at, wrap_angle
from nnql_bullet.sensing import Scan, ray_angles, scan_from
from nnql_bullet.sim.base import COMMAND_RATE, SAMPLE_EVERY, DriveOptions, Motion, Sample, whole_steps
from nnql_bullet.sim.local import LocalFleet
from nnql_bullet.vehicle.drive import plan_turn, sample_turn, wheel_speeds
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.spec import WorldSpec


@contextmanager
def _silenced_stderr() -> Iterator[None]:
    """Keeps what C code prints off the user's terminal."""
    kept = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    try:
        os.dup2(nowhere, 2)
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


with _silenced_stderr():  # it prints its build time
    import pybullet as bullet

CHASSIS, OBSTACLE, WHEEL, GROUND = 1, 2, 4, 8
"""Collision groups, one bit each."""

GRAVITY = 9.81
SHAPES_PER_COMPOUND = 16
"""`createCollisionShapeArray` takes no more."""

CONTACT_BREAKING_THRESHOLD = 0.0005
"""Keeps one contact a wheel: with the default of 0.02 m a rolling wheel drags old contacts along, at the solver's cost.
The engine holds this one number for the whole process, so every simulator sets the same."""


@dataclass(frozen=True, slots=True)
class Physics:
    """Settings of the engine's solver."""

    time_step: float
    """[s]"""
    iterations: int
    """At most, a step."""
    residual: float
    """The solver stops when its squared residual falls below this."""
    resists_driven: bool
    """Whether rolling resistance acts on driven wheels too. There it only takes 1 N m of what the controllers have, and
    costs the solver a third of its time; on free wheels it always acts."""


PHYSICS = {
    "reference": Physics(time_step=1 / 240, iterations=200, residual=1e-7, resists_driven=True),
    "fast": Physics(time_step=1 / 120, iterations=80, residual=1e-7, resists_driven=False),
}


@dataclass(frozen=True, slots=True)
class LinkDynamics:
    """What the engine holds of a link."""

    mass: float
    inertia: tuple[float, float, float]
    friction: float
    rolling_friction: float
    spinning_friction: float


class BulletSimulator:
    """One vehicle in one world, in a DIRECT client of its own. See `sim.base.Simulator` for the contract.

    Below that contract it offers the parts that physics is probed with: `place`, `step`, `command_wheels`,
    `release_wheels`, quantities named for what they are, and the engine's own numbers of its `client`, of the vehicle's
    `body` and of the drive joints `left` and `right`.
    """

    def __init__(self, vehicle: VehicleSpec, drive: DriveOptions, physics: Physics) -> None:
        self.vehicle = vehicle
        self.physics = physics
        self.drive = drive
        self.control_period = drive.decision_period
        self._steps_per_command = whole_steps(1 / COMMAND_RATE, physics.time_step)
        commands = whole_steps(drive.decision_period, 1 / COMMAND_RATE)
        self._command_times = np.arange(commands + 1) / COMMAND_RATE
        self.client = bullet.connect(bullet.DIRECT)
        if self.client < 0:
            raise UserError("PyBullet gives no more simulators in this process; close some first")
        self._finalizer = weakref.finalize(self, _disconnect, self.client)
        angles = ray_angles()
        self._rays = np.stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))], axis=1) * paper.SENSOR_RANGE
        self._begins, self._ends = np.empty_like(self._rays), np.empty_like(self._rays)
        self._turn_rate = 0.0
        self._clearance = 0.0
        self._steps = 0
        footprint = vehicle.footprint
        farthest = hypot(abs(footprint.x) + footprint.half_length, abs(footprint.y) + footprint.half_width)
        fastest = drive.speed + vehicle.limits.yaw_rate * farthest
        # No point of the vehicle gets farther than this from one look to the next, slip included [m]: what is farther
        # off cannot be touched in between.
        self._reach = 1.1 * fastest * SAMPLE_EVERY / COMMAND_RATE + CONTACT_BREAKING_THRESHOLD
        self._footprint = as_rows((footprint,))[0]

    def close(self) -> None:
        """Disconnects the client."""
        self._finalizer()

    # The contract of a simulator

    def reset(self, world: WorldSpec) -> None:
        """Builds the world anew and puts the vehicle on its start, at the drive's speed."""
        self.place(world, world.start, self.drive.speed)

    def advance(self, heading_change: float, trace: list[Sample] | None = None) -> Motion:
        """Follows the turn's profile for one control period, or up to the first contact or the target.

        The wheels are commanded 120 times a second. The heading, whose error takes a quarter of a second to die out, is
        fed back at every look, 30 times a second. Contact is seen at the physics step that it happens in, the target
        after the wheel command that reaches it.
        """
        begin, first_step = self.pose(), self._steps
        turn = plan_turn(self._turn_rate, heading_change, self.vehicle.limits)
        rates, headings = sample_turn(turn, self._command_times)
        wanted, feed_forward = begin.yaw + headings, (headings[1:] - headings[:-1]) * COMMAND_RATE
        way = np.array([begin.x, begin.y, begin.yaw, 0.0, self._clearance, self._clearance])
        speeds = np.empty((SAMPLE_EVERY, 2))
        constants, footprint, solids = self._constants, self._footprint, self._world.solids
        command, last, touching = 0, len(feed_forward), False
        while True:
            com, orientation = bullet.getBasePositionAndOrientation(self.body, self.client)
            near, at_target, until_look = _follow(
                com, orientation, way, wanted, feed_forward, command, speeds, constants, footprint, solids
            )
            over = command > 0 and (touching or at_target)
            if trace is not None and (over or command % SAMPLE_EVERY == 0 < command):
                trace.append(self.sample())
            if over or command == last:
                break
            carried_out, touching = self._run(speeds[:until_look].tolist(), self._steps_per_command, near)
            command += carried_out
        x, y, yaw, path_length, smallest, _ = way.tolist()
        (velocity_x, velocity_y, _), (_, _, yaw_rate) = bullet.getBaseVelocity(self.body, self.client)
        self._clearance = clearance_at(x, y, yaw, footprint, solids)
        self._turn_rate = float(rates[command])
        return Motion(
            pose=Pose(x, y, yaw),
            speed=velocity_x * cos(yaw) + velocity_y * sin(yaw),
            yaw_rate=yaw_rate,
            wheel_speeds=self.wheel_speeds(),
            duration=(self._steps - first_step) * self.physics.time_step,
            path_length=path_length,
            clearance=0.0 if touching else smallest,
            heading_error=wrap_angle(begin.yaw + heading_change - yaw),
            touching=touching,
            at_target=at_target and not touching,
        )

    def scan(self) -> Scan:
        """One batch of rays from the sensor, which pitches and rolls with the chassis."""
        position, orientation = bullet.getBasePositionAndOrientation(self.body, self.client)
        _move_rays(position, orientation, self._sensor, self._rays, self._begins, self._ends)
        hits = bullet.rayTestBatch(self._begins, self._ends, collisionFilterMask=OBSTACLE, physicsClientId=self.client)
        return scan_from(np.array([hit[2] for hit in hits]) * paper.SENSOR_RANGE)

    def pose(self) -> Pose:
        """Of the rear-axle centre, seen from above."""
        x, y, yaw, _ = self._look()
        return Pose(x, y, yaw)

    # What physics is probed with

    def place(self, world: WorldSpec, pose: Pose, speed: float, height: float = 0.0, ground: bool = True) -> None:
        """Builds a world from nothing, so that a reset is a fresh start, and puts the vehicle into it.

        Args:
            world: What stands there.
            pose: Of the rear-axle centre.
            speed: Straight ahead, all wheels rolling [m/s].
            height: Of the wheels above the ground [m].
            ground: Whether there is any.
        """
        self._world = world
        self._turn_rate = 0.0
        self._steps = 0
        bullet.resetSimulation(physicsClientId=self.client)
        bullet.setPhysicsEngineParameter(
            fixedTimeStep=self.physics.time_step,
            numSubSteps=0,
            numSolverIterations=self.physics.iterations,
            solverResidualThreshold=self.physics.residual,
            contactBreakingThreshold=CONTACT_BREAKING_THRESHOLD,
            deterministicOverlappingPairs=1,
            physicsClientId=self.client,
        )
        bullet.setGravity(0.0, 0.0, -GRAVITY, self.client)
        if ground:
            self._add_ground()
        solids = world.obstacles + world.walls
        for first in range(0, len(solids), SHAPES_PER_COMPOUND):
            self._add_solids(solids[first : first + SHAPES_PER_COMPOUND], world.obstacle_height)
        self._add_vehicle(pose, speed, height)
        self._clearance = self._look()[3]
        ahead, _, up = self._com
        drive, (target_x, target_y) = self.drive, world.target
        control = drive.speed, drive.heading_gain, self.vehicle.track, self.vehicle.wheel_radius
        self._constants = np.array((ahead, up, self._reach, *control, target_x, target_y, world.target_radius))

    def step(self) -> None:
        """One physics step."""
        bullet.stepSimulation(self.client)
        self._steps += 1

    def command_wheels(self, left: float, right: float) -> None:
        """Has the wheel-speed controllers track these speeds [rad/s] within the torque limit, until told otherwise."""
        self._run([[left, right]], 0, False)

    def release_wheels(self) -> None:
        """Lets the drive wheels roll freely."""
        self._resist(self.vehicle.contact.rolling_friction)
        for joint in (self.left, self.right):
            self._release(joint)

    def touching(self) -> bool:
        """Whether the chassis touches anything now. The wheels touch nothing but the ground."""
        return bool(bullet.getContactPoints(bodyA=self.body, linkIndexA=-1, physicsClientId=self.client))

    def time(self) -> float:
        """Since the vehicle was placed [s]."""
        return self._steps * self.physics.time_step

    def speed(self) -> float:
        """Of the rear-axle centre along the vehicle [m/s]."""
        (vx, vy, _), _ = bullet.getBaseVelocity(self.body, self.client)
        yaw = self.pose().yaw
        return float(vx * cos(yaw) + vy * sin(yaw))

    def yaw_rate(self) -> float:
        """[rad/s]."""
        return float(bullet.getBaseVelocity(self.body, self.client)[1][2])

    def vertical_velocity(self) -> float:
        """Of the chassis, upwards [m/s]."""
        return float(bullet.getBaseVelocity(self.body, self.client)[0][2])

    def wheel_speeds(self) -> tuple[float, float]:
        """Left and right drive wheel [rad/s]."""
        left, right = bullet.getJointStates(self.body, [self.left, self.right], self.client)
        return left[1], right[1]

    def wheel_heights(self) -> tuple[float, float, float]:
        """Of the left, right and caster wheel centre above the ground [m]."""
        left, right, front = (self._link_height(joint) for joint in (self.left, self.right, self._caster))
        return left, right, front

    def wheel_loads(self) -> tuple[float, float, float]:
        """Normal force of the ground on the left, right and caster wheel [N]."""
        left, right, front = (self._normal_force(joint) for joint in (self.left, self.right, self._caster))
        return left, right, front

    def sample(self) -> Sample:
        """The vehicle now."""
        joints = [self.left, self.right, self._swivel, self._caster]
        states = bullet.getJointStates(self.body, joints, self.client)
        left, right, swivel, roll = (state[0] for state in states)
        return Sample(self.time(), self.pose(), (left, right, swivel, roll), (states[0][1], states[1][1]))

    def link_dynamics(self) -> dict[str, LinkDynamics]:
        """What the engine holds of every link, by the link's name."""
        base = bullet.getBodyInfo(self.body, self.client)[0].decode()
        names = {base: -1}
        for joint in range(bullet.getNumJoints(self.body, self.client)):
            names[bullet.getJointInfo(self.body, joint, self.client)[12].decode()] = joint
        return {name: self._dynamics(index) for name, index in names.items()}

    # How it is built

    def _add_ground(self) -> None:
        shape = bullet.createCollisionShape(bullet.GEOM_PLANE, physicsClientId=self.client)
        ground = bullet.createMultiBody(0.0, shape, useMaximalCoordinates=True, physicsClientId=self.client)
        bullet.changeDynamics(ground, -1, lateralFriction=1.0, physicsClientId=self.client)
        bullet.setCollisionFilterGroupMask(ground, -1, GROUND, WHEEL, self.client)

    def _add_solids(self, boxes: tuple[OrientedBox, ...], height: float) -> None:
        """Static boxes as one body of compound shapes: the solver then keeps one body instead of many.

        Like the ground it is a plain rigid body ("maximal coordinates"), which costs less than a multibody.
        """
        shape = bullet.createCollisionShapeArray(
            shapeTypes=[bullet.GEOM_BOX] * len(boxes),
            halfExtents=[[box.half_length, box.half_width, height / 2] for box in boxes],
            collisionFramePositions=[[box.x, box.y, height / 2] for box in boxes],
            collisionFrameOrientations=[[0.0, 0.0, sin(box.yaw / 2), cos(box.yaw / 2)] for box in boxes],
            physicsClientId=self.client,
        )
        body = bullet.createMultiBody(0.0, shape, useMaximalCoordinates=True, physicsClientId=self.client)
        bullet.setCollisionFilterGroupMask(body, -1, OBSTACLE, CHASSIS, self.client)

    def _add_vehicle(self, pose: Pose, speed: float, height: float) -> None:
        vehicle = self.vehicle
        self.body = bullet.loadURDF(
            str(vehicle.urdf),
            [pose.x, pose.y, vehicle.wheel_radius + height],
            [0.0, 0.0, sin(pose.yaw / 2), cos(pose.yaw / 2)],
            flags=bullet.URDF_USE_INERTIA_FROM_FILE
            | bullet.URDF_USE_IMPLICIT_CYLINDER
            | bullet.URDF_IGNORE_VISUAL_SHAPES,
            physicsClientId=self.client,
        )
        joints = {}
        for joint in range(bullet.getNumJoints(self.body, self.client)):
            joints[bullet.getJointInfo(self.body, joint, self.client)[1].decode()] = joint
            self._release(joint)  # every joint starts with a motor that holds it
        self.left, self.right = joints[vehicle.joints.left_drive], joints[vehicle.joints.right_drive]
        self._wheels, self._torques = (self.left, self.right), (vehicle.wheel_torque,) * 2
        self._swivel, self._caster = joints[vehicle.joints.swivel], joints[vehicle.joints.caster_roll]
        self._com = self._dynamics_info(-1)[3]
        self._sensor = np.subtract(vehicle.sensor, self._com)
        wheels = (self.left, self.right, self._caster)
        for link in (-1, *joints.values()):
            # Damping goes to the whole body and must stand in a call of its own; so must friction.
            bullet.changeDynamics(self.body, link, linearDamping=0.0, angularDamping=0.0, physicsClientId=self.client)
            group, mask = (CHASSIS, OBSTACLE) if link == -1 else (WHEEL, GROUND) if link in wheels else (0, 0)
            bullet.setCollisionFilterGroupMask(self.body, link, group, mask, self.client)
        contact = vehicle.contact
        for wheel in wheels:
            bullet.changeDynamics(self.body, wheel, lateralFriction=contact.wheel_friction, physicsClientId=self.client)
        for wheel in (self.left, self.right):
            friction = contact.spinning_friction
            bullet.changeDynamics(self.body, wheel, spinningFriction=friction, physicsClientId=self.client)
        self._resist(contact.rolling_friction)
        velocity = [speed * cos(pose.yaw), speed * sin(pose.yaw), 0.0]
        bullet.resetBaseVelocity(self.body, velocity, [0.0, 0.0, 0.0], self.client)
        rolling = {wheel: vehicle.wheel_radius for wheel in (self.left, self.right)}
        rolling[self._caster] = vehicle.caster_radius
        for wheel, radius in rolling.items():
            bullet.resetJointState(self.body, wheel, 0.0, speed / radius, self.client)

    def _resist(self, rolling_friction: float) -> None:
        """Sets the drive wheels' rolling friction [m]."""
        for wheel in (self.left, self.right):
            bullet.changeDynamics(self.body, wheel, rollingFriction=rolling_friction, physicsClientId=self.client)
        self._resisted = rolling_friction > 0

    def _release(self, joint: int) -> None:
        bullet.setJointMotorControl2(
            self.body, joint, bullet.VELOCITY_CONTROL, targetVelocity=0.0, force=0.0, physicsClientId=self.client
        )

    def _run(self, speeds: list[list[float]], steps: int, watched: bool) -> tuple[int, bool]:
        """Carries out wheel commands, with some physics steps after each.

        Where contact is possible each step is checked, and the first contact ends it.

        Returns:
            How many commands were carried out, and whether there was contact.
        """
        if self._resisted and not self.physics.resists_driven:
            self._resist(0.0)
        motors, mode, step = bullet.setJointMotorControlArray, bullet.VELOCITY_CONTROL, bullet.stepSimulation
        body, client, wheels, torques = self.body, self.client, self._wheels, self._torques
        for number, pair in enumerate(speeds, 1):
            motors(body, wheels, mode, targetVelocities=pair, forces=torques, physicsClientId=client)
            for taken in range(1, steps + 1):
                step(client)
                if watched and self.touching():
                    self._steps += (number - 1) * steps + taken
                    return number, True
        self._steps += len(speeds) * steps
        return len(speeds), False

    def _look(self) -> tuple[float, float, float, float]:
        """x, y [m] and yaw [rad] of the rear-axle centre, and the clearance there [m]."""
        (x, y, _), (qx, qy, qz, qw) = bullet.getBasePositionAndOrientation(self.body, self.client)
        ahead, _, up = self._com
        x, y, yaw = _rear_axle(x, y, qx, qy, qz, qw, ahead, up)
        return x, y, yaw, clearance_at(x, y, yaw, self._footprint, self._world.solids)

    def _link_height(self, joint: int) -> float:
        return float(bullet.getLinkState(self.body, joint, physicsClientId=self.client)[4][2])

    def _normal_force(self, joint: int) -> float:
        contacts = bullet.getContactPoints(bodyA=self.body, linkIndexA=joint, physicsClientId=self.client)
        return float(sum(contact[9] for contact in contacts))

    def _dynamics_info(self, link: int) -> Any:
        return bullet.getDynamicsInfo(self.body, link, self.client)

    def _dynamics(self, link: int) -> LinkDynamics:
        info = self._dynamics_info(link)
        return LinkDynamics(info[0], info[2], info[1], info[6], info[7])


@numba.njit(cache=True)
def _rear_axle(
    com_x: float, com_y: float, qx: float, qy: float, qz: float, qw: float, ahead: float, up: float
) -> tuple[float, float, float]:
    """x, y [m] and yaw [rad] of the rear-axle centre, from the engine's centre of mass and quaternion.

    The centre of mass lies `ahead` of the axle and `up` from it [m] in the chassis frame.
    """
    forward_x, forward_y = 1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy + qw * qz)
    x = com_x - (ahead * forward_x + up * 2 * (qx * qz + qw * qy))
    y = com_y - (ahead * forward_y + up * 2 * (qy * qz - qw * qx))
    return x, y, np.arctan2(forward_y, forward_x)


@numba.njit(cache=True)
def _follow(
    com: tuple[float, float, float],
    orientation: tuple[float, float, float, float],
    way: Array,
    wanted: Array,
    feed_forward: Array,
    command: int,
    speeds: Array,
    constants: Array,
    footprint: Array,
    solids: Array,
) -> tuple[bool, bool, int]:
    """Looks where the vehicle is, and steers until the next look.

    From one look to the next no point of the vehicle moves farther than the reach, so the clearance is worked out only
    where it may have fallen to the reach, or below the smallest.

    Args:
        com: The engine's centre of mass [m].
        orientation: The engine's quaternion.
        way: Brought up to date: x, y, yaw of the rear-axle centre, path length, smallest clearance so far, and what the
            clearance is now at least.
        wanted: Headings at each command and at the end (m + 1,) [rad].
        feed_forward: Yaw rates after each command (m,) [rad/s].
        command: The next one.
        speeds: Filled with left and right wheel speeds (k, 2) [rad/s] of the commands until the next look.
        constants: Of the simulator, see `BulletSimulator.place`.
        footprint: A row (6,) of `as_rows`.
        solids: Rows (n, 6) of `as_rows`.

    Returns:
        Whether contact is possible before the next look, whether the target is reached, and how many commands there are
        until the next look: one where it might reach the target.
    """
    ahead, up, reach, speed, gain, track, radius, target_x, target_y, target_radius = constants
    x, y, yaw = _rear_axle(com[0], com[1], *orientation, ahead, up)
    way[3] += np.hypot(x - way[0], y - way[1])
    way[0], way[1], way[2] = x, y, yaw
    way[5] -= reach
    if way[5] <= max(way[4], reach):
        way[5] = clearance_at(x, y, yaw, footprint, solids)
        way[4] = min(way[4], way[5])
    to_target = np.hypot(x - target_x, y - target_y) - target_radius
    until_look = min(len(speeds) if to_target > reach else 1, len(feed_forward) - command)
    correction = gain * wrap_angle(wanted[command] - yaw)
    for k in range(until_look):
        speeds[k, 0], speeds[k, 1] = wheel_speeds(speed, feed_forward[command + k] + correction, track, radius)
    return way[5] <= reach, to_target <= 0.0, until_look


@numba.njit(cache=True)
def _move_rays(
    com: tuple[float, float, float],
    orientation: tuple[float, float, float, float],
    sensor: Array,
    rays: Array,
    begins: Array,
    ends: Array,
) -> None:
    """Fills in where rays (n, 3) begin and end in the world (n, 3) [m].

    Args:
        com: The engine's centre of mass [m].
        orientation: The engine's quaternion.
        sensor: Seen from the centre of mass (3,) [m].
        rays: In the chassis frame (n, 3) [m].
        begins: To be filled.
        ends: To be filled.
    """
    ahead, left, up = _rotated(sensor[0], sensor[1], sensor[2], *orientation)
    x, y, z = com[0] + ahead, com[1] + left, com[2] + up
    for i in range(len(rays)):
        dx, dy, dz = _rotated(rays[i, 0], rays[i, 1], rays[i, 2], *orientation)
        begins[i, 0], begins[i, 1], begins[i, 2] = x, y, z
        ends[i, 0], ends[i, 1], ends[i, 2] = x + dx, y + dy, z + dz


@numba.njit(cache=True)
def _rotated(x: float, y: float, z: float, qx: float, qy: float, qz: float, qw: float) -> tuple[float, float, float]:
    """A vector turned by a unit quaternion: v + 2 w (q x v) + 2 q x (q x v)."""
    tx, ty, tz = 2 * (qy * z - qz * y), 2 * (qz * x - qx * z), 2 * (qx * y - qy * x)
    return x + qw * tx + qy * tz - qz * ty, y + qw * ty + qz * tx - qx * tz, z + qw * tz + qx * ty - qy * tx


def _disconnect(client: int) -> None:
    if bullet.isConnected(client):
        bullet.disconnect(client)


def bullet_fleet(vehicle: VehicleSpec, drive: DriveOptions, physics: Physics, size: int) -> LocalFleet:
    """Vehicles in contact physics, in this process."""
    return LocalFleet([BulletSimulator(vehicle, drive, physics) for _ in range(size)])


def has_numpy() -> bool:
    """Whether this build of PyBullet takes and gives NumPy arrays."""
    return bool(bullet.isNumpyEnabled())


def probe_tiny() -> None:
    """Draws one picture with TinyRenderer, the software renderer within PyBullet."""
    client = bullet.connect(bullet.DIRECT)
    _draw_something(client, bullet.ER_TINY_RENDERER)


def probe_egl() -> None:
    """Draws one picture with the EGL plugin.

    Raises:
        RuntimeError: If there is no plugin, or it does not load.
    """
    _silence_output()  # the plugin prints what it finds
    client = bullet.connect(bullet.DIRECT)
    found = importlib.util.find_spec("eglRenderer")
    if found is None or bullet.loadPlugin(found.origin, "_eglRendererPlugin", physicsClientId=client) < 0:
        raise RuntimeError("the EGL plugin does not load")
    _draw_something(client, bullet.ER_BULLET_HARDWARE_OPENGL)


def _draw_something(client: int, renderer: int) -> None:
    sphere = bullet.createVisualShape(bullet.GEOM_SPHERE, radius=0.5, physicsClientId=client)
    bullet.createMultiBody(0.0, -1, sphere, physicsClientId=client)
    view = bullet.computeViewMatrix((3.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 1.0))
    projection = bullet.computeProjectionMatrixFOV(40.0, 1.0, 0.1, 10.0)
    picture = bullet.getCameraImage(32, 32, view, projection, renderer=renderer, physicsClientId=client)
    if np.ptp(picture[2]) == 0:
        raise RuntimeError("the picture is empty")


def _silence_output() -> None:
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
