"""The widest path through a world, exactly: how wide its narrowest passage is, and where.

A disc of diameter w passes between two obstacles if they are at least w apart. So obstacles closer than w, each linked
to the other by a line, are a barrier; a disc cannot get from the start to the target if and only if a closed barrier
surrounds one of them and not the other. The line from the start to the target crosses such a barrier an odd number of
times (Alexander duality with coefficients mod 2; the obstacles are convex, so by the nerve theorem the links show every
barrier). Linking pairs in ascending order of their distance, as Kruskal's algorithm does, the first pair that closes
such a barrier is the narrowest passage of the widest path.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array, Circle, as_rows, clearance, closest_points, reach_of
from nnql_bullet.jit import njit

ROUNDING = 1e-9
"""How much narrower than needed a passage may be for the sake of rounding [m]."""
_FIRST_REACH = 1.0
"""Distance of pairs that are looked at first [m]; it doubles until a barrier closes."""

MOST_PAIRS = 10_000_000
"""Largest number of pairs that are near each other; only obstacles that overlap again and again come to so many."""

Point = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Passage:
    """The narrowest place of the widest path."""

    width: float
    """Diameter of the largest disc that passes [m]; 0 if there is no path."""
    x: float
    """[m]"""
    y: float
    """[m]"""

    def admits(self, width: float) -> bool:
        """Whether a disc of a width [m] passes, to a nanometre."""
        return self.width > width - ROUNDING


def narrowest_passage(shapes: Array, start: Point, target: Point) -> Passage:
    """Finds the narrowest place of the widest path from the start to the target.

    Args:
        shapes: Obstacles and walls, rows (n, 7) of `as_rows`; walls surround the start and the target.
        start: [m]
        target: [m]

    Raises:
        UserError: If more than `MOST_PAIRS` obstacles are near each other.
    """
    found = [_around(point, shapes) for point in (start, target)]
    reach, most = _FIRST_REACH, 2.0 * max(min(its.width for its in found), 0.0)
    while True:
        distances, pairs, points = _pairs_within(shapes, min(reach, most))
        order = np.argsort(distances, kind="stable")
        closing = _first_barrier(order, pairs, points, shapes, np.array([start, target]))
        if closing >= 0:
            x, y = points[closing].mean(axis=0).tolist()
            found.append(Passage(float(distances[closing]), x, y))
        if closing >= 0 or reach >= most:
            return min(found, key=lambda its: its.width)
        reach *= 2.0


def is_passable(shapes: Array, start: Point, target: Point, width: float) -> bool:
    """Whether a disc of a width [m] passes from the start to the target, as `narrowest_passage(...).admits(width)`.

    It looks only at pairs that are no farther apart than the width, which are few among many shapes.

    Raises:
        UserError: See `narrowest_passage`.
    """
    if not all(_around(point, shapes).admits(width) for point in (start, target)):
        return False
    distances, pairs, points = _pairs_within(shapes, float(np.nextafter(width - ROUNDING, np.inf)))
    return _first_barrier(np.arange(len(distances)), pairs, points, shapes, np.array([start, target])) < 0


def _around(point: Point, shapes: Array) -> Passage:
    """The largest disc around a point."""
    row = as_rows([Circle(*point, 0.0)])[0]
    return Passage(2.0 * float(clearance(row, shapes)), *point)


def _pairs_within(shapes: Array, reach: float) -> tuple[Array, NDArray[np.int64], Array]:
    """As `_close_pairs`, with no more than `MOST_PAIRS` pairs.

    Raises:
        UserError: If there are more.
    """
    found = _close_pairs(shapes, reach, MOST_PAIRS)
    if len(found[0]) > MOST_PAIRS:
        raise UserError(
            f"more than {MOST_PAIRS} pairs of obstacles are within {reach:.2f} m of each other; merge what overlaps"
        )
    return found


@njit()
def _close_pairs(shapes: Array, reach: float, most: int) -> tuple[Array, NDArray[np.int64], Array]:
    """Finds the pairs of shapes whose distance is less than `reach` [m], and gives up a little above `most` pairs.

    Returns:
        Distances (k,) [m], indices (k, 2), and the closest points of both (k, 2, 2) [m].
    """
    distances, pairs, points = [], [], []
    radii = np.array([reach_of(shape) for shape in shapes])
    from_left = np.argsort(shapes[:, 0] - radii)
    for place, i in enumerate(from_left):
        for j in from_left[place + 1 :]:
            if shapes[j, 0] - radii[j] - shapes[i, 0] - radii[i] >= reach:
                break
            between = np.hypot(shapes[i, 0] - shapes[j, 0], shapes[i, 1] - shapes[j, 1])
            if between - radii[i] - radii[j] >= reach:
                continue
            x, y, u, v = closest_points(shapes[i], shapes[j])
            apart = np.hypot(x - u, y - v)
            if apart < reach:
                distances.append(apart)
                pairs.append((i, j))
                points.append((x, y, u, v))
        if len(distances) > most:
            break
    count = len(distances)
    found = np.zeros(count), np.zeros((count, 2), np.int64), np.zeros((count, 2, 2))
    for k in range(count):
        found[0][k] = distances[k]
        found[1][k, 0], found[1][k, 1] = pairs[k]
        found[2][k, 0, 0], found[2][k, 0, 1], found[2][k, 1, 0], found[2][k, 1, 1] = points[k]
    return found


@njit()
def _is_odd(x: float, y: float, u: float, v: float, ends: Array) -> bool:
    """Whether the line from (x, y) to (u, v) crosses the line between the ends (2, 2)."""
    dx, dy = ends[1, 0] - ends[0, 0], ends[1, 1] - ends[0, 1]
    one = dx * (y - ends[0, 1]) - dy * (x - ends[0, 0])
    other = dx * (v - ends[0, 1]) - dy * (u - ends[0, 0])
    if (one >= 0.0) == (other >= 0.0):
        return False
    share = one / (one - other)
    along = dx * (x + share * (u - x) - ends[0, 0]) + dy * (y + share * (v - y) - ends[0, 1])
    return bool(0.0 <= along < dx * dx + dy * dy)


@njit()
def _root(parents: NDArray[np.int64], odd: NDArray[np.bool_], shape: int) -> tuple[int, bool]:
    """The root of a shape, and whether the lines from the shape to it cross an odd number of times."""
    crossed = False
    while parents[shape] != shape:
        crossed ^= odd[shape]
        shape = parents[shape]
    return shape, crossed


@njit()
def _first_barrier(
    order: NDArray[np.int64], pairs: NDArray[np.int64], points: Array, shapes: Array, ends: Array
) -> int:
    """Links pairs in this order until a barrier closes that separates the ends.

    Args:
        order: Indices of pairs (k,).
        pairs: Indices of shapes (k, 2).
        points: Their closest points (k, 2, 2) [m].
        shapes: Rows (n, 7) of `as_rows`.
        ends: Start and target (2, 2) [m].

    Returns:
        The index of the closing pair, or -1.
    """
    parents = np.arange(len(shapes))
    odd = np.zeros(len(shapes), np.bool_)  # whether the line to the parent crosses an odd number of times
    for k in order:
        i, j = pairs[k]
        (x, y), (u, v) = points[k]
        crosses = _is_odd(shapes[i, 0], shapes[i, 1], x, y, ends) ^ _is_odd(x, y, u, v, ends)
        crosses ^= _is_odd(u, v, shapes[j, 0], shapes[j, 1], ends)
        (one, odd_one), (other, odd_other) = _root(parents, odd, i), _root(parents, odd, j)
        if one != other:
            parents[one], odd[one] = other, crosses ^ odd_one ^ odd_other
        elif crosses ^ odd_one ^ odd_other:
            return int(k)
    return -1
