"""MuJoCo as the second engine of contact physics: what the probes that every engine goes through do not ask."""

import shutil
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from math import atan2, cos, degrees, hypot, pi, radians, sin
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from nnql_bullet.errors import UserError
from nnql_bullet.geometry import OrientedBox, Pose, as_rows, ray_distances
from nnql_bullet.sim.base import Sample
from nnql_bullet.sim.bullet import PHYSICS as BULLET_PHYSICS
from nnql_bullet.sim.bullet import BulletEngine
from nnql_bullet.sim.engines import contact_engine
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.payload import loaded
from nnql_bullet.vehicle.spec import Payload, VehicleSpec
from nnql_bullet.vehicle.urdf import load_vehicle
from nnql_bullet.worlds.spec import WorldSpec

pytest.importorskip("mujoco", reason="needs the extra: pip install 'nnql-bullet[mujoco]'")
from nnql_bullet.sim.mujoco import PHYSICS, MujocoEngine

G = 9.81
SPEED = 2.0  # [m/s]
START = Pose(100.0, 100.0, 0.0)
# The vehicle as designed, SI units: composite centre of mass A ahead of the rear axle and H high.
MASS, TRACK, WHEELBASE, RADIUS, CASTER_RADIUS = 120.0, 0.60, 0.70, 0.125, 0.05
A = (104.5 * 0.12 + 1.5 * 0.72 + 2.0 * 0.70) / MASS
H = (104.5 * 0.22 + 2 * 6.0 * 0.125 + 1.5 * 0.07 + 2.0 * 0.05) / MASS
WHEEL_INERTIA, CASTER_INERTIA = 0.046874, 0.0025
EFFECTIVE_MASS = MASS + 2 * WHEEL_INERTIA / RADIUS**2 + CASTER_INERTIA / CASTER_RADIUS**2  # wheels spin up too
FRONT, HALF_WIDTH, RANGE = 0.90, 0.325, 10.0

Make = Callable[..., MujocoEngine]
WorldOf = Callable[..., WorldSpec]


@pytest.fixture
def mujoco_of(vehicle: VehicleSpec) -> Iterator[Make]:
    """Makes simulators and closes them: (name of the physics settings, another vehicle, drive options)."""
    made: list[MujocoEngine] = []

    def make(physics: str = "fast", spec: VehicleSpec | None = None, **drive: float) -> MujocoEngine:
        made.append(MujocoEngine(spec or vehicle, DriveOptions(**drive), PHYSICS[physics]))
        return made[-1]

    yield make
    for engine in made:
        engine.close()


def on_tyres(vehicle: VehicleSpec, friction: float) -> VehicleSpec:
    return replace(vehicle, contact=replace(vehicle.contact, wheel_friction=friction))


def rolling_freely(vehicle: VehicleSpec) -> VehicleSpec:
    return replace(vehicle, contact=replace(vehicle.contact, rolling_friction=0.0, spinning_friction=0.0))


