"""What every engine of contact physics shares: the wheel-speed controller, the contract, and what it is probed with.

An engine is a `ContactSimulator` that fills in the abstract methods. The controller stands here once, so that two
engines differ in their physics and in nothing else.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from math import cos, hypot, sin

import numpy as np

from nnql_bullet import paper
from nnql_bullet.geometry import Array, Pose, as_rows, clearance_at, wrap_angle
from nnql_bullet.jit import njit
from nnql_bullet.sensing import Scan, ray_angles, scan_from
from nnql_bullet.sim.base import SAMPLE_EVERY, Motion, Sample
from nnql_bullet.types import Vector
from nnql_bullet.vehicle.controller import COMMAND_RATE, DriveOptions, whole_steps
from nnql_bullet.vehicle.profiles import plan_turn, sample_ramp, sample_turn, wheel_speeds
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.spec import WorldSpec, follow_tracks

CONTACT_MARGIN = 0.0005
"""How far apart things may be that an engine takes for touching [m]."""

Quaternion = tuple[float, float, float, float]
"""x, y, z, w."""


@dataclass(frozen=True, slots=True)
class LinkDynamics:
    """What an engine holds of a link."""

    mass: float
    inertia: Vector
    """About the principal axes [kg m2]."""
    friction: float
    rolling_friction: float
    spinning_friction: float


@dataclass(frozen=True, slots=True)
class ContactForce:
    """Of the ground on a wheel [N]."""

    normal: float
    friction: float
    """In the plane of contact."""


class ContactSimulator(ABC):
    """One vehicle in one world. See `sim.base.Simulator` for the contract.

    Below that contract it offers the parts that physics is probed with: `place`, `step`, `command_wheels`,
    `release_wheels` and what comes after them, quantities named for what they are.
    """

    _tracks: Array
    """Of the patrols: rows (m, 6) of `WorldSpec.tracks`."""
    _com: Vector
    """Origin of `_frame` in the chassis frame [m]."""

    def __init__(self, vehicle: VehicleSpec, drive: DriveOptions, time_step: float) -> None:
        self.vehicle = vehicle
        self.drive = drive
        self.time_step = time_step
        self.control_period = drive.decision_period
        self._steps_per_command = whole_steps(1 / COMMAND_RATE, time_step)
        commands = whole_steps(drive.decision_period, 1 / COMMAND_RATE)
        self._command_times = np.arange(commands + 1) / COMMAND_RATE
        angles = ray_angles()
        self._rays = np.stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))], axis=1) * paper.SENSOR_RANGE
        self._begins, self._ends = np.empty_like(self._rays), np.empty_like(self._rays)
        self._turn_rate = 0.0
        self._ramp_speed = drive.speed
        self._clearance = 0.0
        self._steps = 0
        footprint = vehicle.footprint
        farthest = hypot(abs(footprint.x) + footprint.half_length, abs(footprint.y) + footprint.half_width)
        fastest = drive.speed + vehicle.limits.yaw_rate * farthest
        # No point of the vehicle gets farther than this from one look to the next, slip included [m]: what stands still
        # and is farther off cannot be touched in between.
        self._reach = 1.1 * fastest * SAMPLE_EVERY / COMMAND_RATE + CONTACT_MARGIN
        self._footprint = as_rows((footprint,))[0]

    # The contract of a simulator

    @abstractmethod
    def close(self) -> None:
        """Frees the engine."""

    def reset(self, world: WorldSpec) -> None:
        """Builds the world anew and puts the vehicle on its start, at the drive's speed."""
        self.place(world, world.start, self.drive.speed)

    def advance(
        self,
        heading_change: float,
        trace: list[Sample] | None = None,
        speed_scale: float = 1.0,
        look: Callable[[], None] | None = None,
    ) -> Motion:
        """Follows the turn's profile for one control period, or up to the first contact or the target.

        The wheels are commanded 120 times a second. The heading, whose error takes a quarter of a second to die out, is
        fed back at every look, 30 times a second. Contact is seen at the physics step that it happens in, the target
        after the wheel command that reaches it.

        Args:
            heading_change: See `sim.base.Simulator.advance`.
            trace: Likewise.
            speed_scale: Likewise.
            look: Called after every physics step; it may look at the simulator, not move it.
        """
        run = self._run if look is None else partial(self._run_seen, look)
        begin, first_step = self.pose(), self._steps
        turn = plan_turn(self._turn_rate, heading_change, self.vehicle.limits)
        rates, headings = sample_turn(turn, self._command_times)
        ramp, goal = np.empty(len(headings)), speed_scale * self.drive.speed
        sample_ramp(self._ramp_speed, goal, self.vehicle.limits.acceleration, self._command_times, ramp)
        # Of the axle and of the yaw, in the mean from each command to the next.
        feed_forward = np.stack([(ramp[:-1] + ramp[1:]) / 2, (headings[1:] - headings[:-1]) * COMMAND_RATE], axis=1)
        wanted = begin.yaw + headings
        way = np.array([begin.x, begin.y, begin.yaw, 0.0, self._clearance, self._clearance])
        speeds = np.empty((SAMPLE_EVERY, 2))
        constants, footprint, solids = self._constants, self._footprint, self._solids
        command, last, touching = 0, len(feed_forward), False
        while True:
            com, orientation = self._frame()
            near, at_target, until_look = _follow(
                com, orientation, way, wanted, feed_forward, command, speeds, constants, footprint, solids
            )
            over = command > 0 and (touching or at_target)
            if trace is not None and (over or command % SAMPLE_EVERY == 0 < command):
                trace.append(self.sample())
            if over or command == last:
                break
            carried_out, touching = run(speeds[:until_look].tolist(), self._steps_per_command, near)
            command += carried_out
            if not near:
                self._move_patrols()
        x, y, yaw, path_length, smallest, _ = way.tolist()
        (velocity_x, velocity_y, _), (_, _, yaw_rate) = self._velocities()
        self._clearance = clearance_at(x, y, yaw, footprint, solids)
        self._turn_rate, self._ramp_speed = float(rates[command]), float(ramp[command])
        return Motion(
            pose=Pose(x, y, yaw),
            speed=velocity_x * cos(yaw) + velocity_y * sin(yaw),
            yaw_rate=yaw_rate,
            wheel_speeds=self.wheel_speeds(),
            duration=(self._steps - first_step) * self.time_step,
            path_length=path_length,
            clearance=0.0 if touching else smallest,
            heading_error=wrap_angle(begin.yaw + heading_change - yaw),
            touching=touching,
            at_target=at_target and not touching,
        )

    def scan(self) -> Scan:
        """One batch of rays from the sensor, which pitches and rolls with the chassis."""
        position, orientation = self._frame()
        _move_rays(position, orientation, self._sensor, self._rays, self._begins, self._ends)
        return scan_from(self._cast(self._begins, self._ends))

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
            speed: Straight ahead, all wheels rolling [m/s]; `advance` goes on at the drive's, whatever it is.
            height: Of the wheels above the ground [m].
            ground: Whether there is any.
        """
        self._turn_rate, self._ramp_speed = 0.0, self.drive.speed
        self._steps = 0
        self._tracks, self._solids = world.tracks, world.solids_at(0.0)
        self._movers = self._solids[len(world.solids) :]  # the same numbers, not a copy
        self._build(world, pose, speed, height, ground)
        self._move_patrols()
        self._sensor = np.subtract(self.vehicle.sensor, self._com)
        self._clearance = self._look()[3]
        ahead, _, up = self._com
        drive, (target_x, target_y) = self.drive, world.target
        control = drive.heading_gain, self.vehicle.track, self.vehicle.wheel_radius
        reach = self._reach + max((p.speed for p in world.patrols), default=0.0) * SAMPLE_EVERY / COMMAND_RATE
        self._constants = np.array((ahead, up, reach, *control, target_x, target_y, world.target_radius))

    def run(self, seconds: float) -> None:
        """Physics steps for so long, to the nearest step."""
        for _ in range(round(seconds / self.time_step)):
            self.step()

    def step(self) -> None:
        """One physics step, which ends with the patrols where they are by then."""
        self._step()
        self._move_patrols()

    def command_wheels(self, left: float, right: float) -> None:
        """Has the wheel-speed controllers track these speeds [rad/s] within the torque limit, until told otherwise."""
        self._run([[left, right]], 0, False)

    @abstractmethod
    def release_wheels(self) -> None:
        """Lets the drive wheels roll freely."""

    @abstractmethod
    def lock_joints(self) -> None:
        """Stops every joint and holds it where it is."""

    @abstractmethod
    def set_gravity(self, gravity: Vector) -> None:
        """[m/s2]; a placed vehicle has it pointing down."""

    @abstractmethod
    def set_velocity(self, x: float, y: float) -> None:
        """Sends the chassis along [m/s], without turning it; the joints go on as they were."""

    @abstractmethod
    def set_swivel(self, angle: float) -> None:
        """Turns the caster from trailing [rad], at rest."""

    @abstractmethod
    def twist(self, torque: float) -> None:
        """Turns the chassis about the vertical during the next physics step [N m]."""

    @abstractmethod
    def touching(self) -> bool:
        """Whether the chassis touches anything now. The wheels touch nothing but the ground."""

    @abstractmethod
    def obstacle_force(self) -> float:
        """Normal force of obstacles and walls on the chassis, as a sum over all contacts [N]."""

    @abstractmethod
    def wheel_forces(self) -> tuple[ContactForce, ContactForce, ContactForce]:
        """Of the ground on the left, right and caster wheel."""

    @abstractmethod
    def wheel_speeds(self) -> tuple[float, float]:
        """Left and right drive wheel [rad/s]."""

    @abstractmethod
    def wheel_heights(self) -> Vector:
        """Of the left, right and caster wheel centre above the ground [m]."""

    @abstractmethod
    def link_dynamics(self) -> dict[str, LinkDynamics]:
        """What the engine holds of every link, by the link's name."""

    @abstractmethod
    def sample(self) -> Sample:
        """The vehicle now."""

    def wheel_loads(self) -> Vector:
        """Normal force of the ground on the left, right and caster wheel [N]."""
        left, right, front = (force.normal for force in self.wheel_forces())
        return left, right, front

    def time(self) -> float:
        """Since the vehicle was placed [s]."""
        return self._steps * self.time_step

    def velocity(self) -> Vector:
        """Of the chassis [m/s]."""
        return self._velocities()[0]

    def speed(self) -> float:
        """Of the rear-axle centre along the vehicle [m/s]."""
        vx, vy, _ = self.velocity()
        yaw = self.pose().yaw
        return float(vx * cos(yaw) + vy * sin(yaw))

    def yaw_rate(self) -> float:
        """[rad/s]."""
        return float(self._velocities()[1][2])

    # What else an engine fills in

    @abstractmethod
    def _step(self) -> None:
        """One physics step, counted, in which the patrols stay where they were."""

    @abstractmethod
    def _place_patrols(self) -> None:
        """Puts each patrol where its row of `_movers` says."""

    @abstractmethod
    def _build(self, world: WorldSpec, pose: Pose, speed: float, height: float, ground: bool) -> None:
        """See `place`; also sets `_com`."""

    @abstractmethod
    def _run(self, speeds: list[list[float]], steps: int, watched: bool) -> tuple[int, bool]:
        """Carries out wheel commands, with some physics steps after each.

        Where contact is possible each step is checked, and the first contact ends it; where it is not, the patrols may
        stay where they were.

        Returns:
            How many commands were carried out, and whether there was contact.
        """

    def _run_seen(
        self, look: Callable[[], None], speeds: list[list[float]], steps: int, watched: bool
    ) -> tuple[int, bool]:
        """Does the same as `_run`, and looks after every step."""
        for number, (left, right) in enumerate(speeds, 1):
            self.command_wheels(left, right)
            for _ in range(steps):
                self.step()
                look()
                if watched and self.touching():
                    return number, True
        return len(speeds), False

    def _move_patrols(self) -> None:
        """Brings the patrols to where they are now."""
        if len(self._tracks):
            follow_tracks(self._tracks, self.time(), self._movers)
            self._place_patrols()

    @abstractmethod
    def _frame(self) -> tuple[Vector, Quaternion]:
        """Where a point fixed to the chassis is [m], and how the chassis is turned."""

    @abstractmethod
    def _velocities(self) -> tuple[Vector, Vector]:
        """Linear, of the origin of `_frame` [m/s], and angular [rad/s]."""

    @abstractmethod
    def _cast(self, begins: Array, ends: Array) -> Array:
        """How far rays from `begins` to `ends` (n, 3) get before they meet an obstacle or wall (n,) [m]."""

    def _look(self) -> tuple[float, float, float, float]:
        """x, y [m] and yaw [rad] of the rear-axle centre, and the clearance there [m]."""
        (x, y, _), (qx, qy, qz, qw) = self._frame()
        ahead, _, up = self._com
        x, y, yaw = _rear_axle(x, y, qx, qy, qz, qw, ahead, up)
        return x, y, yaw, clearance_at(x, y, yaw, self._footprint, self._solids)


