"""What a vehicle foresees of every manoeuvre: the memory behind it, and its encoding as bytes for a network."""

from dataclasses import dataclass, fields, replace
from typing import Annotated, Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from nnql_bullet.agents.symmetry import MIRRORED_ACTIONS, mirrored_directions, mirrored_rays
from nnql_bullet.config import options
from nnql_bullet.env import (
    ACTIONS,
    MANOEUVRES,
    REVERSE,
    SLOW,
    STOP,
    Observation,
    commands_of,
    heading_change,
    speed_scale,
)
from nnql_bullet.geometry import Array, as_rows
from nnql_bullet.mapping import body_map, foresight
from nnql_bullet.mapping.body_map import FARTHER, SIDE
from nnql_bullet.mapping.foresight import BEARINGS, COLUMNS, MOST_ROOM, SIGHT, Mover, foresee
from nnql_bullet.mapping.grid_map import first_poses, places_of, tracked
from nnql_bullet.mapping.pace import Pace, keeps_pace
from nnql_bullet.mapping.search import KEPT, searched
from nnql_bullet.mapping.velocities import PAST, velocities
from nnql_bullet.sensing import RAYS, nearest_rays
from nnql_bullet.types import Bytes, NonNegative, Reach
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.profiles import ramp_distances, rolled_path, turn_headings
from nnql_bullet.vehicle.scale import length_scale, turning_radius
from nnql_bullet.vehicle.spec import Limits, VehicleSpec

Search = TypeVar("Search", bound="SearchOptions")

SECTORS = 24
"""Readings of a scan in what a network sees: each the nearest of three of 72 rays."""
SCANS = 3
"""Scans that it sees at once, by which it may tell what moves."""
FAR, NEAR = 50.0, 5.0
"""Upper bounds on the target's distance, which is told on both scales, over the length scale [m]."""
DETOUR = 20.0
"""Upper bound on how much longer than that distance the way is, likewise [m]."""
TRAIL = 32
"""Decisions for which a vehicle remembers its poses."""
FASTEST = 0.6
"""Largest speed of an obstacle, over the drive's."""
MIRRORED_MANOEUVRES = (np.arange(0, MANOEUVRES, ACTIONS)[:, None] + MIRRORED_ACTIONS).ravel()
"""The mirror image of each manoeuvre (24,)."""
PHI = COLUMNS + 1
"""Numbers about each manoeuvre: what is foreseen of it, and its turn."""
CONTEXT = SECTORS * SCANS + 3 * BEARINGS + 9
"""Numbers about the vehicle and its surroundings."""
WIDTH = CONTEXT + MANOEUVRES * PHI
_MARGIN, _LEAST, _APPROACH, _LOOK_AHEAD, _CORRIDOR = 0.3, 0.1, 0.03, 2.0, 6.0
"""What full speed asks for, see `Pace`, over the length scale [m]: what a shield asks for by default."""
_TOO_FAST = 10.0
"""What a manoeuvre at full speed loses where there is no room for it, likewise [m]: less than one that meets
something."""
_ODD = 2
"""How many of the last numbers of the context change their sign in a mirror."""
_INSTANTS = 5
_FOLLOW = np.array(
    [0, 1, 2, 3, 4, SLOW, SLOW + 2, SLOW + 4, STOP, STOP + 2, STOP + 4, REVERSE, REVERSE + 2, REVERSE + 4]
)
"""Manoeuvres that a search tries after the first."""


