"""Draws solid bodies without any graphics library: the same picture on every machine.

Every solid is a mesh of triangles. What a triangle shows in a row of pixels is the interval in which the linear
functions of its three edges are positive (Olano and Greer, Triangle scan conversion using 2D homogeneous coordinates,
Graphics Hardware 1997), so nothing has to be clipped; a buffer of depths keeps what is nearest. Light is known at the
corners and is interpolated between them (Gouraud, Continuous shading of curved surfaces, IEEE Trans. Computers 1971).
"""

from collections.abc import Sequence
from itertools import count
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from trimesh.creation import box, icosphere
from trimesh.creation import cylinder as tube

from nnql_bullet.colours import Colour
from nnql_bullet.geometry import Array, Circle
from nnql_bullet.geometry import Shape as Footprint
from nnql_bullet.recording import Recording
from nnql_bullet.render.camera import Camera
from nnql_bullet.render.shading import TO_SUN, Eye, clipped, dot, eye_of, kernel
from nnql_bullet.render.solids import BOX, MOVING, WALL, Solids
from nnql_bullet.render.timeline import Moment
from nnql_bullet.types import Bytes, Vector
from nnql_bullet.vehicle.visuals import Kind, Shape, Visuals, upright

FACETS = 48
"""Number of facets around a cylinder or sphere."""
EVERYWHERE, FROM_SKY, FROM_SUN = 0.62, 0.14, 0.34
"""Light on a surface: on every one; on one that faces up, and as much less on one that faces down; and on one that
faces the sun."""
DIM_BELOW, DIM = 0.35, 0.14
"""Height below which surfaces receive less light [m], and the share that they miss on the ground."""
KINDS: list[Kind] = ["box", "cylinder", "sphere"]
"""Solids that have a mesh in common."""
ROUNDING = 1e-7
"""How far intervals are widened, so that triangles leave no gap [pixels]."""


class Meshes(NamedTuple):
    """Meshes, each within the cube from -1 to 1, which the half sizes of a solid stretch."""

    corners: Array
    """Corners of the triangles (t, 3, 3)."""
    normals: Array
    """Outward normals at the corners (t, 3, 3)."""
    first: NDArray[np.int64]
    """Index of the first triangle of each mesh, and t (m + 1,)."""
    closed: NDArray[np.bool_]
    """Whether each mesh is closed, so that triangles are seen from outside only (m,)."""


class Bodies(NamedTuple):
    """Solids in the world."""

    mesh: NDArray[np.int64]
    """Index of the mesh of each solid (n,)."""
    half_sizes: Array
    """Half extents of each solid along its own axes (n, 3) [m]."""
    frames: Array
    """Transforms from the frame of each solid to the world (n, 4, 4)."""
    inks: Bytes
    """Colours: red, green, blue (n, 3)."""


class RasterRenderer:
    """Draws a recording."""

    lights = False
    samples = 1

    def __init__(self, recording: Recording) -> None:
        """Builds the scene.

        Args:
            recording: Recording of the drive.

        Raises:
            UserError: If the recording has no shapes of the vehicle.
        """
        self._visuals = Visuals(recording.about["vehicle"])
        world, shapes = recording.world, self._visuals.shapes
        self._height = world.obstacle_height
        solids = [*world.obstacles, *world.walls, *(patrol.box for patrol in world.patrols)]
        paints = [BOX] * len(world.obstacles) + [WALL] * len(world.walls) + [MOVING] * len(world.patrols)
        own = [_unit_mesh(its) for its in shapes if its.kind == "mesh"]
        self._meshes = _joined([*_unit_meshes(), *own], closed=len(KINDS))
        meshes = [int(isinstance(its, Circle)) for its in solids]
        free = count(len(KINDS))
        meshes += [KINDS.index(its.kind) if its.kind in KINDS else next(free) for its in shapes]
        sizes = [self._half_sizes(its) for its in solids] + [its.half_sizes for its in shapes]
        self._bodies = Bodies(
            np.array(meshes),
            np.array(sizes),
            np.stack([self._frame(its) for its in solids] + [np.eye(4)] * len(shapes)),
            _bytes(paints + [its.colour for its in shapes]),
        )

    def draw(self, moment: Moment, camera: Camera) -> Solids:
        """Draws the camera's picture at a moment."""
        parts = self._visuals.frames(moment.pose, moment.joint_angles, moment.tilt)
        moving = [self._frame(box) for box in moment.movers] + parts
        self._bodies.frames[len(self._bodies.frames) - len(moving) :] = moving
        return Solids(*draw_bodies(camera.height, camera.width, eye_of(camera), self._bodies, self._meshes))

    def close(self) -> None:
        """Has nothing to free."""

    def _half_sizes(self, its: Footprint) -> Vector:
        half = (its.radius, its.radius) if isinstance(its, Circle) else (its.half_length, its.half_width)
        return *half, self._height / 2

    def _frame(self, its: Footprint) -> Array:
        return upright(its.x, its.y, self._height / 2, 0.0 if isinstance(its, Circle) else its.yaw)