class TestRays:
    SIDE = 40.0
    ANGLES = np.radians(np.arange(72) * 5.0 - 20.0)
    WALLS = (  # the arena is a hole of SIDE x SIDE
        OrientedBox(20.0, -0.5, 30.0, 0.5),
        OrientedBox(20.0, 40.5, 30.0, 0.5),
        OrientedBox(-0.5, 20.0, 0.5, 30.0),
        OrientedBox(40.5, 20.0, 0.5, 30.0),
    )

    @staticmethod
    def eye(pose: Pose) -> tuple[float, float]:
        return pose.x + 0.35 * cos(pose.yaw), pose.y + 0.35 * sin(pose.yaw)

    @pytest.mark.parametrize("seed", range(6))
    def test_they_read_the_analytic_distance_in_any_world(self, mujoco_of: Make, world_of: WorldOf, seed: int) -> None:
        generator = np.random.default_rng(seed)
        rows = np.column_stack(
            [generator.uniform(0, 40, (25, 2)), generator.uniform(0.1, 3, (25, 2)), generator.uniform(-pi, pi, 25)]
        )
        boxes = tuple(OrientedBox(*row) for row in rows.tolist())
        world, solids = world_of(*boxes, side=self.SIDE), as_rows(boxes + self.WALLS)
        engine = mujoco_of()
        compared = hits = 0
        for x, y, yaw in generator.uniform((1, 1, -pi), (39, 39, pi), (8, 3)).tolist():
            eye = self.eye(Pose(x, y, yaw))
            if ray_distances(eye, self.ANGLES, solids, RANGE).min() < 0.05:
                continue  # within a box
            engine.place(world, Pose(x, y, yaw), 0.0)
            expected = ray_distances(eye, self.ANGLES + yaw, solids, RANGE)
            assert engine.scan() == pytest.approx(expected, abs=2e-3)
            compared += 1
            hits += int(np.sum(expected < RANGE))
        assert compared and hits > 36 * compared

    def test_they_follow_the_vehicle(self, mujoco_of: Make, world_of: WorldOf) -> None:
        boxes = (OrientedBox(20.0, 24.0, 6.0, 1.0, 0.1), OrientedBox(17.0, 12.0, 2.0, 1.0, 0.7))
        engine = mujoco_of()
        engine.reset(world_of(*boxes, start=Pose(5.0, 18.0, 0.0), side=self.SIDE))
        for turn in (0.3, -0.6, 0.4, 0.0, -0.5, 0.5):
            pose = engine.advance(turn).pose
            beside = [
                ray_distances(self.eye(pose), self.ANGLES + pose.yaw + nudge, as_rows(boxes + self.WALLS), RANGE)
                for nudge in (-1e-3, 0.0, 1e-3)
            ]
            plain = np.ptp(beside, axis=0) < 0.2  # the rest just passes a corner, and the chassis leans a little
            assert plain.sum() > 68
            assert engine.scan()[plain] == pytest.approx(beside[1][plain], abs=2e-3)

    @pytest.mark.parametrize("sensor", [(0.0, 0.1, 0.0), (0.6, 0.0, -0.09), (-0.5, 0.0, -0.124)])
    def test_they_see_neither_vehicle_nor_ground(
        self, mujoco_of: Make, empty_world: WorldSpec, vehicle: VehicleSpec, sensor: tuple[float, float, float]
    ) -> None:
        engine = mujoco_of("fast", replace(vehicle, sensor=replace(vehicle.sensor, position=sensor)))
        engine.reset(empty_world)
        engine.advance(0.5)
        assert np.all(engine.scan() == RANGE)


