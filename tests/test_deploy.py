"""The runtime: it drives as the simulators' loop does, by scans of any lidar, and stops on what it cannot drive by."""

import re
import shutil
import subprocess
import sys
from copy import copy
from dataclasses import dataclass, field, replace
from functools import cache
from inspect import getsource
from math import inf, nan, pi, radians
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import nnql_bullet as nb
from nnql_bullet.deploy import Command, Controller, Odometry, Scan, WatchOptions
from nnql_bullet.deploy.scans import Unusable, rays_of
from nnql_bullet.env import STOP, commands_of
from nnql_bullet.exports.c99 import c_files
from nnql_bullet.exports.contract import contract_of
from nnql_bullet.exports.running import build
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
        [
            ("paper", "cover_10", 1, False),
            ("vfh", "aisles", 2, False),
            ("double_dqn", "cover_10", 1, True),
            ("distilled", "cover_10", 1, True),
        ],
    )
    def test_it_drives_as_the_simulators_loop_does(self, policy: str, world: str, seed: int, shield: bool) -> None:
        same_drive(policy, world, seed, shield)

    @pytest.mark.skipif(shutil.which("cc") is None, reason="needs a C compiler")
    @pytest.mark.parametrize("shield", [False, True])
    def test_what_was_exported_to_c_drives_as_well(self, shield: bool, tmp_path: Path) -> None:
        nb.export("paper", to="c", with_shield=shield, out=tmp_path / "c")
        library = build(tmp_path / "c", tmp_path / "policy.so")
        changes: dict[str, Any] = {"shield": {"recovers": False}} if shield else {}
        recording = nb.drive("paper", world="cover_10", seed=1, simulator="kinematic", changes=changes)
        mine = Replay(Controller("paper", shield=shield, library=library))
        mine.drive("cover_10", 1, len(recording.action))
        assert (len(mine.actions), mine.ending) == (len(recording.action), recording.summary.ending)
        with pytest.raises(nb.UserError, match="no shared library"):
            Controller("paper", library=tmp_path / "c" / "policy.c")
        with pytest.raises(nb.UserError, match="does not fit 'double_dqn'"):
            Controller("double_dqn", library=library)

    @pytest.mark.slow
    @pytest.mark.parametrize("world", ["cover_10", "cover_20", "traps", "moving"])
    @pytest.mark.parametrize(("policy", "shield"), [("paper", True), ("tuned", False), ("double_dqn", True)])
    def test_in_many_worlds(self, policy: str, world: str, shield: bool) -> None:
        for seed in (3, 4):
            same_drive(policy, world, seed, shield)


SENSOR = Sensor(position=(0.35, 0.0, 0.4))


def lidar(distances: Any, first: float = -pi, increment: float | None = None, **values: Any) -> Scan:
    """A scan all round by so many beams, unless told otherwise."""
    beams = np.asarray(distances, np.float64)
    step = 2 * pi / len(beams) if increment is None else increment
    named = {"range_min": 0.1, "range_max": 30.0, "stamp": 0.0, **values}
    return Scan(distances, first, first + (len(beams) - 1) * step, step, **named)


