"""What a vehicle looks like: the boxes, cylinders and spheres of its URDF, and where they are when its joints turn."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Literal

import numpy as np

from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array, Pose

Kind = Literal["box", "cylinder", "sphere"]
Colour = tuple[float, float, float]
"""Red, green, blue, from 0 to 1."""

UNPAINTED: Colour = (0.8, 0.8, 0.8)


@dataclass(frozen=True)
class Shape:
    """A solid of one colour, about its middle; a cylinder stands along z."""

    link: str
    kind: Kind
    half_sizes: tuple[float, float, float]
    """Along x, y and z [m]."""
    origin: Array
    """From its own frame to that of its link (4, 4)."""
    colour: Colour


class Looks:
    """A vehicle's shapes, link by link."""

    def __init__(self, vehicle: Mapping[str, Any]) -> None:
        """Reads them.

        Args:
            vehicle: What a recording says about it.

        Raises:
            UserError: If it does not say what the vehicle looks like, or some of it is a mesh.
        """
        if "urdf" not in vehicle:
            raise UserError(
                "this recording does not say what the vehicle looks like; record it again with: nnql-bullet drive"
            )
        import yourdfpy  # 70 MB

        with TemporaryDirectory(prefix="nnql-bullet-") as folder:
            path = Path(folder) / "vehicle.urdf"
            path.write_text(vehicle["urdf"], encoding="utf-8")
            self._urdf: Any = yourdfpy.URDF.load(str(path), load_meshes=False, load_collision_meshes=False)
        paints = {material.name: material.color for material in self._urdf.robot.materials}
        links = self._urdf.link_map.values()
        self.shapes = [_shape(link.name, visual, paints) for link in links for visual in link.visuals]
        self._joints = [vehicle["joints"][key] for key in ("left_drive", "right_drive", "swivel", "caster_roll")]
        self._axle_height = vehicle["wheel_radius"]

    def link_frames(self, joint_angles: Sequence[float]) -> dict[str, Array]:
        """From each link's frame to that of the chassis (4, 4).

        Args:
            joint_angles: Left drive, right drive, swivel, caster roll [rad].
        """
        self._urdf.update_cfg(dict(zip(self._joints, joint_angles, strict=True)))
        return {link: self._urdf.get_transform(link) for link in self._urdf.link_map}

    def frames(self, pose: Pose, joint_angles: Sequence[float]) -> list[Array]:
        """From the frame of each of the shapes to the world (4, 4), on level ground."""
        links = self.link_frames(joint_angles)
        chassis = upright(pose.x, pose.y, self._axle_height, pose.yaw)
        return [chassis @ links[shape.link] @ shape.origin for shape in self.shapes]


def upright(x: float, y: float, z: float, yaw: float) -> Array:
    """From a frame at a place [m], turned [rad] but not tilted, to the world (4, 4)."""
    frame = np.eye(4)
    frame[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    frame[:3, 3] = x, y, z
    return frame


def _shape(link: str, visual: Any, paints: Mapping[str, Any]) -> Shape:
    geometry, material = visual.geometry, visual.material
    kind: Kind
    if geometry.box is not None:
        kind, sizes = "box", geometry.box.size / 2
    elif geometry.cylinder is not None:
        radius = geometry.cylinder.radius
        kind, sizes = "cylinder", (radius, radius, geometry.cylinder.length / 2)
    elif geometry.sphere is not None:
        kind, sizes = "sphere", [geometry.sphere.radius] * 3
    else:
        raise UserError(f"link '{link}' of the vehicle looks like a mesh; only boxes, cylinders and spheres are drawn")
    paint = None if material is None else material.color or paints.get(material.name)
    x, y, z = map(float, sizes)
    red, green, blue = UNPAINTED if paint is None else map(float, paint.rgba[:3])
    return Shape(link, kind, (x, y, z), np.eye(4) if visual.origin is None else visual.origin, (red, green, blue))
