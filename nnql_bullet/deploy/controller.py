"""Drives a vehicle by a policy: it decides by scan and odometry, and commands the wheels until the next decision.

Decisions, and the wheel speeds that follow from them, are those of the simulators' loop (`env.Navigation`,
`vehicle.controller`). Around it is a watch: on what is missing, late, damaged or in the wrong frame the vehicle brakes
straight ahead to a stand, with a reason. What was remembered is forgotten then; once all is well the vehicle drives on
as at a start.
"""

import logging
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from nnql_bullet.deploy.networks import in_numpy
from nnql_bullet.deploy.scans import Scan, Unusable, rays_of
from nnql_bullet.deploy.watch import (
    Fastest,
    Odometry,
    WatchOptions,
    WrongTime,
    check_move,
    checked_call,
    checked_odometry,
    checked_scan,
    checked_target,
)
from nnql_bullet.env import MOST_YAW_RATE, STOP, Observation, commands_of, sights
from nnql_bullet.errors import UserError
from nnql_bullet.experiment import Experiment
from nnql_bullet.geometry import Array, wrap_angle
from nnql_bullet.rollout import Policy, decide
from nnql_bullet.runs import LoadedPolicy, PolicyLike, is_learned, load_policy, read_learned
from nnql_bullet.setting import asked_tables
from nnql_bullet.shield.setting import FASTEST
from nnql_bullet.task import SAFE, readings_of, state_property
from nnql_bullet.vehicle.controller import COMMAND_RATE, Plan, command_wheels, plan_period
from nnql_bullet.vehicle.profiles import wheel_speeds
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.passages import Point

_log = logging.getLogger(__name__)
EARLY = 1e-3
"""Share of the time of a wheel command by which a call may come early and still be for it."""


@dataclass(frozen=True, slots=True)
class Command:
    """What the vehicle is to do now."""

    left: float
    """Speed of the left drive wheel [rad/s]."""
    right: float
    """Speed of the right drive wheel [rad/s]."""
    speed: float
    """The speed that both make [m/s]."""
    yaw_rate: float
    """The yaw rate that both make [rad/s]."""
    reason: str
    """Why the vehicle stops; empty while it drives."""
    action: int
    """The manoeuvre of `env` that it carries out."""
    decided: bool
    """Whether it was decided now."""
    overridden: bool
    """Whether a shield decided it in place of the agent."""


class _Course(NamedTuple):
    """What is carried out until the next decision."""

    begin: float
    """[s]"""
    yaw: float
    """Yaw then [rad]."""
    yaw_rate: float
    """Planned yaw rate then [rad/s]."""
    speed: float
    """Planned speed then [m/s]."""
    heading_change: float = 0.0
    """[rad]"""
    goal: float = 0.0
    """Speed to reach [m/s]."""
    action: int = STOP
    overridden: bool = False


