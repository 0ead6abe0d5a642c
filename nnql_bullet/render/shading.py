"""Shades a picture pixel by pixel: light on solid bodies, and ground and sky around them.

A renderer gives only colours and depths, so pictures look alike with every renderer. Surfaces follow from the depths;
sun and sky light them. A pixel without a surface shows the ground (its ray meets the plane z = 0) or the sky. Deferred
shading: Saito and Takahashi, Comprehensible rendering of 3-D shapes, SIGGRAPH 1990.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.geometry import Array, reach_of, squared_distance
from nnql_bullet.jit import njit
from nnql_bullet.render.camera import Camera
from nnql_bullet.types import Bytes, Vector

SHADOW, SAFE_PATH, NON_SAFE_PATH = 0, 1, 2
"""Layers of the map of the ground."""

LEAN = (0.49, -0.35)
"""Displacement of a shadow for each metre of height, in x and y; it gives the direction of the light."""
TO_SUN: Vector = tuple((np.array([-LEAN[0], -LEAN[1], 1.0]) / np.linalg.norm([*LEAN, 1.0])).tolist())
"""Unit vector to the sun."""
SOFTNESS = 0.12
"""Half width of a shadow's edge [m]."""
BEND = 0.01
"""Largest second difference of depths within one surface, as a share of 1 - depth."""
HALF_ROOT = 0.5**0.5
WIDE, NARROW = 10.0, 2.0
"""Sides of the squares of the floor's two grids [m]; lines of the wide one lie on lines of the narrow one."""
TINT = 0.24
"""Share of a sector's colour in the free part of the sector."""
RUN = 16
"""Number of pixels of a row that are left out together where the floor is empty."""
BLOCK = 16
"""Side of a block of the map of the ground [cells]."""
TINY = 1e-30
"""Slope that counts as none."""

Rgb = tuple[Array, Array, Array]
"""Red, green and blue of a row (w,); in arrays of their own, so that the compiler can do several pixels at once."""
Place = tuple[float, float]
"""x, y [m]"""
Span = tuple[int, int]
"""The first column, and the one after the last."""
Line = tuple[float, float, float, float]
"""Place on the ground that the first pixel of a row shows, and the step to the next pixel: x, y, dx, dy [m]."""


kernel = njit(fastmath=True, error_model="numpy", nogil=True)
"""Compiles a function with fast arithmetic; several threads may run it at once."""
_part = njit(fastmath=True, error_model="numpy", inline="always")
"""Compiles a function with fast arithmetic into the functions that call it."""


class Eye(NamedTuple):
    """A camera for the kernels."""

    place: Vector
    """Place of the camera [m]."""
    ahead: Vector
    """Unit vector along the line of sight."""
    right: Vector
    """Vector from the middle of the picture to its right edge, at distance 1."""
    up: Vector
    """Vector from the middle to the upper edge, at distance 1."""
    near: float
    """Near clipping distance [m]."""
    far: float
    """Far clipping distance [m]."""


class Inks(NamedTuple):
    """Colours: red, green, blue from 0 to 255."""

    floor: Vector
    outside: Vector
    """Ground outside the arena."""
    target: Vector
    safe: Vector
    """Path driven in safe states."""
    non_safe: Vector
    """Path driven in non-safe states."""
    horizon: Vector


class Ground(NamedTuple):
    """Numbers of the ground; its arrays are separate, because arrays in a record slow the kernels down."""

    cell: float
    """Side of a cell of the map [m]; the first cell lies in the arena's lower left corner."""
    width: float
    """Width of the arena [m]."""
    depth: float
    """Depth of the arena [m]."""
    target: Vector
    """x, y and radius of the target [m]."""
    scan: Vector
    """Pose of the sensor: x, y [m], yaw [rad]."""
    sensor_range: float
    """[m]"""


def eye_of(camera: Camera) -> Eye:
    """Converts a camera for the kernels."""
    right, up, ahead = camera.axes
    across, along = camera.half_extents
    return Eye(camera.eye, _vector(ahead), _vector(right * across), _vector(up * along), camera.near, camera.far)


