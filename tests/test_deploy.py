"""The runtime: it drives as the simulators' loop does, by scans of any lidar, and stops on what it cannot drive by."""

from dataclasses import dataclass, field
from math import inf, pi
from typing import Any

import numpy as np
import pytest

import nnql_bullet as nb
from nnql_bullet.deploy import Command, Controller, Odometry, Scan
from nnql_bullet.env import commands_of
from nnql_bullet.geometry import Array
from nnql_bullet.sensing import Sensor
from nnql_bullet.sim.base import SAMPLE_EVERY, Sample
from nnql_bullet.sim.kinematic import KinematicSimulator
from nnql_bullet.vehicle.controller import COMMAND_RATE
from nnql_bullet.worlds.source import World

TICK = 1 / COMMAND_RATE
TARGET = (20.0, 0.0)


def scanned(distances: Array, sensor: Sensor, stamp: float) -> Scan:
    """The distances of a sensor's rays as a LaserScan has them."""
    angles, beams = sensor.angles, np.where(distances < sensor.range, distances, inf)
    return Scan(beams, angles[0], angles[-1], angles[1] - angles[0], 0.05, 30.0, stamp)


@dataclass
class Replay:
    """A drive in the kinematic model by the wheel commands of a controller, one call for each."""

    controller: Controller
    actions: list[int] = field(default_factory=list)
    ending: str = ""
    calls: list[tuple[Any, ...]] = field(default_factory=list)
    """What the controller was told, and the wheel speeds that it answered."""

    def drive(self, world: str, seed: int, decisions: int) -> "Replay":
        """Drives so many decisions at most."""
        c = self.controller
        drawn = World.load(world).draw(seed, c.vehicle.width)
        simulator = KinematicSimulator(c.vehicle, c.drive, 1, 1)
        poses, rays = simulator.reset({0: drawn})
        now, pose, speed, rate = 0.0, poses[0], drawn.start_speed(c.drive.speed), 0.0
        for _ in range(decisions):
            odometry = Odometry(*pose.tolist(), stamp=now, speed=speed, yaw_rate=rate)
            command = self.call(scanned(rays[0], c.vehicle.sensor, now), odometry, drawn.target, now)
            assert command.decided
            self.actions.append(command.action)
            bearing = np.arctan2(*(drawn.target - pose[:2])[::-1]) - pose[2]
            asked = commands_of(np.array([command.action]), np.array([(bearing + pi) % (2 * pi) - pi]), c.drive)
            trace: list[Sample] = []
            motion, rays_then = simulator.advance(asked.heading_changes, None, asked.speed_scales, {0: trace})
            path = simulator.path(0)
            commands = [command]
            for k in range(1, len(path) - 1):
                then = now + k * TICK
                there = Odometry(*path[k].tolist(), stamp=then)
                commands.append(self.call(scanned(rays[0], c.vehicle.sensor, then), there, drawn.target, then))
            assert not any(its.decided or its.reason for its in commands[1:])
            for number, sample in zip(range(SAMPLE_EVERY, len(path), SAMPLE_EVERY), trace, strict=False):
                mine = commands[number - 1]
                assert (mine.left, mine.right) == pytest.approx(sample.wheel_speeds, abs=1e-9)
            now, pose, rays = now + float(motion.duration[0]), motion.pose[0], rays_then
            speed, rate = float(motion.speed[0]), float(motion.yaw_rate[0])
            if motion.touching[0] or motion.at_target[0]:
                self.ending = "collision" if motion.touching[0] else "goal"
                break
        return self

    def call(self, scan: Scan, odometry: Odometry, target: Any, now: float) -> Command:
        """Tells the controller, and remembers what it says."""
        command = self.controller.step(scan, odometry, target, now)
        self.calls.append((scan, odometry, target, now, command))
        return command


def same_drive(policy: str, world: str, seed: int, shield: bool) -> Replay:
    """Drives a policy through a controller and by `nb.drive`, and compares both."""
    recording = nb.drive(policy, world=world, seed=seed, shield=shield, simulator="kinematic")
    mine = Replay(Controller(policy, shield=shield)).drive(world, seed, len(recording.action))
    assert mine.actions == recording.action.tolist()
    assert mine.ending == (recording.summary.ending if recording.summary.ending in ("goal", "collision") else "")
    return mine


class TestDrives:
    @pytest.mark.parametrize(
        ("policy", "world", "seed", "shield"),
        [("paper", "cover_10", 1, False), ("vfh", "aisles", 2, False), ("double_dqn", "cover_20", 1, False)],
    )
    def test_it_drives_as_the_simulators_loop_does(self, policy: str, world: str, seed: int, shield: bool) -> None:
        same_drive(policy, world, seed, shield)

    @pytest.mark.slow
    @pytest.mark.parametrize("world", ["cover_10", "cover_20", "traps", "moving"])
    @pytest.mark.parametrize(("policy", "shield"), [("paper", True), ("tuned", False), ("double_dqn", True)])
    def test_in_many_worlds(self, policy: str, world: str, shield: bool) -> None:
        for seed in (3, 4):
            same_drive(policy, world, seed, shield)
