"""Tells what recent scans have shown to be free: where no obstacle of a stated width can stand.

A disc of that width is not at a place if a ray that would have met it went past. Everything else is possibly occupied:
what lies between two rays, behind an obstacle, in a blind arc, or out of range.
"""

from typing import NamedTuple

import numpy as np

from nnql_bullet.geometry import Array, squared_distance
from nnql_bullet.jit import njit

SCANS = 12
"""Most scans that are remembered, the present one among them."""
APART, TURNED = 0.02, 0.003
"""Distance [m] and angle [rad] by which a vehicle has to move before its scan tells more than the one before."""
CERTAIN = 0.01
"""Distance by which a ray has to go on behind the near side of an obstacle before it shows that none is there [m]."""
CONTACT = 0.005
"""Distance by which a possible obstacle may come nearer to a vehicle that has less than its margin already [m]."""


class RecentScans(NamedTuple):
    """Recent scans of one vehicle (k of them), the newest first. The rays are evenly spaced all round."""

    rays: Array
    """Ray distances (k, r) [m]; 0 for a ray that tells nothing."""
    poses: Array
    """Poses of the vehicle at the scans, in its present frame (k, 3)."""
    strayed: Array
    """Possible position errors of these poses (k,) [m]."""


@njit()
def covered_half_width(radius: float, beyond: float) -> float:
    """How far beside a ray it shows discs to be absent [m].

    Args:
        radius: Of the discs [m].
        beyond: Distance of their centres beyond the end of the ray, along it [m]; negative before its end.
    """
    beyond += CERTAIN
    if beyond <= 0.0:
        return radius
    return float(np.sqrt(radius * radius - beyond * beyond)) if beyond < radius else 0.0


@njit()
def shown_free(
    x: float,
    y: float,
    direction: float,
    half_length: float,
    half_width: float,
    radius: float,
    scans: RecentScans,
    newest: int,
    known: int,
    sensor: Array,
    first_angle: float,
) -> bool:
    """Whether a scan shows that no disc has its centre in a rectangle.

    Args:
        x: Centre of the rectangle, in the present frame [m].
        y: The same [m].
        direction: Of its length [rad].
        half_length: [m]
        half_width: [m]
        radius: Of the discs [m].
        scans: The scans.
        newest: Number of the first scan that is asked.
        known: Number of the scans.
        sensor: Origin of the rays in the vehicle frame: x, y [m].
        first_angle: Of the first ray in the vehicle frame [rad].
    """
    rays, poses, strayed = scans
    count = rays.shape[1]
    step = 2 * np.pi / count
    for j in range(newest, min(known, len(rays))):
        c, s = np.cos(poses[j, 2]), np.sin(poses[j, 2])
        dx, dy = x - poses[j, 0], y - poses[j, 1]
        px, py = c * dx + s * dy - sensor[0], c * dy - s * dx - sensor[1]
        place = np.rint((np.arctan2(py, px) - first_angle) / step)
        angle = first_angle + place * step
        ca, sa = np.cos(angle), np.sin(angle)
        along, across = ca * px + sa * py, abs(ca * py - sa * px)
        turned = direction - poses[j, 2] - angle
        ct, st = abs(np.cos(turned)), abs(np.sin(turned))
        across += half_width * ct + half_length * st
        beyond = along + half_width * st + half_length * ct + strayed[j] - rays[j, int(place) % count]
        if across <= covered_half_width(radius - strayed[j], beyond):
            return True
    return False


@njit()
def meets_unseen(
    path: Array,
    footprint: Array,
    margin: float,
    width: float,
    scans: RecentScans,
    sensor: Array,
    first_angle: float,
) -> bool:
    """Whether a vehicle on a path comes near to where an unseen obstacle may stand.

    The places between every two neighbouring rays of the present scan are gone through in cells of half the width.

    Args:
        path: Poses of the vehicle, in its present frame (k, 3).
        footprint: A row (7,) of `geometry.as_rows`, in the vehicle's frame.
        margin: Smallest distance that it has to keep from possible obstacles [m]; where it has less already, that.
        width: Least width of an obstacle [m].
        scans: Its recent scans.
        sensor: Origin of the rays in the vehicle frame: x, y [m].
        first_angle: Of the first ray in the vehicle frame [rad].
    """
    frames, steps = np.empty((len(path), 4)), len(path)
    for k in range(steps):
        frames[k] = path[k, 0], path[k, 1], np.cos(path[k, 2]), np.sin(path[k, 2])
    cells, known = np.empty((1 << 16, 5)), len(scans.rays)
    return comes_near(
        cells, frames, steps, footprint, margin, width, scans, known, sensor, first_angle, 1 << 30, 1 << 30
    )