class TestCollisions:
    def test_wheels_go_through_what_the_chassis_clears(self, mujoco_of: Make, world_of: WorldOf, physics: str) -> None:
        kerb = replace(world_of(OrientedBox(101.5, 100.0, 0.3, 2.0)), obstacle_height=0.10)
        engine = mujoco_of(physics)
        engine.reset(kerb)
        motion = engine.advance(0.0)
        assert engine.pose().x == pytest.approx(101.0, abs=1e-3)
        assert not motion.touching
        assert engine.wheel_heights() == pytest.approx((RADIUS, RADIUS, CASTER_RADIUS), abs=5e-5)

    def test_the_chassis_meets_what_reaches_up_to_it(self, mujoco_of: Make, world_of: WorldOf, physics: str) -> None:
        box = replace(world_of(OrientedBox(101.5, 100.0, 0.3, 2.0)), obstacle_height=0.12)
        engine = mujoco_of(physics)
        engine.reset(box)
        motion = engine.advance(0.0)
        assert motion.touching
        assert motion.pose.x + FRONT == pytest.approx(101.2, abs=2 * SPEED * engine.time_step)
        assert engine.obstacle_force() > 0.0

    @pytest.mark.parametrize("gap", [0.05, 0.236, 0.5, 0.73, 0.95])
    def test_a_contact_ends_the_step_when_it_happens(
        self, mujoco_of: Make, world_of: WorldOf, physics: str, gap: float
    ) -> None:
        engine = mujoco_of(physics)
        engine.reset(world_of(OrientedBox(START.x + FRONT + gap + 0.5, START.y, 0.5, 2.0)))
        motion = engine.advance(0.0)
        assert motion.touching
        assert motion.duration == pytest.approx(gap / SPEED, abs=2.5 * engine.time_step)
        assert motion.duration == pytest.approx(engine.time(), abs=1e-9)
        assert -1e-5 < motion.pose.x - (START.x + gap) < SPEED * engine.time_step

    def test_a_wall_just_beyond_the_step_is_not_touched(self, mujoco_of: Make, world_of: WorldOf, physics: str) -> None:
        engine = mujoco_of(physics)
        engine.reset(world_of(OrientedBox(START.x + FRONT + 1.03 + 0.5, START.y, 0.5, 2.0)))
        motion = engine.advance(0.0)
        assert not motion.touching
        assert motion.clearance == pytest.approx(0.03, abs=1e-3)
        assert engine.advance(0.0).touching

    def test_a_hit_gives_next_to_nothing_back(self, mujoco_of: Make, world_of: WorldOf, physics: str) -> None:
        engine = mujoco_of(physics)
        world = world_of(OrientedBox(START.x + FRONT + 0.11 + 0.5, START.y, 0.5, 2.0))
        engine.place(world, START, 0.0, ground=False)
        engine.set_gravity((0.0, 0.0, 0.0))
        engine.lock_joints()
        engine.set_velocity(SPEED, 0.0)
        impulse = 0.0
        while engine.time() < 0.15:
            engine.step()
            impulse += engine.obstacle_force() * engine.time_step
        vx, _, _ = engine.velocity()
        assert -0.02 * SPEED < vx <= 0.0
        assert impulse == pytest.approx(MASS * (SPEED - vx), rel=1e-4)

    @pytest.mark.parametrize("side", [1, -1])
    def test_a_post_brushed_in_passing_is_a_contact(
        self, mujoco_of: Make, world_of: WorldOf, physics: str, side: int
    ) -> None:
        engine = mujoco_of(physics)
        for overlap, touches in ((0.005, True), (-0.005, False)):
            post = OrientedBox(START.x + FRONT + 0.1, START.y + side * (HALF_WIDTH - overlap + 0.02), 0.02, 0.02)
            engine.reset(world_of(post))
            assert engine.advance(0.0).touching is touches

    @pytest.mark.parametrize("offset", [0.0, 0.15])
    def test_the_target_is_noticed_within_a_command(
        self, mujoco_of: Make, world_of: WorldOf, physics: str, offset: float
    ) -> None:
        engine = mujoco_of(physics)
        engine.reset(world_of(target=(START.x + 0.5, START.y + offset), target_radius=0.2))
        motion = engine.advance(0.0)
        assert motion.at_target and not motion.touching
        assert motion.duration == pytest.approx((0.5 - (0.04 - offset**2) ** 0.5) / SPEED, abs=1 / 120 + 1e-9)


class TestFreshStart:
    BOXES = (OrientedBox(103.0, 98.0, 0.4, 0.4, 0.3), OrientedBox(98.0, 106.0, 1.0, 1.0))

    def drive(self, engine: MujocoEngine, world: WorldSpec) -> list[object]:
        trace: list[Sample] = []
        engine.reset(world)
        seen: list[object] = []
        for turn in (0.4, -0.8, 0.3, 0.0, 1.0):
            seen += [engine.advance(turn, trace), engine.scan().tolist()]
        return [*seen, *trace, engine.wheel_forces(), engine.velocity()]

    def test_nothing_of_before_is_left_after_a_reset(
        self, mujoco_of: Make, world_of: WorldOf, empty_world: WorldSpec, physics: str
    ) -> None:
        world = world_of(*self.BOXES)
        expected = self.drive(mujoco_of(physics), world)
        assert not any(motion.touching for motion in expected[:10:2])  # type: ignore[attr-defined]
        engine = mujoco_of(physics)
        upsets: list[Callable[[], object]] = [
            lambda: self.drive(engine, empty_world),
            lambda: engine.command_wheels(50.0, -50.0),
            engine.release_wheels,
            engine.lock_joints,
            lambda: engine.set_gravity((1.0, 2.0, 3.0)),
            lambda: engine.twist(1e4),
            lambda: engine.set_swivel(1.0),
            lambda: engine.set_velocity(3.0, 4.0),
            lambda: engine.place(empty_world, START, 1.0, height=3.0, ground=False),
        ]
        for upset in upsets:
            upset()
            engine.step()
            upset()  # and what is left to the next step
            assert self.drive(engine, world) == expected

    def test_looking_changes_nothing(self, mujoco_of: Make, world_of: WorldOf) -> None:
        quiet, watched = mujoco_of(), mujoco_of()
        for engine in (quiet, watched):
            engine.reset(world_of(*self.BOXES))
        for turn in (0.4, -0.8, 0.3):
            looks = (
                watched.scan,
                watched.sample,
                watched.wheel_forces,
                watched.wheel_heights,
                watched.obstacle_force,
                watched.link_dynamics,
            )
            for look in looks:
                look()
            assert watched.advance(turn, []) == quiet.advance(turn)

    def test_simulators_side_by_side_do_not_touch_each_other(
        self, mujoco_of: Make, world_of: WorldOf, empty_world: WorldSpec
    ) -> None:
        alone = mujoco_of("fast")
        alone.reset(world_of(*self.BOXES))
        expected = [alone.advance(turn) for turn in (0.4, -0.8, 0.3)]
        first, second = mujoco_of("fast"), mujoco_of("reference")
        first.reset(world_of(*self.BOXES))
        second.reset(empty_world)
        seen = []
        for turn in (0.4, -0.8, 0.3):
            second.advance(-turn)
            seen.append(first.advance(turn))
        assert seen == expected


