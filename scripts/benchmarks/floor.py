"""How many times faster the physics `fast` is than PyBullet used plainly.

The plain floor is what an ordinary PyBullet program does: 24 steps of 1/240 s, one wheel command and 8 rays every
0.1 s, the engine's default solver (50 iterations), every box a body of its own, cylinders as wheels. It and `fast`
follow the same headings through the same worlds, and both cast the same rays. The contact breaking threshold holds for
the whole process, so each side sets its own whenever it builds its world.
"""

import time
from dataclasses import dataclass
from math import cos, pi, sin
from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch
from xml.etree import ElementTree

from nnql_bullet.constants import GRAVITY
from nnql_bullet.experiment import Experiment
from nnql_bullet.geometry import Pose, wrap_angle
from nnql_bullet.run_config import RunConfig
from nnql_bullet.sim.base import Sample
from nnql_bullet.sim.bullet import OBSTACLE, BulletEngine
from nnql_bullet.sim.bullet import bullet as pybullet
from nnql_bullet.sim.engines import ContactSimulator
from nnql_bullet.task import NO_ENDING
from nnql_bullet.vehicle.controller import COMMAND_RATE
from nnql_bullet.vehicle.profiles import wheel_speeds
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.spec import WorldSpec

from .drives import hand_rule, quickest

WORLD = "cover_10"
"""With about 40 boxes."""
PERIOD, STEPS, RAYS = 0.1, 24, 8
THRESHOLD = 0.02
"""The engine's own contact breaking threshold [m]."""


@dataclass
class Drive:
    """One episode under the hand rule with the physics `fast`: what both sides do again."""

    world: WorldSpec
    commands: list[list[float]]
    """Wheel speeds [rad/s] of `fast`, 120 a second."""
    yaws: list[float]
    """[rad], every `PERIOD`."""


def fast_over_floor(seeds: range, rounds: int, steps: int) -> float:
    """Simulated seconds a wall second of `fast`, as a bare loop, over those of the floor."""
    experiment = Experiment(RunConfig(world=WORLD, physics="fast"))
    simulator, floor = experiment.simulator, Floor(experiment.vehicle, experiment.config.drive.speed)
    assert isinstance(simulator, ContactSimulator)
    (engine,) = simulator.engines
    assert isinstance(engine, BulletEngine)
    spent = {"floor": 0.0, "fast": 0.0}
    simulated = {"floor": 0.0, "fast": 0.0}
    for seed in seeds:
        drive = _recorded(experiment, seed, steps)
        sides = {
            "floor": lambda drive=drive: floor.follow(drive),
            "fast": lambda drive=drive: _replay(engine, drive),
        }
        for name, seconds in quickest(sides, rounds).items():
            spent[name] += seconds
        simulated["floor"] += len(drive.yaws) * PERIOD
        simulated["fast"] += len(drive.commands) / COMMAND_RATE
    floor.close()
    return (simulated["fast"] / spent["fast"]) / (simulated["floor"] / spent["floor"])


def _recorded(experiment: Experiment, seed: int, most: int) -> Drive:
    world, navigation = experiment.world(seed), experiment.navigation
    navigation.reset({0: world})
    trace: list[Sample] = []
    commands: list[list[float]] = []
    motors = pybullet.setJointMotorControlArray

    def command(*arguments: object, targetVelocities: list[float], **options: object) -> None:
        commands.append(targetVelocities)
        motors(*arguments, targetVelocities=targetVelocities, **options)

    with patch.object(pybullet, "setJointMotorControlArray", command):
        for _ in range(most):
            transition = navigation.step(hand_rule(navigation.observation.readings), traces={0: trace})
            if transition.ending[0] != NO_ENDING:
                break
    per_period = round(30 * PERIOD)
    return Drive(world, commands, [sample.pose.yaw for sample in trace][per_period - 1 :: per_period])


def _replay(engine: BulletEngine, drive: Drive) -> float:
    """`fast` as a bare loop; how long it took [s]."""
    engine.reset(drive.world)
    engine.command_wheels(*drive.commands[0])  # from here on the wheels are driven ones
    step, motors, rays = pybullet.stepSimulation, pybullet.setJointMotorControlArray, pybullet.rayTestBatch
    client, body, wheels = engine.client, engine.body, (engine.left, engine.right)
    mode, torques = pybullet.VELOCITY_CONTROL, (engine.vehicle.wheel_torque,) * 2
    per_command = range(round(1 / COMMAND_RATE / engine.physics.time_step))
    per_period = round(PERIOD * COMMAND_RATE)
    begins, ends = _rays(drive.world.start)
    with engine.own_threshold():
        begin = time.perf_counter()
        for number, speeds in enumerate(drive.commands, 1):
            motors(body, wheels, mode, targetVelocities=speeds, forces=torques, physicsClientId=client)
            for _ in per_command:
                step(client)
            if number % per_period == 0:
                rays(begins, ends, collisionFilterMask=OBSTACLE, physicsClientId=client)
        return time.perf_counter() - begin


