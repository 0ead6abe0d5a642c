"""Computes the light in a picture: rays from each place find the visible parts of the sun and the sky.

A place receives three lights: from the sun's disc, whose shadows have soft edges; from the whole sky, which makes
corners and the ground under the vehicle darker (ambient occlusion: Zhukov, Iones and Kronin, An ambient light
illumination model, EGWR 1998); and from the ground, by reflection. Rays meet exact shapes, so shadows have no pixels
(Whitted, An improved illumination model for shaded display, CACM 1980).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.blocks import SHAPES_PER_BLOCK, bounds_of, squared_distance_to_bounds
from nnql_bullet.geometry import Array, OrientedBox, as_rows, reach_of, squared_distance
from nnql_bullet.render.shading import TO_SUN, Eye, distance_ahead, dot, kernel, ray_through, surface_normal
from nnql_bullet.types import Vector
from nnql_bullet.vehicle.visuals import Kind, Shape
from nnql_bullet.worlds.spec import WorldSpec

SUN_SHARE = 0.42
"""Share of the light on open ground that comes from the sun; the rest comes from the sky."""
BOUNCE = 0.6
"""Light that the ground reflects onto a surface that faces it, over the light on open ground."""
SUN_RADIUS = 0.03
"""Radius of the sun's disc [rad]; it is larger than the true one for softer edges."""
SUN_RAYS, SKY_RAYS, BEARINGS = 32, 256, 48
"""Numbers of rays into the sun's disc, rays into the sky past the vehicle, and bearings past boxes."""
SAMPLES = 2
"""Side of a square of pixels that share the rays into the sun and the sky."""
REACH = 4.0
"""Distance beyond which boxes block no light [m]."""
VEHICLE_REACH = 0.8
"""Distance from the vehicle's bounding sphere beyond which the vehicle blocks no light [m]."""
FAR = 1e9
"""Distance in place of infinity [m], which fast arithmetic does not support."""
NEARBY_CELL = 1.0
"""Side of a cell of the grid that lists near boxes [m]."""
NEARBY_MARGIN = 3.0
"""Width of the grid's margin around the arena [m]."""
KINDS: dict[Kind, int] = {"box": 0, "cylinder": 1, "sphere": 2, "mesh": 3}
NEAR_MESH = 0.01
"""How far from the bounding box of a mesh a place is taken to be on the mesh [m]."""
GOLDEN_ANGLE = np.pi * (3 - np.sqrt(5))


class Boxes(NamedTuple):
    """Boxes on the ground, and a grid that lists the boxes near each cell."""

    rows: Array
    """Rows of `as_rows` (n + m, 7): n standing boxes or circles, then m moving boxes."""
    height: float
    """Height of all boxes [m]."""
    still: int
    """Number n of standing boxes."""
    first: NDArray[np.int64]
    """Index in `near` of the first standing box near each cell (rows, columns + 1)."""
    near: NDArray[np.int64]
    """Standing boxes near the cells, cell by cell."""


class Parts(NamedTuple):
    """The vehicle's shapes."""

    kinds: NDArray[np.int64]
    half_sizes: Array
    """Half sizes of each shape (k, 3) [m]."""
    frames: Array
    """Transforms from the world to each shape (k, 3, 4)."""
    spheres: Array
    """Bounding spheres: middle and radius (k, 4) [m]."""
    sphere: Vector
    """Middle of the bounding sphere of all shapes [m]."""
    radius: float
    """Radius of that sphere [m]."""


def sky_directions(count: int) -> Array:
    """Returns directions (count, 3) spread evenly over the upper hemisphere: a Fibonacci spiral."""
    up = (np.arange(count) + 0.5) / count
    angle, level = GOLDEN_ANGLE * np.arange(count), np.sqrt(1 - up**2)
    return np.column_stack([level * np.cos(angle), level * np.sin(angle), up])


def sun_directions(count: int) -> Array:
    """Returns directions (count, 3) spread evenly over the sun's disc: Vogel's spiral."""
    middle = np.array(TO_SUN)
    aside = np.cross(middle, (0.0, 0.0, 1.0))
    aside /= np.linalg.norm(aside)
    angle, radius = GOLDEN_ANGLE * np.arange(count), SUN_RADIUS * np.sqrt((np.arange(count) + 0.5) / count)
    spread = np.outer(radius * np.cos(angle), aside) + np.outer(radius * np.sin(angle), np.cross(middle, aside))
    directions = middle + spread
    return np.asarray(directions / np.linalg.norm(directions, axis=1, keepdims=True))