class TestVehicle:
    PAYLOAD = Payload(mass=60.0, ahead=0.4, height=0.5, side=0.3)

    def test_a_payload_is_a_link_of_its_own(
        self, mujoco_of: Make, vehicle: VehicleSpec, empty_world: WorldSpec
    ) -> None:
        plain, carrying = mujoco_of(), mujoco_of("fast", loaded(vehicle, self.PAYLOAD))
        for engine in (plain, carrying):
            engine.reset(empty_world)
        held, without = carrying.link_dynamics(), plain.link_dynamics()
        assert held.keys() - without.keys() == {"payload"}
        assert held["payload"].mass == pytest.approx(60.0, rel=1e-12)
        assert held["payload"].inertia == pytest.approx([60.0 * 0.3**2 / 6] * 3, rel=1e-12)
        assert {name: held[name] for name in without} == without
        assert sum(link.mass for link in held.values()) == pytest.approx(MASS + 60.0, rel=1e-12)

    def test_a_payload_weighs_on_the_wheels(
        self, mujoco_of: Make, vehicle: VehicleSpec, empty_world: WorldSpec, physics: str
    ) -> None:
        engine = mujoco_of(physics, loaded(vehicle, self.PAYLOAD))
        engine.place(empty_world, Pose(100.0, 100.0, 0.7), 0.0)
        engine.run(1.0)
        ahead = (MASS * A + 60.0 * 0.4) / (MASS + 60.0)
        front = (MASS + 60.0) * G * ahead / WHEELBASE
        rear = ((MASS + 60.0) * G - front) / 2
        assert engine.wheel_loads() == pytest.approx((rear, rear, front), rel=1e-4)

    def test_moments_of_inertia_are_told_by_axis(self, mujoco_of: Make, empty_world: WorldSpec) -> None:
        engine = mujoco_of()
        engine.reset(empty_world)
        held = engine.link_dynamics()
        assert held["chassis"].inertia == pytest.approx((2.76577, 9.29702, 10.8854), rel=1e-9)
        assert held["left_wheel"].inertia == pytest.approx((0.024687, WHEEL_INERTIA, 0.024687), rel=1e-9)

    def test_a_urdf_that_the_engine_refuses_is_named(
        self, mujoco_of: Make, empty_world: WorldSpec, tmp_path: Path
    ) -> None:
        robots = Path(__file__).resolve().parents[1] / "robots"
        shutil.copy(robots / "tricycle.toml", tmp_path)
        text = (robots / "tricycle.urdf").read_text()
        (tmp_path / "tricycle.urdf").write_text(text.replace('"fork"', '"world"'))
        engine = mujoco_of("fast", load_vehicle(str(tmp_path / "tricycle.toml")))
        with pytest.raises(UserError, match=r"^\S*tricycle\.urdf: MuJoCo cannot take this URDF: .*world"):
            engine.reset(empty_world)


