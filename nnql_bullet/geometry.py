"""Angles, boxes, circles, distances and rays in the plane, in SI units. Angles are counter-clockwise from +x."""

from collections.abc import Sequence
from dataclasses import dataclass
from math import atan2, cos, hypot, pi, sin

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.jit import njit

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Pose:
    """A pose in the plane: x, y [m] and yaw [rad] in (-pi, pi]."""

    x: float
    y: float
    yaw: float


@dataclass(frozen=True, slots=True)
class OrientedBox:
    """A rectangle in the plane: centre [m], half extents [m], and yaw of its length [rad]."""

    x: float
    y: float
    half_length: float
    half_width: float
    yaw: float = 0.0

    @property
    def area(self) -> float:
        """Area [m2]."""
        return 4.0 * self.half_length * self.half_width

    def corners(self) -> Array:
        """The corners, counter-clockwise (4, 2) [m]."""
        signs = np.array([[1.0, 1.0], [-1.0, 1.0], [-1.0, -1.0], [1.0, -1.0]])
        c, s = cos(self.yaw), sin(self.yaw)
        scaled: Array = signs * (self.half_length, self.half_width)
        return np.asarray(scaled @ np.array([[c, s], [-s, c]]) + (self.x, self.y))


@dataclass(frozen=True, slots=True)
class Circle:
    """A disc in the plane: centre and radius [m]."""

    x: float
    y: float
    radius: float

    @property
    def area(self) -> float:
        """Area [m2]."""
        return pi * self.radius**2


Shape = OrientedBox | Circle


@njit()
def wrap_angle(angle: float) -> float:
    """Wraps an angle into (-pi, pi]."""
    wrapped = pi - (pi - angle) % (2.0 * pi)
    return float(wrapped if wrapped > -pi else pi)  # the remainder rounds up to 2 pi just above an odd multiple of pi


def wrap_angles(angles: Array) -> Array:
    """Wraps angles (...) [rad] into (-pi, pi]."""
    wrapped = pi - (pi - angles) % (2.0 * pi)
    return np.where(wrapped > -pi, wrapped, pi)


def bearing(pose: Pose, x: float, y: float) -> float:
    """Direction of the point (x, y) in the frame of `pose`, in (-pi, pi], positive to the left [rad]."""
    return float(wrap_angle(atan2(y - pose.y, x - pose.x) - pose.yaw))


def distance(pose: Pose, x: float, y: float) -> float:
    """Distance from `pose` to the point (x, y) [m]."""
    return hypot(x - pose.x, y - pose.y)


def placed(pose: Pose, x: float, y: float) -> tuple[float, float]:
    """Transforms the point (x, y) [m] from the frame of `pose` into the world."""
    c, s = cos(pose.yaw), sin(pose.yaw)
    return pose.x + c * x - s * y, pose.y + s * x + c * y


def moved(box: OrientedBox, pose: Pose) -> OrientedBox:
    """Transforms a box from the frame of `pose` into the world."""
    x, y = placed(pose, box.x, box.y)
    return OrientedBox(x, y, box.half_length, box.half_width, wrap_angle(pose.yaw + box.yaw))


COLUMNS = 7
"""Number of columns of `as_rows`."""


def as_rows(shapes: Sequence[Shape]) -> Array:
    """Converts shapes to rows (n, 7) for kernels.

    Returns:
        x, y, half length, half width [m], cos yaw, sin yaw, and radius [m] of each shape: a box that is grown by the
        radius all around. Here a box has no radius, and a circle has no length and no width.
    """
    rows = [
        (s.x, s.y, 0.0, 0.0, 1.0, 0.0, s.radius)
        if isinstance(s, Circle)
        else (s.x, s.y, s.half_length, s.half_width, cos(s.yaw), sin(s.yaw), 0.0)
        for s in shapes
    ]
    return np.array(rows, dtype=np.float64).reshape(len(rows), COLUMNS)