def _bytes(paints: Sequence[Colour]) -> Bytes:
    return np.asarray(np.round(255 * np.clip(paints, 0.0, 1.0)).astype(np.uint8))


def _unit_meshes() -> list[tuple[Array, Array]]:
    """Makes the triangles of a cube, a cylinder and a sphere from -1 to 1, and their normals (t, 3, 3)."""
    cube, cylinder = (np.asarray(solid.triangles) for solid in (box((2, 2, 2)), tube(1, 2, sections=FACETS)))
    ball = np.asarray(icosphere(subdivisions=3).triangles)
    flat = _flat(cylinder)
    rounded = np.where(np.abs(flat[..., 2:]) < 0.5, cylinder * (1.0, 1.0, 0.0), flat)
    return [(cube, _flat(cube)), (cylinder, rounded), (ball, ball)]


def _unit_mesh(its: Shape) -> tuple[Array, Array]:
    """Scales the triangles of a mesh to the cube from -1 to 1."""
    triangles = its.triangles / np.maximum(its.half_sizes, 1e-9)
    return triangles, _flat(its.triangles) * its.half_sizes  # as the kernel divides normals by the half sizes


def _flat(triangles: Array) -> Array:
    """Returns the unit normals of flat triangles at their corners (t, 3, 3); 0 of triangles without area."""
    normals = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    lengths = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.repeat((normals / np.where(lengths > 0.0, lengths, 1.0))[:, None], 3, axis=1)


def _joined(meshes: Sequence[tuple[Array, Array]], closed: int) -> Meshes:
    """Joins meshes, of which the first `closed` are closed."""
    corners, normals = (np.ascontiguousarray(np.concatenate(parts)) for parts in zip(*meshes, strict=True))
    first = np.cumsum([0, *(len(triangles) for triangles, _ in meshes)])
    return Meshes(corners, normals, first, np.arange(len(meshes)) < closed)


@kernel
def draw_bodies(
    h: int, w: int, eye: Eye, bodies: Bodies, meshes: Meshes
) -> tuple[Bytes, NDArray[np.float32], NDArray[np.float32]]:
    """Draws solids (h, w); returns the arrays of `Solids`."""
    depths, drawn = np.ones((h, w), np.float32), np.empty((h, w), np.int32)
    seen, most = _in_view(eye, bodies, meshes)
    nearness, light = np.empty((most, 3)), np.empty((most, 3))
    inks = np.empty((most, 3), np.uint8)
    corners, edges, shine = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    number = 0
    for n in seen:
        mesh = bodies.mesh[n]
        for t in range(meshes.first[mesh], meshes.first[mesh + 1]):
            _place_triangle(t, n, eye, bodies, meshes, corners)
            facing = _edges_of(corners, h, w, edges)
            if facing == 0.0 or (facing < 0.0 and meshes.closed[mesh]):
                continue
            for i in range(3):
                shine[i] = _light_at(t, i, n, facing, bodies, meshes)
                nearness[number, i] = edges[0, i] + edges[1, i] + edges[2, i]
            for i in range(3):
                light[number, i] = shine[0] * edges[0, i] + shine[1] * edges[1, i] + shine[2] * edges[2, i]
            inks[number] = bodies.inks[n]
            _fill(number, corners, edges, nearness[number], eye.near, eye.far, depths, drawn)
            number += 1
    colours, shines = _resolved(eye, nearness, light, inks, depths, drawn)
    return colours, depths, shines


