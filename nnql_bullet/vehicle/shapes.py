"""How far the shapes of a URDF reach: boxes, cylinders, spheres, and meshes by their convex hull."""

from dataclasses import dataclass
from io import BytesIO
from math import inf, pi
from pathlib import Path
from typing import Any
from urllib.parse import unquote

import numpy as np

from nnql_bullet.files import real
from nnql_bullet.geometry import Array
from nnql_bullet.markup import parse_xml
from nnql_bullet.vehicle.description import Solid

CORNERS = 128
"""Points of each end of a cylinder; they lie on its rim, on its own axes too."""
MESHES = (".stl", ".obj", ".dae")
"""Mesh files that are read."""
MOST_MESH_BYTES = 30_000_000
"""Size of the largest mesh that is read; an STL of it has 600 000 triangles."""


@dataclass(frozen=True, slots=True)
class Hull:
    """All points within a distance of the convex hull of some points."""

    points: Array
    """(n, 3) [m]"""
    inflation: float = 0.0
    """[m]"""

    def moved(self, transform: Array) -> "Hull":
        """Returns it in the frame to which a transform (4, 4) leads."""
        return Hull(self.points @ transform[:3, :3].T + transform[:3, 3], self.inflation)

    @property
    def low(self) -> Array:
        """Smallest x, y, z (3,) [m]."""
        return np.asarray(self.points.min(axis=0) - self.inflation)

    @property
    def high(self) -> Array:
        """Largest x, y, z (3,) [m]."""
        return np.asarray(self.points.max(axis=0) + self.inflation)

    def radius_about(self, point: Array, axis: Array) -> float:
        """Computes the largest distance from an axis (3,), of length 1, through a point (3,) [m]."""
        away = self.points - point
        return float(np.linalg.norm(away - np.outer(away @ axis, axis), axis=1).max() + self.inflation)


class Meshes:
    """Finds and reads the mesh files of a URDF."""

    def __init__(self, urdf: Path) -> None:
        """Looks for meshes relative to a URDF's path, and for packages in the folders above it."""
        self._folder = real(urdf).parent
        self._hulls: dict[Path, Array | None] = {}

    def find(self, file: str) -> Path | None:
        """Finds a mesh by its path, relative path, package:// or file:// address; None if it is not there."""
        scheme, _, rest = file.rpartition("://")
        name = unquote(rest) if scheme == "file" else rest
        if scheme in ("package", "model"):
            package, _, inside = name.partition("/")
            tries = [above / part for above in (self._folder, *self._folder.parents) for part in (name, inside)]
            tries = [path for path in tries if package in path.parts]
        elif scheme in ("", "file"):
            tries = [self._folder / name]
        else:
            return None
        return next((path for path in tries if _is_mesh_file(path)), None)

    def hull(self, solid: Solid) -> Array | None:
        """Reads the corners of the convex hull of a mesh (n, 3) [m]; None if it is not there or cannot be read."""
        path = self.find(solid.file)
        if path is None:
            return None
        if path not in self._hulls:
            self._hulls[path] = _hull_of(path)
        corners, scale = self._hulls[path], np.array(solid.sizes if len(solid.sizes) == 3 else (1.0, 1.0, 1.0))
        return None if corners is None else corners * scale


def hull_of(solid: Solid, meshes: Meshes) -> Hull | None:
    """Returns what a shape covers in its link's frame; None if it is not known, as of a mesh that is not found."""
    match solid.kind, solid.sizes:
        case "box", (x, y, z):
            signs = np.array(np.meshgrid(*[(-0.5, 0.5)] * 3)).reshape(3, -1).T
            hull = Hull(signs * (x, y, z))
        case "sphere", (radius,):
            hull = Hull(np.zeros((1, 3)), radius)
        case "capsule", (radius, length):
            hull = Hull(np.array([(0.0, 0.0, -length / 2), (0.0, 0.0, length / 2)]), radius)
        case "cylinder", (radius, length):
            angles = np.arange(CORNERS) * (2 * pi / CORNERS)
            rim = np.column_stack([radius * np.cos(angles), radius * np.sin(angles), np.full(CORNERS, length / 2)])
            hull = Hull(np.concatenate([rim, rim * (1, 1, -1)]))
        case "mesh", _:
            corners = meshes.hull(solid)
            if corners is None:
                return None
            hull = Hull(corners)
        case _:
            return None
    return hull.moved(solid.origin)


def _is_mesh_file(path: Path) -> bool:
    try:
        return path.is_file() and path.stat().st_size <= MOST_MESH_BYTES
    except (OSError, ValueError):  # a name that no file can have
        return False


def _hull_of(path: Path) -> Array | None:
    mesh = read_mesh(path)
    try:
        return None if mesh is None else np.asarray(mesh.convex_hull.vertices, dtype=float)
    except Exception:  # of meshes without a volume
        return None


def read_mesh(path: Path) -> Any:
    """Reads the triangles of a mesh file as a `trimesh.Trimesh` in metres; None if they cannot be read.

    Nothing is read but the file itself: no material, texture or buffer that it names, no archive, no XML entity.
    """
    import trimesh  # here because few programs need it

    kind = path.suffix.lower()
    if kind not in MESHES or not _is_mesh_file(path):
        return None
    try:
        data = path.read_bytes()
        unit = _collada_unit(data) if kind == ".dae" else 1.0
        mesh = trimesh.load(BytesIO(data), file_type=kind[1:], force="mesh", skip_materials=True, process=False)
        vertices = np.asarray(mesh.vertices, dtype=float) * unit
        bare = trimesh.Trimesh(vertices, np.asarray(mesh.faces))  # without what is not finite
    except Exception:  # trimesh passes on all errors of its parsers
        return None
    return bare if len(bare.faces) and np.isfinite(vertices).all() else None


def _collada_unit(data: bytes) -> float:
    """Reads the length of a unit of a COLLADA file [m], which trimesh does not apply.

    Raises:
        ValueError: If the file is no XML that `markup.parse_xml` takes, or it has no such length.
    """
    found = parse_xml(data).find("{*}asset/{*}unit")
    unit = 1.0 if found is None else float(found.get("meter", "1"))
    if not 0 < unit < inf:
        raise ValueError
    return unit