class TestScans:
    @settings(max_examples=40, deadline=None)
    @given(
        st.integers(36, 1500),
        st.floats(-4.0, 4.0),
        st.booleans(),
        st.integers(0, 2**32 - 1),
        st.sampled_from([8, 72, 360]),
    )
    def test_a_ray_reads_the_nearest_of_the_beams_about_it(
        self, beams: int, first: float, clockwise: bool, seed: int, rays: int
    ) -> None:
        drawn = np.random.default_rng(seed).uniform(0.2, 14.0, beams)
        step = (-1 if clockwise else 1) * 2 * pi / beams
        sensor = replace(SENSOR, rays=rays)
        found = rays_of(lidar(drawn, first, step), sensor)
        half = max(2 * pi / rays, abs(step)) / 2
        away = first + step * np.arange(beams) - sensor.angles[:, None]
        away = np.abs(np.arctan2(np.sin(away), np.cos(away)))
        surely, perhaps = (np.where(away < half + slack, drawn, inf).min(axis=1) for slack in (-1e-5, 1e-5))
        assert (np.minimum(perhaps, 10.0) <= found).all()
        assert (found <= np.minimum(surely, 10.0)).all()

    def test_what_is_not_measured_is_not_free(self) -> None:
        beams = np.full(720, inf)
        beams[[360, 361, 362]] = -inf, nan, 0.05  # ahead: too near, nothing told, too near
        found = rays_of(lidar(beams), SENSOR)
        assert found[np.abs(SENSOR.angles).argmin()] == 0.0
        assert (found == 10.0).sum() == 71

    @pytest.mark.parametrize(
        ("scan", "reason"),
        [
            (lidar(np.full(360, nan)), "72 of 72 rays tell nothing"),
            (lidar(np.r_[np.full(345, 5.0), np.full(15, nan)]), "tell nothing: all beams are NaN at"),
            (lidar([5.0] * 99 + [-1.0]), "beam 99 of the scan reads -1 m"),
            (Scan([], 0.0, 6.0, 0.1, 0.1, 30.0, 0.0), "0 beams"),
            (replace(lidar(np.full(360, 5.0)), ranges=np.full(200, 5.0)), "200 beams where its angles make 360"),
            (replace(lidar(np.full(360, 5.0)), ranges=np.full(500, 5.0)), "500 beams where its angles make 360"),
            (lidar(np.full(271, 5.0), -0.75 * pi, radians(1.0)), "no beam at"),
            (lidar(np.full(360, 5.0), range_max=8.0), "reaches 8 m"),
            (lidar(np.full(360, 5.0), range_max=nan), "reaches nan m"),
            (replace(lidar(np.full(360, 5.0)), angle_increment=0.0), "angles and limits"),
            (lidar(np.full(360, 5.0), 1e15), "angles and limits"),
            (replace(lidar(np.full(360, 5.0)), ranges=["a"] * 360), "something else than numbers"),
            (replace(lidar(np.full(360, 5.0)), ranges=None), "0 dimensions"),
        ],
    )
    def test_what_cannot_be_driven_by_is_refused(self, scan: Scan, reason: str) -> None:
        with pytest.raises(Unusable, match=reason):
            rays_of(scan, SENSOR)

    def test_a_lidar_that_does_not_see_all_round_needs_a_sensor_with_that_blind_arc(self) -> None:
        sensor = replace(SENSOR, blind_arc_degrees=(134.0, -134.0))
        found = rays_of(lidar(np.full(271, 5.0), -0.75 * pi, radians(1.0)), sensor)
        assert (found[sensor.seen] == 5.0).all()
        assert (found[~sensor.seen] == 10.0).all()

    def test_a_lidar_may_look_another_way(self) -> None:
        beams = np.full(360, inf)
        beams[180] = 3.0  # its own 0
        assert rays_of(lidar(beams), SENSOR, yaw=pi / 2).argmin() == np.abs(SENSOR.angles - pi / 2).argmin()


FREE = np.full(360, inf)


@cache
def loaded() -> Controller:
    """A controller that was never called; a copy of it is one, too."""
    return Controller("straight")


class Told:
    """A controller, called 40 times a second with a scan at each, that has driven for a while."""

    def __init__(self, controller: Controller | None = None) -> None:
        self.controller = copy(controller or loaded())
        self.now, self.x = 100.0, 0.0
        self.commands = [self.tell() for _ in range(30)]
        assert not any(its.reason for its in self.commands)

    def tell(self, **wrong: Any) -> Command:
        """Calls it once more, with something wrong if so told."""
        self.now = wrong.pop("now", self.now + 0.025)
        scan = lidar(FREE, stamp=self.now)
        odometry = Odometry(self.x, 0.0, 0.0, self.now, 1.0, 0.0)
        given = {"scan": scan, "odometry": odometry, "target": TARGET} | wrong
        command = self.controller.step(given["scan"], given["odometry"], given["target"], self.now)
        self.x += 0.025 * command.speed
        assert all(map(np.isfinite, (command.left, command.right, command.speed, command.yaw_rate)))
        return command