@njit()
def comes_near(
    cells: Array,
    frames: Array,
    steps: int,
    footprint: Array,
    margin: float,
    width: float,
    scans: RecentScans,
    known: int,
    sensor: Array,
    first_angle: float,
    most_along: int,
    most_across: int,
) -> bool:
    """`meets_unseen` of poses as frames: x, y, cosine and sine of the heading (k, 4).

    Args:
        cells: Room for `unseen_cells`; where there are more, the vehicle is taken to come near one.
        frames: Poses of the vehicle, in its present frame, and room for more.
        steps: Number of them.
        footprint: See `meets_unseen`.
        margin: See `meets_unseen`.
        width: See `meets_unseen`.
        scans: See `meets_unseen`, and room for more.
        known: Number of them.
        sensor: See `meets_unseen`.
        first_angle: See `meets_unseen`.
        most_along: Bound on the cells along a ray.
        most_across: Bound on the cells across it.
    """
    radius = width / 2
    grown = radius + margin
    count = unseen_cells(
        cells, frames, steps, footprint, grown, radius, scans.rays, sensor, first_angle, most_along, most_across
    )
    if count > len(cells):
        return True
    for cell in range(min(count, len(cells))):
        x, y, direction = cells[cell, 0], cells[cell, 1], cells[cell, 2]
        half_length, half_width = cells[cell, 3], cells[cell, 4]
        if shown_free(x, y, direction, half_length, half_width, radius, scans, 1, known, sensor, first_angle):
            continue
        here = np.sqrt(squared_distance(x, y, footprint))
        least = min(grown, here - CONTACT)
        for k in range(min(steps, len(frames))):
            dx, dy = x - frames[k, 0], y - frames[k, 1]
            ahead, beside = frames[k, 2] * dx + frames[k, 3] * dy, frames[k, 2] * dy - frames[k, 3] * dx
            if least > 0 and squared_distance(ahead, beside, footprint) < least * least:
                return True
    return False


@njit()
def unseen_cells(
    cells: Array,
    frames: Array,
    steps: int,
    footprint: Array,
    grown: float,
    radius: float,
    rays: Array,
    sensor: Array,
    first_angle: float,
    most_along: int,
    most_across: int,
) -> int:
    """Lists the places about a path that the present scan does not show to be free, as rectangles.

    Args:
        cells: Room for their centres x, y [m], directions [rad], half lengths and half widths [m] (m, 5).
        frames: See `comes_near`.
        steps: See `comes_near`.
        footprint: See `meets_unseen`.
        grown: Distance from the footprint within which they count [m].
        radius: Of an obstacle, and the largest length and width of a cell [m].
        rays: Ray distances (j, r) [m], the first those of the present scan; 0 for a ray that tells nothing.
        sensor: See `meets_unseen`.
        first_angle: See `meets_unseen`.
        most_along: See `comes_near`.
        most_across: See `comes_near`.

    Returns:
        How many there are. Those that there is no room for are not listed.
    """
    count, found = rays.shape[1], 0
    step = 2 * np.pi / count
    sine = np.sin(step / 2)
    together = radius / sine  # up to where two rays leave no room for a disc between them
    # A circle round the grown footprint at every frame: a ray that leaves it before its gap opens meets nothing.
    middle_x = middle_y = away = 0.0
    for k in range(min(steps, len(frames))):
        middle_x, middle_y = middle_x + frames[k, 0], middle_y + frames[k, 1]
    middle_x, middle_y = middle_x / steps - sensor[0], middle_y / steps - sensor[1]
    for k in range(min(steps, len(frames))):
        away = max(away, np.hypot(frames[k, 0] - sensor[0] - middle_x, frames[k, 1] - sensor[1] - middle_y))
    length, breadth = abs(footprint[0]) + footprint[2] + grown, abs(footprint[1]) + footprint[3] + grown
    circle = middle_x * middle_x + middle_y * middle_y - (away + np.hypot(length, breadth)) ** 2
    for ray in range(count):
        right, left = rays[0, ray], rays[0, (ray + 1) % count]
        start = min(together, min(right, left))
        direction = first_angle + (ray + 0.5) * step
        c, s = np.cos(direction), np.sin(direction)
        towards = c * middle_x + s * middle_y
        if towards * towards < circle or towards + np.sqrt(towards * towards - circle) < start:
            continue
        near, far = _span(sensor[0], sensor[1], c, s, frames, steps, footprint, grown)
        near = max(near, start)
        if far <= near:
            continue
        lengths = int(np.ceil((far - near) / radius))
        for cell in range(min(lengths, most_along)):
            end = far - cell * radius
            half_length = min(radius, end - near) / 2
            low = -end * sine + covered_half_width(radius, end - right)
            high = end * sine - covered_half_width(radius, end - left)
            pieces = int(np.ceil((high - low) / radius))
            for piece in range(min(pieces, most_across)):
                half_width = (high - low) / pieces / 2
                along, across = end - half_length, low + (2 * piece + 1) * half_width
                if found < len(cells):
                    x, y = sensor[0] + c * along - s * across, sensor[1] + s * along + c * across
                    cells[found] = x, y, direction, half_length, half_width
                found += 1
    return found


