"""What an environment tells of its vehicles: a registry of observations, each a space and a pure function."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import hypot, pi
from typing import Any, Literal

import gymnasium
import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.agents.learning.frames import FrameMaker, Look
from nnql_bullet.agents.learning.options import DoubleDqnOptions
from nnql_bullet.env import MOST_YAW_RATE, Observation, as_numbers
from nnql_bullet.experiment import Experiment
from nnql_bullet.geometry import Array
from nnql_bullet.task import FAILURE

Space = gymnasium.spaces.Space[Any]
Told = Any
"""Observations of n vehicles: an array (n, ...), or a dictionary of such arrays."""

ObservationName = Literal["sectors", "rays", "goal", "frames"]


@dataclass(frozen=True, slots=True)
class Situation:
    """All that may be told of n vehicles."""

    observation: Observation
    pose: Array
    """(n, 3)"""
    target: Array
    """(n, 2) [m]"""
    look: Look | None
    """What they see and remember; None unless the observation is one that `remembers`."""


@dataclass(frozen=True, slots=True)
class ObservationKind:
    """An observation that an environment may give."""

    space: Callable[[Experiment], Space]
    """The space of one vehicle."""
    tell: Callable[[Situation], Told]
    """What lies in that space, but for rounding and clipping, of n vehicles."""
    remembers: bool = False
    """Whether it needs the vehicles' memory."""


def clipped(told: Told, space: Space) -> Told:
    """The observations as numbers of the kind and within the bounds of the space of one."""
    if isinstance(space, gymnasium.spaces.Dict):
        return {name: clipped(told[name], part) for name, part in space.items()}
    low, high = space.low, space.high  # type: ignore[attr-defined]
    return np.minimum(np.maximum(np.asarray(told, space.dtype), low), high)


def rows_of(told: Told, size: int) -> list[Told]:
    """The observation of each of n vehicles."""
    if isinstance(told, Mapping):
        return [{name: values[i] for name, values in told.items()} for i in range(size)]
    return [told[i] for i in range(size)]


def frame_options(experiment: Experiment) -> DoubleDqnOptions:
    """The options of the agent whose frames, map and reward are meant: the configuration's, or its defaults."""
    agent = experiment.config.agent
    return agent if isinstance(agent, DoubleDqnOptions) else DoubleDqnOptions()


def frame_maker(experiment: Experiment) -> FrameMaker:
    """What makes the frames of `double_dqn`."""
    o = frame_options(experiment)
    return FrameMaker(o.rays, o.frames, o.grid_map, experiment.vehicle, experiment.config.drive)


def _box(low: list[float], high: list[float], kind: type[np.floating[Any]] = np.float32) -> Space:
    return gymnasium.spaces.Box(np.array(low, kind), np.array(high, kind), dtype=kind)


def _diagonal(experiment: Experiment) -> float:
    return hypot(experiment.worlds.width, experiment.worlds.depth)


def _most_speed(experiment: Experiment) -> float:
    """Bound of a measured speed, with room for what a shock adds [m/s]."""
    return 2.0 * experiment.config.drive.speed


def _sectors_space(experiment: Experiment) -> Space:
    low = [0.0] * paper.SECTORS + [0.0, -pi, -MOST_YAW_RATE]
    reach = [experiment.vehicle.sensor.range] * paper.SECTORS
    return _box(low, [*reach, _diagonal(experiment), pi, MOST_YAW_RATE])


def _sectors(s: Situation) -> NDArray[np.float32]:
    """The eight readings, target distance, target bearing, yaw rate (n, 11)."""
    return as_numbers(s.observation)


def _rays_space(experiment: Experiment) -> Space:
    sensor, speed = experiment.vehicle.sensor, _most_speed(experiment)
    low = [0.0] * sensor.rays + [0.0, -pi, -MOST_YAW_RATE, -speed]
    return _box(low, [sensor.range] * sensor.rays + [_diagonal(experiment), pi, MOST_YAW_RATE, speed])


def _rays(s: Situation) -> Array:
    """Every ray, target distance, target bearing, yaw rate, speed (n, rays + 4)."""
    o = s.observation
    return np.column_stack([o.ray_distances, o.target_distance, o.target_bearing, o.yaw_rate, o.speed])


def _goal_space(experiment: Experiment) -> Space:
    world, speed = experiment.worlds, _most_speed(experiment)
    goal = _box([0.0, 0.0, 0.0], [world.width, world.depth, 1.0], np.float64)  # so that they decide as the task does
    low = [0.0] * paper.SECTORS + [-1.0, -1.0, -MOST_YAW_RATE, -speed]
    high = [experiment.vehicle.sensor.range] * paper.SECTORS + [1.0, 1.0, MOST_YAW_RATE, speed]
    return gymnasium.spaces.Dict({"observation": _box(low, high), "achieved_goal": goal, "desired_goal": goal})


def _goal(s: Situation) -> dict[str, Array]:
    """What is known without the target (n, 12), and where the vehicle is and should be (n, 3)."""
    o, (x, y, yaw) = s.observation, s.pose.T
    touching = np.equal(o.state_property, FAILURE)
    seen = [o.readings, np.cos(yaw), np.sin(yaw), o.yaw_rate, o.speed]
    return {
        "observation": np.column_stack(seen),
        "achieved_goal": np.column_stack([x, y, touching]),
        "desired_goal": np.column_stack([s.target, np.zeros(len(x))]),
    }


def _frames_space(experiment: Experiment) -> Space:
    maker = frame_maker(experiment)
    return gymnasium.spaces.Box(-1.0, 1.0, (maker.frames * maker.width,), np.float32)


def _frames(s: Situation) -> Array:
    """The last frames, the newest first (n, frames * width): the numbers that the network of `double_dqn` is given."""
    if s.look is None:
        raise ValueError("frames need a look")
    return np.asarray(s.look.stacked / np.float32(127.5) - np.float32(1.0))


OBSERVATIONS: dict[ObservationName, ObservationKind] = {
    "sectors": ObservationKind(_sectors_space, _sectors),
    "rays": ObservationKind(_rays_space, _rays),
    "goal": ObservationKind(_goal_space, _goal),
    "frames": ObservationKind(_frames_space, _frames, remembers=True),
}
"""The observations that an environment may give, by name."""