SUN, SKY = sun_directions(SUN_RAYS), sky_directions(SKY_RAYS)
LEVEL = np.hypot(SUN[:, 0], SUN[:, 1])
SUN_BEARINGS = np.column_stack([SUN[:, 0] / LEVEL, SUN[:, 1] / LEVEL, LEVEL / SUN[:, 2]])
"""Directions of the sun's rays on the ground, and the distance there for each metre of rise (SUN_RAYS, 3)."""
ROUND = np.array([(np.cos(angle), np.sin(angle)) for angle in 2 * np.pi * (np.arange(BEARINGS) + 0.5) / BEARINGS])


def standing_boxes(world: WorldSpec) -> Boxes:
    """Sorts the boxes and walls of a world into the grid."""
    rows, columns = (int(np.ceil((side + 2 * NEARBY_MARGIN) / NEARBY_CELL)) for side in (world.depth, world.width))
    first, near = _sorted_into_cells(world.solids, bounds_of(world.solids), rows, columns)
    return Boxes(world.solids, world.obstacle_height, len(world.solids), first, near)


def with_movers(boxes: Boxes, movers: tuple[OrientedBox, ...]) -> Boxes:
    """Replaces the moving boxes."""
    return boxes._replace(rows=np.concatenate([boxes.rows[: boxes.still], as_rows(movers)]))


def placed_parts(shapes: Sequence[Shape], frames: Sequence[Array]) -> Parts:
    """Places shapes by transforms from their frames to the world (4, 4)."""
    placed = np.array(frames)
    half_sizes = np.array([shape.half_sizes for shape in shapes])
    middles, radii = placed[:, :3, 3], np.linalg.norm(half_sizes, axis=1)
    x, y, z = (middles.min(axis=0) + middles.max(axis=0)).tolist()
    return Parts(
        kinds=np.array([KINDS[shape.kind] for shape in shapes], dtype=np.int64),
        half_sizes=half_sizes,
        frames=np.ascontiguousarray(np.linalg.inv(placed)[:, :3]),
        spheres=np.column_stack([middles, radii]),
        sphere=(x / 2, y / 2, z / 2),
        radius=float(np.max(np.linalg.norm(middles - (x / 2, y / 2, z / 2), axis=1) + radii)),
    )


