"""Faults to be found: each an engine, or a vehicle file, that is wrong in one way, while what is expected is not."""

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from math import radians, sin
from typing import Any
from unittest.mock import patch
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
import pybullet

from nnql_bullet.fidelity.probe import Bench
from nnql_bullet.geometry import Array, Pose, Shape
from nnql_bullet.sim.bullet import GROUND, PHYSICS, WHEEL, BulletEngine, Physics
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.spec import WorldSpec

CHASSIS = "link[@name='chassis']/inertial"


@dataclass(frozen=True)
class Fault:
    """What is wrong: with the URDF, with what the engine is told of the vehicle, its settings, or its workings."""

    seen_by: tuple[str, ...]
    """Probes that must turn red."""
    urdf: Callable[[Element], None] | None = None
    vehicle: Callable[[VehicleSpec], VehicleSpec] = lambda vehicle: vehicle
    settings: Callable[[Physics], Physics] = lambda settings: settings
    made_by: type[BulletEngine] = BulletEngine


@dataclass(frozen=True)
class FaultyBench(Bench):
    """A bench that expects what is true of its vehicle, and whose simulators are at fault."""

    fault: Fault = Fault(())

    @contextmanager
    def open_engine(self, vehicle: VehicleSpec | None = None, **drive: float) -> Iterator[BulletEngine]:
        wrong = self.fault.vehicle(vehicle or self.vehicle)
        if self.fault.urdf:
            robot = ElementTree.fromstring(wrong.description)
            self.fault.urdf(robot)
            wrong = replace(wrong, description=ElementTree.tostring(robot, encoding="unicode"))
        settings = self.fault.settings(PHYSICS[self.physics])
        with closing(self.fault.made_by(wrong, DriveOptions(**drive), settings)) as made:
            yield made


# In the URDF


def scaled(path: str, attribute: str, factor: float) -> Callable[[Element], None]:
    """Multiplies the numbers of an attribute, wherever the path leads."""

    def edit(robot: Element) -> None:
        found = robot.findall(path)
        assert found
        for element in found:
            numbers = [factor * float(number) for number in element.attrib[attribute].split()]
            element.set(attribute, " ".join(map(repr, numbers)))

    return edit