def _rays(pose: Pose) -> tuple[list[list[float]], list[list[float]]]:
    """Begins and ends of 8 rays of 10 m around a pose."""
    angles = [pose.yaw + sector * 2 * pi / RAYS for sector in range(RAYS)]
    ends = [[pose.x + 10 * cos(angle), pose.y + 10 * sin(angle), 0.6] for angle in angles]
    return [[pose.x, pose.y, 0.6]] * RAYS, ends


class Floor:
    """The vehicle in PyBullet as an ordinary program would have it."""

    def __init__(self, vehicle: VehicleSpec, speed: float) -> None:
        self.vehicle = vehicle
        self.speed = speed
        self.client = pybullet.connect(pybullet.DIRECT)
        self._folder = TemporaryDirectory()
        self._urdf = Path(self._folder.name, "cylinders.urdf")
        tree = ElementTree.parse(vehicle.urdf)
        links = vehicle.links
        for wheel in (links["left_drive"], links["right_drive"], links["caster_roll"]):
            collision, visual = (tree.find(f"link[@name='{wheel}']/{kind}") for kind in ("collision", "visual"))
            assert collision is not None and visual is not None
            collision[:] = visual[:2]  # origin and geometry of the tyre, a cylinder
        tree.write(self._urdf)

    def close(self) -> None:
        """Frees what it holds."""
        pybullet.disconnect(self.client)
        self._folder.cleanup()

    def follow(self, drive: Drive) -> float:
        """Follows the headings of a drive; how long it took [s]."""
        self._build(drive.world)
        step, motor, rays = pybullet.stepSimulation, pybullet.setJointMotorControl2, pybullet.rayTestBatch
        client, body, vehicle, speed = self.client, self.body, self.vehicle, self.speed
        mode, torque = pybullet.VELOCITY_CONTROL, vehicle.wheel_torque
        begins, ends = _rays(drive.world.start)
        begin = time.perf_counter()
        for wanted in drive.yaws:
            _, orientation = pybullet.getBasePositionAndOrientation(body, client)
            yaw = pybullet.getEulerFromQuaternion(orientation)[2]
            left, right = wheel_speeds(speed, wrap_angle(wanted - yaw) / PERIOD, vehicle.track, vehicle.wheel_radius)
            motor(body, self.left, mode, targetVelocity=left, force=torque, physicsClientId=client)
            motor(body, self.right, mode, targetVelocity=right, force=torque, physicsClientId=client)
            for _ in range(STEPS):
                step(client)
            rays(begins, ends, physicsClientId=client)
        return time.perf_counter() - begin

    def _build(self, world: WorldSpec) -> None:
        """Boxes and walls as bodies of their own, the ground, and the vehicle on the start, rolling."""
        client, start, vehicle = self.client, world.start, self.vehicle
        pybullet.resetSimulation(physicsClientId=client)
        pybullet.setPhysicsEngineParameter(contactBreakingThreshold=THRESHOLD, physicsClientId=client)
        pybullet.setGravity(0.0, 0.0, -GRAVITY, client)
        plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=client)
        ground = pybullet.createMultiBody(0.0, plane, physicsClientId=client)
        pybullet.changeDynamics(ground, -1, lateralFriction=1.0, physicsClientId=client)
        height = world.obstacle_height / 2
        for box in world.obstacles + world.walls:
            half = [box.half_length, box.half_width, height]
            shape = pybullet.createCollisionShape(pybullet.GEOM_BOX, halfExtents=half, physicsClientId=client)
            turned = [0.0, 0.0, sin(box.yaw / 2), cos(box.yaw / 2)]
            pybullet.createMultiBody(0.0, shape, -1, [box.x, box.y, height], turned, physicsClientId=client)
        turned = [0.0, 0.0, sin(start.yaw / 2), cos(start.yaw / 2)]
        place = [start.x, start.y, vehicle.wheel_radius]
        self.body = pybullet.loadURDF(str(self._urdf), place, turned, physicsClientId=client)
        joints = {
            pybullet.getJointInfo(self.body, joint, client)[1].decode(): joint
            for joint in range(pybullet.getNumJoints(self.body, client))
        }
        self.left, self.right = joints[vehicle.joints["left_drive"]], joints[vehicle.joints["right_drive"]]
        caster = joints[vehicle.joints["caster_roll"]]
        for joint in (joints[vehicle.joints["swivel"]], caster):
            mode = pybullet.VELOCITY_CONTROL
            pybullet.setJointMotorControl2(self.body, joint, mode, force=0.0, physicsClientId=client)
        velocity = [self.speed * cos(start.yaw), self.speed * sin(start.yaw), 0.0]
        pybullet.resetBaseVelocity(self.body, velocity, physicsClientId=client)
        radii = {self.left: vehicle.wheel_radius, self.right: vehicle.wheel_radius, caster: vehicle.casters[0].radius}
        for wheel, radius in radii.items():
            friction = vehicle.contact.wheel_friction
            pybullet.changeDynamics(self.body, wheel, lateralFriction=friction, physicsClientId=client)
            pybullet.resetJointState(self.body, wheel, 0.0, self.speed / radius, client)
