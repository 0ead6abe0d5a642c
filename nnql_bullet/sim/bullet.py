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


PHYSICS = {
    "reference": Physics(time_step=1 / 240, iterations=200, residual=1e-7),
    "fast": Physics(time_step=1 / 120, iterations=200, residual=1e-7),
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
        self._rays = np.stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))]) * paper.SENSOR_RANGE
        self._turn_rate = 0.0
        self._clearance = 0.0
        self._steps = 0
        footprint = vehicle.footprint
        farthest = hypot(abs(footprint.x) + footprint.half_length, abs(footprint.y) + footprint.half_width)
        fastest = drive.speed + vehicle.limits.yaw_rate * farthest
        # No point of the vehicle gets farther than this from one command to the next, slip included [m]: what is
        # farther off cannot be touched before the next look.
        self._reach = 1.1 * fastest / COMMAND_RATE + CONTACT_BREAKING_THRESHOLD
        self._footprint = as_rows((footprint,))[0]

    def close(self) -> None:
        """Disconnects the client."""
        self._finalizer()

    # The contract of a simulator

    def reset(self, world: WorldSpec) -> None:
        """Builds the world anew and puts the vehicle on its start, at the drive's speed."""
        self.place(world, world.start, self.drive.speed)

    def advance(self, heading_change: float, trace: list[Sample] | None = None) -> Motion:
        """Follows the turn's profile for one control period, or up to the first contact or the target."""
        begin, first_step = self.pose(), self._steps
        turn = plan_turn(self._turn_rate, heading_change, self.vehicle.limits)
        rates, headings = sample_turn(turn, self._command_times)
        feed_forward = (np.diff(headings) * COMMAND_RATE).tolist()
        wanted = (begin.yaw + headings).tolist()
        speed, gain = self.drive.speed, self.drive.heading_gain
        track, radius = self.vehicle.track, self.vehicle.wheel_radius
        (target_x, target_y), target_radius = self._world.target, self._world.target_radius
        closest = clear = self._clearance
        x, y, yaw = begin.x, begin.y, begin.yaw
        path_length, commands = 0.0, 0
        touching = at_target = False
        for commands, rate in enumerate(feed_forward, 1):
            yaw_rate = rate + gain * wrap_angle(wanted[commands - 1] - yaw)
            self.command_wheels(*wheel_speeds(speed, yaw_rate, track, radius))
            touching = self._run(self._steps_per_command, watched=clear <= self._reach)
            last_x, last_y = x, y
            x, y, yaw, clear = self._look()
            path_length += hypot(x - last_x, y - last_y)
            closest = min(closest, clear)
            at_target = hypot(x - target_x, y - target_y) <= target_radius
            over = touching or at_target
            if trace is not None and (over or commands % SAMPLE_EVERY == 0):
                trace.append(self.sample())
            if over:
                break
        self._turn_rate = float(rates[commands])
        self._clearance = clear
        return Motion(
            pose=Pose(x, y, yaw),
            speed=self.speed(),
            yaw_rate=self.yaw_rate(),
            wheel_speeds=self.wheel_speeds(),
            duration=(self._steps - first_step) * self.physics.time_step,
            path_length=path_length,
            clearance=0.0 if touching else closest,
            heading_error=wrap_angle(begin.yaw + heading_change - yaw),
            touching=touching,
            at_target=at_target and not touching,
        )

    def scan(self) -> Scan:
        """One batch of rays from the sensor, which pitches and rolls with the chassis."""
        position, rotation = self._chassis_frame()
        origin = position + rotation @ self.vehicle.sensor
        ends = origin + (rotation @ self._rays).T
        hits = bullet.rayTestBatch(
            [origin.tolist()] * len(ends), ends.tolist(), collisionFilterMask=OBSTACLE, physicsClientId=self.client
        )
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

    def step(self) -> None:
        """One physics step."""
        bullet.stepSimulation(self.client)
        self._steps += 1

    def command_wheels(self, left: float, right: float) -> None:
        """Has the wheel-speed controllers track these speeds [rad/s] within the torque limit, until told otherwise."""
        body, client, torque = self.body, self.client, self.vehicle.wheel_torque
        motor, mode = bullet.setJointMotorControl2, bullet.VELOCITY_CONTROL
        motor(body, self.left, mode, targetVelocity=left, force=torque, physicsClientId=client)
        motor(body, self.right, mode, targetVelocity=right, force=torque, physicsClientId=client)

    def release_wheels(self) -> None:
        """Lets the drive wheels roll freely."""
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
        ground = bullet.createMultiBody(0.0, shape, physicsClientId=self.client)
        bullet.changeDynamics(ground, -1, lateralFriction=1.0, physicsClientId=self.client)
        bullet.setCollisionFilterGroupMask(ground, -1, GROUND, WHEEL, self.client)

    def _add_solids(self, boxes: tuple[OrientedBox, ...], height: float) -> None:
        """Static boxes as one body of compound shapes: the solver then keeps one body instead of many."""
        shape = bullet.createCollisionShapeArray(
            shapeTypes=[bullet.GEOM_BOX] * len(boxes),
            halfExtents=[[box.half_length, box.half_width, height / 2] for box in boxes],
            collisionFramePositions=[[box.x, box.y, height / 2] for box in boxes],
            collisionFrameOrientations=[[0.0, 0.0, sin(box.yaw / 2), cos(box.yaw / 2)] for box in boxes],
            physicsClientId=self.client,
        )
        body = bullet.createMultiBody(0.0, shape, physicsClientId=self.client)
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
        self._swivel, self._caster = joints[vehicle.joints.swivel], joints[vehicle.joints.caster_roll]
        self._com = self._dynamics_info(-1)[3]
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
            bullet.changeDynamics(
                self.body,
                wheel,
                rollingFriction=contact.rolling_friction,
                spinningFriction=contact.spinning_friction,
                physicsClientId=self.client,
            )
        velocity = [speed * cos(pose.yaw), speed * sin(pose.yaw), 0.0]
        bullet.resetBaseVelocity(self.body, velocity, [0.0, 0.0, 0.0], self.client)
        rolling = {wheel: vehicle.wheel_radius for wheel in (self.left, self.right)}
        rolling[self._caster] = vehicle.caster_radius
        for wheel, radius in rolling.items():
            bullet.resetJointState(self.body, wheel, 0.0, speed / radius, self.client)

    def _release(self, joint: int) -> None:
        bullet.setJointMotorControl2(
            self.body, joint, bullet.VELOCITY_CONTROL, targetVelocity=0.0, force=0.0, physicsClientId=self.client
        )

    def _run(self, steps: int, watched: bool) -> bool:
        """Physics steps; where contact is possible each is checked, and the first one ends them."""
        for _ in range(steps):
            self.step()
            if watched and self.touching():
                return True
        return False

    def _look(self) -> tuple[float, float, float, float]:
        """x, y [m] and yaw [rad] of the rear-axle centre, and the clearance there [m]."""
        (x, y, _), (qx, qy, qz, qw) = bullet.getBasePositionAndOrientation(self.body, self.client)
        ahead, _, up = self._com
        return _seen_from_above(x, y, qx, qy, qz, qw, ahead, up, self._footprint, self._world.solids)  # type: ignore[no-any-return]

    def _chassis_frame(self) -> tuple[Array, Array]:
        """Origin (3,) [m] and rotation (3, 3) of the chassis frame; the engine gives the centre of mass."""
        com, orientation = bullet.getBasePositionAndOrientation(self.body, self.client)
        rotation = np.array(bullet.getMatrixFromQuaternion(orientation)).reshape(3, 3)
        return np.array(com) - rotation @ self._com, rotation

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
def _seen_from_above(
    com_x: float,
    com_y: float,
    qx: float,
    qy: float,
    qz: float,
    qw: float,
    ahead: float,
    up: float,
    footprint: Array,
    solids: Array,
) -> tuple[float, float, float, float]:
    """x, y, yaw of the rear-axle centre and the clearance there, from the engine's centre of mass and quaternion.

    The centre of mass lies `ahead` of the axle and `up` from it [m] in the chassis frame.
    """
    forward_x, forward_y = 1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy + qw * qz)
    x = com_x - (ahead * forward_x + up * 2 * (qx * qz + qw * qy))
    y = com_y - (ahead * forward_y + up * 2 * (qy * qz - qw * qx))
    yaw = np.arctan2(forward_y, forward_x)
    return x, y, yaw, clearance_at(x, y, yaw, footprint, solids)


def _disconnect(client: int) -> None:
    if bullet.isConnected(client):
        bullet.disconnect(client)


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
