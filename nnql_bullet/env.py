"""The task over a simulator of n vehicles: `reset` and `step` only sequence; other modules decide.

All arrays have a leading n, which may be 1.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nnql_bullet import paper
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array, wrap_angles
from nnql_bullet.planning.course import Course
from nnql_bullet.planning.planner import Planner
from nnql_bullet.sim.base import Motion, Simulator, Traces
from nnql_bullet.task import (
    REWARD_TERMS,
    RewardTerm,
    StateProperty,
    TaskOptions,
    ending,
    is_terminal,
    look_up,
    paper_reward,
    paper_table,
    readings_of,
    reward_terms,
    state_property,
)
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.worlds.passages import Point
from nnql_bullet.worlds.spec import WorldSpec

TOWARD_TARGET = len(paper.TURNS)
"""The sixth action: the paper's rule for a safe state, "changes its orientation toward the target location"."""
ACTIONS = len(paper.TURNS) + 1
STOP = ACTIONS
"""Added to an action: the same turn, while the vehicle brakes to a stand, and on the spot once it stands."""
REVERSE = 2 * ACTIONS
"""Added to an action: the same heading change, while the vehicle drives backwards; from ahead it brakes first."""
SLOW = 3 * ACTIONS
"""Added to an action: the same turn, while the vehicle drives ahead as slowly as it reverses."""
MANOEUVRES = 4 * ACTIONS
"""An action ahead, with `STOP`, with `REVERSE` or with `SLOW`: what a policy may choose. Most agents of this package
choose among the actions alone; `guided_search`, `dwa`, `pure_pursuit`, `mppi`, `orca`, `distilled` and a shield choose
among all, and so may your policy."""
LARGEST_TURN = max(paper.TURNS)
_TURNS = np.tile([*paper.TURNS, np.nan], MANOEUVRES // ACTIONS)


def as_actions(given: object, size: int, count: int = MANOEUVRES) -> NDArray[np.int64]:
    """Actions (n,) that a caller gave for n vehicles.

    Raises:
        UserError: If they are not as many whole numbers from 0 to `count` - 1.
    """
    try:
        actions = np.asarray(given)
    except ValueError:  # of lists of several lengths
        actions = np.empty(())
    if actions.shape != (size,) or actions.dtype.kind not in "iu" or not ((actions >= 0) & (actions < count)).all():
        raise UserError(f"give {size} whole numbers from 0 to {count - 1} as actions, not {given}")
    return actions.astype(np.int64)


def heading_change(action: int | Sequence[int] | NDArray[np.int64], target_bearing: ArrayLike) -> Array:
    """Heading changes (...) [rad] of manoeuvres (...): a turn of the paper, or toward the target up to the largest."""
    toward = np.minimum(np.maximum(target_bearing, -LARGEST_TURN), LARGEST_TURN)
    return np.where(np.isnan(_TURNS[action]), toward, _TURNS[action])


def speed_scale(action: int | NDArray[np.int64], drive: DriveOptions) -> Array:
    """Wanted speeds (...) of manoeuvres (...), as shares of the drive's, negative in reverse."""
    return np.array([1.0, 0.0, -drive.reverse_share, drive.reverse_share])[np.floor_divide(action, ACTIONS)]


@dataclass(frozen=True, slots=True)
class Commands:
    """What n vehicles are to do until the next decision."""

    actions: NDArray[np.int64]
    """Manoeuvres (n,); of commands that are none of them, the nearest."""
    heading_changes: Array
    """(n,) [rad], positive to the left."""
    speed_scales: Array
    """Wanted speeds as shares of the drive's (n,), from -1 to 1, negative backwards."""


def commands_of(actions: NDArray[np.int64], target_bearing: Array, drive: DriveOptions) -> Commands:
    """The commands of manoeuvres (n,), of vehicles whose targets are at bearings (n,) [rad]."""
    return Commands(actions, heading_change(actions, target_bearing), speed_scale(actions, drive))


def nearest_manoeuvres(heading_changes: Array, speed_scales: Array, drive: DriveOptions) -> NDArray[np.int64]:
    """The manoeuvres (n,) with one of the five turns that are nearest to commands (n,)."""
    turns = np.abs(heading_changes[:, None] - paper.TURNS).argmin(axis=-1)
    ways = np.arange(0, MANOEUVRES, ACTIONS)
    return np.asarray(turns + ways[np.abs(speed_scales[:, None] - speed_scale(ways, drive)).argmin(axis=-1)])


@dataclass(frozen=True, slots=True)
class Observation:
    """What an agent is told of n vehicles."""

    readings: Array
    """Readings of the eight sensors (n, 8) [m]: s_t of eq. (1)."""
    target_distance: Array
    """Distance of what the vehicle is to reach next: the target, the way point in turn or, on a plan, the point that
    moves on ahead (n,) [m]."""
    target_bearing: Array
    """Its bearing in the vehicle frame (n,) [rad], positive to the left."""
    yaw_rate: Array
    """(n,) [rad/s]"""
    speed: Array
    """Measured speed along the vehicle (n,) [m/s], negative backwards: see `sim.base.Motion`."""
    state_property: NDArray[np.int64]
    """`StateProperty` (n,)."""
    ray_distances: Array
    """The rays behind the readings (n, rays) [m], as `vehicle.sensor` has them; one that meets nothing reads its range.
    The paper's vehicle does not have them; only agents that say so use them."""
    landmark_distance: Array = None  # type: ignore[assignment]
    """Distance of a place that stays for the whole episode, by which a vehicle can localize itself: that of the target
    at the start (n,) [m]. By default the target stays."""
    landmark_bearing: Array = None  # type: ignore[assignment]
    """Its bearing in the vehicle frame (n,) [rad]."""
    distance_left: Array = None  # type: ignore[assignment]
    """Length of the known way to the last target: straight, by the way points, along the plan (n,) [m]."""

    def __post_init__(self) -> None:
        """Takes the target for landmark and for the only one where nothing else is said."""
        for name, other in _BY_DEFAULT.items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, getattr(self, other))


