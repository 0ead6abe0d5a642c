"""Draws the solid bodies of a recording (boxes, walls, the vehicle) without ground and light."""

from dataclasses import dataclass, field
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.colours import SOLID_BOX, SOLID_MOVING, SOLID_WALL, Colour, unit_rgb
from nnql_bullet.geometry import Circle, OrientedBox
from nnql_bullet.recording import Recording
from nnql_bullet.render.camera import Camera
from nnql_bullet.render.timeline import Moment
from nnql_bullet.sim.scene_trial import SceneKind
from nnql_bullet.vehicle.visuals import recorded_urdf

BOX: Colour = unit_rgb(SOLID_BOX)
WALL: Colour = unit_rgb(SOLID_WALL)
MOVING: Colour = unit_rgb(SOLID_MOVING)


@dataclass(frozen=True, slots=True)
class Solids:
    """Picture of the solid bodies that a camera sees."""

    colours: NDArray[np.uint8]
    """(height, width, 3 or 4)"""
    depths: NDArray[np.float32]
    """OpenGL's depths (height, width); 1 in empty pixels."""
    gain: float
    """Factor on the colours."""
    light: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 0), np.float32))
    """Light on the surface or ground in each pixel, over that on open ground (height, width); (0, 0) if the renderer
    does not compute it."""


class Renderer(Protocol):
    """Draws solid bodies."""

    lights: bool
    """Whether it computes light and shadows."""
    samples: int
    """Number of pixels that it draws for each pixel of the picture, along each side."""

    def draw(self, moment: Moment, camera: Camera) -> Solids:
        """Draws the camera's picture at a moment."""

    def close(self) -> None:
        """Frees its resources."""


class BulletRenderer:
    """Draws a recording with PyBullet's own renderers or in its window."""

    lights = False
    samples = 1

    def __init__(self, recording: Recording, kind: SceneKind) -> None:
        """Builds the scene.

        Args:
            recording: Recording of the drive.
            kind: See `BulletScene`.

        Raises:
            UserError: If the recording has no shapes of the vehicle, or the renderer does not work on this machine.
        """
        from nnql_bullet.sim.bullet_scene import BulletScene  # here because other renderers need no PyBullet

        vehicle = recording.about["vehicle"]
        with TemporaryDirectory(prefix="nnql-bullet-") as folder:
            urdf = recorded_urdf(vehicle, Path(folder))
            self.scene = BulletScene(kind)
            self._add_world(recording)
            self._vehicle, joints = self.scene.add_robot(urdf)
        self._joints = [joints[name] for name in vehicle["joints"].values()]
        self._axle_height = vehicle["wheel_radius"]

    def show(self, moment: Moment) -> None:
        """Moves all bodies to their positions at a moment."""
        pose = moment.pose
        rise, roll, pitch = moment.tilt
        self.scene.place(self._vehicle, pose.x, pose.y, self._axle_height + rise, pose.yaw, roll, pitch)
        for joint, angle in zip(self._joints, moment.joint_angles, strict=True):
            self.scene.turn(self._vehicle, joint, angle)
        for body, box in zip(self._movers, moment.movers, strict=True):
            self.scene.place(body, box.x, box.y, self._height / 2, box.yaw)

    def draw(self, moment: Moment, camera: Camera) -> Solids:
        """Draws the camera's picture at a moment."""
        self.show(moment)
        return Solids(*self.scene.picture(camera.view, camera.projection, camera.width, camera.height))

    def close(self) -> None:
        """Frees the engine."""
        self.scene.close()

    def _add_world(self, recording: Recording) -> None:
        world = recording.world
        self._height = world.obstacle_height
        for its in world.obstacles:
            if isinstance(its, Circle):
                pole = self.scene.add_disc(its.radius, self._height / 2, BOX)
                self.scene.place(pole, its.x, its.y, self._height / 2, 0.0)
            else:
                self._add_box(its, BOX)
        for wall in world.walls:
            self._add_box(wall, WALL)
        self._movers = [self._add_box(patrol.box, MOVING) for patrol in world.patrols]

    def _add_box(self, box: OrientedBox, colour: Colour) -> int:
        body = self.scene.add_box((box.half_length, box.half_width, self._height / 2), colour)
        self.scene.place(body, box.x, box.y, self._height / 2, box.yaw)
        return body