class TestDrives:
    @pytest.mark.parametrize("torque", [5.0, 20.0, 30.0])
    @pytest.mark.parametrize("direction", [1, -1])
    def test_they_give_their_torque_limit_and_no_more(
        self, mujoco_of: Make, vehicle: VehicleSpec, empty_world: WorldSpec, physics: str, torque: float, direction: int
    ) -> None:
        engine = mujoco_of(physics, replace(rolling_freely(vehicle), wheel_torque=torque))
        engine.place(empty_world, START, 0.0)
        engine.command_wheels(direction * 1e6, direction * 1e6)  # out of reach
        engine.run(0.5)
        assert engine.speed() == pytest.approx(direction * 2 * torque * 0.5 / (RADIUS * EFFECTIVE_MASS), rel=1e-4)

    def test_a_vehicle_starts_with_its_wheels_rolling(
        self, mujoco_of: Make, vehicle: VehicleSpec, empty_world: WorldSpec, physics: str
    ) -> None:
        engine = mujoco_of(physics, rolling_freely(vehicle))
        engine.place(empty_world, Pose(100.0, 100.0, 2.0), SPEED)
        assert engine.wheel_speeds() == pytest.approx((SPEED / RADIUS, SPEED / RADIUS))
        engine.run(0.5)  # a wheel that had to be spun up, the caster's too, would take speed away
        assert engine.speed() == pytest.approx(SPEED, abs=1e-6)
        assert engine.sample().joint_angles[3] == pytest.approx(0.5 * SPEED / CASTER_RADIUS, rel=1e-5)

    def test_a_wheel_in_the_air_comes_to_its_speed_and_stays_there(
        self, mujoco_of: Make, empty_world: WorldSpec, physics: str
    ) -> None:
        # A gain that is right for the whole vehicle would have a free wheel, which is twenty times lighter, swing.
        engine = mujoco_of(physics)
        engine.place(empty_world, START, 0.0, height=5.0, ground=False)
        engine.command_wheels(16.0, -16.0)
        engine.run(16.0 * WHEEL_INERTIA / 40.0 + 2 * engine.time_step)
        for _ in range(50):
            engine.step()
            assert engine.wheel_speeds() == pytest.approx((16.0, -16.0), abs=1e-2)

    def test_a_lock_and_a_release_end_with_the_next_command(
        self, mujoco_of: Make, empty_world: WorldSpec, physics: str
    ) -> None:
        engine = mujoco_of(physics)
        for let_go in (engine.lock_joints, engine.release_wheels):
            engine.place(empty_world, START, 1.0)
            let_go()
            engine.step()
            engine.command_wheels(8.0, 8.0)
            engine.run(1.0)
            assert engine.speed() == pytest.approx(1.0, rel=1e-4)

    def test_a_twist_lasts_for_one_step(self, mujoco_of: Make, vehicle: VehicleSpec, empty_world: WorldSpec) -> None:
        engine = mujoco_of()
        engine.place(empty_world, START, 0.0, height=5.0, ground=False)
        engine.lock_joints()
        rates = []
        engine.twist(100.0)
        for _ in range(3):
            engine.step()
            rates.append(engine.yaw_rate())
        assert rates == pytest.approx([100.0 * engine.time_step / vehicle.yaw_inertia] * 3, rel=5e-3)

    def test_velocities_are_those_of_the_world(self, mujoco_of: Make, empty_world: WorldSpec) -> None:
        engine = mujoco_of()
        engine.place(empty_world, Pose(100.0, 100.0, 2.0), 1.0, height=5.0, ground=False)
        engine.command_wheels(90.0, -20.0)  # which pitches the chassis
        engine.twist(3000.0)
        for _ in range(40):
            before, turned = engine._frame()
            engine.step()
            after, now = engine._frame()
            linear, angular = engine._velocities()
            assert linear == pytest.approx(np.subtract(after, before) / engine.time_step, abs=1e-6)
            rotation = (Rotation.from_quat(now) * Rotation.from_quat(turned).inv()).as_rotvec()
            assert angular == pytest.approx(rotation / engine.time_step, abs=1e-6)
        assert np.min(np.abs(angular)) > 0.05


