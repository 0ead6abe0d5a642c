"""The shortest way to the target through what a vehicle has seen since it began to ask for one.

Cells about the vehicle are occupied where rays ended, until rays pass. Unseen ones count as free, as in Koenig and
Likhachev, "D* Lite" (AAAI 2002); here every decision searches anew by A* (Hart, Nilsson and Raphael, "A Formal Basis
for the Heuristic Determination of Minimum Cost Paths", 1968), with a cost that falls with the distance to the nearest
occupied cell. Poses are in the landmark's frame of `grid_map`.
"""

from heapq import heappop, heappush
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.geometry import Array, wrap_angle
from nnql_bullet.jit import njit
from nnql_bullet.mapping.grid_map import SEEN, Cells, first_poses, places_of, tracked
from nnql_bullet.vehicle.scale import turning_radius
from nnql_bullet.vehicle.spec import VehicleSpec

SIDE = 256
"""Number of cells along a side of the map, with the vehicle in its middle."""
CELLS_ACROSS = 4
"""Number of cells across the vehicle."""
BESIDE = 3.0
"""Cost factor of a way that touches obstacles, beyond that of one with room to turn round, which is 1."""
TIGHT, BARRED = 12.0, 60.0
"""Cost factors where the vehicle hardly fits, and where it does not. They are finite: a way leads through obstacles
where there is no other."""
_DIAGONAL = 2**0.5


class Surroundings(NamedTuple):
    """What one vehicle has seen, in square cells."""

    cells: Cells
    """Above zero in occupied cells (SIDE, SIDE)."""
    corner: NDArray[np.int64]
    """The first cell, counted from the landmark (2,)."""
    pose: Array
    """Present pose in the landmark's frame (3,)."""


def first_surroundings(distance: float, bearing: float) -> Surroundings:
    """The surroundings of a vehicle that has seen nothing, from distance [m] and bearing [rad] of its landmark."""
    pose = first_poses(np.array([distance]), np.array([bearing]))[0]
    return Surroundings(np.zeros((SIDE, SIDE), np.int8), np.zeros(2, np.int64), pose)


def moved_on(before: Surroundings, moved: Array, distance: float, bearing: float) -> Surroundings:
    """The surroundings of a vehicle that has moved, with the pose that its landmark tells.

    Args:
        before: Where it was.
        moved: Its pose in the frame of then (3,).
        distance: Of the landmark now [m].
        bearing: Likewise [rad].
    """
    pose = tracked(before.pose[None], moved[None, :2], np.array([distance]), np.array([bearing]))[0]
    return before._replace(pose=pose)


def place_seen(pose: Array, distance: float, bearing: float) -> Array:
    """The place (2,) [m] that is seen from a pose (3,) at a distance [m] and bearing [rad]."""
    return np.asarray(places_of(pose[None], np.array([distance]), np.array([bearing]))[0])


def with_scan(before: Surroundings, rays: Array, vehicle: VehicleSpec) -> Surroundings:
    """The surroundings with one more scan (r,) [m]; 0 for a ray that tells nothing."""
    cells, corner, sensor = before.cells.copy(), before.corner.copy(), vehicle.sensor
    origin = np.array(sensor.position[:2])
    _add_scan(cells, corner, before.pose, rays, origin, sensor.angles, sensor.range, _cell(vehicle))
    return before._replace(cells=cells, corner=corner)


def way_ahead(surroundings: Surroundings, vehicle: VehicleSpec, margin: float, reach: float, target: Array) -> float:
    """Bearing of the farthest place on the shortest way to the target that lies in a straight line [rad].

    Args:
        surroundings: Of the vehicle.
        vehicle: The vehicle, which has to fit.
        margin: Clearance that it keeps where it can [m].
        reach: Largest distance of that place [m].
        target: Place of the target (2,) [m].
    """
    cell, its = _cell(vehicle), surroundings.pose
    half_width, radius = vehicle.footprint.half_width, turning_radius(vehicle.footprint)
    lengths = half_width / cell, (half_width + margin) / cell, radius / cell, reach / cell, cell
    x, y = _carrot(*surroundings, *lengths, target)
    return wrap_angle(float(np.arctan2(y * cell - its[1], x * cell - its[0])) - float(its[2]))


def _cell(vehicle: VehicleSpec) -> float:
    """Side of a cell [m]."""
    return 2 * vehicle.footprint.half_width / CELLS_ACROSS