_BY_DEFAULT = {
    "landmark_distance": "target_distance",
    "landmark_bearing": "target_bearing",
    "distance_left": "target_distance",
}

MOST_YAW_RATE = 10.0
"""Bound that `as_numbers` clips the yaw rate to [rad/s]."""
FARTHEST = 1e6
"""Distance of a target above which no vehicle outside of the simulators drives to it: a map counts its cells [m]."""


def as_numbers(observation: Observation) -> NDArray[np.float32]:
    """Observations as float32 (n, 11): the eight readings, target distance, target bearing, yaw rate (clipped)."""
    o = observation
    numbers = np.empty((len(o.readings), paper.SECTORS + 3), np.float32)
    numbers[:, : paper.SECTORS] = o.readings
    numbers[:, -3], numbers[:, -2] = o.target_distance, o.target_bearing
    numbers[:, -1] = np.minimum(np.maximum(o.yaw_rate, -MOST_YAW_RATE), MOST_YAW_RATE)
    return numbers


@dataclass(frozen=True, slots=True)
class Transition:
    """One step of n vehicles; the rows of those that stood by have no meaning.

    `discount_t` is 0 where the episode ended for good, and 1 otherwise, also at one of `task.TRUNCATIONS`.
    """

    s_tm1: Observation
    a_tm1: NDArray[np.int64]
    """See `Commands.actions` (n,)."""
    r_t: Array
    """(n,)"""
    discount_t: Array
    """(n,)"""
    s_t: Observation
    terms: Array
    """Terms of the reward (n, number of terms)."""
    ending: NDArray[np.int64]
    """Index into `task.ENDINGS`, or `task.NO_ENDING` (n,)."""
    heading_command: Array
    """Heading changes that were commanded (n,) [rad]."""
    speed_command: Array
    """Speeds that were commanded (n,), as shares of the drive's."""
    motion: Motion
    active: NDArray[np.bool_]
    """Whether the vehicle took a step (n,)."""
    term_names: tuple[str, ...] = REWARD_TERMS
    """Names of `terms`."""
    at_waypoint: tuple[int, ...] = ()
    """The vehicles that reached a way point, which is not their last target."""


