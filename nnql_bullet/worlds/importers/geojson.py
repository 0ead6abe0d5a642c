"""Reads polygons of GeoJSON as obstacles.

A rectangle becomes a box. Other polygons become cells of a grid, each that they reach into, merged to boxes.
"""

from collections import Counter
from math import atan2, cos, hypot, radians
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.errors import UserError
from nnql_bullet.files import read_json
from nnql_bullet.geometry import Array, OrientedBox, Shape
from nnql_bullet.types import LARGEST
from nnql_bullet.worlds.importers.base import ForeignWorld, Reading, counted, in_arena
from nnql_bullet.worlds.importers.cells import check_size, merged_boxes

CELL = 0.05
"""Side of a cell of the grid for slanted polygons by default [m]."""
MOST_POLYGONS, MOST_POINTS = 100_000, 2_000_000
"""Of a file."""
EARTH_RADIUS = 6_371_008.8
"""Mean radius of the Earth [m]."""
_CONTAINERS = {"FeatureCollection": "features", "GeometryCollection": "geometries"}


def read_geojson(path: Path, reading: Reading) -> ForeignWorld:
    """Reads the polygons of a file.

    Raises:
        UserError: If it is malformed or too large, there is no polygon in it, or shapely is not installed.
    """
    skipped: Counter[str] = Counter()
    rings = [[_ring(ring, path) for ring in polygon] for polygon in _polygons(read_json(path), path, skipped)]
    if not rings:
        raise UserError(f"{path}: there is no polygon in it")
    everything = np.concatenate([polygon[0] for polygon in rings])
    low, high = everything.min(axis=0), everything.max(axis=0)
    notes = ["coordinates are taken for metres"]
    if reading.units == "degrees":
        if abs(everything[:, 0]).max() > 180 or abs(everything[:, 1]).max() >= 90:
            raise UserError(f"{path}: its coordinates are no degrees of longitude and latitude; give units metres")
        middle = (low + high) / 2
        scale = radians(EARTH_RADIUS) * np.array([cos(radians(middle[1])), 1.0])
        rings = [[(ring - middle) * scale for ring in polygon] for polygon in rings]
        notes = [f"(0, 0) is longitude {middle[0]:.7f}, latitude {middle[1]:.7f}; x is east, y is north"]
    elif (high - low).max() < 1.0:
        raise UserError(
            f"{path}: its polygons are within {(high - low).max():.2g} m; if they are in degrees, give units degrees"
        )
    side = reading.cell or CELL
    shapes: list[Shape] = []
    slanted = [polygon for polygon in rings if not _add_rectangle(polygon, shapes)]
    if slanted:
        cells = _cells(slanted, side, path)
        shapes += cells
        polygons = counted(len(slanted), "polygon is", "polygons are")
        notes.append(f"{polygons} no rectangle: every cell of {side:g} m that one reaches into, as {len(cells)} boxes")
    moved, width, depth, frame = in_arena(shapes, [], reading.margin, path)
    return ForeignWorld(
        format="GeoJSON",
        shapes=moved,
        width=width,
        depth=depth,
        frame=frame,
        files=(path,),
        notes=(f"{counted(len(rings), 'polygon')} as {counted(len(shapes), 'box', 'boxes')}", *notes),
        skipped=tuple(f"{kind} ({number} times)" for kind, number in sorted(skipped.items())),
    )