@kernel
def _in_view(eye: Eye, bodies: Bodies, meshes: Meshes) -> tuple[NDArray[np.int64], int]:
    """Finds the solids whose bounding spheres the camera may see, and the number of their triangles."""
    seen, size, triangles = np.empty(len(bodies.mesh), np.int64), 0, 0
    across, along = np.sqrt(dot(eye.right, eye.right)), np.sqrt(dot(eye.up, eye.up))
    for n in range(len(seen)):
        half, frame = bodies.half_sizes[n], bodies.frames[n]
        radius = np.sqrt(half[0] ** 2 + half[1] ** 2 + half[2] ** 2)
        away = frame[0, 3] - eye.place[0], frame[1, 3] - eye.place[1], frame[2, 3] - eye.place[2]
        ahead = dot(away, eye.ahead)
        aside, above = abs(dot(away, eye.right)) / across, abs(dot(away, eye.up)) / along
        if (
            eye.near - radius < ahead < eye.far + radius
            and aside - across * ahead < radius * np.sqrt(1 + across**2)
            and above - along * ahead < radius * np.sqrt(1 + along**2)
        ):
            seen[size] = n
            size += 1
            triangles += meshes.first[bodies.mesh[n] + 1] - meshes.first[bodies.mesh[n]]
    return seen[:size], triangles


@kernel
def _place_triangle(t: int, n: int, eye: Eye, bodies: Bodies, meshes: Meshes, corners: Array) -> None:
    """Stores the corners of triangle t of solid n: right and up over the picture's half extents, and ahead (3, 3)."""
    half, frame = bodies.half_sizes[n], bodies.frames[n]
    for i in range(3):
        x, y, z = (
            half[0] * meshes.corners[t, i, 0],
            half[1] * meshes.corners[t, i, 1],
            half[2] * meshes.corners[t, i, 2],
        )
        away = (
            frame[0, 0] * x + frame[0, 1] * y + frame[0, 2] * z + frame[0, 3] - eye.place[0],
            frame[1, 0] * x + frame[1, 1] * y + frame[1, 2] * z + frame[1, 3] - eye.place[1],
            frame[2, 0] * x + frame[2, 1] * y + frame[2, 2] * z + frame[2, 3] - eye.place[2],
        )
        corners[i, 0] = dot(away, eye.right) / dot(eye.right, eye.right)
        corners[i, 1] = dot(away, eye.up) / dot(eye.up, eye.up)
        corners[i, 2] = dot(away, eye.ahead)


@kernel
def _edges_of(corners: Array, h: int, w: int, edges: Array) -> float:
    """Computes the three linear functions of a triangle.

    Function i is the weight of corner i, in barycentric coordinates, over the distance ahead.

    Args:
        corners: See `_place_triangle`.
        h: Height of the picture [pixels].
        w: Width of the picture [pixels].
        edges: Receives the factors of column, of row, and 1 (3, 3).

    Returns:
        Above 0 if the camera is on the side from which the corners are counter-clockwise, below 0 on the other; 0 if
        it sees the triangle edge on.
    """
    facing = 0.0
    for i in range(3):
        a, b = corners[(i + 1) % 3], corners[(i + 2) % 3]
        u, v, one = a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
        edges[i, 0], edges[i, 1] = 2 * u / w, -2 * v / h
        edges[i, 2] = one + u * (1 / w - 1) + v * (1 - 1 / h)
        facing = corners[i, 0] * u + corners[i, 1] * v + corners[i, 2] * one
    if abs(facing) < 1e-12:
        return 0.0
    for i in range(3):
        for j in range(3):
            edges[i, j] /= facing
    return facing


