"""The visible shapes of a vehicle's URDF and their frames at given joint angles."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal
from xml.etree.ElementTree import Element

import numpy as np

from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array, Pose
from nnql_bullet.types import Vector
from nnql_bullet.vehicle.description import Unfit, for_drawing, parse, rotation
from nnql_bullet.vehicle.shapes import read_mesh

Kind = Literal["box", "cylinder", "sphere", "mesh"]
Colour = tuple[float, float, float]
"""Red, green, blue, from 0 to 1."""

MOST_TRIANGLES = 20_000
"""Most triangles of a mesh that are drawn one by one."""
UNPAINTED: Colour = (0.8, 0.8, 0.8)


@dataclass(frozen=True)
class Shape:
    """A solid of one colour, centred in its own frame; the axis of a cylinder is z."""

    link: str
    kind: Kind
    half_sizes: tuple[float, float, float]
    """Half extents along x, y and z [m]."""
    origin: Array
    """Transform from its own frame to its link's frame (4, 4)."""
    colour: Colour
    triangles: Array = field(default_factory=lambda: np.zeros((0, 3, 3)))
    """Corners of a mesh's triangles (k, 3, 3) [m]; (0, 3, 3) of other solids."""


class Visuals:
    """The visible shapes of a vehicle, link by link."""

    def __init__(self, vehicle: Mapping[str, Any]) -> None:
        """Reads the shapes from the URDF in a recording.

        Args:
            vehicle: The recording's entry `vehicle`.

        Raises:
            UserError: If the entry has no URDF, or one that cannot be read.
        """
        import yourdfpy  # here because few programs need its memory

        with TemporaryDirectory(prefix="nnql-bullet-") as folder:
            text = BytesIO(recorded_urdf(vehicle, Path(folder)).encode())
            try:
                self._urdf: Any = yourdfpy.URDF.load(text, load_meshes=False, load_collision_meshes=False)
            except Exception as error:  # yourdfpy passes on all errors of its parsers
                reason = " ".join(f"{type(error).__name__}: {error}".split())
                raise UserError(f"the vehicle in this recording cannot be drawn ({reason}); record it again") from None
            paints = {material.name: material.color for material in self._urdf.robot.materials}
            links = self._urdf.link_map.values()
            self.shapes = [_shape(link.name, visual, paints) for link in links for visual in link.visuals]
        self._joints = list(vehicle["joints"].values())
        self._axle_height = vehicle["wheel_radius"]

    def link_frames(self, joint_angles: Sequence[float]) -> dict[str, Array]:
        """Computes the transforms from each link's frame to the chassis frame (4, 4), by link.

        Args:
            joint_angles: Angles of the joints of the recording's vehicle, in its order [rad].
        """
        self._urdf.update_cfg(dict(zip(self._joints, joint_angles, strict=True)))
        return {link: self._urdf.get_transform(link) for link in self._urdf.link_map}

    def frames(self, pose: Pose, joint_angles: Sequence[float], tilt: Vector = (0.0, 0.0, 0.0)) -> list[Array]:
        """Computes the transforms from the frame of each shape to the world (4, 4).

        Args:
            pose: Pose of the vehicle.
            joint_angles: See `link_frames`.
            tilt: Rise above level ground [m], roll and pitch [rad].
        """
        links, (rise, roll, pitch) = self.link_frames(joint_angles), tilt
        chassis = upright(pose.x, pose.y, self._axle_height + rise, pose.yaw)
        chassis[:3, :3] = rotation(roll, pitch, pose.yaw)
        return [chassis @ links[shape.link] @ shape.origin for shape in self.shapes]


def recorded_urdf(vehicle: Mapping[str, Any], meshes: Path | None = None) -> str:
    """Returns the text to draw of the URDF in a recording's entry `vehicle`; see `description.for_drawing`.

    Args:
        vehicle: The recording's entry.
        meshes: Folder for the meshes that it looks like, which are written anew, as bare triangles; without it the
            collision shapes are drawn.

    Raises:
        UserError: If the entry has none, or one that cannot be read.
    """
    if "urdf" not in vehicle:
        raise UserError("this recording has no shapes of the vehicle; record it again with: nnql-bullet drive")
    try:
        robot = parse(str(vehicle["urdf"]))
        return for_drawing(robot) if meshes is None else for_drawing(robot, lambda mesh: _rewritten(mesh, meshes))
    except Unfit as error:
        raise UserError(f"the vehicle in this recording {error}; record it again with: nnql-bullet drive") from None


def _rewritten(mesh: Element, folder: Path) -> Path | None:
    """Writes a mesh that is found as an OBJ, scaled; one of very many triangles as its convex hull."""
    path = Path(mesh.get("filename", ""))
    found = read_mesh(path) if path.is_absolute() else None
    if found is None:
        return None
    try:
        drawn = found if len(found.faces) <= MOST_TRIANGLES else found.convex_hull
        drawn.apply_scale([float(factor) for factor in mesh.get("scale", "1 1 1").split()])
        file = folder / f"{len(list(folder.iterdir()))}.obj"
        drawn.export(file)
    except Exception:  # trimesh passes on all errors of its writers
        return None
    return file


def upright(x: float, y: float, z: float, yaw: float) -> Array:
    """Makes the transform (4, 4) to the world from a frame at a position [m], rotated about z by a yaw [rad]."""
    frame = np.eye(4)
    frame[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    frame[:3, 3] = x, y, z
    return frame


def _shape(link: str, visual: Any, paints: Mapping[str, Any]) -> Shape:
    geometry, material = visual.geometry, visual.material
    kind: Kind
    origin = np.eye(4) if visual.origin is None else np.array(visual.origin)
    triangles = np.zeros((0, 3, 3))
    if geometry.box is not None:
        kind, sizes = "box", geometry.box.size / 2
    elif geometry.cylinder is not None:
        radius = geometry.cylinder.radius
        kind, sizes = "cylinder", (radius, radius, geometry.cylinder.length / 2)
    elif geometry.sphere is not None:
        kind, sizes = "sphere", [geometry.sphere.radius] * 3
    else:
        kind, triangles = "mesh", np.asarray(read_mesh(Path(geometry.mesh.filename)).triangles)
        low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
        sizes, middle = (high - low) / 2, (high + low) / 2
        origin[:3, 3] += origin[:3, :3] @ middle
        triangles = triangles - middle
    paint = None if material is None else material.color or paints.get(material.name)
    x, y, z = map(float, sizes)
    red, green, blue = UNPAINTED if paint is None else map(float, paint.rgba[:3])
    return Shape(link, kind, (x, y, z), origin, (red, green, blue), triangles)