NOW = 100.75 + 0.025
GOOD = {"scan": lidar(FREE, stamp=NOW), "odometry": Odometry(0.7, 0.0, 0.0, NOW, 1.0, 0.0)}
WRONG: list[tuple[dict[str, Any], str]] = [
    ({"scan": None}, "no scan has come"),
    ({"scan": lidar(np.full(360, nan), stamp=NOW)}, "tell nothing"),
    ({"scan": lidar(FREE, stamp=NOW - 1.0)}, "scan: 1.00 s old"),
    ({"scan": lidar(FREE, stamp=NOW - 0.2)}, "older than the one before it"),
    ({"scan": lidar(FREE, stamp=NOW + 5.0)}, "in the future"),
    ({"scan": lidar(FREE, stamp=NOW, frame="camera")}, "scan: in the frame 'camera', not in 'laser'"),
    ({"scan": lidar(FREE, stamp=nan)}, "stamp is nan"),
    ({"odometry": None}, "no odometry has come"),
    ({"odometry": Odometry(0.0, 0.0, 0.0, NOW - 0.5)}, "odometry: 0.50 s old"),
    ({"odometry": Odometry(0.0, 0.0, 0.0, NOW, frame="map")}, "odometry: in the frame 'map', not in 'odom'"),
    ({"odometry": Odometry(nan, 0.0, 0.0, NOW)}, "'x' is nan"),
    ({"odometry": Odometry(0.0, 0.0, inf, NOW)}, "'yaw' is inf"),
    ({"odometry": Odometry(0.0, 0.0, 0.0, NOW, speed=nan)}, "'speed' is nan"),
    ({"odometry": Odometry(0.7, 0.0, 0.0, NOW, speed=50.0)}, "'speed' is 50; this vehicle's is at most 4"),
    ({"odometry": Odometry(0.7, 0.0, 0.0, NOW, yaw_rate=-99.0)}, "'yaw_rate' is -99"),
    ({"odometry": Odometry(0.7, 0.0, 0.0, NOW - 0.2)}, "odometry: 0.1[78] s older than the one before it"),
    ({"odometry": Odometry(5.0, 0.0, 0.0, NOW)}, "jumps by 3.7[0-9] m in 0.0[23] s"),
    ({"odometry": Odometry(0.7, 0.0, 3.0, NOW)}, "jumps by 3.00 rad"),
    ({"target": None}, "no target is given"),
    ({"target": (1e11, 0.0)}, "the target is 1e.11 m away; at most"),
    ({"target": (nan, 1.0)}, "the target is at nan"),
    ({"target": 3.0}, "no pair"),
    ({"target": (1.0, 0.0)}, "at the target"),
    ({"now": NOW + 3.0}, "not called for 3.0"),
    ({"now": 4.0}, "gone back by"),
    ({"now": nan}, "clock: it shows nan"),
]


class TestWatch:
    @pytest.mark.parametrize(("wrong", "reason"), WRONG, ids=[reason for _, reason in WRONG])
    def test_it_brakes_with_a_reason_and_drives_on_when_all_is_well(
        self, wrong: dict[str, Any], reason: str, caplog: pytest.LogCaptureFixture
    ) -> None:
        told = Told()
        limit, speed = told.controller.vehicle.limits.acceleration, told.commands[-1].speed
        assert speed == pytest.approx(told.controller.drive.speed)
        command = told.tell(**wrong)
        assert re.search(reason, command.reason) and command.reason == told.controller.reason
        assert command.action == STOP
        assert f"stops: {command.reason}" in caplog.text
        after = [command]
        told.now = told.now if np.isfinite(told.now) else NOW - 0.025
        for _ in range(80):
            after.append(told.tell(scan=None))
        speeds = np.array([speed, *(its.speed for its in after)])
        assert (np.diff(speeds) <= 1e-9).all()
        assert (-np.diff(speeds)[1:] <= limit * 0.025 + 1e-9).all()
        assert (after[-1].left, after[-1].right) == (0.0, 0.0)
        assert told.tell().reason == ""

    def test_a_scan_that_does_not_come_again_stops_it_at_the_next_decision_or_when_it_is_too_old(self) -> None:
        told = Told()
        old = lidar(FREE, stamp=told.now)
        reasons = [told.tell(scan=old).reason for _ in range(12)]
        assert reasons[0] == ""
        assert "old; at most 0.25 s" in reasons[-1]

    def test_wheels_stay_below_their_limit_whatever_the_yaw_is(self) -> None:
        told = Told()
        told.controller.watch = WatchOptions(most_yaw_jump=pi)
        most = told.controller.drive.speed + told.controller.vehicle.limits.yaw_rate * told.controller.vehicle.track / 2
        command = told.tell(odometry=Odometry(0.7, 0.0, 2.0, told.now + 0.025, 1.0, 0.0))
        assert max(abs(command.left), abs(command.right)) * told.controller.vehicle.wheel_radius <= most + 1e-9

    @settings(max_examples=150, deadline=None)
    @given(st.data())
    def test_nothing_that_it_is_told_breaks_it(self, data: st.DataObject) -> None:
        controller = copy(loaded())
        some = st.one_of(st.floats(), st.none(), st.text(max_size=3), st.integers(-5, 2**70))
        times = st.one_of(st.just(1.0), some)
        ranges = st.one_of(some, st.lists(some, max_size=9), st.just(FREE))
        for _ in range(3):
            scan = data.draw(st.builds(Scan, ranges, *[some] * 5, times, st.sampled_from(["laser", "x"])))
            odometry = data.draw(st.builds(Odometry, some, some, some, times, some, some))
            target = data.draw(st.one_of(st.none(), st.tuples(some, some)))
            now: Any = data.draw(times)
            command = controller.step(scan, odometry, target, now)
            assert command.reason or (np.isfinite(command.left) and np.isfinite(command.right))
            assert abs(command.speed) <= controller.drive.speed + 1e-9