@kernel
def _sorted_into_cells(
    boxes: Array, bounds: Array, rows: int, columns: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Computes `first` and `near` of `Boxes`: the first pass counts, the second stores."""
    squared_reach = (REACH + NEARBY_CELL) ** 2
    first = np.zeros((rows, columns + 1), np.int64)
    near = np.empty(0, np.int64)
    for noting in (False, True):
        count = 0
        for row in range(rows):
            for column in range(columns):
                x, y = (column + 0.5) * NEARBY_CELL - NEARBY_MARGIN, (row + 0.5) * NEARBY_CELL - NEARBY_MARGIN
                first[row, column] = count
                for block in range(len(bounds)):
                    if squared_distance_to_bounds(x, y, bounds[block]) >= squared_reach:
                        continue
                    for k in range(SHAPES_PER_BLOCK * block, min(SHAPES_PER_BLOCK * (block + 1), len(boxes))):
                        if squared_distance(x, y, boxes[k]) < squared_reach:
                            if noting:
                                near[count] = k
                            count += 1
            first[row, columns] = count
        if not noting:
            near = np.empty(count, np.int64)
    return first, near


@kernel
def light_in_pixels(depths: NDArray[np.float32], eye: Eye, boxes: Boxes, parts: Parts) -> NDArray[np.float32]:
    """Computes the light in each pixel, over that on open ground.

    Args:
        depths: OpenGL's depths (h, w); 1 for ground and sky.
        eye: Camera.
        boxes: Boxes of the world.
        parts: Shapes of the vehicle.

    Returns:
        Light (h, w); 1 in the sky.
    """
    h, w = depths.shape
    light = np.ones((h, w), np.float32)
    near = np.empty(len(boxes.rows), np.int64)
    for row in range(h):
        for column in range(w):
            ray = ray_through(row, column, h, w, eye)
            if depths[row, column] < 1.0:
                normal = surface_normal(row, column, depths, eye)
                distance = distance_ahead(depths[row, column], eye)
            elif ray[2] < -1e-6:
                normal = 0.0, 0.0, 1.0
                distance = -eye.place[2] / ray[2]
            else:
                continue
            off = 0.002 + 3e-4 * distance  # depths are not exact
            place = (
                eye.place[0] + distance * ray[0] + off * normal[0],
                eye.place[1] + distance * ray[1] + off * normal[1],
                max(eye.place[2] + distance * ray[2], 0.0) + off * normal[2],
            )
            first = row % SAMPLES * SAMPLES + column % SAMPLES
            light[row, column] = light_at(place, normal, boxes, parts, near, first, SAMPLES * SAMPLES)
    return light


@kernel
def light_at(
    place: Vector, normal: Vector, boxes: Boxes, parts: Parts, near: NDArray[np.int64], first: int, every: int
) -> float:
    """Computes the light on a surface, over that on open ground.

    Args:
        place: Place just off the surface [m].
        normal: Unit normal of the surface.
        boxes: Boxes of the world.
        parts: Shapes of the vehicle.
        near: Buffer with an entry for each box.
        first: Index of the first ray into the sun and the sky.
        every: Stride to the next ray.
    """
    count = _find_near(place, boxes, near)
    away = place[0] - parts.sphere[0], place[1] - parts.sphere[1], place[2] - parts.sphere[2]
    by_vehicle = dot(away, away) < (VEHICLE_REACH + parts.radius) ** 2
    sun = _from_sun(place, normal, boxes, near, count, parts, by_vehicle, first, every)
    sky = _from_sky(place, normal, boxes, near, count)
    if by_vehicle:
        sky *= _past_vehicle(place, normal, parts, first, every)
    return SUN_SHARE * sun + (1 - SUN_SHARE) * sky + BOUNCE * (1 - normal[2]) / 2


@kernel
def _find_near(place: Vector, boxes: Boxes, near: NDArray[np.int64]) -> int:
    """Stores the boxes that may block light in `near`, and returns their number."""
    count = 0
    if place[2] >= boxes.height:
        return count
    row, column = int((place[1] + NEARBY_MARGIN) / NEARBY_CELL), int((place[0] + NEARBY_MARGIN) / NEARBY_CELL)
    if 0 <= row < boxes.first.shape[0] and 0 <= column < boxes.first.shape[1] - 1:
        for k in range(boxes.first[row, column], boxes.first[row, column + 1]):
            near[count] = boxes.near[k]
            count += 1
    for k in range(boxes.still, len(boxes.rows)):
        dx, dy = place[0] - boxes.rows[k, 0], place[1] - boxes.rows[k, 1]
        if np.hypot(dx, dy) < REACH + reach_of(boxes.rows[k]):
            near[count] = k
            count += 1
    return count


@kernel
def _from_sun(
    place: Vector,
    normal: Vector,
    boxes: Boxes,
    near: NDArray[np.int64],
    count: int,
    parts: Parts,
    by_vehicle: bool,
    first: int,
    every: int,
) -> float:
    """Computes the light from the sun, over that on open ground."""
    arriving, all_of_it = 0.0, 0.0
    for i in range(first, SUN_RAYS, every):
        direction = SUN[i, 0], SUN[i, 1], SUN[i, 2]
        all_of_it += direction[2]
        facing = dot(normal, direction)
        if facing <= 0.0:
            continue
        at_top = (boxes.height - place[2]) * SUN_BEARINGS[i, 2]  # distance at which the ray is above all boxes
        free = True
        for k in range(count):
            if _distance_to_box(place, SUN_BEARINGS[i, 0], SUN_BEARINGS[i, 1], boxes.rows, near[k]) < at_top:
                free = False
                break
        if free and not (by_vehicle and meets_parts(place, direction, parts)):
            arriving += facing
    return arriving / all_of_it


@kernel
def _from_sky(place: Vector, normal: Vector, boxes: Boxes, near: NDArray[np.int64], count: int) -> float:
    """Computes the light from the sky above the boxes, over that on open ground.

    All boxes stand on the ground and have one height, so in each bearing the sky begins above the nearest box. With
    the components a of the normal toward the bearing and c upward, the light from there is the integral of
    (a cos + c sin) cos over the elevations of the sky.
    """
    c = normal[2]
    if count == 0:
        return (1 + c) / 2
    arriving, height = 0.0, boxes.height - place[2]
    for i in range(BEARINGS):
        a = normal[0] * ROUND[i, 0] + normal[1] * ROUND[i, 1]
        if a <= 0.0 and c <= 1e-3:
            continue
        away = FAR
        for k in range(count):
            away = min(away, _distance_to_box(place, ROUND[i, 0], ROUND[i, 1], boxes.rows, near[k]))
        rise, run = height, away  # to the lower edge of the sky
        if a < 0.0 and -a * run > rise * c:
            rise, run = -a, c  # the surface itself hides the lower sky
        squared = rise * rise + run * run
        part = c * run * run / (2 * squared)
        if a != 0.0:
            part += a * ((np.pi / 2 - np.arctan2(rise, run)) - rise * run / squared) / 2
        arriving += max(part, 0.0)
    return 2 * arriving / BEARINGS


@kernel
def _past_vehicle(place: Vector, normal: Vector, parts: Parts, first: int, every: int) -> float:
    """Computes the share of the sky's light that passes the vehicle."""
    arriving, all_of_it = 0.0, 1e-9
    for i in range(first, SKY_RAYS, every):
        direction = SKY[i, 0], SKY[i, 1], SKY[i, 2]
        facing = dot(normal, direction)
        if facing > 0.0:
            all_of_it += facing
            if not meets_parts(place, direction, parts):
                arriving += facing
    return arriving / all_of_it


@kernel
def _distance_to_box(place: Vector, ux: float, uy: float, rows: Array, k: int) -> float:
    """Computes the distance along a level ray to box or circle k [m]; `FAR` if the ray misses it."""
    dx, dy, c, s = place[0] - rows[k, 0], place[1] - rows[k, 1], rows[k, 4], rows[k, 5]
    if rows[k, 6] > 0.0:
        nearest, inside = -(dx * ux + dy * uy), rows[k, 6] ** 2 - (dx * uy - dy * ux) ** 2
        if inside <= 0.0 or nearest + np.sqrt(inside) <= 0.0:
            return FAR
        enter = max(nearest - np.sqrt(inside), 0.0)
        return enter if enter < REACH else FAR
    enter, leave = _between_planes(0.0, REACH, c * dx + s * dy, c * ux + s * uy, rows[k, 2])
    enter, leave = _between_planes(enter, leave, c * dy - s * dx, c * uy - s * ux, rows[k, 3])
    return enter if enter < leave else FAR


@kernel
def _between_planes(enter: float, leave: float, start: float, rate: float, half: float) -> tuple[float, float]:
    """Clips a piece of a ray to the part in which the coordinate start + rate * distance is within +-half."""
    if abs(rate) < 1e-9:
        return (enter, leave) if abs(start) < half else (enter, enter)
    first, second = (-half - start) / rate, (half - start) / rate
    return max(enter, min(first, second)), min(leave, max(first, second))


@kernel
def meets_parts(place: Vector, direction: Vector, parts: Parts) -> bool:
    """Whether a ray along a unit vector meets one of the vehicle's shapes."""
    if _passes(place, direction, parts.sphere, parts.radius):
        return False
    for k in range(len(parts.kinds)):
        middle = parts.spheres[k, 0], parts.spheres[k, 1], parts.spheres[k, 2]
        if not _passes(place, direction, middle, parts.spheres[k, 3]) and _meets_part(place, direction, parts, k):
            return True
    return False


@kernel
def _passes(place: Vector, direction: Vector, middle: Vector, radius: float) -> bool:
    """Whether a ray misses a sphere."""
    away = middle[0] - place[0], middle[1] - place[1], middle[2] - place[2]
    along = dot(away, direction)
    return along < -radius or dot(away, away) - along * along > radius * radius


@kernel
def _meets_part(place: Vector, direction: Vector, parts: Parts, k: int) -> bool:
    """Whether a ray meets a shape: slabs (Kay and Kajiya, SIGGRAPH 1986), and a quadratic for curved surfaces.

    A mesh counts as its bounding box, for places outside of it: it throws a shadow on others, and none on itself.
    """
    x, y, z = _in_frame(parts.frames, k, place, 1.0)
    u, v, w = _in_frame(parts.frames, k, direction, 0.0)
    enter, leave = _between_planes(0.0, FAR, z, w, parts.half_sizes[k, 2])
    kind, radius = parts.kinds[k], parts.half_sizes[k, 0]
    if kind == 3 and (
        abs(x) < radius + NEAR_MESH
        and abs(y) < parts.half_sizes[k, 1] + NEAR_MESH
        and abs(z) < parts.half_sizes[k, 2] + NEAR_MESH
    ):
        return False
    if kind == 0 or kind == 3:
        enter, leave = _between_planes(enter, leave, x, u, radius)
        enter, leave = _between_planes(enter, leave, y, v, parts.half_sizes[k, 1])
        return enter < leave
    bends = 1.0 if kind == 2 else 0.0  # a sphere is curved along z too
    a, b = u * u + v * v + bends * w * w, x * u + y * v + bends * z * w
    c = x * x + y * y + bends * z * z - radius * radius
    if a < 1e-12:
        return c < 0.0 and enter < leave
    squared = b * b - a * c
    if squared <= 0.0:
        return False
    root = np.sqrt(squared)
    return bool(max(enter, (-b - root) / a) < min(leave, (-b + root) / a))


@kernel
def _in_frame(frames: Array, k: int, vector: Vector, moved: float) -> Vector:
    """Transforms a vector, or with `moved` = 1 a place, into the frame of shape k."""
    return (
        frames[k, 0, 0] * vector[0]
        + frames[k, 0, 1] * vector[1]
        + frames[k, 0, 2] * vector[2]
        + moved * frames[k, 0, 3],
        frames[k, 1, 0] * vector[0]
        + frames[k, 1, 1] * vector[1]
        + frames[k, 1, 2] * vector[2]
        + moved * frames[k, 1, 3],
        frames[k, 2, 0] * vector[0]
        + frames[k, 2, 1] * vector[1]
        + frames[k, 2, 2] * vector[2]
        + moved * frames[k, 2, 3],
    )