@njit()
def squared_distance(x: float, y: float, shape: Array) -> float:
    """Computes the squared distance from a point [m] to a filled shape, a row (7,) of `as_rows` [m2]; 0 inside."""
    squared = _squared_distance_to_box(x, y, shape)
    if shape[6] == 0.0:
        return squared
    return float(max(np.sqrt(squared) - shape[6], 0.0) ** 2)


@njit()
def _squared_distance_to_box(x: float, y: float, box: Array) -> float:
    """Computes the squared distance from a point [m] to the filled box of a row, without its radius [m2]; 0 inside."""
    dx, dy = x - box[0], y - box[1]
    along = max(abs(box[4] * dx + box[5] * dy) - box[2], 0.0)
    across = max(abs(box[4] * dy - box[5] * dx) - box[3], 0.0)
    return float(along * along + across * across)


@njit()
def reach_of(shape: Array) -> float:
    """Computes the distance from the centre of a shape to its farthest point [m]."""
    return float(np.hypot(shape[2], shape[3]) + shape[6])


@njit()
def _corners_to_box(a: Array, b: Array) -> float:
    """Computes the smallest squared distance from a corner of row `a` to the filled box of row `b` [m2]."""
    closest = np.inf
    for i in (-1.0, 1.0):
        for j in (-1.0, 1.0):
            x = a[0] + i * a[2] * a[4] - j * a[3] * a[5]
            y = a[1] + i * a[2] * a[5] + j * a[3] * a[4]
            closest = min(closest, _squared_distance_to_box(x, y, b))
    return closest


@njit()
def _gap_along_axes_of(a: Array, b: Array) -> tuple[float, float, float]:
    """The larger gap between the projections of two boxes on the axes of row `a` [m], and that axis from `a` to `b`.

    That is one half of the separating-axis test. The gap is 0 or less if both projections overlap; no distance between
    the boxes is smaller than a gap.
    """
    dx, dy = b[0] - a[0], b[1] - a[1]
    c, s = abs(a[4] * b[4] + a[5] * b[5]), abs(a[4] * b[5] - a[5] * b[4])
    ahead, left = a[4] * dx + a[5] * dy, a[4] * dy - a[5] * dx
    along = abs(ahead) - (a[2] + b[2] * c + b[3] * s)
    across = abs(left) - (a[3] + b[2] * s + b[3] * c)
    if along >= across:
        side = np.copysign(1.0, ahead)
        return along, side * a[4], side * a[5]
    side = np.copysign(1.0, left)
    return across, -side * a[5], side * a[4]


@njit()
def separation(a: Array, b: Array) -> tuple[float, float, float]:
    """Finds the widest gap between the projections of two boxes on one of their axes (separating-axis test).

    Args:
        a: A row (7,) of `as_rows`, whose radius does not count.
        b: Another one.

    Returns:
        The gap [m], 0 or less if the boxes overlap, and the unit vector x, y along that axis from `a` to `b`.
    """
    (gap, x, y), (other, back_x, back_y) = _gap_along_axes_of(a, b), _gap_along_axes_of(b, a)
    return (gap, x, y) if gap >= other else (other, -back_x, -back_y)


@njit()
def distance_apart(a: Array, b: Array) -> float:
    """Computes the distance between the shapes of two rows (7,) of `as_rows` whose boxes do not overlap [m].

    Two disjoint convex polygons are closest at a corner of one of them. Overlapping radii make it negative.
    """
    return float(np.sqrt(min(_corners_to_box(a, b), _corners_to_box(b, a))) - a[6] - b[6])