@options
class SearchOptions:
    """Options of the search over several manoeuvres in a row."""

    depth: Annotated[int, Field(ge=1, le=10)] = 4
    """Number of manoeuvres in a row."""
    width: Annotated[int, Field(ge=1, le=1000)] = 24
    """Number of states that are driven on after each."""
    margin: Reach = 0.06
    """Clearance from all that was seen below which a manoeuvre is a last resort [m]."""
    room: Reach = 0.3
    """Clearance that it keeps where that costs little [m]."""
    constancy: NonNegative = 0.3
    """What it is worth to keep to the plan [m]."""
    room_weight: NonNegative = 1.0
    """Length of way that each metre of clearance is worth that lacks, at every manoeuvre."""
    haste: NonNegative = 1.5
    """What the drive's speed costs where there is no clearance at all, at every manoeuvre, as a share of the way that
    it covers; half the speed costs a quarter."""
    caution: NonNegative = 1.3
    """The same near something thin, whatever the clearance: there may be more that the rays miss."""
    paced: bool | None = None
    """Whether it drives at full speed only where a shield of default lengths admits that, see `mapping.pace`; by
    default in a shield."""

    def in_shield(self: Search) -> Search:
        """Returns the options for drives in a shield."""
        return replace(self, paced=True) if self.paced is None else self


@dataclass(frozen=True, slots=True)
class Memory:
    """Memory of n vehicles. While the age is 0, the other entries mean nothing."""

    age: NDArray[np.int64]
    """Decisions in the episode so far (n,)."""
    poses: Array
    """Poses at the last decision, in the frame of `grid_map` (n, 3)."""
    trails: Array
    """Poses at the last decisions likewise, the newest first (n, TRAIL, 3); infinite for none."""
    steps: Array
    """Displacements since then, in the vehicle frame of then (n, 2) [m]."""
    corners: NDArray[np.int64]
    """First cells of the maps (n, 2)."""
    cells: body_map.Cells
    """Cells of the maps (n, SIDE, SIDE)."""
    offsets: body_map.Offsets
    """Places of points in their cells (n, SIDE, SIDE, 2)."""
    scans: Array
    """The last scans, the newest first (n, PAST, rays) [m]; NaN for a ray that tells nothing, and for no scan."""
    planned: NDArray[np.int64]
    """Manoeuvres that were to come next; -1 for none (n,)."""
    frames: Bytes
    """What a network sees, or saw last (n, WIDTH)."""

    def state_dict(self) -> dict[str, NDArray[Any]]:
        """Copies the memory, by name."""
        return {field.name: getattr(self, field.name).copy() for field in fields(self)}


@dataclass(frozen=True, slots=True)
class Look:
    """The memory of vehicles with their present observation entered, and what is known of the ways."""

    memory: Memory
    moving: Array
    """Velocities of the points of the scans in the vehicle frame (n, seen rays, 2) [m/s]."""
    factors: body_map.Lengths
    """Cost factors of the maps, see `body_map.ways_to` (n, SIDE, SIDE)."""
    left: body_map.Lengths
    """Costs of the ways to the targets likewise (n, SIDE, SIDE)."""
    turns: Array
    """Heading changes of the manoeuvres (n, 24) [rad]."""
    too_fast: NDArray[np.bool_]
    """Manoeuvres at full speed without the room for it, see `mapping.pace` (n, 24)."""
    foreseen: Array | None = None
    """Of each manoeuvre, see `mapping.foresight` (n, 24, COLUMNS); None where no network is to see it."""

    @property
    def stacked(self) -> Bytes:
        """Network inputs (n, WIDTH)."""
        return self.memory.frames