@kernel
def _light_at(t: int, i: int, n: int, facing: float, bodies: Bodies, meshes: Meshes) -> float:
    """Computes the light at corner i of triangle t of solid n, on the side that is seen."""
    half, frame = bodies.half_sizes[n], bodies.frames[n]
    x, y, z = (
        meshes.normals[t, i, 0] / half[0],
        meshes.normals[t, i, 1] / half[1],
        meshes.normals[t, i, 2] / half[2],
    )
    normal = (
        frame[0, 0] * x + frame[0, 1] * y + frame[0, 2] * z,
        frame[1, 0] * x + frame[1, 1] * y + frame[1, 2] * z,
        frame[2, 0] * x + frame[2, 1] * y + frame[2, 2] * z,
    )
    scale = np.sign(facing) / max(np.sqrt(dot(normal, normal)), 1e-12)
    return float(EVERYWHERE + FROM_SKY * scale * normal[2] + FROM_SUN * max(scale * dot(normal, TO_SUN), 0.0))


@kernel
def _fill(
    number: int,
    corners: Array,
    edges: Array,
    nearness: Array,
    near: float,
    far: float,
    depths: NDArray[np.float32],
    drawn: NDArray[np.int32],
) -> None:
    """Stores the depths and the number of a triangle in the pixels where it is nearest.

    Args:
        number: Number of the triangle.
        corners: See `_place_triangle`.
        edges: See `_edges_of`.
        nearness: Sum of the edges: 1 over the distance ahead, as factors of column, of row, and 1 (3,).
        near: Near clipping distance [m].
        far: Far clipping distance [m].
        depths: OpenGL's depths (h, w).
        drawn: Numbers of the triangles (h, w).
    """
    h, w = depths.shape
    top, bottom = 0, h - 1
    if min(corners[0, 2], corners[1, 2], corners[2, 2]) > near / 2:
        a, b, c = corners[0, 1] / corners[0, 2], corners[1, 1] / corners[1, 2], corners[2, 1] / corners[2, 2]
        top = int(min(max((1 - max(a, b, c)) * h / 2 - 1, 0), h))
        bottom = int(min(max((1 - min(a, b, c)) * h / 2 + 1, -1), h - 1))
    base, scale = far / (far - near), -near * far / (far - near)
    for row in range(top, bottom + 1):
        low, high = 0.0, w - 1.0
        for i in range(4):  # three edges, and the near clipping distance
            if i < 3:
                slope, value = edges[i, 0], edges[i, 1] * row + edges[i, 2]
            else:
                slope, value = -nearness[0], 1 / near - nearness[1] * row - nearness[2]
            low, high = clipped(low, high, slope, value)
        rate, start = scale * nearness[0], base + scale * (nearness[1] * row + nearness[2])
        for column in range(int(np.ceil(low - ROUNDING)), int(np.floor(high + ROUNDING)) + 1):
            depth = np.float32(start + rate * column)
            if depth < depths[row, column]:
                depths[row, column] = depth
                drawn[row, column] = number


@kernel
def _resolved(
    eye: Eye, nearness: Array, light: Array, inks: Bytes, depths: NDArray[np.float32], drawn: NDArray[np.int32]
) -> tuple[Bytes, NDArray[np.float32]]:
    """Finds the colour and the light in each pixel from the number of its triangle."""
    h, w = depths.shape
    colours, shines = np.empty((h, w, 3), np.uint8), np.ones((h, w), np.float32)
    for row in range(h):
        rise = eye.ahead[2] + (1.0 - (2 * row + 1) / h) * eye.up[2]
        for column in range(w):
            if depths[row, column] < 1.0:
                k = drawn[row, column]
                distance = 1 / (nearness[k, 0] * column + nearness[k, 1] * row + nearness[k, 2])
                shine = distance * (light[k, 0] * column + light[k, 1] * row + light[k, 2])
                height = eye.place[2] + distance * rise
                shines[row, column] = shine * (1 - DIM * (1 - min(max(height / DIM_BELOW, 0.0), 1.0)))
                for i in range(3):
                    colours[row, column, i] = inks[k, i]
    return colours, shines