class TestSliding:
    """The engine alone lifts whatever slides; Coulomb's law does not."""

    @pytest.mark.parametrize("direction", [0.0, pi / 6, pi / 4, pi / 3, -pi / 2])
    @pytest.mark.parametrize("friction", [0.8, 0.4])
    def test_a_skid_goes_straight_and_stops_where_grip_says(
        self, mujoco_of: Make, vehicle: VehicleSpec, empty_world: WorldSpec, direction: float, friction: float
    ) -> None:
        engine = mujoco_of("reference", on_tyres(vehicle, friction))
        engine.place(empty_world, START, 0.0)
        engine.lock_joints()
        engine.set_velocity(4.0 * cos(direction), 4.0 * sin(direction))
        heights = []
        while hypot(*engine.velocity()) > 0.05:
            engine.step()
            heights.append(engine.wheel_heights())
        pose = engine.pose()
        dx, dy = pose.x - START.x, pose.y - START.y
        assert hypot(dx, dy) == pytest.approx(4.0**2 / (2 * friction * G), rel=1e-2)
        assert degrees(atan2(dy, dx) - direction) == pytest.approx(0.0, abs=0.05)
        assert degrees(pose.yaw) == pytest.approx(0.0, abs=0.05)
        hops = np.array(heights) - (RADIUS, RADIUS, CASTER_RADIUS)
        assert np.max(np.abs(hops)) < 1e-5

    @pytest.mark.parametrize("torque", [40.0, 400.0])
    def test_wheels_that_brake_beyond_grip_keep_their_load(
        self, mujoco_of: Make, vehicle: VehicleSpec, empty_world: WorldSpec, physics: str, torque: float
    ) -> None:
        friction = 0.4
        engine = mujoco_of(physics, replace(on_tyres(vehicle, friction), wheel_torque=torque))
        engine.reset(empty_world)
        engine.advance(0.0)
        engine.command_wheels(0.0, 0.0)
        while engine.time() < 0.65:  # until they stand
            engine.step()
            assert min(engine.wheel_loads()) > 100.0
            assert engine.wheel_heights() == pytest.approx((RADIUS, RADIUS, CASTER_RADIUS), abs=1e-5)
        assert engine.wheel_speeds() == pytest.approx((0.0, 0.0), abs=0.05)
        caster = CASTER_INERTIA / CASTER_RADIUS  # its spin is stopped by its own contact
        shifted = friction * (MASS * H + caster) / WHEELBASE
        deceleration = friction * MASS * G * (1 - A / WHEELBASE) / (MASS + caster / CASTER_RADIUS + shifted)
        rear = (MASS + caster / CASTER_RADIUS) * deceleration / friction / 2
        before = engine.speed()
        for n in range(1, 21):
            engine.step()
            assert engine.wheel_loads()[:2] == pytest.approx((rear, rear), rel=5e-3)
            assert before - engine.speed() == pytest.approx(n * deceleration * engine.time_step, rel=1e-2)


@pytest.mark.parametrize(
    "yaw", [0.0, pi / 4]
)  # in between, PyBullet's friction is itself off by more: see its own tests
@pytest.mark.parametrize("turn", [0, 30, 60, -30, -60])
def test_two_engines_agree_on_the_five_turns(
    mujoco_of: Make, vehicle: VehicleSpec, world_of: WorldOf, physics: str, turn: int, yaw: float
) -> None:
    world = world_of(start=Pose(100.0, 100.0, yaw))
    other = BulletEngine(vehicle, DriveOptions(decision_period=1.0), BULLET_PHYSICS["reference"])
    traces: list[list[Sample]] = []
    for engine in (mujoco_of(physics, decision_period=1.0), other):
        traces.append([])
        engine.reset(world)
        engine.advance(radians(turn), traces[-1])
    other.close()
    here, there = ([(s.pose.x, s.pose.y, degrees(s.pose.yaw)) for s in trace] for trace in traces)
    gaps = np.abs(np.subtract(here, there))
    assert np.max(np.hypot(gaps[:, 0], gaps[:, 1])) < {"reference": 1e-3, "fast": 6e-3}[physics]
    assert gaps[-1, 2] < 0.1
    assert here[-1][2] == pytest.approx(degrees(yaw) + turn, abs=0.1)


def test_without_the_package_it_is_named(vehicle: VehicleSpec, monkeypatch: pytest.MonkeyPatch) -> None:
    import nnql_bullet.sim

    monkeypatch.delitem(sys.modules, "nnql_bullet.sim.mujoco")
    monkeypatch.delattr(nnql_bullet.sim, "mujoco")
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(UserError, match=r"pip install 'nnql-bullet\[mujoco\]'"):
        contact_engine("mujoco", "fast", vehicle, DriveOptions())