def moved(path: str, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Callable[[Element], None]:
    """Moves an <origin>."""

    def edit(robot: Element) -> None:
        origin: Any = robot.find(path)
        at = np.add([float(number) for number in origin.attrib["xyz"].split()], (x, y, z))
        origin.set("xyz", " ".join(map(repr, at.tolist())))

    return edit


def wider_track(robot: Element) -> None:
    for joint in ("left_drive", "right_drive"):
        scaled(f"joint[@name='{joint}']/origin", "xyz", 1.02)(robot)


def larger_wheels(robot: Element) -> None:
    for link in ("left_wheel", "right_wheel"):
        scaled(f"link[@name='{link}']/collision/geometry/sphere", "radius", 1.02)(robot)


def harder_spin(robot: Element) -> None:
    for link in ("left_wheel", "right_wheel"):
        scaled(f"link[@name='{link}']/inertial/inertia", "iyy", 1.05)(robot)


larger_caster = scaled("link[@name='caster_wheel']/collision/geometry/sphere", "radius", 1.02)


def shorter_trail(robot: Element) -> None:
    moved("joint[@name='swivel']/origin", x=-0.01)(robot)
    moved("joint[@name='caster_roll']/origin", x=0.01)(robot)


def cylinders(robot: Element) -> None:
    for link in ("left_wheel", "right_wheel"):
        collision: Any = robot.find(f"link[@name='{link}']/collision")
        collision.find("origin").set("rpy", "1.57079633 0 0")
        geometry = collision.find("geometry")
        sphere = geometry.find("sphere")
        geometry.remove(sphere)
        geometry.append(Element("cylinder", radius=sphere.attrib["radius"], length="0.05"))


# In what the engine is told


def contact(**changes: float) -> Callable[[VehicleSpec], VehicleSpec]:
    """Multiplies friction by factors."""

    def change(vehicle: VehicleSpec) -> VehicleSpec:
        wrong = {name: factor * getattr(vehicle.contact, name) for name, factor in changes.items()}
        return replace(vehicle, contact=replace(vehicle.contact, **wrong))

    return change


def torque_times(factor: float) -> Callable[[VehicleSpec], VehicleSpec]:
    return lambda vehicle: replace(vehicle, wheel_torque=factor * vehicle.wheel_torque)


def swapped(vehicle: VehicleSpec) -> VehicleSpec:
    names = vehicle.joints
    return replace(vehicle, joints=names | {"left_drive": names["right_drive"], "right_drive": names["left_drive"]})


def sensor_moved(x: float, y: float, z: float) -> Callable[[VehicleSpec], VehicleSpec]:
    def change(vehicle: VehicleSpec) -> VehicleSpec:
        ahead, left, up = vehicle.sensor.position
        return replace(vehicle, sensor=replace(vehicle.sensor, position=(ahead + x, left + y, up + z)))

    return change


# In the engine


def loaded_with(flags: int) -> type[BulletEngine]:
    """The URDF is loaded with other flags."""

    class Loading(BulletEngine):
        def _add_vehicle(self, pose: Pose, speed: float, height: float) -> None:
            load = pybullet.loadURDF
            with patch.object(pybullet, "loadURDF", lambda *given, **named: load(*given, **(named | {"flags": flags}))):
                super()._add_vehicle(pose, speed, height)

    return Loading


def changed(*links: str, **dynamics: float) -> type[BulletEngine]:
    """Calls `changeDynamics` of links once more, after everything else."""

    class Changed(BulletEngine):
        def _add_vehicle(self, pose: Pose, speed: float, height: float) -> None:
            super()._add_vehicle(pose, speed, height)
            for name in links:
                link = {"base": -1, "left": self.left, "right": self.right, "caster": self._supports[2]}[name]
                pybullet.changeDynamics(self.body, link, **dynamics, physicsClientId=self.client)

    return Changed


def motor_left_on(joint: str) -> type[BulletEngine]:
    """The motor that a joint is loaded with still holds it."""

    class Holding(BulletEngine):
        def _hold(self, number: int, torque: float) -> None:
            name = pybullet.getJointInfo(self.body, number, self.client)[1].decode()
            if torque > 0 or name != joint:
                super()._hold(number, torque)

    return Holding


def solving_with(**parameters: float) -> type[BulletEngine]:
    """Calls `setPhysicsEngineParameter` once more."""

    class Solving(BulletEngine):
        def _set_solver(self) -> None:
            super()._set_solver()
            pybullet.setPhysicsEngineParameter(**parameters, physicsClientId=self.client)

    return Solving


def pulled_by(x: float, y: float, z: float) -> type[BulletEngine]:
    """Other gravity."""

    class Pulled(BulletEngine):
        def _build(self, world: WorldSpec, pose: Pose, speed: float, height: float, ground: bool) -> None:
            super()._build(world, pose, speed, height, ground)
            pybullet.setGravity(x, y, z, self.client)

    return Pulled


class SlipperyGround(BulletEngine):
    def _add_ground(self) -> None:
        change = pybullet.changeDynamics
        smooth = lambda body, link, **given: change(body, link, **(given | {"lateralFriction": 0.9}))  # noqa: E731
        with patch.object(pybullet, "changeDynamics", smooth):
            super()._add_ground()


class SelfSeeing(BulletEngine):
    """Rays without a mask, and wheels in a group that they meet."""

    def _add_vehicle(self, pose: Pose, speed: float, height: float) -> None:
        super()._add_vehicle(pose, speed, height)
        for wheel in self._supports:
            pybullet.setCollisionFilterGroupMask(self.body, wheel, WHEEL, GROUND | 1, self.client)

    def _cast(self, begins: Array, ends: Array) -> Array:
        hits = pybullet.rayTestBatch(begins, ends, physicsClientId=self.client)
        return np.array([hit[2] for hit in hits]) * 10.0


class ShortRays(BulletEngine):
    def _cast(self, begins: Array, ends: Array) -> Array:
        return super()._cast(begins, ends) * 0.999


class LateRays(BulletEngine):
    """Rays from where the vehicle was at the last look."""

    _last: tuple[Array, Array] | None = None

    def _cast(self, begins: Array, ends: Array) -> Array:
        before, self._last = self._last or (begins.copy(), ends.copy()), (begins.copy(), ends.copy())
        return super()._cast(*before)


class Bouncing(BulletEngine):
    def _build(self, world: WorldSpec, pose: Pose, speed: float, height: float, ground: bool) -> None:
        super()._build(world, pose, speed, height, ground)
        for number in range(pybullet.getNumBodies(self.client)):
            body = pybullet.getBodyUniqueId(number, self.client)
            pybullet.changeDynamics(body, -1, restitution=0.7071, physicsClientId=self.client)


class NoObstacles(BulletEngine):
    def _add_solids(self, solids: tuple[Shape, ...], height: float, group: int) -> None:
        del solids, height, group


class WearingTyres(BulletEngine):
    """What happened before leaks into what follows."""

    _placed = 0

    def _add_vehicle(self, pose: Pose, speed: float, height: float) -> None:
        super()._add_vehicle(pose, speed, height)
        self._placed += 1
        friction = self.vehicle.contact.wheel_friction * (1 - 1e-9 * self._placed)
        for wheel in (self.left, self.right):
            pybullet.changeDynamics(self.body, wheel, lateralFriction=friction, physicsClientId=self.client)


class DoubleForces(BulletEngine):
    def obstacle_force(self) -> float:
        return 2 * super().obstacle_force()


FAULTS = {
    "track 2 % wider": Fault(("five-actions", "steady-turn"), urdf=wider_track),
    "drive wheels 2 % larger": Fault(("settle", "acceleration", "coast", "straight"), urdf=larger_wheels),
    "caster wheel 2 % larger": Fault(("settle",), urdf=larger_caster),
    "trail 1 cm shorter": Fault(("caster", "reversing"), urdf=shorter_trail),
    "wheelbase 2 % longer": Fault(("settle", "steady-turn"), urdf=moved("joint[@name='swivel']/origin", x=0.014)),
    "mass 2 % larger": Fault(
        ("read-back", "settle", "acceleration", "wall"), urdf=scaled("link/inertial/mass", "value", 1.02)
    ),
    "chassis 2 % heavier after loading": Fault(
        ("read-back", "yaw-inertia"), made_by=changed("base", mass=104.5 * 1.02)
    ),
    "chassis turns 5 % harder": Fault(("read-back", "yaw-inertia"), urdf=scaled(f"{CHASSIS}/inertia", "izz", 1.05)),
    "wheels spin up 5 % harder": Fault(("read-back", "acceleration"), urdf=harder_spin),
    "centre of mass 2 cm ahead": Fault(("settle", "locked-braking"), urdf=moved(f"{CHASSIS}/origin", x=0.02)),
    "centre of mass 2 cm to the left": Fault(("settle", "tilt-table"), urdf=moved(f"{CHASSIS}/origin", y=0.02)),
    "centre of mass 3 cm higher": Fault(
        ("tilt-table", "steady-turn", "locked-braking"), urdf=moved(f"{CHASSIS}/origin", z=0.03)
    ),
    "wheels are hulls": Fault(
        ("settle", "straight"), urdf=cylinders, made_by=loaded_with(pybullet.URDF_USE_INERTIA_FROM_FILE)
    ),
    "left and right swapped": Fault(("five-actions", "steady-turn"), vehicle=swapped),
    "wheel friction 0.7": Fault(("read-back", "skids", "friction-cone"), vehicle=contact(wheel_friction=0.875)),
    "caster friction 0.4": Fault(("read-back", "skids"), made_by=changed("caster", lateralFriction=0.4)),
    "ground friction 0.9": Fault(("locked-braking", "skids", "friction-cone"), made_by=SlipperyGround),
    "rolling friction missing": Fault(("read-back", "rolling-resistance"), vehicle=contact(rolling_friction=0.0)),
    "spinning friction tenfold": Fault(("read-back", "five-actions"), vehicle=contact(spinning_friction=10.0)),
    "torque limit doubled": Fault(("acceleration",), vehicle=torque_times(2.0)),
    "torque limit not applied": Fault(("acceleration",), vehicle=torque_times(1e6)),
    "inertia from shapes": Fault(
        ("read-back", "yaw-inertia"), made_by=loaded_with(pybullet.URDF_USE_IMPLICIT_CYLINDER)
    ),
    "default damping": Fault(
        ("free-fall", "coast", "skids"), made_by=changed("base", linearDamping=0.04, angularDamping=0.04)
    ),
    "joints held below 100 rad/s": Fault(("coast",), made_by=changed("base", maxJointVelocity=100.0)),
    "joint damping": Fault(("coast", "acceleration"), made_by=changed("left", "right", jointDamping=0.1)),
    "motor left on the caster": Fault(("coast", "caster"), made_by=motor_left_on("caster_roll")),
    "motor left on the swivel": Fault(("five-actions", "caster", "reversing"), made_by=motor_left_on("swivel")),
    "motor left on a drive": Fault(("coast",), made_by=motor_left_on("left_drive")),
    "10 iterations": Fault(("creep", "straight", "five-actions"), settings=partial(replace, iterations=10)),
    "residual 1e-4": Fault(("creep", "acceleration"), settings=partial(replace, residual=1e-4)),
    "four substeps": Fault(("settle", "acceleration", "wall"), made_by=solving_with(numSubSteps=4)),
    "friction pyramid": Fault(("friction-cone",), made_by=solving_with(enableConeFriction=0)),
    "engine steps 1/200 s": Fault(("free-fall", "yaw-inertia", "caster"), made_by=solving_with(fixedTimeStep=1 / 200)),
    "penetration pushed out at once": Fault(("wall",), made_by=solving_with(contactERP=0.9)),
    "gravity 9.80": Fault(("free-fall",), made_by=pulled_by(0.0, 0.0, -9.80)),
    "ground not level by 0.2 degrees": Fault(
        ("settle", "coast"), made_by=pulled_by(0.0, 9.81 * sin(radians(0.2)), -9.81)
    ),
    "rays see the vehicle": Fault(("rays",), made_by=SelfSeeing),
    "rays 0.1 % short": Fault(("rays",), made_by=ShortRays),
    "rays late by one look": Fault(("rays", "determinism"), made_by=LateRays),
    "sensor 5 cm ahead": Fault(("rays",), vehicle=sensor_moved(0.05, 0.0, 0.0)),
    "sensor 5 cm to the left": Fault(("rays",), vehicle=sensor_moved(0.0, 0.05, 0.0)),
    "sensor 5 cm higher": Fault(("rays",), vehicle=sensor_moved(0.0, 0.0, 0.05)),
    "sensor 5 cm lower": Fault(("rays",), vehicle=sensor_moved(0.0, 0.0, -0.05)),
    "restitution 0.5": Fault(("wall",), made_by=Bouncing),
    "soft chassis": Fault(("wall",), made_by=changed("base", contactStiffness=2e4, contactDamping=1e3)),
    "no obstacles": Fault(("wall", "rays"), made_by=NoObstacles),
    "forces of contact doubled": Fault(("wall",), made_by=DoubleForces),
    "tyres that wear": Fault(("determinism",), made_by=WearingTyres),
}
