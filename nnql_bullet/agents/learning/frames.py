"""Frames: what a vehicle sees and remembers at a decision, as bytes for the network and the replay buffer."""

from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.agents.symmetry import MIRRORED_ACTIONS, mirrored_directions, mirrored_rays
from nnql_bullet.env import ACTIONS, Commands, Observation, Transition, commands_of
from nnql_bullet.geometry import Array
from nnql_bullet.mapping import grid_map
from nnql_bullet.sensing import nearest_rays
from nnql_bullet.types import Bytes
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.profiles import ramp_distances, rolled_path, turn_headings
from nnql_bullet.vehicle.scale import length_scale
from nnql_bullet.vehicle.spec import VehicleSpec

FAR = 50.0
"""Upper bound on the target's distance in a frame [m]."""
DETOUR = 20.0
"""Upper bound on the detour in a frame: path length to the target minus its distance [m]."""
MOST_PROGRESS = 2.0
"""Upper bound on the progress of one decision [m]. More is new knowledge of the map, not progress."""
_INSTANTS = 5
"""Number of times at which the path between two decisions is computed."""
_STATE, _ODD = 5, (3, 4)
"""Count of numbers about target and vehicle in a frame, and the indices of those whose sign a mirror changes."""


@dataclass(frozen=True, slots=True)
class Memory:
    """Memory of n vehicles. While the age is 0, the other entries mean nothing."""

    age: NDArray[np.int64]
    """Decisions in the episode so far (n,)."""
    poses: Array
    """Poses at the last decision, in the frame of `grid_map` (n, 3)."""
    steps: Array
    """Displacements since then, in the vehicle frame of then (n, 2) [m]."""
    actions: NDArray[np.int64]
    """Last actions (n,)."""
    speeds: Array
    """Commanded speeds, as fractions of the drive's speed (n,)."""
    corners: NDArray[np.int64]
    """First cells of the maps (n, 2)."""
    cells: grid_map.Cells
    """Cells of the maps (n, SIZE, SIZE)."""
    frames: Bytes
    """Last frames, the newest first (n, frames, width)."""

    def state_dict(self) -> dict[str, NDArray[Any]]:
        """Copies the memory, by name."""
        return {field.name: getattr(self, field.name).copy() for field in fields(self)}


@dataclass(frozen=True, slots=True)
class Look:
    """The memory of vehicles, with their present observation entered."""

    memory: Memory
    progress: Array
    """Distance by which the last decision shortened the path to the target (n,) [m]."""

    @property
    def stacked(self) -> Bytes:
        """Network inputs (n, frames * width)."""
        frames = self.memory.frames
        return frames.reshape(len(frames), -1)


@dataclass(frozen=True, slots=True)
class Sensed:
    """What n vehicles see through their maps, before it is in a frame. Lengths are those of the shipped vehicle."""

    memory: Memory
    """With the present pose and scan entered; the frames are those of before."""
    around: Array
    """What `grid_map` says of the way to places around the vehicle (n, places) [m]; no places without a map."""
    way: Array
    """Length of the way to the target through the map (n,) [m]."""
    progress: Array
    """See `Look` (n,) [m]."""


def frame_width(rays: int, with_map: bool) -> int:
    """Number of bytes in a frame of a `FrameMaker`."""
    return rays + (len(grid_map.REACHES) * grid_map.BEARINGS if with_map else 0) + _STATE + ACTIONS


