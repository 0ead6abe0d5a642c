"""PyBullet's renderers and its window, which show boxes and a vehicle without physics."""

import importlib.util
import weakref
from math import asin, atan2, degrees
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.colours import Colour
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array
from nnql_bullet.machine import one_thread_for_mesa
from nnql_bullet.sim.bullet import bullet, load_text
from nnql_bullet.sim.bullet_state import DynamicsInfo, JointInfo
from nnql_bullet.sim.c_library import decimal_points, silenced
from nnql_bullet.sim.scene_trial import NO_EGL, SceneKind
from nnql_bullet.types import Vector
from nnql_bullet.vehicle.description import parse, text_of

EMPTY_DEPTH = 1 - 1e-6
"""Smallest depth of an empty pixel; TinyRenderer's is 1 up to rounding."""


class BulletScene:
    """Boxes and a vehicle, drawn without light: pixels have the objects' own colours.

    PyBullet's renderers light objects differently, and EGL lights large ones wrongly; they agree on colours and depths.
    """

    def __init__(self, kind: SceneKind) -> None:
        """Starts a renderer.

        Args:
            kind: See `SceneKind`.

        Raises:
            UserError: If the renderer does not work on this machine.
        """
        self._kind = kind
        with silenced():
            self.client = bullet.connect(bullet.GUI if kind == "window" else bullet.DIRECT)
            if self.client < 0:
                raise UserError("PyBullet gives no more scenes in this process; close some first")
            if kind == "window":
                bullet.configureDebugVisualizer(bullet.COV_ENABLE_GUI, 0, physicsClientId=self.client)
                self.show(False)
            if kind == "egl" and not _load_egl(self.client):
                bullet.disconnect(self.client)
                raise UserError(NO_EGL)
        self._free = weakref.finalize(self, _disconnect, self.client)  # or at the end of the process, where EGL prints

    def close(self) -> None:
        """Frees the renderer."""
        self._free()

    def add_box(self, half_extents: tuple[float, float, float], colour: Colour) -> int:
        """Adds a box; returns the engine's number of it."""
        shape = bullet.createVisualShape(
            bullet.GEOM_BOX, halfExtents=half_extents, rgbaColor=(*colour, 1.0), physicsClientId=self.client
        )
        return int(bullet.createMultiBody(0.0, -1, shape, physicsClientId=self.client))

    def add_disc(self, radius: float, half_height: float, colour: Colour) -> int:
        """Adds an upright cylinder; returns the engine's number of it."""
        shape = bullet.createVisualShape(
            bullet.GEOM_CYLINDER,
            radius=radius,
            length=2 * half_height,
            rgbaColor=(*colour, 1.0),
            physicsClientId=self.client,
        )
        return int(bullet.createMultiBody(0.0, -1, shape, physicsClientId=self.client))

    def add_robot(self, urdf: str) -> tuple[int, dict[str, int]]:
        """Adds the visible shapes of a URDF's text; returns the engine's number of it, and of its joints by name."""
        text = _one_visual_per_link(urdf) if self._kind == "window" else urdf
        # PyBullet warns of links without a mass. A window's own thread reads the text.
        with silenced(), decimal_points(every_thread=self._kind == "window"):
            body = load_text(text, self.client, useFixedBase=True)
        joints = range(bullet.getNumJoints(body, self.client))
        infos = [JointInfo(*bullet.getJointInfo(body, joint, self.client)) for joint in joints]
        return body, {info.name: info.number for info in infos}

    def place(self, body: int, x: float, y: float, z: float, yaw: float, roll: float = 0.0, pitch: float = 0.0) -> None:
        """Sets the position [m] of an object's origin, and its yaw, roll and pitch [rad]."""
        # The engine sets centres of mass and principal axes of inertia.
        inertial = DynamicsInfo(*bullet.getDynamicsInfo(body, -1, self.client))
        frame = (x, y, z), bullet.getQuaternionFromEuler((roll, pitch, yaw))
        centre = bullet.multiplyTransforms(*frame, inertial.inertia_position, inertial.inertia_orientation)
        bullet.resetBasePositionAndOrientation(body, *centre, self.client)

    def turn(self, body: int, joint: int, angle: float) -> None:
        """Turns a joint to an angle [rad]."""
        bullet.resetJointState(body, joint, angle, physicsClientId=self.client)

    def picture(
        self, view: Array, projection: Array, width: int, height: int
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32], float]:
        """Draws the picture of a camera.

        Args:
            view: OpenGL's view matrix (4, 4).
            projection: OpenGL's projection matrix (4, 4).
            width: Width [pixels].
            height: Height [pixels].

        Returns:
            Colours (height, width, 4); OpenGL's depths (height, width), 1 in empty pixels; and the factor that turns
            the colours into the objects' own.
        """
        egl = self._kind == "egl"
        # Without a direction, EGL's light is uniform and half as bright as it should be.
        light = {"lightDirection": (0.0, 0.0, 0.0)} if egl else {"lightAmbientCoeff": 1.0, "lightDiffuseCoeff": 0.0}
        with silenced():
            _, _, colours, depths, _ = bullet.getCameraImage(
                width,
                height,
                view.T.ravel().tolist(),
                projection.T.ravel().tolist(),
                shadow=0,
                lightSpecularCoeff=0.0,
                renderer=bullet.ER_BULLET_HARDWARE_OPENGL if egl else bullet.ER_TINY_RENDERER,
                flags=bullet.ER_NO_SEGMENTATION_MASK,
                physicsClientId=self.client,
                **light,
            )
        # Builds of PyBullet without NumPy give tuples.
        seen = np.asarray(depths, np.float32).reshape(height, width)
        cleared = np.where(seen < EMPTY_DEPTH, seen, np.float32(1.0))
        return np.asarray(colours, np.uint8).reshape(height, width, 4), cleared, 2.0 if egl else 1.0

    def show(self, on: bool) -> None:
        """Switches the window's drawing on or off; it starts off, because the scene is then built faster."""
        bullet.configureDebugVisualizer(bullet.COV_ENABLE_RENDERING, int(on), physicsClientId=self.client)

    @property
    def is_open(self) -> bool:
        """Whether the window is open."""
        return bool(bullet.isConnected(self.client))

    def look(self, eye: Vector, target: Vector) -> None:
        """Moves the window's camera [m]."""
        ahead = np.subtract(target, eye)
        distance = float(np.linalg.norm(ahead))
        yaw, pitch = atan2(ahead[1], ahead[0]), asin(ahead[2] / distance)
        bullet.resetDebugVisualizerCamera(distance, degrees(yaw) - 90.0, degrees(pitch), target, self.client)


def _disconnect(client: int) -> None:
    with silenced():
        if bullet.isConnected(client):
            bullet.disconnect(client)


def _load_egl(client: int) -> bool:
    found = importlib.util.find_spec("eglRenderer")
    with one_thread_for_mesa():
        return found is not None and bullet.loadPlugin(found.origin, "_eglRendererPlugin", physicsClientId=client) >= 0


def _one_visual_per_link(urdf: str) -> str:
    """Gives every visual shape its own link, because the window shows all shapes of a link in one colour."""
    robot = parse(urdf)
    for link in robot.findall("link"):
        for number, visual in enumerate(link.findall("visual")[1:]):
            name = f"{link.attrib['name']}_{number}"
            link.remove(visual)
            ElementTree.SubElement(robot, "link", name=name).append(visual)
            joint = ElementTree.SubElement(robot, "joint", name=name, type="fixed")
            ElementTree.SubElement(joint, "parent", link=link.attrib["name"])
            ElementTree.SubElement(joint, "child", link=name)
    return text_of(robot)