Reward = Sequence[RewardTerm] | Callable[[Transition], Array]
"""A reward in place of the paper's: terms whose sum it is, or a function that gives the rewards (n,) of the transitions
of n vehicles. Beside a function, the terms stay the paper's."""


def _as_rewards(given: object, size: int) -> Array:
    """Rewards (n,) that a function of the caller gave for n vehicles.

    Raises:
        UserError: If they are no finite numbers.
    """
    rewards = np.asarray(given)
    if rewards.shape != (size,) or rewards.dtype.kind not in "fiub" or not np.isfinite(rewards).all():
        raise UserError(f"the reward must be {size} finite numbers, one for each vehicle, not {given}")
    return rewards.astype(np.float64)


class Navigation:
    """Episodes of n vehicles in lockstep, in any simulator."""

    def __init__(
        self,
        simulator: Simulator,
        task: TaskOptions,
        reward: Reward | None = None,
        planner: Planner | None = None,
    ) -> None:
        """Makes the environment.

        Args:
            simulator: The simulator of n vehicles.
            task: Options of states, rewards and endings.
            reward: A reward in place of the paper's.
            planner: Plans the ways to the targets; without one vehicles are told the bearing of the target itself.

        Raises:
            UserError: If two terms of the reward have the same name.
        """
        self.simulator = simulator
        self.task = task
        given = None if reward is None or callable(reward) else tuple(reward)
        self._terms = paper_reward(task) if given is None else given
        self._table = paper_table(task) if given is None else None
        self._reward = reward if callable(reward) else None
        self.term_names = tuple(term.name for term in self._terms)
        if len(set(self.term_names)) < len(self.term_names):
            raise UserError(f"each term of a reward needs a name of its own, not {', '.join(self.term_names)}")
        n = simulator.size
        self._planner = planner
        self._worlds: dict[int, WorldSpec] = {}
        self._poses, self._landmarks = np.zeros((n, 3)), np.zeros((n, 2))
        self._courses: dict[int, Course] = {}  # of the vehicles with several targets, another one, or a plan
        self._steps = np.zeros(n, np.int64)
        self._places, self._staying = np.zeros((n, 2)), np.zeros(n)  # where each stays about, and for how long [m, s]
        self._about = task.stuck_radius * simulator.vehicle.length
        self._observation = Observation(
            readings=np.zeros((n, paper.SECTORS)),
            target_distance=np.zeros(n),
            target_bearing=np.zeros(n),
            yaw_rate=np.zeros(n),
            speed=np.zeros(n),
            state_property=np.zeros(n, np.int64),
            ray_distances=np.zeros((n, simulator.vehicle.sensor.rays)),
        )

    @property
    def observation(self) -> Observation:
        """The present observation. The rows of vehicles that were never reset have no meaning."""
        return self._observation

    def reset(self, worlds: Mapping[int, WorldSpec]) -> None:
        """Starts an episode for some vehicles, in a world each."""
        if not worlds:
            return
        vehicles = np.array(list(worlds))
        poses, ray_distances = self.simulator.reset(worlds)
        self._landmarks[vehicles] = [world.target for world in worlds.values()]
        self._worlds |= worlds
        self._poses = self._poses.copy()
        self._poses[vehicles] = poses
        for row, (vehicle, world) in enumerate(worlds.items()):
            self._courses.pop(vehicle, None)
            if world.waypoints or self._planner:
                self._courses[vehicle] = Course(world, world.targets, self._planner, *poses[row, :2].tolist())
        self._steps[vehicles] = 0
        self._places[vehicles], self._staying[vehicles] = poses[:, :2], 0.0
        nothing, safe = np.zeros(len(vehicles), np.bool_), np.full(len(vehicles), StateProperty.SAFE)
        still = np.zeros(len(vehicles))
        speeds = np.array([world.start_speed(self.simulator.drive.speed) for world in worlds.values()])
        started = self._observed(vehicles, poses, still, speeds, ray_distances, nothing, nothing, safe)
        self._observation = _put(self._observation, vehicles, started)

    def step(
        self, actions: NDArray[np.int64], active: NDArray[np.bool_] | None = None, traces: Traces | None = None
    ) -> Transition:
        """Carries out one decision of each vehicle.

        Args:
            actions: The manoeuvres (n,); those of vehicles that are not active have no effect.
            active: Vehicles that take a step (n,), all by default.
            traces: Lists that receive samples between the decisions, by vehicle.

        Raises:
            UserError: If they are not such numbers.
        """
        actions = as_actions(actions, self.simulator.size)
        commands = commands_of(actions, self._observation.target_bearing, self.simulator.drive)
        return self.carry_out(commands, active, traces)

    def carry_out(
        self, commands: Commands, active: NDArray[np.bool_] | None = None, traces: Traces | None = None
    ) -> Transition:
        """Carries out commands, as `step` does those of manoeuvres."""
        s_tm1, turns, scales = self._observation, commands.heading_changes, commands.speed_scales
        m, ray_distances = self.simulator.advance(turns, active, scales, traces)
        every = np.arange(self.simulator.size)
        if active is None:
            active = np.ones(self.simulator.size, np.bool_)
        at_waypoint = self._move_on(m, active)
        at_target = m.at_target
        if at_waypoint:
            at_target = at_target & ~np.isin(every, at_waypoint)
        s_t = self._observed(
            every,
            m.pose,
            m.yaw_rate,
            m.speed,
            ray_distances,
            m.touching | m.overturned,
            at_target,
            s_tm1.state_property,
        )
        poses = m.pose
        if not active.all():
            v = np.flatnonzero(active)
            poses = self._poses.copy()
            poses[v] = m.pose[v]
            s_t = _put(s_tm1, v, Observation(*(getattr(s_t, name)[v] for name in _FIELDS)))
        self._observation, self._poses = s_t, poses
        self._steps += active
        self._stay(m, active)
        terms = (
            reward_terms(s_tm1, s_t, self.task, self._terms)
            if self._table is None
            else look_up(s_tm1, s_t, self.task, self._table)
        )
        t = Transition(
            s_tm1=s_tm1,
            a_tm1=commands.actions,
            r_t=terms.sum(axis=-1),
            discount_t=np.where(is_terminal(s_t.state_property), 0.0, 1.0),
            s_t=s_t,
            terms=terms,
            ending=ending(s_t.state_property, self._steps, self.task, self._staying, m.overturned),
            heading_command=turns,
            speed_command=scales,
            motion=m,
            active=active,
            at_waypoint=at_waypoint,
            term_names=self.term_names,
        )
        return t if self._reward is None else replace(t, r_t=_as_rewards(self._reward(t), len(turns)))

    def set_targets(self, targets: Mapping[int, Sequence[Point]]) -> None:
        """Gives some vehicles, in the middle of their episodes, other targets in place of all that they had left.

        Args:
            targets: Places x, y [m] to reach in turn, by vehicle; the last is the target.

        Raises:
            UserError: If one has no target, or there is a planner and no way; then nothing has changed.
        """
        for vehicle, its in targets.items():
            if vehicle not in self._worlds or not its:
                lacks = "a target at least" if vehicle in self._worlds else "an episode first, by reset"
                raise UserError(f"give vehicle {vehicle} {lacks}")
        begun = {}
        for vehicle, its in targets.items():
            x, y = self._poses[vehicle, :2].tolist()
            begun[vehicle] = Course(self._worlds[vehicle], its, self._planner, x, y)
        self._courses |= begun
        self.simulator.retarget({vehicle: course.target for vehicle, course in begun.items()})
        self._observation = replace(self._observation, **self._sights(np.arange(self.simulator.size), self._poses))

    def plans(self, vehicle: int) -> list[tuple[float, Array]]:
        """Returns the plans of a vehicle in its present episode: when each was made [s], and its corners (k, 2) [m]."""
        course = self._courses.get(vehicle)
        return course.plans if course else []

    def _move_on(self, motion: Motion, active: NDArray[np.bool_]) -> tuple[int, ...]:
        """Tells the active vehicles (n,) of several targets or a plan what they are to reach next.

        Returns:
            Those that reached a way point.
        """
        passed = []
        for vehicle, course in self._courses.items():
            if active[vehicle]:
                x, y, _ = motion.pose[vehicle].tolist()
                if motion.at_target[vehicle] and course.is_at_waypoint:
                    course.turn_to_next(x, y)
                    self.simulator.retarget({vehicle: course.target})
                    passed.append(vehicle)
                course.update(x, y, float(motion.duration[vehicle]))
        return tuple(passed)

    def _sights(self, vehicles: NDArray[np.int64], poses: Array) -> dict[str, Any]:
        """What some vehicles are told of their targets, by the names of an `Observation`."""
        found = sights(self._landmarks[vehicles], poses, "target")
        if self._courses:
            left = found["target_distance"].copy()
            aims = self._landmarks[vehicles]
            for row, vehicle in enumerate(vehicles.tolist()):
                course = self._courses.get(vehicle)
                if course:
                    aims[row], left[row] = course.aim, course.distance_left
            landmarks = sights(self._landmarks[vehicles], poses, "landmark")
            found = {**sights(aims, poses, "target"), **landmarks, "distance_left": left}
        return found

    def _stay(self, motion: Motion, active: NDArray[np.bool_]) -> None:
        """Adds a control period to the time for which the active vehicles (n,) have stayed about one place."""
        x, y = (motion.pose[:, :2] - self._places).T
        gone = active & (np.hypot(x, y) > self._about)
        self._staying += np.where(active, motion.duration, 0.0)
        self._places[gone], self._staying[gone] = motion.pose[gone, :2], 0.0

    def _observed(
        self,
        vehicles: NDArray[np.int64],
        poses: Array,
        yaw_rates: Array,
        speeds: Array,
        ray_distances: Array,
        failed: NDArray[np.bool_],
        at_target: NDArray[np.bool_],
        before: NDArray[np.int64],
    ) -> Observation:
        """The observation of some vehicles."""
        readings = readings_of(ray_distances, self.task)
        return Observation(
            readings=readings,
            **self._sights(vehicles, poses),
            yaw_rate=yaw_rates,
            speed=speeds,
            state_property=state_property(readings, failed, at_target, self.task, before),
            ray_distances=ray_distances,
        )


def sights(places: Array, poses: Array, name: str) -> dict[str, Array]:
    """Distances (n,) [m] and bearings (n,) [rad] of places (n, 2) [m] from poses (n, 3), under a name."""
    dx, dy = (places - poses[:, :2]).T
    bearing = wrap_angles(np.arctan2(dy, dx) - poses[:, 2])
    return {f"{name}_distance": np.hypot(dx, dy), f"{name}_bearing": bearing}


_FIELDS = tuple(field.name for field in fields(Observation))


def _put(observation: Observation, vehicles: NDArray[np.int64], part: Observation) -> Observation:
    """The observation with the rows of some vehicles replaced; earlier observations stay as they were."""
    if len(vehicles) == len(observation.readings) and (np.diff(vehicles) > 0).all():
        return part
    whole = Observation(*(getattr(observation, name).copy() for name in _FIELDS))
    for name in _FIELDS:
        getattr(whole, name)[vehicles] = getattr(part, name)
    return whole