class FrameMaker:
    """Makes frames of what vehicles see.

    A frame holds, each number as a byte from -1 to 1: nearness of the nearest of every few rays, what `grid_map` says
    of the way, bearing and distance of the target, the yaw rate, and the action before. Of another number of rays
    than 72 it takes those nearest to these 72, so that a network sees the same through every sensor.
    """

    def __init__(self, rays: int, frames: int, with_map: bool, vehicle: VehicleSpec, drive: DriveOptions) -> None:
        """Decides what a frame holds.

        Args:
            rays: Readings that the 72 rays are told as, a divisor of 72.
            frames: That make up what the network is shown.
            with_map: Whether what was seen before is remembered.
            vehicle: Its limits tell where it gets by a turn, and its sensor where rays start.
            drive: Likewise speed and time between decisions.
        """
        self.rays, self.frames, self.with_map = rays, frames, with_map
        self._limits, self._scale = vehicle.limits, length_scale(vehicle.footprint)
        self._range = vehicle.sensor.range / self._scale
        self._times = drive.decision_period * np.arange(1, _INSTANTS + 1) / _INSTANTS
        self._speed, self._acceleration = drive.speed / self._scale, vehicle.limits.acceleration / self._scale
        self._drive = drive
        self._taken = nearest_rays(vehicle.sensor.rays)
        self._angles, self._origin = (
            vehicle.sensor.angles[self._taken],
            np.array(vehicle.sensor.position[:2]) / self._scale,
        )
        reaches = np.repeat(np.arange(len(grid_map.REACHES) if with_map else 0), grid_map.BEARINGS)
        around = mirrored_directions(grid_map.BEARINGS)[np.arange(len(reaches)) % grid_map.BEARINGS]
        parts = [
            mirrored_rays(rays),
            reaches * grid_map.BEARINGS + around,
            np.arange(_STATE),
            MIRRORED_ACTIONS,
        ]
        begins = np.cumsum([0, *map(len, parts)])
        self.width = int(begins[-1])
        """Number of bytes in a frame."""
        self._mirrored = np.concatenate([begin + part for begin, part in zip(begins, parts, strict=False)])
        self._odd = np.zeros(self.width, np.bool_)
        self._odd[begins[2] + np.array(_ODD)] = True

    def nothing(self, size: int) -> Memory:
        """Memory of vehicles at the start of an episode."""
        side = grid_map.SIZE if self.with_map else 0
        return Memory(
            age=np.zeros(size, np.int64),
            poses=np.zeros((size, 3)),
            steps=np.zeros((size, 2)),
            actions=np.zeros(size, np.int64),
            speeds=np.ones(size),
            corners=np.zeros((size, 2), np.int64),
            cells=np.zeros((size, side, side), np.int8),
            frames=np.zeros((size, self.frames, self.width), np.uint8),
        )

    def look(self, memory: Memory, observations: Observation) -> Look:
        """Enters the observations of n vehicles into a copy of their memory."""
        o, new, sensed = observations, memory.age == 0, self.sense(memory, observations)
        rays, away = o.ray_distances[:, self._taken] / self._scale, o.target_distance / self._scale
        actions = np.where(new, -1, memory.actions)
        frame = self._frame(o, rays, away, sensed.around, sensed.way - away, actions)
        earlier = np.where(new[:, None, None], frame[:, None], memory.frames)
        frames = np.concatenate([frame[:, None], earlier[:, : self.frames - 1]], axis=1)
        return Look(replace(sensed.memory, frames=frames), sensed.progress)

    def sense(self, memory: Memory, observations: Observation) -> Sensed:
        """Enters the observations of n vehicles into a copy of their maps, and asks these for ways."""
        o, new = observations, memory.age == 0
        rays, away = o.ray_distances[:, self._taken] / self._scale, o.target_distance / self._scale
        mark = o.landmark_distance / self._scale
        first = grid_map.first_poses(mark, o.landmark_bearing)
        later = grid_map.tracked(memory.poses, memory.steps, mark, o.landmark_bearing)
        poses = np.where(new[:, None], first, later)
        before = np.where(new[:, None], poses, memory.poses)[:, :2]
        corners, cells = memory.corners.copy(), memory.cells.copy()
        if self.with_map:
            cells[new] = 0
            grid_map.add_scans(cells, corners, poses, rays, self._origin, self._angles, self._range)
            targets = grid_map.places_of(poses, away, o.target_bearing)
            targets[o.target_distance == o.landmark_distance] = 0.0  # rounding would move them off the frame's origin
            around, ways, progress = grid_map.sensed(cells, corners, poses, before, targets)
        else:
            around, ways = np.zeros((len(new), 0)), away
            progress = np.hypot(*before.T) - away
        seen = replace(memory, poses=poses, corners=corners, cells=cells)
        return Sensed(seen, around, ways, np.clip(progress, -MOST_PROGRESS, MOST_PROGRESS))

    def after(self, look: Look, observations: Observation, actions: NDArray[np.int64]) -> Memory:
        """The memory of vehicles after they were given `actions` (n,), manoeuvres of `env`."""
        return self.commanded(look, observations, commands_of(actions, observations.target_bearing, self._drive))

    def commanded(self, look: Look, observations: Observation, commands: Commands) -> Memory:
        """The memory of vehicles after they were given commands."""
        o, memory, actions, goals = observations, look.memory, commands.actions, commands.speed_scales
        speeds = np.where(memory.age == 0, o.speed / self._drive.speed, memory.speeds)
        headings = turn_headings(o.yaw_rate, commands.heading_changes, self._limits, self._times)
        ways = ramp_distances(self._speed * speeds, self._speed * goals, self._acceleration, self._times)
        steps = rolled_path(0.0, ways, np.diff(headings, prepend=0.0, axis=-1))[:, -1]
        change = self._acceleration * self._times[-1] / self._speed
        speeds = np.clip(goals, speeds - change, speeds + change)
        return replace(memory, age=memory.age + 1, steps=steps, actions=actions % ACTIONS, speeds=speeds)

    def mirrored(self, stacked: Bytes) -> Bytes:
        """Mirror images of network inputs (m, frames * width)."""
        seen = stacked.reshape(len(stacked), self.frames, self.width)[:, :, self._mirrored]
        return np.where(self._odd, 255 - seen, seen).reshape(stacked.shape)

    def _frame(
        self, o: Observation, rays: Array, away: Array, around: Array, detour: Array, actions: NDArray[np.int64]
    ) -> Bytes:
        """Frames (n, width) of 72 rays (n, 72) and a target so far away (n,); an action of -1 is none."""
        far = np.where(rays < self._range, rays, paper.SENSOR_RANGE)
        nearest = far.reshape(len(actions), self.rays, -1).min(axis=-1)
        reaches = np.repeat(2 * np.array(grid_map.REACHES), grid_map.BEARINGS)
        state = [
            np.cos(o.target_bearing),
            1 - 2 * away / FAR,
            2 * detour / DETOUR - 1,
            np.sin(o.target_bearing),
            o.yaw_rate / self._limits.yaw_rate,
        ]
        parts = [
            1 - 2 * nearest / paper.SENSOR_RANGE,
            around / reaches if self.with_map else around,
            np.stack(state, axis=-1),
            2.0 * (actions[:, None] == np.arange(ACTIONS)) - 1,
        ]
        return as_bytes(np.concatenate(parts, axis=-1))


class Sight:
    """What n vehicles see and remember, for one who follows their steps and decides nothing."""

    def __init__(self, maker: FrameMaker, size: int) -> None:
        self._maker = maker
        self._memory = maker.nothing(size)
        self.look: Look
        """The memory with the present observation entered; there is one from the first `begin` on."""

    def begin(self, vehicles: NDArray[np.int64], observations: Observation) -> None:
        """Forgets some vehicles, which are put into worlds; the observations are of all n."""
        age = self._memory.age.copy()
        age[vehicles] = 0
        self._memory = replace(self._memory, age=age)
        self.look = self._maker.look(self._memory, observations)

    def follow(self, t: Transition) -> None:
        """Enters a step of all n vehicles."""
        commands = Commands(t.a_tm1, t.heading_command, t.speed_command)
        self._memory = self._maker.commanded(self.look, t.s_tm1, commands)
        self.look = self._maker.look(self._memory, t.s_t)


def as_bytes(numbers: Array) -> Bytes:
    """Numbers from -1 to 1 as bytes. The byte of -x is 255 minus that of x, except half-way between two bytes."""
    return np.rint(127.5 * (np.clip(numbers, -1.0, 1.0) + 1)).astype(np.uint8)