@njit()
def clearance(footprint: Array, shapes: Array, most: float = np.inf) -> float:
    """Computes the distance from a shape to the nearest of several [m]: 0 if they overlap, `most` if none is nearer.

    Args:
        footprint: One row (7,) of `as_rows`.
        shapes: Rows (n, 7) of `as_rows`.
        most: Distance from which on shapes do not matter [m].
    """
    closest = float(most)
    reach = np.hypot(footprint[2], footprint[3]) + footprint[6]
    for shape in shapes:
        dx, dy = shape[0] - footprint[0], shape[1] - footprint[1]
        most_near = closest + reach + np.sqrt(shape[2] * shape[2] + shape[3] * shape[3]) + shape[6]
        if dx * dx + dy * dy >= most_near * most_near:
            continue
        gap, _, _ = separation(footprint, shape)
        if gap <= 0.0:
            return 0.0
        if gap - footprint[6] - shape[6] >= closest:
            continue
        distance = distance_apart(footprint, shape)
        if distance <= 0.0:
            return 0.0
        closest = min(closest, distance)
    return closest


@njit()
def _closest_in(box: Array, x: float, y: float) -> tuple[float, float]:
    """Computes the point of a filled box that is closest to (x, y) [m]."""
    dx, dy = x - box[0], y - box[1]
    along = min(max(box[4] * dx + box[5] * dy, -box[2]), box[2])
    across = min(max(box[4] * dy - box[5] * dx, -box[3]), box[3])
    return box[0] + box[4] * along - box[5] * across, box[1] + box[5] * along + box[4] * across


@njit()
def _corner(box: Array, k: int) -> tuple[float, float]:
    """Computes the corner number `k` (0 to 3, counter-clockwise) of a box [m]."""
    along, across = box[2] * (1.0 if k in (0, 3) else -1.0), box[3] * (1.0 if k < 2 else -1.0)
    return box[0] + box[4] * along - box[5] * across, box[1] + box[5] * along + box[4] * across


@njit()
def _common_point(a: Array, b: Array) -> tuple[float, float]:
    """Finds a point of two overlapping boxes [m]: on an edge of row `a`, or the centre of row `b` if that is inside."""
    for k in range(4):
        (x, y), (u, v) = _corner(a, k), _corner(a, (k + 1) % 4)
        first, last = 0.0, 1.0
        for axis in range(2):
            c, s = (b[4], b[5]) if axis == 0 else (-b[5], b[4])
            begin, way = c * (x - b[0]) + s * (y - b[1]), c * (u - x) + s * (v - y)
            half = b[2 + axis]
            if way == 0.0:
                if abs(begin) > half:
                    last = -1.0
            else:
                one, other = (-half - begin) / way, (half - begin) / way
                first, last = max(first, min(one, other)), min(last, max(one, other))
        if first <= last:
            share = 0.5 * (first + last)
            return x + share * (u - x), y + share * (v - y)
    return b[0], b[1]


@njit()
def closest_points(a: Array, b: Array) -> tuple[float, float, float, float]:
    """Finds the closest points x, y of row `a` and x, y of row `b` (7,) of `as_rows` [m]; one point if they overlap."""
    if separation(a, b)[0] <= 0.0:
        x, y = _common_point(a, b)
        return x, y, x, y
    closest, found = np.inf, (0.0, 0.0, 0.0, 0.0)
    for k in range(4):
        x, y = _corner(a, k)
        u, v = _closest_in(b, x, y)
        squared = (x - u) ** 2 + (y - v) ** 2
        if squared < closest:
            closest, found = squared, (x, y, u, v)
        u, v = _corner(b, k)
        x, y = _closest_in(a, u, v)
        squared = (x - u) ** 2 + (y - v) ** 2
        if squared < closest:
            closest, found = squared, (x, y, u, v)
    radii = a[6] + b[6]
    if radii == 0.0:
        return found
    x, y, u, v = found
    apart = np.sqrt(closest)
    # From the boxes to the edges of the shapes around them, or to one point if these overlap.
    one, other = (a[6] / apart, b[6] / apart) if apart > radii else (a[6] / radii, b[6] / radii)
    return x + one * (u - x), y + one * (v - y), u + other * (x - u), v + other * (y - v)