@njit()
def _rear_axle(
    com_x: float, com_y: float, qx: float, qy: float, qz: float, qw: float, ahead: float, up: float
) -> tuple[float, float, float]:
    """x, y [m] and yaw [rad] of the rear-axle centre, from the engine's frame.

    Its origin, the centre of mass for instance, lies `ahead` of the axle and `up` from it [m] in the chassis frame.
    """
    forward_x, forward_y = 1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy + qw * qz)
    x = com_x - (ahead * forward_x + up * 2 * (qx * qz + qw * qy))
    y = com_y - (ahead * forward_y + up * 2 * (qy * qz - qw * qx))
    return x, y, np.arctan2(forward_y, forward_x)


@njit()
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

    From one look to the next no point of the vehicle and of a solid get nearer to each other by more than the reach, so
    the clearance is worked out only where it may have fallen to the reach, or below the smallest.

    Args:
        com: Origin of the engine's frame [m].
        orientation: Its quaternion.
        way: Brought up to date: x, y, yaw of the rear-axle centre, path length, smallest clearance so far, and what the
            clearance is now at least.
        wanted: Headings at each command and at the end (m + 1,) [rad].
        feed_forward: Speed [m/s] and yaw rate [rad/s] after each command (m, 2).
        command: The next one.
        speeds: Filled with left and right wheel speeds (k, 2) [rad/s] of the commands until the next look.
        constants: Of the simulator, see `ContactSimulator.place`.
        footprint: A row (6,) of `as_rows`.
        solids: Rows (n, 6) of `as_rows`, as they are now.

    Returns:
        Whether contact is possible before the next look, whether the target is reached, and how many commands there are
        until the next look: one where it might reach the target.
    """
    ahead, up, reach, gain, track, radius, target_x, target_y, target_radius = constants
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
        speed, yaw_rate = feed_forward[command + k]
        speeds[k, 0], speeds[k, 1] = wheel_speeds(speed, yaw_rate + correction, track, radius)
    return way[5] <= reach, to_target <= 0.0, until_look


@njit()
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
        com: Origin of the engine's frame [m].
        orientation: Its quaternion.
        sensor: Seen from that origin (3,) [m].
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


@njit()
def _rotated(x: float, y: float, z: float, qx: float, qy: float, qz: float, qw: float) -> tuple[float, float, float]:
    """A vector turned by a unit quaternion: v + 2 w (q x v) + 2 q x (q x v)."""
    tx, ty, tz = 2 * (qy * z - qz * y), 2 * (qz * x - qx * z), 2 * (qx * y - qy * x)
    return x + qw * tx + qy * tz - qz * ty, y + qw * ty + qz * tx - qx * tz, z + qw * tz + qx * ty - qy * tx