class Foresight:
    """Keeps maps of what vehicles see, and foresees what each manoeuvre comes to.

    All that it tells is relative: lengths to the vehicle, speeds to the drive's, and manoeuvres are driven in thought
    by the vehicle's own limits and footprint, so that one network may drive several vehicles.
    """

    def __init__(self, vehicle: VehicleSpec, drive: DriveOptions) -> None:
        self._scale, self._limits, self._drive = length_scale(vehicle.footprint), vehicle.limits, drive
        sensor = vehicle.sensor
        self._sensor = sensor
        self._seen, self._taken = np.flatnonzero(sensor.seen), nearest_rays(sensor.rays)
        self._goals = drive.speed * speed_scale(np.arange(MANOEUVRES), drive)
        self._mover = Mover(
            cell=vehicle.width / body_map.CELLS_ACROSS,
            scale=self._scale,
            footprint=as_rows((vehicle.footprint,))[0],
            sensor=np.array(sensor.position[:2]),
            angles=np.ascontiguousarray(sensor.angles[self._seen]),
            sensor_range=sensor.range,
            max_rate=vehicle.limits.yaw_rate,
            yaw_acceleration=vehicle.limits.yaw_acceleration,
            acceleration=vehicle.limits.acceleration,
            period=drive.decision_period,
        )
        self._pace = Pace(
            speed=drive.speed,
            margin=_MARGIN * self._scale,
            least=_LEAST * self._scale,
            approach=_APPROACH * self._scale,
            look_ahead=_LOOK_AHEAD * self._scale,
            corridor=_CORRIDOR * self._scale,
            circle=turning_radius(vehicle.footprint) + _LEAST * self._scale,
        )
        parts = [
            *(k * SECTORS + mirrored_rays(SECTORS) for k in range(SCANS)),
            *(SCANS * SECTORS + k * BEARINGS + mirrored_directions(BEARINGS) for k in range(3)),
            np.arange(CONTEXT - 9, CONTEXT),
            CONTEXT + (MIRRORED_MANOEUVRES[:, None] * PHI + np.arange(PHI)).ravel(),
        ]
        self._mirrored = np.concatenate(parts)
        self._odd = np.zeros(WIDTH, np.bool_)
        self._odd[CONTEXT - _ODD : CONTEXT] = True
        self._odd[CONTEXT + COLUMNS :: PHI] = True

    def nothing(self, size: int) -> Memory:
        """Memory of vehicles at the start of an episode."""
        return Memory(
            age=np.zeros(size, np.int64),
            poses=np.zeros((size, 3)),
            trails=np.full((size, TRAIL, 3), np.inf),
            steps=np.zeros((size, 2)),
            corners=np.zeros((size, 2), np.int64),
            cells=np.zeros((size, SIDE, SIDE), np.int8),
            offsets=np.zeros((size, SIDE, SIDE, 2), np.uint8),
            scans=np.full((size, PAST, self._sensor.rays), np.nan),
            planned=np.full(size, -1),
            frames=np.zeros((size, WIDTH), np.uint8),
        )

    def look(self, memory: Memory, observations: Observation, paced: bool | None = None) -> Look:
        """Enters the observations of n vehicles into a copy of their memory; see `SearchOptions.paced`."""
        o, new, mover = observations, memory.age == 0, self._mover
        first = first_poses(o.landmark_distance, o.landmark_bearing)
        later = tracked(memory.poses, memory.steps, o.landmark_distance, o.landmark_bearing)
        poses = np.where(new[:, None], first, later)
        trails = np.where(new[:, None, None], np.inf, np.roll(memory.trails, 1, axis=1))
        trails[:, 0] = poses
        corners, cells, offsets = memory.corners.copy(), memory.cells.copy(), memory.offsets.copy()
        cells[new] = body_map.UNSEEN
        rays = np.ascontiguousarray(o.ray_distances[:, self._seen])
        body_map.add_scans(
            cells, offsets, corners, poses, rays, mover.sensor, mover.angles, mover.sensor_range, mover.cell
        )
        scan = np.where(self._sensor.seen, o.ray_distances, np.nan)
        scans = np.where(new[:, None, None], np.nan, memory.scans)
        moving = velocities(
            *(scan, scans, poses, memory.trails[:, :PAST]),
            *(mover.sensor, self._sensor.angles, mover.sensor_range, mover.period),
            *(FASTEST * self._drive.speed, self._scale),
        )[:, self._seen]
        targets = places_of(poses, o.target_distance, o.target_bearing)
        turns = heading_change(np.arange(MANOEUVRES), o.target_bearing[:, None])
        factors, left = body_map.ways_to(cells, offsets, corners, poses, targets, mover.cell)
        too_fast = np.zeros(turns.shape, np.bool_)
        if paced:
            too_fast[:, :ACTIONS] = ~keeps_pace(
                *(cells, offsets, corners, poses, rays, moving, o.speed, o.yaw_rate),
                *(np.ascontiguousarray(turns[:, :ACTIONS]), mover, self._pace),
            )
        seen = replace(
            memory,
            planned=np.where(new, -1, memory.planned),
            poses=poses,
            trails=trails,
            corners=corners,
            cells=cells,
            offsets=offsets,
            scans=np.concatenate([scan[:, None], scans[:, :-1]], axis=1),
        )
        return Look(seen, moving, factors, left, turns, too_fast)

    def ahead(self, look: Look, observations: Observation) -> Look:
        """Returns a look with what a network sees: what is foreseen of every manoeuvre, and the surroundings."""
        foreseen, around, ways, thin = self.foreseen(look, observations)
        m = look.memory
        frames = self._frame(observations, m, m.age == 0, foreseen, around, ways, thin, look.turns)
        return replace(look, memory=replace(m, frames=frames), foreseen=foreseen)

    def foreseen(self, look: Look, observations: Observation) -> tuple[Array, Array, Array, NDArray[np.bool_]]:
        """What `mapping.foresight.foresee` says of n vehicles: of manoeuvres, around, of the ways, and what is thin."""
        o, m = observations, look.memory
        rays = np.ascontiguousarray(o.ray_distances[:, self._seen])
        told: tuple[Array, Array, Array, NDArray[np.bool_]] = foresee(
            *(m.cells, m.offsets, m.corners, m.poses, m.trails, look.factors, look.left, rays, look.moving),
            *(o.speed, o.yaw_rate, look.turns, self._goals, self._mover),
        )
        return told

    def searched(self, look: Look, observations: Observation, o: SearchOptions) -> tuple[Array, NDArray[np.int64]]:
        """Scores the manoeuvres by a search over several in a row (n, 24) [m]; says what follows the best (n,).

        What is planned to follow the last manoeuvre has an advantage, without which plans take turns.
        """
        m, scale, pace = look.memory, self._scale, self._drive.speed * self._drive.decision_period
        rays = np.ascontiguousarray(observations.ray_distances[:, self._seen])
        scores, then = searched(
            m.cells,
            m.offsets,
            m.corners,
            m.poses,
            m.trails,
            look.factors,
            look.left,
            rays,
            look.moving,
            observations.speed,
            observations.yaw_rate,
            look.turns,
            self._goals,
            _FOLLOW,
            m.planned,
            o.depth,
            o.width,
            o.room * scale,
            o.room * max(scale, pace),
            o.room_weight,
            o.haste * pace / self._drive.speed**2,
            o.caution * pace / self._drive.speed**2,
            o.margin * scale,
            o.constancy * scale,
            self._mover,
        )
        best = scores.argmax(axis=-1)
        scores -= _TOO_FAST * scale * look.too_fast
        return scores / scale, np.where(scores.argmax(axis=-1) == best, then, -1)

    def chosen(self, look: Look, values: Array, margin: float) -> NDArray[np.int64]:
        """The best manoeuvres by values (n, 24), of those that meet nothing and are not too fast (n,).

        If there is none, one that is too fast; if all meet something, the one that does so last.

        Args:
            look: What is foreseen.
            values: Their values.
            margin: Clearance below which a manoeuvre is a last resort, over the length scale [m].
        """
        if look.foreseen is None:
            raise ValueError("nothing is foreseen: ask `ahead` first")
        clear = look.foreseen[..., foresight.ROOM : foresight.STOP_ROOM + 1].min(axis=-1)
        least = np.minimum(margin * self._scale, KEPT * clear.max(axis=-1))
        lasts = look.foreseen[..., foresight.LASTS]
        meets = (lasts < 1.0) | (clear < least[:, None])
        worst = np.ptp(values, axis=-1, keepdims=True) + 1.0
        values = values - worst * look.too_fast
        return np.asarray(np.where(meets, values - worst * (3.0 + 100.0 * (1.0 - lasts)), values).argmax(axis=-1))

    def after(
        self,
        look: Look,
        observations: Observation,
        actions: NDArray[np.int64],
        planned: NDArray[np.int64] | None = None,
    ) -> Memory:
        """The memory of vehicles after they were given manoeuvres (n,), and planned what follows (n,)."""
        memory = look.memory
        steps = displacements(observations, actions, self._drive, self._limits)
        planned = np.full(len(actions), -1) if planned is None else planned
        return replace(memory, age=memory.age + 1, steps=steps, planned=planned)

    def mirrored(self, stacked: Bytes) -> Bytes:
        """Mirror images of network inputs (m, WIDTH)."""
        seen = stacked[:, self._mirrored]
        return np.where(self._odd, 255 - seen, seen)

    def _frame(
        self,
        o: Observation,
        memory: Memory,
        new: NDArray[np.bool_],
        foreseen: Array,
        around: Array,
        ways: Array,
        thin: NDArray[np.bool_],
        turns: Array,
    ) -> Bytes:
        """What a network sees (n, WIDTH)."""
        n, scale, limits = len(new), self._scale, self._limits
        nearest = (o.ray_distances[:, self._taken] / scale).reshape(n, SECTORS, RAYS // SECTORS).min(axis=-1)
        scan = _as_bytes(2 / (1 + nearest) - 1)
        earlier = np.where(
            new[:, None, None], scan[:, None], memory.frames[:, : SECTORS * (SCANS - 1)].reshape(n, SCANS - 1, SECTORS)
        )
        most = FARTHER * self._mover.cell
        probes = np.concatenate([around[:, :2] / most, around[:, 2:] / (SIGHT * scale) * 2 - 1], axis=1)
        away = o.target_distance
        context: list[Array | float] = [
            o.speed / self._drive.speed,
            1 - 2 * away / (FAR * scale),
            2 * (ways - away) / (DETOUR * scale) - 1,
            1 - 2 * away / (NEAR * scale),
            self._drive.speed / scale / 2 - 1,
            np.where(thin, 1.0, -1.0),
            np.cos(o.target_bearing),
            np.sin(o.target_bearing),
            o.yaw_rate / limits.yaw_rate,
        ]
        phi = np.concatenate([foreseen, turns[..., None]], axis=-1)
        phi[..., foresight.ROOM : foresight.STOP_ROOM + 1] *= 2 / (MOST_ROOM * scale)
        phi[..., foresight.ROOM : foresight.STOP_ROOM + 1] -= 1
        phi[..., foresight.LASTS] = 2 * phi[..., foresight.LASTS] - 1
        phi[..., foresight.WAY : foresight.WAY_AHEAD + 1] /= most
        phi[..., foresight.UNKNOWN] = 2 * phi[..., foresight.UNKNOWN] - 1
        phi[..., foresight.VISITS] = 2 * phi[..., foresight.VISITS] / foresight.MOST_VISITS - 1
        phi[..., COLUMNS] /= np.pi / 3
        rest = [
            probes.reshape(n, -1),
            np.stack([np.broadcast_to(its, n) for its in context], axis=-1),
            phi.reshape(n, -1),
        ]
        return np.concatenate([scan, earlier.reshape(n, -1), _as_bytes(np.concatenate(rest, axis=-1))], axis=-1)


def displacements(observations: Observation, actions: NDArray[np.int64], drive: DriveOptions, limits: Limits) -> Array:
    """Foresees the displacements of vehicles by manoeuvres (n,) until the next decision, in their frames (n, 2) [m]."""
    o, times = observations, drive.decision_period * np.arange(1, _INSTANTS + 1) / _INSTANTS
    commands = commands_of(actions, o.target_bearing, drive)
    headings = turn_headings(o.yaw_rate, commands.heading_changes, limits, times)
    ways = ramp_distances(o.speed, drive.speed * commands.speed_scales, limits.acceleration, times)
    return rolled_path(0.0, ways, np.diff(headings, prepend=0.0, axis=-1))[:, -1]


def _as_bytes(numbers: Array) -> Bytes:
    """Numbers from -1 to 1 as bytes. The byte of -x is 255 minus that of x, except half-way between two bytes."""
    return np.rint(127.5 * (np.clip(numbers, -1.0, 1.0) + 1)).astype(np.uint8)