@njit()
def row_at(x: float, y: float, yaw: float, row: Array) -> Array:
    """Transforms a row (7,) of `as_rows` from the frame at a pose [m, rad] into the world; as a tuple, for kernels."""
    c, s = np.cos(yaw), np.sin(yaw)
    return (  # type: ignore[return-value] # a tuple needs no allocation
        x + c * row[0] - s * row[1],
        y + s * row[0] + c * row[1],
        row[2],
        row[3],
        c * row[4] - s * row[5],
        s * row[4] + c * row[5],
        row[6],
    )


@njit()
def clearance_at(x: float, y: float, yaw: float, footprint: Array, shapes: Array) -> float:
    """Computes the clearance of a vehicle at a pose [m].

    Args:
        x: [m]
        y: [m]
        yaw: [rad]
        footprint: Row (7,) of `as_rows`, in the vehicle's frame.
        shapes: Rows (n, 7) of `as_rows`.
    """
    return float(clearance(row_at(x, y, yaw, footprint), shapes))


@njit()
def meet_circle(x: float, y: float, radius: float, directions: Array, distances: Array) -> None:
    """Shortens rays from the origin that meet a circle.

    Args:
        x: x of the circle's centre, from the rays' origin [m].
        y: y of the circle's centre, from the rays' origin [m].
        radius: Radius of the circle [m].
        directions: Vectors (m, 2) [m]; a distance counts them.
        distances: Array to shorten (m,); 1 is the length of a ray's direction.
    """
    for i in range(len(directions)):
        ux, uy = directions[i, 0], directions[i, 1]
        squared = ux * ux + uy * uy
        inside = squared * radius * radius - (ux * y - uy * x) ** 2
        if inside >= 0.0:
            nearest, chord = ux * x + uy * y, np.sqrt(inside)
            if nearest + chord >= 0.0:
                distances[i] = min(distances[i], max((nearest - chord) / squared, 0.0))


def ray_distances(origin: tuple[float, float], angles: Array, shapes: Array, sensor_range: float) -> Array:
    """Computes the distances at which rays meet a shape.

    Boxes by the slab method (Kay and Kajiya, SIGGRAPH 1986), circles by the quadratic equation of the distance.

    Args:
        origin: Origin of the rays [m].
        angles: Directions of the rays in the world (m,) [rad].
        shapes: Rows (n, 7) of `as_rows`.
        sensor_range: Length of a ray that meets nothing [m].

    Returns:
        Distances (m,) [m]; 0 for an origin inside a shape.
    """
    boxes, circles = shapes[shapes[:, 6] == 0.0], shapes[shapes[:, 6] > 0.0]
    c, s = boxes[:, 4], boxes[:, 5]
    dx, dy = origin[0] - boxes[:, 0], origin[1] - boxes[:, 1]
    start = np.stack([c * dx + s * dy, c * dy - s * dx])  # (2, n) in the frame of each box
    ux, uy = np.cos(angles)[:, None], np.sin(angles)[:, None]
    direction = np.stack([c * ux + s * uy, c * uy - s * ux])  # (2, m, n)
    half = boxes[:, 2:4].T  # (2, n)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        first = (-half - start)[:, None, :] / direction
        second = (half - start)[:, None, :] / direction
    enter = np.nanmax(np.minimum(first, second), axis=0, initial=0.0)
    leave = np.nanmin(np.maximum(first, second), axis=0, initial=sensor_range)
    hit = np.where(enter <= leave, enter, sensor_range)
    away = circles[:, :2] - origin
    nearest = ux * away[:, 0] + uy * away[:, 1]  # along the ray to its point nearest to the centre (m, k)
    inside = circles[:, 6] ** 2 - (ux * away[:, 1] - uy * away[:, 0]) ** 2
    chord = np.sqrt(np.maximum(inside, 0.0))
    met = (inside >= 0.0) & (nearest + chord >= 0.0)
    round_hit = np.where(met, np.maximum(nearest - chord, 0.0), sensor_range)
    return np.min(np.concatenate([hit, round_hit], axis=1), axis=1, initial=sensor_range)  # type: ignore[no-any-return]