def _polygons(value: Any, path: Path, skipped: Counter[str]) -> list[list[Any]]:
    """Lists the polygons in GeoJSON, each as its rings."""
    found, waiting = [], [value]
    while waiting:
        one = waiting.pop()
        kind = str(one.get("type")) if isinstance(one, dict) else ""
        if kind == "Feature":
            waiting += [] if one.get("geometry") is None else [one["geometry"]]
        elif kind in _CONTAINERS and isinstance(one.get(_CONTAINERS[kind]), list):
            waiting += reversed(one[_CONTAINERS[kind]])
        elif kind in ("Polygon", "MultiPolygon"):
            polygons = one.get("coordinates") if kind == "MultiPolygon" else [one.get("coordinates")]
            if not isinstance(polygons, list) or not all(isinstance(its, list) and its for its in polygons):
                raise UserError(f"{path}: the coordinates of a {kind} are not lists of rings")
            found += polygons
        elif kind in ("Point", "MultiPoint", "LineString", "MultiLineString"):
            skipped[f"{kind}: only polygons are obstacles"] += 1
        else:
            raise UserError(f"{path}: is not GeoJSON: an object in it has no type that GeoJSON knows")
    if len(found) > MOST_POLYGONS:
        raise UserError(f"{path}: it has {len(found)} polygons; up to {MOST_POLYGONS} are read")
    return found


def _ring(ring: Any, path: Path) -> Array:
    """The corners of a ring (n, 2), of which the first is the last again."""
    pairs = isinstance(ring, list) and 4 <= len(ring) <= MOST_POINTS
    pairs = pairs and all(isinstance(point, list) and len(point) >= 2 for point in ring)
    numbers = [value for point in ring for value in point[:2]] if pairs else []
    if not numbers or not all(type(its) in (int, float) and abs(its) <= LARGEST for its in numbers):
        raise UserError(f"{path}: a ring of a polygon must be at least four points of finite numbers")
    corners = np.array(numbers, dtype=np.float64).reshape(-1, 2)
    if (corners[0] != corners[-1]).any():
        raise UserError(f"{path}: a ring of a polygon does not end where it begins")
    return corners


def _add_rectangle(polygon: list[Array], shapes: list[Shape]) -> bool:
    """Adds a polygon that is a rectangle as a box; whether it is one."""
    ring = polygon[0]
    if len(polygon) > 1 or len(ring) != 5:
        return False
    one, other = ring[1] - ring[0], ring[3] - ring[0]
    length, width = hypot(*one), hypot(*other)
    near = 1e-6 * max(length, width)
    if min(length, width) <= near or abs(one @ other) > near * min(length, width):
        return False
    if abs(ring[0] + one + other - ring[2]).max() > near:
        return False
    x, y = (ring[0] + ring[2]) / 2
    shapes.append(OrientedBox(float(x), float(y), length / 2, width / 2, round(atan2(one[1], one[0]), 9)))
    return True


def _cells(polygons: list[list[Array]], side: float, path: Path) -> list[Shape]:
    """Boxes of the cells that polygons reach into, on a grid through (0, 0)."""
    try:
        import shapely
    except ImportError:
        raise UserError("polygons that are no rectangles need shapely: pip install 'nnql-bullet[maps]'") from None
    corners = np.concatenate([polygon[0] for polygon in polygons])
    first, last = np.floor(corners.min(axis=0) / side), np.ceil(corners.max(axis=0) / side)
    columns, rows = (max(int(count), 1) for count in last - first)
    check_size(columns, rows, side, path)
    solid: NDArray[np.bool_] = np.zeros((rows, columns), np.bool_)
    for number, (shell, *holes) in enumerate(polygons, 1):
        polygon = shapely.Polygon(shell, holes)
        if not polygon.is_valid:
            raise UserError(f"{path}: slanted polygon {number}: {shapely.is_valid_reason(polygon)}")
        shapely.prepare(polygon)
        left, low = np.maximum(np.floor(shell.min(axis=0) / side) - first, 0).astype(int)
        right, high = (np.ceil(shell.max(axis=0) / side) - first).astype(int)
        x = (np.arange(left, max(right, left + 1)) + first[0]) * side
        for row in range(low, max(high, low + 1)):
            y = (row + first[1]) * side
            little = 1e-9 * side  # touching is not reaching into
            boxes = shapely.box(x + little, y + little, x + side - little, y + side - little)
            solid[row, left : left + len(x)] |= shapely.intersects(polygon, boxes)
    boxes = merged_boxes(solid, side, path)
    dx, dy = (first * side).tolist()
    return [OrientedBox(box.x + dx, box.y + dy, box.half_length, box.half_width) for box in boxes]