@pytest.fixture(scope="module")
def by_library(tmp_path_factory: pytest.TempPathFactory) -> Controller:
    """A `double_dqn` in C that was never called."""
    if shutil.which("cc") is None:
        pytest.skip("needs a C compiler")
    folder, policy = tmp_path_factory.mktemp("c"), nb.load_policy("double_dqn")
    for name, text in c_files(contract_of(policy), policy.experiment)[0].items():
        (folder / name).write_text(text)
    return Controller("double_dqn", library=build(folder, folder / "policy.so"))


class TestDoubleDqnInC:
    def test_it_decides_as_the_agent_does(self, by_library: Controller) -> None:
        recording = nb.drive("double_dqn", world="traps", seed=1, simulator="kinematic")
        mine = Replay(copy(by_library)).drive("traps", 1, len(recording.action))
        assert mine.actions == recording.action.tolist() and mine.ending == recording.summary.ending

    def test_it_stops_as_others_do(self, by_library: Controller) -> None:
        for wrong, reason in WRONG:
            command = Told(by_library).tell(**wrong)
            assert re.search(reason, command.reason) and (command.action, command.decided) == (STOP, False)

    def test_of_another_target_it_begins_anew(self, by_library: Controller) -> None:
        moved, anew = copy(by_library), copy(by_library)
        scans = [np.random.default_rng(k // 5).uniform(1.0, 12.0, 360) for k in range(60)]
        for k, ranges in enumerate(scans):
            given = lidar(ranges, stamp=0.1 * k), Odometry(0.1 * k, 0.0, 0.0, 0.1 * k, 1.0, 0.0)
            target = (30.0, 3.0) if k < 30 else (3.0, -20.0)
            command = moved.step(*given, target, 0.1 * k)
            assert k < 30 or command == anew.step(*given, target, 0.1 * k)


WITHOUT = """
import sys

sys.modules.update(dict.fromkeys("torch numba llvmlite scipy pybullet mujoco gymnasium onnxruntime jinja2".split()))
"""


def decisions() -> str:
    """What two policies in a shield decide, scan by scan."""
    import numpy as np

    from nnql_bullet.deploy import Controller, Odometry, Scan
    from nnql_bullet.exports import running, shielded  # noqa: F401  # what a compiled policy needs

    told = []
    for policy in ("paper", "double_dqn"):
        controller = Controller(policy, shield=True)
        for k in range(31):
            ranges = np.random.default_rng(k).uniform(2.0, 12.0, 360)
            scan = Scan(ranges, 0.0, 2 * np.pi * 359 / 360, 2 * np.pi / 360, 0.1, 30.0, 0.1 * k)
            told.append(controller.step(scan, Odometry(0.1 * k, 0.0, 0.0, 0.1 * k, 1.0, 0.0), (20.0, 3.0), 0.1 * k))
    return repr(told)


def test_it_drives_without_torch_numba_scipy_and_simulators_as_with_them() -> None:
    program = f"{WITHOUT}\n{getsource(decisions)}\nprint(decisions())"
    told = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout.strip()
    assert told.count("decided=True") == 14
    assert told == decisions()


@pytest.mark.parametrize(
    ("policy", "refused"), [("nobody", "no such run or policy file"), ("paper", "needs a map of the whole world")]
)
def test_what_it_cannot_drive_is_refused(policy: str, refused: str) -> None:
    given = policy if policy == "nobody" else nb.load_policy(policy, {"plan": {}})
    with pytest.raises(nb.UserError, match=refused):
        Controller(given)


def test_options_are_checked() -> None:
    with pytest.raises(nb.UserError, match="most_age"):
        WatchOptions(most_age=-1.0)