def _vector(array: Array) -> Vector:
    x, y, z = array.tolist()
    return x, y, z


def blocks_of(cells: NDArray[np.uint32]) -> Bytes:
    """Makes the table of the blocks of an empty map (rows, columns); 1 will mean that a block may not be empty."""
    rows, columns = (-(-count // BLOCK) for count in cells.shape)
    return np.zeros((rows, columns), np.uint8)


@kernel
def shadow_reach(box: Array, height: float) -> float:
    """Computes the largest distance of a shadow from the middle of its box, a row (7,) of `as_rows` [m]."""
    return float(reach_of(box) + height * np.hypot(LEAN[0], LEAN[1]) + 2 * SOFTNESS)


@kernel
def paint_shadow(layer: Bytes, busy: Bytes, cell: float, box: Array, height: float) -> None:
    """Adds a box's shadow to the map.

    Args:
        layer: Layer of shadows (rows, columns).
        busy: Receives 1 where a block of the map is not empty, see `blocks_of`.
        cell: Side of a cell [m].
        box: Row (7,) of `as_rows`.
        height: Height of the box [m].
    """
    reach = shadow_reach(box, height)
    low_x, high_x = max(int((box[0] - reach) / cell), 0), min(int((box[0] + reach) / cell) + 1, layer.shape[1])
    low_y, high_y = max(int((box[1] - reach) / cell), 0), min(int((box[1] + reach) / cell) + 1, layer.shape[0])
    for row in range(low_y, high_y):
        for column in range(low_x, high_x):
            dark = _shadow((column + 0.5) * cell, (row + 0.5) * cell, box, height)
            _paint(layer, busy, row, column, dark)


@kernel
def paint_line(layer: Bytes, busy: Bytes, cell: float, begin: Array, end: Array, half_width: float) -> None:
    """Adds a straight line with round ends and smooth edges to the map.

    Args:
        layer: Layer of the map (rows, columns).
        busy: Receives 1 where a block of the map is not empty, see `blocks_of`.
        cell: Side of a cell [m].
        begin: Begin of the line: x, y [m].
        end: End of the line: x, y [m].
        half_width: Half the width of the line [m].
    """
    margin = half_width + 2 * cell
    low_x = max(int((min(begin[0], end[0]) - margin) / cell), 0)
    high_x = min(int((max(begin[0], end[0]) + margin) / cell) + 1, layer.shape[1])
    low_y = max(int((min(begin[1], end[1]) - margin) / cell), 0)
    high_y = min(int((max(begin[1], end[1]) + margin) / cell) + 1, layer.shape[0])
    way_x, way_y = end[0] - begin[0], end[1] - begin[1]
    squared = max(way_x * way_x + way_y * way_y, 1e-12)
    for row in range(low_y, high_y):
        for column in range(low_x, high_x):
            x, y = (column + 0.5) * cell - begin[0], (row + 0.5) * cell - begin[1]
            along = min(max((x * way_x + y * way_y) / squared, 0.0), 1.0)
            off = np.hypot(x - along * way_x, y - along * way_y)
            cover = min(max((half_width - off) / (2 * cell) + 0.5, 0.0), 1.0)
            _paint(layer, busy, row, column, cover)


@_part
def _paint(layer: Bytes, busy: Bytes, row: int, column: int, cover: float) -> None:
    """Raises the cover of a cell, from 0 to 1."""
    if cover * 255 >= 1.0:
        layer[row, column] = max(layer[row, column], np.uint8(255 * cover))
        busy[row // BLOCK, column // BLOCK] = 1


@kernel
def shade(
    colours: Bytes,
    depths: NDArray[np.float32],
    light: NDArray[np.float32],
    eye: Eye,
    ground: Ground,
    inks: Inks,
    cells: NDArray[np.uint32],
    busy: Bytes,
    casters: Array,
    sectors: Array,
) -> Bytes:
    """Shades a picture.

    Args:
        colours: Colours of solid bodies, see `Solids`.
        depths: See `Solids`.
        light: See `Solids`.
        eye: Camera; it has no roll, so all pixels of a row see the ground at one distance ahead.
        ground: Numbers of the ground.
        inks: Colours of the ground.
        cells: Map of the ground (rows, columns). The bytes of a cell, from the lowest, hold its cover by shadow, by
            the path in safe states and by the path in non-safe states.
        busy: Which blocks of the map are not empty, see `blocks_of`.
        casters: Moving bodies that cast shadows (k, 9): rows of `as_rows`, height and `shadow_reach` [m].
        sectors: Free distance [m] and colour of each sector (8, 4).

    Returns:
        Red, green, blue (h, w, 3).
    """
    h, w = depths.shape
    picture = np.empty((h, w, 3), np.uint8)
    steep, behind = np.empty(w), (np.empty(w), np.empty(w), np.empty(w))  # of a row: see `_haze`; ground or sky
    dark, coarse = np.empty(w), np.empty(w)  # in the sky, `coarse` holds the lengths of the rays alone
    pixel = 2 * np.sqrt(dot(eye.up, eye.up)) / h
    for row in range(h):
        first = ray_through(row, 0, h, w, eye)
        rate_x, rate_y = 2 * eye.right[0] / w, 2 * eye.right[1] / w
        for column in range(w):
            x, y = first[0] + rate_x * column, first[1] + rate_y * column
            coarse[column] = np.sqrt(x * x + y * y + first[2] * first[2])
            steep[column] = abs(first[2]) / coarse[column]
        distance = 0.0
        if first[2] < -1e-6:
            distance = -eye.place[2] / first[2]
            x, y, dx, dy = distance * first[0], distance * first[1], distance * rate_x, distance * rate_y
            line = x + eye.place[0], y + eye.place[1], dx, dy
            fine = pixel * distance
            begin, end = span = _arena_in_row(line, w, ground)
            for i in range(3):
                behind[i][:] = inks.outside[i]
            stretch = -fine / first[2]
            for column in range(begin, end):
                coarse[column] *= stretch
            _lay_floor(line, (x, y), fine, coarse, span, inks, behind)
            _mark_floor(line, fine, coarse, span, ground, inks, sectors, behind)
            _shade_floor(
                line, (x, y), fine, coarse, span, depths[row], ground, inks, cells, busy, casters, dark, behind
            )
        else:
            for column in range(w):
                up = min(steep[column] / 0.35, 1.0)
                behind[0][column] = inks.horizon[0] * (1 - 0.20 * up)
                behind[1][column] = inks.horizon[1] * (1 - 0.14 * up)
                behind[2][column] = inks.horizon[2] * (1 - 0.08 * up)
        for column in range(w):
            share = _haze(distance, steep[column])
            for i in range(3):
                shown = light[row, column] * behind[i][column]
                behind[i][column] = shown + share * (inks.horizon[i] - shown)
        for column in range(w):
            if depths[row, column] < 1.0:
                share, bright = _haze(distance_ahead(depths[row, column], eye), steep[column]), light[row, column]
                for i in range(3):
                    shown = bright * colours[row, column, i]
                    behind[i][column] = shown + share * (inks.horizon[i] - shown)
        for column in range(w):
            for i in range(3):
                picture[row, column, i] = np.uint8(min(max(behind[i][column], 0.0), 255.0))
    return picture


@kernel
def smooth_edges(picture: Bytes, depths: NDArray[np.float32]) -> Bytes:
    """Smooths the edges of solid bodies, where depths jump or bend.

    Args:
        picture: Picture (h, w, 3).
        depths: OpenGL's depths (h, w).

    Returns:
        A new picture (h, w, 3).
    """
    h, w = depths.shape
    smooth = picture.copy()
    for row in range(1, h - 1):
        for column in range(1, w - 1):
            here = 1.0 - depths[row, column]
            left, right = 1.0 - depths[row, column - 1], 1.0 - depths[row, column + 1]
            above, below = 1.0 - depths[row - 1, column], 1.0 - depths[row + 1, column]
            nearest = max(here, left, right, above, below)
            if nearest == 0.0:
                continue
            bend = max(abs(left + right - 2 * here), abs(above + below - 2 * here))
            if bend > BEND * nearest:
                for i in range(3):
                    around = (
                        np.int64(picture[row, column - 1, i])
                        + picture[row, column + 1, i]
                        + picture[row - 1, column, i]
                        + picture[row + 1, column, i]
                    )
                    smooth[row, column, i] = np.uint8((4 * np.int64(picture[row, column, i]) + around) // 8)
    return smooth


@_part
def dot(a: Vector, b: Vector) -> float:
    """Computes the scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@_part
def _unit(x: float, y: float, z: float) -> Vector:
    length = max(np.sqrt(x * x + y * y + z * z), 1e-12)
    return x / length, y / length, z / length


@_part
def _inside(distance: float, sharp: float) -> float:
    """Computes the share of a pixel, 1 / `sharp` wide [m], inside an edge at a distance [m], positive inside."""
    return min(max(0.5 + distance * sharp, 0.0), 1.0)


@_part
def ray_through(row: int, column: int, h: int, w: int, eye: Eye) -> Vector:
    """Computes the vector from the eye through a pixel, one metre ahead."""
    x, y = (2 * column + 1) / w - 1.0, 1.0 - (2 * row + 1) / h
    return (
        eye.ahead[0] + x * eye.right[0] + y * eye.up[0],
        eye.ahead[1] + x * eye.right[1] + y * eye.up[1],
        eye.ahead[2] + x * eye.right[2] + y * eye.up[2],
    )


@_part
def distance_ahead(depth: float, eye: Eye) -> float:
    """Computes the distance ahead of the eye at a depth [m], by OpenGL's perspective matrix."""
    return 2 * eye.near * eye.far / (eye.far + eye.near - (2 * depth - 1) * (eye.far - eye.near))


@_part
def surface_normal(row: int, column: int, depths: NDArray[np.float32], eye: Eye) -> Vector:
    """Computes the normal of the surface in a pixel from the neighbours that are nearest to it in depth."""
    h, w = depths.shape
    here = depths[row, column]
    step = 2 + min(int(distance_ahead(here, eye) / 15.0), 2)  # depths become coarser with distance
    left, right = max(column - step, 0), min(column + step, w - 1)
    above, below = max(row - step, 0), min(row + step, h - 1)
    # Depths are not exact, so both neighbours count where the surface continues on both sides.
    if abs(depths[row, left] + depths[row, right] - 2 * here) > BEND * (1.0 - here):
        if abs(depths[row, left] - here) > abs(depths[row, right] - here):
            left = column
        else:
            right = column
    if abs(depths[above, column] + depths[below, column] - 2 * here) > BEND * (1.0 - here):
        if abs(depths[above, column] - here) > abs(depths[below, column] - here):
            above = row
        else:
            below = row
    a, b = _place(row, left, depths, eye), _place(row, right, depths, eye)
    c, d = _place(below, column, depths, eye), _place(above, column, depths, eye)
    across, along = (b[0] - a[0], b[1] - a[1], b[2] - a[2]), (d[0] - c[0], d[1] - c[1], d[2] - c[2])
    return _unit(
        across[1] * along[2] - across[2] * along[1],
        across[2] * along[0] - across[0] * along[2],
        across[0] * along[1] - across[1] * along[0],
    )


@_part
def _place(row: int, column: int, depths: NDArray[np.float32], eye: Eye) -> Vector:
    """Computes the vector from the eye to the surface in a pixel [m]."""
    ray = ray_through(row, column, depths.shape[0], depths.shape[1], eye)
    distance = distance_ahead(depths[row, column], eye)
    return distance * ray[0], distance * ray[1], distance * ray[2]


@_part
def clipped(low: float, high: float, slope: float, value: float) -> tuple[float, float]:
    """Clips an interval to the part in which the linear function value + slope * x is not negative.

    An empty interval ends 1 before it begins.
    """
    if slope > TINY:
        return min(max(low, -value / slope), high + 1.0), high
    if slope < -TINY:
        return low, max(min(high, -value / slope), low - 1.0)
    return low, high if value >= 0.0 else low - 1.0


@_part
def _haze(distance: float, steep: float) -> float:
    """Computes the horizon's share in the colour of a place: distant ones along flat lines of sight fade.

    Args:
        distance: Distance ahead of the eye [m].
        steep: Sine of the angle between the line of sight and the ground.
    """
    return 0.75 * (1.0 - steep) * min(max((distance - 15.0) / 110.0, 0.0), 1.0)


@_part
def _arena_in_row(line: Line, w: int, ground: Ground) -> Span:
    """Finds the columns that show the floor of the arena."""
    low, high = clipped(0.0, w - 1.0, line[2], line[0])
    low, high = clipped(low, high, -line[2], ground.width - line[0])
    low, high = clipped(low, high, line[3], line[1])
    low, high = clipped(low, high, -line[3], ground.depth - line[1])
    return int(np.ceil(low)), int(np.floor(high)) + 1


@_part
def _columns_within(line: Line, place: Place, radius: float, begin: int, end: int) -> Span:
    """Finds the columns from `begin` to before `end` that show the ground within a radius of a place [m]."""
    x, y = line[0] - place[0], line[1] - place[1]
    a, b, c = line[2] * line[2] + line[3] * line[3], x * line[2] + y * line[3], x * x + y * y - radius * radius
    squared = b * b - a * c
    if squared <= 0.0:
        return begin, begin
    root = np.sqrt(squared)
    low, high = max((-b - root) / a, float(begin)), min((-b + root) / a, end - 1.0)
    return int(np.ceil(low)), int(np.floor(high)) + 1


@_part
def _blend(behind: Rgb, column: int, ink: Vector, share: float) -> None:
    """Mixes a colour into that of a pixel."""
    behind[0][column] += share * (ink[0] - behind[0][column])
    behind[1][column] += share * (ink[1] - behind[1][column])
    behind[2][column] += share * (ink[2] - behind[2][column])


@kernel
def _lay_floor(line: Line, sight: Place, fine: float, coarse: Array, span: Span, inks: Inks, behind: Rgb) -> None:
    """Stores the colours of the floor and its grid.

    Args:
        line: What the row shows.
        sight: From the camera to the place that the first pixel shows: x, y [m].
        fine: Size of a pixel on the ground across the line of sight [m].
        coarse: Sizes of the pixels on the ground along the line of sight (w,) [m].
        span: First column of the floor, and the one after the last.
        inks: See `shade`.
        behind: Receives red, green and blue.
    """
    for i in range(3):
        behind[i][span[0] : span[1]] = inks.floor[i]
    for begin in range(span[0], span[1], RUN):
        end = min(begin + RUN, span[1])
        if not _has_lines(line, begin, end - 1, max(coarse[begin], coarse[end - 1])):
            continue
        for column in range(begin, end):
            sight_x, sight_y = sight[0] + line[2] * column, sight[1] + line[3] * column
            share = (coarse[column] - fine) / max(np.sqrt(sight_x * sight_x + sight_y * sight_y), 1e-9)
            wide_x, wide_y = fine + share * abs(sight_x), fine + share * abs(sight_y)
            x, y = line[0] + line[2] * column, line[1] + line[3] * column
            lines = 0.22 * _grid(x, y, wide_x, wide_y, WIDE, 0.035) + 0.09 * _grid(x, y, wide_x, wide_y, NARROW, 0.02)
            behind[0][column] = inks.floor[0] * (1 - lines)
            behind[1][column] = inks.floor[1] * (1 - lines)
            behind[2][column] = inks.floor[2] * (1 - lines)


@_part
def _has_lines(line: Line, first: int, last: int, widest: float) -> bool:
    """Whether columns `first` to `last`, whose pixels are at most `widest` [m], may show a line of the floor's grid."""
    if widest >= NARROW / 2:
        return True
    margin = (widest + NARROW / 50) / 2
    for i in range(2):
        a, b = line[i] + line[2 + i] * first, line[i] + line[2 + i] * last
        if np.floor((min(a, b) - margin) / NARROW) < np.floor((max(a, b) + margin) / NARROW):
            return True
    return False


@kernel
def _mark_floor(
    line: Line,
    fine: float,
    coarse: Array,
    span: Span,
    ground: Ground,
    inks: Inks,
    sectors: Array,
    behind: Rgb,
) -> None:
    """Paints the sectors' free distances and the target on the floor; see `shade` and `_lay_floor`."""
    begin, end = span
    scan = ground.scan[0], ground.scan[1]
    first, last = _columns_within(line, scan, ground.sensor_range, begin, end)
    x, y, crossings = line[0] - scan[0], line[1] - scan[1], np.empty(6)
    for k in range(4):
        edge = ground.scan[2] + (k - 0.5) * np.pi / 4
        c, s = np.cos(edge), np.sin(edge)
        rate = c * line[3] - s * line[2]
        crossings[k] = (s * x - c * y) / (rate if abs(rate) > TINY else TINY)
    crossings[4], crossings[5] = first, last
    crossings = np.ceil(np.minimum(np.maximum(np.sort(crossings), first), last))
    for k in range(5 if first < last else 0):
        low, high = int(crossings[k]), int(crossings[k + 1])
        if low < high:
            middle = (low + high - 1) / 2
            bearing = np.arctan2(y + line[3] * middle, x + line[2] * middle) - ground.scan[2]
            sector = int(np.floor(bearing / (np.pi / 4) + 0.5)) % 8
            _tint_sector(line, fine, coarse, low, high, sector, ground, sectors, behind)
    if begin >= end:
        return
    radius, place = ground.target[2], (ground.target[0], ground.target[1])
    widest = max(fine, 0.5 * coarse[begin], 0.5 * coarse[end - 1])
    first, last = _columns_within(line, place, radius + widest, begin, end)
    for column in range(first, last):
        sharp = 1 / max(fine, 0.5 * coarse[column])
        off = np.hypot(line[0] + line[2] * column - place[0], line[1] + line[3] * column - place[1])
        _blend(behind, column, inks.target, 0.28 * _inside(radius - off, sharp))
        _blend(behind, column, inks.target, 0.9 * _inside(0.1 - abs(radius - 0.1 - off), sharp))
        _blend(behind, column, inks.target, 0.9 * _inside(0.25 - off, sharp))


@kernel
def _shade_floor(
    line: Line,
    sight: Place,
    fine: float,
    coarse: Array,
    span: Span,
    depths: NDArray[np.float32],
    ground: Ground,
    inks: Inks,
    cells: NDArray[np.uint32],
    busy: Bytes,
    casters: Array,
    dark: Array,
    behind: Rgb,
) -> None:
    """Paints shadows and the path on the floor; see `shade` and `_lay_floor`.

    Here `depths` is a row (w,), and `dark` is a buffer (w,).
    """
    begin, end = span
    dark[begin:end] = 0.0
    low, high = end, begin  # where moving bodies may throw a shadow
    for k in range(len(casters)):
        first, last = _columns_within(line, (casters[k, 0], casters[k, 1]), casters[k, 8], begin, end)
        if first < last:
            low, high = min(low, first), max(high, last)
        for column in range(first, last):
            x, y = line[0] + line[2] * column, line[1] + line[3] * column
            dark[column] = max(dark[column], _shadow(x, y, casters[k], casters[k, 7]))
    for first in range(begin, end, RUN):
        last = min(first + RUN, end)
        widest = fine + max(coarse[first], coarse[last - 1])
        mapped = _is_busy(line, first, last - 1, widest / 2 + 2 * ground.cell, ground.cell * BLOCK, busy)
        if not mapped and (last <= low or first >= high):
            continue
        for column in range(first, last):
            if depths[column] < 1.0:
                continue
            shadow, safe, non_safe = dark[column], 0.0, 0.0
            if mapped:
                x, y = line[0] + line[2] * column, line[1] + line[3] * column
                sight_x, sight_y = sight[0] + line[2] * column, sight[1] + line[3] * column
                still, safe, non_safe = _look_up(x, y, sight_x, sight_y, fine, coarse[column], ground.cell, cells)
                shadow = max(shadow, still)
            if shadow + safe + non_safe == 0.0:
                continue
            _blend(behind, column, (0.0, 0.0, 0.0), 0.42 * shadow)
            _blend(behind, column, inks.safe, 0.85 * safe)
            _blend(behind, column, inks.non_safe, 0.85 * non_safe)


@_part
def _is_busy(line: Line, first: int, last: int, margin: float, side: float, busy: Bytes) -> bool:
    """Whether the map may hold something within a margin [m] of what columns `first` to `last` show.

    `side` is that of a block [m].
    """
    a, b = line[0] + line[2] * first, line[0] + line[2] * last
    c, d = line[1] + line[3] * first, line[1] + line[3] * last
    left, right = int(max((min(a, b) - margin) / side, 0.0)), int((max(a, b) + margin) / side)
    below, above = int(max((min(c, d) - margin) / side, 0.0)), int((max(c, d) + margin) / side)
    for row in range(below, min(above + 1, busy.shape[0])):
        for column in range(left, min(right + 1, busy.shape[1])):
            if busy[row, column]:
                return True
    return False


@_part
def _grid(x: float, y: float, wide_x: float, wide_y: float, every: float, width: float) -> float:
    """Computes the share of a pixel that the lines of a grid cover."""
    return max(_line(x, wide_x, every, width), _line(y, wide_y, every, width))


@_part
def _line(x: float, wide: float, every: float, width: float) -> float:
    """Computes the share of a pixel that parallel lines cover; the mean cover if lines are denser than pixels."""
    off = abs(x - every * np.int32(x / every + 0.5))  # x is not negative in the arena
    line = min(max((width + wide) / 2 - off, 0.0), min(width, wide)) / wide
    return float(line + (width / every - line) * min(max(wide / every - 0.5, 0.0), 1.0))


@kernel
def _tint_sector(
    line: Line,
    fine: float,
    coarse: Array,
    begin: int,
    end: int,
    sector: int,
    ground: Ground,
    sectors: Array,
    behind: Rgb,
) -> None:
    """Tints the free part of a sector in the columns from `begin` to before `end`, and marks its rim and its edges.

    All these columns show the sector; see `shade` and `_lay_floor`.
    """
    scan, reach = (ground.scan[0], ground.scan[1]), sectors[sector, 0]
    begin, end = _columns_within(line, scan, reach, begin, end)
    tint = sectors[sector, 1], sectors[sector, 2], sectors[sector, 3]
    edge = ground.scan[2] + (sector - 0.5) * np.pi / 4
    c, s = np.cos(edge), np.sin(edge)
    x, y = line[0] - scan[0], line[1] - scan[1]
    u, v, du, dv = c * x + s * y, c * y - s * x, c * line[2] + s * line[3], c * line[3] - s * line[2]
    for first in range(begin, end, RUN):
        last = min(first + RUN, end)
        margin = 0.07 + max(fine, 0.5 * coarse[first], 0.5 * coarse[last - 1]) / 2
        ends = u + du * first, v + dv * first, u + du * (last - 1), v + dv * (last - 1)
        farthest = np.sqrt(max(ends[0] * ends[0] + ends[1] * ends[1], ends[2] * ends[2] + ends[3] * ends[3]))
        nearest = min(ends[1], ends[3], HALF_ROOT * min(ends[0] - ends[1], ends[2] - ends[3]))
        if min(nearest, reach - farthest) > margin:  # neither edge nor rim
            for column in range(first, last):
                _blend(behind, column, tint, TINT)
            continue
        for column in range(first, last):
            along, off = u + du * column, v + dv * column  # along the right edge, and to the left of it
            side = min(off, (along - off) * HALF_ROOT)  # distance from the nearer edge
            sharp = 1 / max(fine, 0.5 * coarse[column])
            rim = 0.75 * _inside(0.07 - (reach - np.sqrt(along * along + off * off)), sharp)
            edge = max(rim, 0.25 * _inside(0.015 - side, sharp))
            _blend(behind, column, tint, TINT + (1.0 - TINT) * edge)


@_part
def _look_up(
    x: float,
    y: float,
    sight_x: float,
    sight_y: float,
    fine: float,
    coarse: float,
    cell: float,
    cells: NDArray[np.uint32],
) -> Vector:
    """Averages the layers of the map over the ground that a pixel shows, at one point per cell and at most 16."""
    across, along = min(max(int(fine / cell), 1), 4), min(max(int(coarse / cell), 1), 4)
    if across == along == 1:
        dark, safe, non_safe = _between(x / cell - 0.5, y / cell - 0.5, cells)
        return dark / 255.0, safe / 255.0, non_safe / 255.0
    level = max(np.sqrt(sight_x * sight_x + sight_y * sight_y), 1e-9)
    along_x, along_y = sight_x / level, sight_y / level
    dark, safe, non_safe = 0.0, 0.0, 0.0
    for i in range(across):
        aside = ((i + 0.5) / across - 0.5) * fine
        for j in range(along):
            ahead = ((j + 0.5) / along - 0.5) * coarse
            at_x, at_y = x + ahead * along_x - aside * along_y, y + ahead * along_y + aside * along_x
            here = _between(at_x / cell - 0.5, at_y / cell - 0.5, cells)
            dark, safe, non_safe = dark + here[0], safe + here[1], non_safe + here[2]
    looks = 255.0 * across * along
    return dark / looks, safe / looks, non_safe / looks


@_part
def _between(x: float, y: float, cells: NDArray[np.uint32]) -> Vector:
    """Interpolates the layers of the map at a point given in cells; 0 outside the map."""
    column, row = int(x + 1.0) - 1, int(y + 1.0) - 1  # rounds down, as x and y are above -1
    if column < 0 or row < 0 or column + 1 >= cells.shape[1] or row + 1 >= cells.shape[0]:
        return 0.0, 0.0, 0.0
    e, f = cells[row, column], cells[row, column + 1]
    g, h = cells[row + 1, column], cells[row + 1, column + 1]
    if e | f | g | h == 0:
        return 0.0, 0.0, 0.0
    a, b = x - column, y - row
    p, q, r, s = (1 - a) * (1 - b), a * (1 - b), (1 - a) * b, a * b
    return (
        p * (e & 255) + q * (f & 255) + r * (g & 255) + s * (h & 255),
        p * (e >> 8 & 255) + q * (f >> 8 & 255) + r * (g >> 8 & 255) + s * (h >> 8 & 255),
        p * (e >> 16 & 255) + q * (f >> 16 & 255) + r * (g >> 16 & 255) + s * (h >> 16 & 255),
    )


@_part
def _shadow(x: float, y: float, box: Array, height: float) -> float:
    """Computes the darkness of a point in a box's shadow, which is the box's base moved along the light."""
    nearest = np.inf
    for k in range(7):
        up = height * k / 6
        nearest = min(nearest, squared_distance(x - LEAN[0] * up, y - LEAN[1] * up, box))
    return float(max(1.0 - np.sqrt(nearest) / (2 * SOFTNESS), 0.0))