@njit()
def _add_scan(
    cells: Cells,
    corner: NDArray[np.int64],
    pose: Array,
    rays: Array,
    sensor: Array,
    angles: Array,
    sensor_range: float,
    cell: float,
) -> None:
    """Moves a map along with its vehicle, frees the cells that rays pass and marks those where they end."""
    x, y, yaw = pose
    to_x, to_y = int(np.floor(x / cell)) - SIDE // 2, int(np.floor(y / cell)) - SIDE // 2
    along, across = to_x - corner[0], to_y - corner[1]
    if along or across:
        before = cells.copy()
        cells[:] = 0
        for a in range(max(0, -along), min(SIDE, SIDE - along)):
            for b in range(max(0, -across), min(SIDE, SIDE - across)):
                cells[a, b] = before[a + along, b + across]
        corner[0], corner[1] = to_x, to_y
    c, s = np.cos(yaw), np.sin(yaw)
    x, y = (x + c * sensor[0] - s * sensor[1]) / cell - to_x, (y + s * sensor[0] + c * sensor[1]) / cell - to_y
    for ends in (False, True):
        for j in range(len(angles)):
            c, s, length = np.cos(yaw + angles[j]), np.sin(yaw + angles[j]), rays[j] / cell
            if not ends:
                for k in range(int(length - 0.5)):
                    a, b = int(np.floor(x + c * (k + 0.5))), int(np.floor(y + s * (k + 0.5)))
                    if 0 <= a < SIDE and 0 <= b < SIDE and cells[a, b] > 0:
                        cells[a, b] -= 1
            elif 0 < rays[j] < sensor_range:
                a, b = int(np.floor(x + c * (length + 0.25))), int(np.floor(y + s * (length + 0.25)))
                if 0 <= a < SIDE and 0 <= b < SIDE:
                    cells[a, b] = SEEN


@njit()
def _clearances(cells: Cells, most: float) -> Array:
    """Distances between cells and the nearest occupied one (SIDE, SIDE) [cells]; `most` where they are larger."""
    reach = int(most)
    squares = np.full((SIDE, SIDE), most * most)
    for a in range(SIDE):
        for b in range(SIDE):
            if cells[a, b] > 0:
                for to_a in range(max(a - reach, 0), min(a + reach + 1, SIDE)):
                    for to_b in range(max(b - reach, 0), min(b + reach + 1, SIDE)):
                        squares[to_a, to_b] = min(squares[to_a, to_b], (to_a - a) ** 2 + (to_b - b) ** 2)
    rooms: Array = np.sqrt(squares)
    return rooms


@njit()
def _carrot(
    cells: Cells,
    corner: NDArray[np.int64],
    pose: Array,
    half_width: float,
    fits: float,
    radius: float,
    reach: float,
    cell: float,
    target: Array,
) -> tuple[float, float]:
    """The place that `way_ahead` looks at, counted in cells from the landmark.

    Args:
        cells: See `Surroundings`.
        corner: Likewise.
        pose: Likewise.
        half_width: Of the vehicle [cells].
        fits: Distance from obstacles at which it fits well [cells].
        radius: Distance from obstacles at which it can turn round [cells].
        reach: Largest distance of the place [cells].
        cell: Side of a cell [m].
        target: Place of the target (2,) [m].
    """
    room = _clearances(cells, radius + 1.0)
    factors = np.empty((SIDE, SIDE))
    for a in range(SIDE):
        for b in range(SIDE):
            near = BESIDE * max(radius - room[a, b], 0.0) / (radius - half_width)
            factors[a, b] = BARRED if room[a, b] <= half_width else TIGHT if room[a, b] <= fits else 1.0 + near
    goal_a, goal_b = target[0] / cell - corner[0] - 0.5, target[1] / cell - corner[1] - 0.5
    first = (int(np.floor(pose[0] / cell)) - corner[0], int(np.floor(pose[1] / cell)) - corner[1])
    cost, came = np.full((SIDE, SIDE), np.inf), np.full((SIDE, SIDE), -1, np.int64)
    done = np.zeros((SIDE, SIDE), np.bool_)
    cost[first] = 0.0
    queue = [(np.hypot(first[0] - goal_a, first[1] - goal_b), 0.0, first[0], first[1])]
    last = first
    while len(queue) > 0:
        _, so_far, a, b = heappop(queue)
        if done[a, b]:
            continue
        done[a, b] = True
        last = (a, b)
        outside = a == 0 or b == 0 or a == SIDE - 1 or b == SIDE - 1
        if outside or np.hypot(a - goal_a, b - goal_b) <= 1.0:
            break
        for da in (-1, 0, 1):
            for db in (-1, 0, 1):
                to_a, to_b = a + da, b + db
                if done[to_a, to_b]:
                    continue
                step = _DIAGONAL if da and db else 1.0
                there = so_far + step * (factors[a, b] + factors[to_a, to_b]) / 2
                if there < cost[to_a, to_b]:
                    cost[to_a, to_b], came[to_a, to_b] = there, a * SIDE + b
                    left = np.hypot(to_a - goal_a, to_b - goal_b)
                    heappush(queue, (there + left, there, to_a, to_b))
    way = [last]
    while way[-1] != first:
        before = came[way[-1]]
        way.append((before // SIDE, before % SIDE))
    carrot = way[-1]
    for k in range(len(way) - 2, -1, -1):
        a, b = way[k]
        away = np.hypot(a - first[0], b - first[1])
        if away > reach and carrot != first:
            break
        pieces = int(2 * away) + 1
        least = np.inf
        for piece in range(1, pieces + 1):
            share = piece / pieces
            on_a, on_b = first[0] + share * (a - first[0]), first[1] + share * (b - first[1])
            least = min(least, room[int(np.rint(on_a)), int(np.rint(on_b))])
        if least <= min(fits, room[first]) and carrot != first:
            break
        carrot = way[k]
    if carrot == first:
        return 0.0, 0.0
    return carrot[0] + corner[0] + 0.5, carrot[1] + corner[1] + 0.5
