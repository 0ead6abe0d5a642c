"""PyBullet's window, which shows boxes and a vehicle without physics."""

import weakref
from math import asin, atan2, degrees
from xml.etree import ElementTree

import numpy as np

from nnql_bullet.colours import Colour
from nnql_bullet.errors import UserError
from nnql_bullet.sim.bullet import bullet, load_text
from nnql_bullet.sim.bullet_state import DynamicsInfo, JointInfo
from nnql_bullet.sim.c_library import decimal_points, silenced
from nnql_bullet.types import Vector
from nnql_bullet.vehicle.description import parse, text_of


class BulletScene:
    """Boxes and a vehicle in a window."""

    def __init__(self) -> None:
        """Opens the window, which `scene_trial` has tried.

        Raises:
            UserError: If this process holds too many.
        """
        with silenced():
            self.client = bullet.connect(bullet.GUI)
            if self.client < 0:
                raise UserError("PyBullet gives no more scenes in this process; close some first")
            bullet.configureDebugVisualizer(bullet.COV_ENABLE_GUI, 0, physicsClientId=self.client)
            self.show(False)
        self._free = weakref.finalize(self, _disconnect, self.client)

    def close(self) -> None:
        """Closes the window."""
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
        # PyBullet warns of links without a mass. The window's own thread reads the text.
        with silenced(), decimal_points(every_thread=True):
            body = load_text(_one_visual_per_link(urdf), self.client, useFixedBase=True)
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