@njit()
def _span(
    x: float, y: float, c: float, s: float, frames: Array, steps: int, footprint: Array, grown: float
) -> tuple[float, float]:
    """The part of a ray from (x, y) along (c, s) in which it meets a grown footprint at some of the frames [m]."""
    first, last = np.inf, 0.0
    for k in range(min(steps, len(frames))):
        dx, dy = x - frames[k, 0], y - frames[k, 1]
        ahead, beside = frames[k, 2] * dx + frames[k, 3] * dy, frames[k, 2] * dy - frames[k, 3] * dx
        cr, sr = frames[k, 2] * c + frames[k, 3] * s, frames[k, 2] * s - frames[k, 3] * c
        enter, leave = 0.0, np.inf
        for offset, towards, half in (
            (ahead - footprint[0], cr, footprint[2] + grown),
            (beside - footprint[1], sr, footprint[3] + grown),
        ):
            if abs(towards) >= 1e-12:
                one, other = (-half - offset) / towards, (half - offset) / towards
                enter, leave = max(enter, min(one, other)), min(leave, max(one, other))
            elif abs(offset) > half:
                leave = -1.0
        if leave > enter:
            first, last = min(first, enter), max(last, leave)
    return first, last


@njit()
def is_missed(
    x: float, y: float, rays: Array, sensor: Array, first_angle: float, reach: float, slack: float, close: float
) -> bool:
    """Whether the rays of a scan miss a remembered point, and so neither refute nor replace it.

    Args:
        x: Of the point, in the vehicle frame [m].
        y: The same [m].
        rays: The scan (r,) [m]; 0 for a ray that tells nothing.
        sensor: Origin of the rays in the vehicle frame: x, y [m].
        first_angle: Of the first ray in the vehicle frame [rad].
        reach: Distance from the sensor from which on points do not matter [m].
        slack: Distance beside a ray within which it would have met the point [m].
        close: Distance within which a point of the scan replaces a remembered one [m].
    """
    step = 2 * np.pi / len(rays)
    x, y = x - sensor[0], y - sensor[1]
    if x * x + y * y > reach * reach:
        return False
    right = np.floor((np.arctan2(y, x) - first_angle) / step)
    for place in (right, right + 1):
        angle, distance = first_angle + place * step, rays[int(place) % len(rays)]
        c, s = np.cos(angle), np.sin(angle)
        along, across = c * x + s * y, abs(c * y - s * x)
        replaced = (along - distance) ** 2 + across * across < close * close
        if replaced or (across < slack and along < distance):
            return False
    return True