class Controller:
    """Drives one vehicle; see the module. It has no clock: `step` is told the time."""

    def __init__(
        self,
        policy: PolicyLike,
        vehicle: str | VehicleSpec | None = None,
        shield: bool = False,
        *,
        speed: float | None = None,
        watch: WatchOptions | None = None,
        library: str | Path | None = None,
    ) -> None:
        """Loads the policy.

        Args:
            policy: As `load_policy` takes it. A run folder, a policy file or a shipped policy drives in NumPy.
            vehicle: A shipped robot, a TOML file or a `Vehicle`; by default that of the training.
            shield: Whether to put the policy into a shield, if it is in none.
            speed: Largest speed [m/s]; by default that of the policy, or the vehicle's own if that is less.
            watch: What is demanded of scans and odometry.
            library: A shared library of this policy as `export` writes it in C (see `exports.running.build`), which
                decides in its place. With a shield, the shield is in it too, and does not lead the vehicle. What it
                remembers it remembers by where the target is: of another target it begins anew.

        Raises:
            UserError: If there is no such policy or vehicle, or the policy needs what is not there: a plan through the
                whole world, or PyTorch.
        """
        loaded = _loaded(policy, asked_tables({"robot": vehicle, "speed": speed, "shield": shield}))
        experiment = loaded.experiment
        if experiment.config.plan:
            raise UserError("a policy on a plan needs a map of the whole world; leave out the table 'plan'")
        self.vehicle, self.drive, self.task = experiment.vehicle, experiment.config.drive, experiment.task
        self.watch = watch or WatchOptions()
        self.reason = "no call yet"
        """Why the vehicle stops; empty while it drives."""
        self._policy = experiment.policy if library is None else _compiled(loaded, Path(library))
        self._by_target = library is not None
        self._most = wheel_speeds(self.drive.speed, self.vehicle.limits.yaw_rate, *self._body)[1]
        yaw_rate = min(FASTEST * self.vehicle.limits.yaw_rate, MOST_YAW_RATE)
        self._fastest = Fastest(FASTEST * self.drive.speed, yaw_rate)
        self._called = -inf
        self._course = _Course(0.0, 0.0, 0.0, 0.0)
        self._rays: Array = np.empty(0)
        self._scanned = self._decided = -inf
        self._measured: Odometry | None = None
        self._forget()

    def step(self, scan: Scan | None, odometry: Odometry | None, target: Point | None, now: float) -> Command:
        """Says what the wheels are to do now. Call it at the rate at which they are commanded.

        Args:
            scan: The last one that came; None for none yet.
            odometry: Likewise.
            target: x, y [m] of the target in the frame of the odometry; None to stop.
            now: Time [s], by the clock of the stamps, which does not go back.
        """
        reason, decided, measured, before = "", False, None, self._called
        try:
            self._called = checked_call(now, before, self.watch)
            measured = self._measure(odometry, now)
            self._look(checked_scan(scan, self._scanned, self.watch, now))
            aim = checked_target(target, measured, self.watch)
            decided = bool(self.reason) or now >= self._course.begin + self.drive.decision_period - EARLY / COMMAND_RATE
            if decided:
                self._decide(measured, aim, now)
        except Unusable as why:
            reason, decided, measured = str(why), False, None
            if isinstance(why, WrongTime):
                self._called = why.now
            if not self.reason or self._called < before:
                self._stop(before)
        if reason != self.reason:
            _log.log(logging.WARNING if reason else logging.INFO, "%s", f"stops: {reason}" if reason else "drives")
            self.reason = reason
        return self._command(measured, decided)

    @property
    def _body(self) -> tuple[float, float]:
        return self.vehicle.track, self.vehicle.wheel_radius

    def _forget(self) -> None:
        """Begins anew, as at the start of a drive."""
        self._state = self._policy.reset(self._policy.initial_state(1), {0: 0})
        self._property = np.full(1, SAFE)
        self._mark: Point | None = None

    def _measure(self, odometry: Odometry | None, now: float) -> Odometry:
        """Takes odometry.

        Raises:
            Unusable: If the vehicle cannot be driven by it.
        """
        o, before = checked_odometry(odometry, self._fastest, self.watch, now), self._measured
        if before and o.stamp < before.stamp:
            raise Unusable(f"odometry: {before.stamp - o.stamp:.2f} s older than the one before it")
        self._measured = o
        if before:
            check_move(before, o, self._fastest, self.watch)
        return o

    def _look(self, scan: Scan) -> None:
        """Takes the rays of a scan, if it is a new one.

        Raises:
            Unusable: See `rays_of`.
        """
        if scan.stamp != self._scanned or not self._rays.size:
            self._rays, self._scanned = np.empty(0), float(scan.stamp)
            self._rays = rays_of(scan, self.vehicle.sensor, self.watch.scan_yaw)

    def _decide(self, o: Odometry, target: Point, now: float) -> None:
        """Decides, and begins to carry it out.

        Raises:
            Unusable: If nothing was scanned since the last decision.
        """
        if self._scanned <= self._decided:
            raise Unusable("scan: none since the last decision")
        if self._by_target and self._mark not in (None, target):
            self._forget()
        plan = self._plan(now)
        speed, yaw_rate = float(plan.speeds[0]), float(plan.yaw_rates[0])
        measured_speed = speed if o.speed is None else o.speed
        measured_rate = yaw_rate if o.yaw_rate is None else o.yaw_rate
        if self._mark is None:
            self._mark, speed, yaw_rate = target, measured_speed, measured_rate
        seen = self._observed(o, target, measured_speed, measured_rate)
        decision, self._state = decide(self._policy, seen, self._state)
        commands = commands_of(decision.actions, seen.target_bearing, self.drive)
        self._property, self._decided = seen.state_property, self._scanned
        self._course = _Course(
            begin=now,
            yaw=o.yaw,
            yaw_rate=yaw_rate,
            speed=speed,
            heading_change=float(commands.heading_changes[0]),
            goal=float(commands.speed_scales[0]) * self.drive.speed,
            action=int(decision.actions[0]),
            overridden=bool(decision.overridden[0]),
        )

    def _observed(self, o: Odometry, target: Point, speed: float, yaw_rate: float) -> Observation:
        """What the policy is told, as `env.Navigation` does. What it localizes itself by is its first target."""
        rays, here, nothing = self._rays[None], np.array([[o.x, o.y, o.yaw]]), np.zeros(1, np.bool_)
        readings = readings_of(rays, self.task)
        return Observation(
            readings=readings,
            **sights(np.array([target]), here, "target"),
            **sights(np.array([self._mark]), here, "landmark"),
            yaw_rate=np.array([yaw_rate]),
            speed=np.array([speed]),
            state_property=state_property(readings, nothing, nothing, self.task, self._property),
            ray_distances=rays,
        )

    def _stop(self, before: float) -> None:
        """Begins to brake straight ahead to a stand, from what was commanded at the last call [s], and forgets."""
        plan = self._plan(before)
        self._course = _Course(self._called, 0.0, float(plan.yaw_rates[0]), float(plan.speeds[0]))
        if self._called < before:  # so do the stamps begin anew
            self._scanned, self._decided, self._measured = -inf, -inf, None
        self._forget()

    def _plan(self, now: float) -> Plan:
        """The profiles of the wheel command at a time: at its begin and its end."""
        c = self._course
        number = np.floor((now - c.begin) * COMMAND_RATE + EARLY) if now > c.begin else 0.0
        times = np.array([number, number + 1]) / COMMAND_RATE
        return plan_period(c.yaw_rate, c.speed, c.heading_change, c.goal, self.vehicle.limits, times)

    def _command(self, o: Odometry | None, decided: bool) -> Command:
        """What the wheels do now, with feedback of the heading where it is known."""
        plan, c = self._plan(self._called), self._course
        error = wrap_angle(c.yaw + float(plan.headings[0]) - o.yaw) if o else 0.0
        both = np.empty((1, 2))
        command_wheels(plan.feed_forward, error, self.drive.heading_gain, *self._body, both)
        left, right = (both[0] * min(1.0, self._most / max(np.abs(both).max(), self._most))).tolist()
        track, radius = self._body
        return Command(
            left=left,
            right=right,
            speed=radius * (left + right) / 2,
            yaw_rate=radius * (right - left) / track,
            reason=self.reason,
            action=c.action,
            decided=decided,
            overridden=c.overridden,
        )


def _loaded(policy: PolicyLike, changes: dict[str, Any]) -> LoadedPolicy:
    """A policy whose agent is in NumPy if it was learned.

    Raises:
        UserError: If there is no such policy, or a value is wrong.
    """
    if not is_learned(policy):
        return load_policy(policy, changes)
    experiment, weights = read_learned(policy, changes)  # type: ignore[arg-type]  # a name or path
    config = experiment.config
    agent = in_numpy(experiment.agent_options, weights.arrays, experiment.vehicle, config.drive)
    return LoadedPolicy(str(policy), Experiment(config, agent), weights.episodes)


def _compiled(policy: LoadedPolicy, library: Path) -> Policy:
    """The policy in a shared library.

    Raises:
        UserError: If there is no such library, or such policies are not exported to C.
    """
    from nnql_bullet.exports.contract import contract_of
    from nnql_bullet.exports.running import LibraryPolicy
    from nnql_bullet.exports.shielded import in_shield

    exported = in_shield(policy) if policy.experiment.config.shield else policy
    return LibraryPolicy(library.absolute(), contract_of(exported))
