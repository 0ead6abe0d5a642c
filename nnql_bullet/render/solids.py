"""Solid things of a recording as a renderer draws them: boxes, walls and the vehicle, without ground and light."""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.colours import SOLID_BOX, SOLID_MOVING, SOLID_WALL, unit_rgb
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import OrientedBox
from nnql_bullet.recording import Recording
from nnql_bullet.render.camera import Camera
from nnql_bullet.render.timeline import Moment
from nnql_bullet.sim.bullet_scene import BulletScene, Colour, SceneKind

BOX: Colour = unit_rgb(SOLID_BOX)
WALL: Colour = unit_rgb(SOLID_WALL)
MOVING: Colour = unit_rgb(SOLID_MOVING)


@dataclass(frozen=True, slots=True)
class Solids:
    """What a camera sees of them."""

    colours: NDArray[np.uint8]
    """(height, width, 3 or 4)"""
    depths: NDArray[np.float32]
    """OpenGL's (height, width): 1 where nothing is."""
    gain: float
    """What the colours are to be multiplied by."""
    light: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 0), np.float32))
    """What falls in each pixel on surface or ground, as a share of what falls on open ground (height, width); (0, 0) of
    a renderer that does not say."""


class Renderer(Protocol):
    """Draws solid things."""

    lights: bool
    """Whether it says what light falls where, shadows and all."""
    samples: int
    """How many pixels it wants to draw for one of the picture, along either side."""

    def draw(self, moment: Moment, camera: Camera) -> Solids:
        """What the camera sees at an instant."""

    def close(self) -> None:
        """Frees it."""


class BulletRenderer:
    """PyBullet's own renderers, and its window: a `scene` with what a recording says."""

    lights = False
    samples = 1

    def __init__(self, recording: Recording, kind: SceneKind) -> None:
        """Builds the scene.

        Args:
            recording: Says what there is.
            kind: See `BulletScene`.

        Raises:
            UserError: If the recording does not say what the vehicle looks like, or the renderer does not work here.
        """
        vehicle = recording.about["vehicle"]
        if "urdf" not in vehicle:
            raise UserError(
                "this recording does not say what the vehicle looks like; record it again with: nnql-bullet drive"
            )
        self.scene = BulletScene(kind)
        world = recording.world
        self._height = world.obstacle_height
        for box in world.obstacles:
            self._add_box(box, BOX)
        for wall in world.walls:
            self._add_box(wall, WALL)
        self._movers = [self._add_box(patrol.box, MOVING) for patrol in world.patrols]
        self._vehicle, joints = self.scene.add_robot(vehicle["urdf"])
        names = vehicle["joints"]
        self._joints = [joints[names[key]] for key in ("left_drive", "right_drive", "swivel", "caster_roll")]
        self._axle_height = vehicle["wheel_radius"]

    def show(self, moment: Moment) -> None:
        """Puts everything where it is at an instant."""
        pose = moment.pose
        self.scene.place(self._vehicle, pose.x, pose.y, self._axle_height, pose.yaw)
        for joint, angle in zip(self._joints, moment.joint_angles, strict=True):
            self.scene.turn(self._vehicle, joint, angle)
        for body, box in zip(self._movers, moment.movers, strict=True):
            self.scene.place(body, box.x, box.y, self._height / 2, box.yaw)

    def draw(self, moment: Moment, camera: Camera) -> Solids:
        """What the camera sees at an instant."""
        self.show(moment)
        return Solids(*self.scene.picture(camera.view, camera.projection, camera.width, camera.height))

    def close(self) -> None:
        """Frees the engine."""
        self.scene.close()

    def _add_box(self, box: OrientedBox, colour: Colour) -> int:
        body = self.scene.add_box((box.half_length, box.half_width, self._height / 2), colour)
        self.scene.place(body, box.x, box.y, self._height / 2, box.yaw)
        return body
