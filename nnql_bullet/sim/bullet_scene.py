"""Things that are only looked at: PyBullet's renderers and its window, without any physics."""

import importlib.util
import multiprocessing
import os
from functools import cache
from math import asin, atan2, cos, degrees, sin
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Literal
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array
from nnql_bullet.sim.bullet import bullet, silenced
from nnql_bullet.sim.bullet_state import DynamicsInfo, JointInfo
from nnql_bullet.types import Vector

SceneKind = Literal["tiny", "egl", "window"]

NO_EGL = "EGL does not work here; choose the renderer 'tiny', or install EGL (Debian: libegl1)"
NOTHING = 1 - 1e-6
"""Depth from which on there is nothing: TinyRenderer's is 1 but for rounding."""

Colour = tuple[float, float, float]
"""Red, green, blue, from 0 to 1."""


class BulletScene:
    """Boxes and a vehicle, drawn unlit: what comes back are the colours that things were given.

    The renderers of PyBullet light things differently, EGL large ones wrongly; colours and depths are what they agree
    on.
    """

    def __init__(self, kind: SceneKind) -> None:
        """Starts a renderer.

        Args:
            kind: TinyRenderer, which works everywhere; EGL, which is quicker; or a window.

        Raises:
            UserError: If it does not work here.
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

    def close(self) -> None:
        """Frees it."""
        with silenced():
            if bullet.isConnected(self.client):
                bullet.disconnect(self.client)

    def add_box(self, half_extents: tuple[float, float, float], colour: Colour) -> int:
        """A box; the engine's number of it."""
        shape = bullet.createVisualShape(
            bullet.GEOM_BOX, halfExtents=half_extents, rgbaColor=(*colour, 1.0), physicsClientId=self.client
        )
        return int(bullet.createMultiBody(0.0, -1, shape, physicsClientId=self.client))

    def add_disc(self, radius: float, half_height: float, colour: Colour) -> int:
        """An upright cylinder; the engine's number of it."""
        shape = bullet.createVisualShape(
            bullet.GEOM_CYLINDER,
            radius=radius,
            length=2 * half_height,
            rgbaColor=(*colour, 1.0),
            physicsClientId=self.client,
        )
        return int(bullet.createMultiBody(0.0, -1, shape, physicsClientId=self.client))

    def add_robot(self, urdf: str) -> tuple[int, dict[str, int]]:
        """What the text of a URDF looks like; the engine's number of it, and those of its joints by their names."""
        with TemporaryDirectory(prefix="nnql-bullet-") as folder:
            file = Path(folder) / "robot.urdf"
            file.write_text(_one_look_a_link(urdf) if self._kind == "window" else urdf, encoding="utf-8")
            with silenced():  # it complains of links without a mass
                body = bullet.loadURDF(str(file), useFixedBase=True, physicsClientId=self.client)
        joints = range(bullet.getNumJoints(body, self.client))
        infos = [JointInfo(*bullet.getJointInfo(body, joint, self.client)) for joint in joints]
        return body, {info.name: info.number for info in infos}

    def place(self, body: int, x: float, y: float, z: float, yaw: float) -> None:
        """Puts the origin of something somewhere [m, rad]."""
        # The engine places centres of mass.
        ahead, left, up = DynamicsInfo(*bullet.getDynamicsInfo(body, -1, self.client)).inertia_position
        c, s = cos(yaw), sin(yaw)
        centre = (x + c * ahead - s * left, y + s * ahead + c * left, z + up)
        turned = (0.0, 0.0, sin(yaw / 2), cos(yaw / 2))
        bullet.resetBasePositionAndOrientation(body, centre, turned, self.client)

    def turn(self, body: int, joint: int, angle: float) -> None:
        """Turns a joint to an angle [rad]."""
        bullet.resetJointState(body, joint, angle, physicsClientId=self.client)

    def picture(
        self, view: Array, projection: Array, width: int, height: int
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32], float]:
        """What a camera sees.

        Args:
            view: OpenGL's view matrix (4, 4).
            projection: OpenGL's projection matrix (4, 4).
            width: In pixels.
            height: In pixels.

        Returns:
            Colours (height, width, 4), OpenGL's depths (height, width), which are 1 where nothing is, and what the
            colours have to be multiplied by to be those that things were given.
        """
        egl = self._kind == "egl"
        # Without a direction, EGL's light is the same everywhere, and half of what it should be.
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
        shape = (height, width)
        there = np.where(np.reshape(depths, shape) < NOTHING, np.reshape(depths, shape), np.float32(1.0))
        return np.reshape(colours, (*shape, 4)), there, 2.0 if egl else 1.0

    def show(self, on: bool) -> None:
        """Whether the window draws; at first it does not, which makes building the scene quicker."""
        bullet.configureDebugVisualizer(bullet.COV_ENABLE_RENDERING, int(on), physicsClientId=self.client)

    @property
    def is_open(self) -> bool:
        """Whether the window has not been closed."""
        return bool(bullet.isConnected(self.client))

    def look(self, eye: Vector, target: Vector) -> None:
        """Moves the window's camera [m]."""
        ahead = np.subtract(target, eye)
        distance = float(np.linalg.norm(ahead))
        yaw, pitch = atan2(ahead[1], ahead[0]), asin(ahead[2] / distance)
        bullet.resetDebugVisualizerCamera(distance, degrees(yaw) - 90.0, degrees(pitch), target, self.client)


@cache
def works(kind: SceneKind, patience: float = 60.0) -> bool:
    """Whether a renderer draws something here. It is tried in a process of its own, which a bad policy may end.

    Args:
        kind: See `BulletScene`.
        patience: How long it may take [s].
    """
    process = multiprocessing.get_context("spawn").Process(target=_draw_something, args=(kind,))
    process.start()
    process.join(patience)
    if process.is_alive():
        process.kill()
        process.join()
    return process.exitcode == 0


def _draw_something(kind: SceneKind) -> None:
    for stream in (1, 2):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream)  # whether it fails is told by the exit code
    scene = BulletScene(kind)
    scene.add_box((0.5, 0.5, 0.5), (1.0, 0.0, 0.0))
    ahead = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -3], [0, 0, 0, 1]])
    lens = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1.2, -2.2], [0, 0, -1, 0]])
    if np.ptp(scene.picture(ahead, lens, 32, 32)[1]) == 0:
        raise RuntimeError("the picture is empty")


def _load_egl(client: int) -> bool:
    os.environ.setdefault("LP_NUM_THREADS", "1")  # Mesa's software renderer: pictures are drawn in several processes
    found = importlib.util.find_spec("eglRenderer")
    return found is not None and bullet.loadPlugin(found.origin, "_eglRendererPlugin", physicsClientId=client) >= 0


def _one_look_a_link(urdf: str) -> str:
    """The same robot with a link for every visual shape: the window gives all shapes of a link one colour."""
    robot = ElementTree.fromstring(urdf)
    for link in robot.findall("link"):
        for number, visual in enumerate(link.findall("visual")[1:]):
            name = f"{link.attrib['name']}_{number}"
            link.remove(visual)
            ElementTree.SubElement(robot, "link", name=name).append(visual)
            joint = ElementTree.SubElement(robot, "joint", name=name, type="fixed")
            ElementTree.SubElement(joint, "parent", link=link.attrib["name"])
            ElementTree.SubElement(joint, "child", link=name)
    return ElementTree.tostring(robot, encoding="unicode")
