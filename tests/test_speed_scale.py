"""Vehicles that stop, turn on the spot, reverse and go: every simulator against closed forms and an integrator."""

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from functools import partial
from importlib.util import find_spec
from math import cos, degrees, exp, hypot, log, pi, radians, sin, sqrt, tan
from typing import Any

import numpy as np
import pytest
from helpers import Alone, row
from scipy.integrate import solve_ivp

from nnql_bullet.env import (
    ACTIONS,
    MANOEUVRES,
    REVERSE,
    SLOW,
    STOP,
    TOWARD_TARGET,
    Navigation,
    heading_change,
    speed_scale,
)
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array, OrientedBox, Pose, as_rows, clearance_at
from nnql_bullet.render import labels
from nnql_bullet.sim.base import Sample, Simulator
from nnql_bullet.sim.contact import VehicleMotion
from nnql_bullet.sim.engines import contact_simulator
from nnql_bullet.sim.kinematic import KinematicSimulator
from nnql_bullet.sim.workers import WorkerSimulator
from nnql_bullet.task import ENDINGS, NO_ENDING, TaskOptions
from nnql_bullet.vehicle.controller import COMMAND_RATE, DriveOptions
from nnql_bullet.vehicle.limits import braking, braking_rear_load
from nnql_bullet.vehicle.payload import deck_load, loaded
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.source import load_world
from nnql_bullet.worlds.spec import Patrol, WorldSpec

SPEED, RATE = 2.0, 2.5
"""Of the drive [m/s], and the shipped vehicle's limit [m/s2]."""
RADIUS = 0.125
"""Of the drive wheels [m]."""
STOPPING = SPEED**2 / (2 * RATE)
"""Way to a stand [m]."""
FRONT = 0.9
"""Of the footprint, ahead of the axle [m]."""
MIDDLE = Pose(100.0, 100.0, 0.0)
NEEDS_MUJOCO = pytest.mark.skipif(
    find_spec("mujoco") is None, reason="needs the extra: pip install 'nnql-bullet[mujoco]'"
)
NAMES = ("kinematic", "bullet", pytest.param("mujoco", marks=NEEDS_MUJOCO))

WorldOf = Callable[..., WorldSpec]


def make(name: str, vehicle: VehicleSpec, size: int = 1) -> Simulator:
    if name == "kinematic":
        return KinematicSimulator(vehicle, DriveOptions(), size)
    if name == "workers":
        return WorkerSimulator(partial(contact_simulator, "bullet", "fast", vehicle, DriveOptions()), size, 2)
    return contact_simulator("mujoco" if name == "mujoco" else "bullet", "fast", vehicle, DriveOptions(), size)


@pytest.fixture(scope="module", params=NAMES)
def simulator(request: pytest.FixtureRequest, vehicle: VehicleSpec) -> Iterator[Alone]:
    with Alone(make(request.param, vehicle)) as made:
        yield made


def speed(sample: Sample) -> float:
    return sum(sample.wheel_speeds) / 2 * RADIUS


def drive(simulator: Alone, world: WorldSpec, commands: list[tuple[float, float]]) -> list[VehicleMotion]:
    """Motion of commands (turn in degrees, speed_scale), up to the first contact."""
    simulator.reset(world)
    motions = []
    for turn, wanted in commands:
        motions.append(simulator.advance(radians(turn), speed_scale=wanted))
        if motions[-1].touching:
            break
    return motions


def way(motions: list[VehicleMotion]) -> float:
    return sum(motion.path_length for motion in motions)


class TestStopping:
    def test_it_stands_after_the_braking_distance(self, simulator: Alone, empty_world: WorldSpec) -> None:
        first, _, third = motions = drive(simulator, empty_world, [(0, 0)] * 3)
        assert way(motions) == pytest.approx(STOPPING, rel=0.01)
        assert simulator.pose.x - MIDDLE.x == pytest.approx(STOPPING, rel=0.01)
        assert first.path_length == pytest.approx(SPEED * 0.5 - RATE * 0.5**2 / 2, rel=0.01)
        assert third.path_length < 0.002
        assert simulator.end.wheel_speeds == pytest.approx((0.0, 0.0), abs=0.05)
        assert [motion.duration for motion in motions] == pytest.approx([0.5] * 3)

    def test_it_goes_again_within_the_same_limit(self, simulator: Alone, empty_world: WorldSpec) -> None:
        first, second, third = drive(simulator, empty_world, [(0, 0)] * 2 + [(0, 1)] * 3)[2:]
        assert first.path_length == pytest.approx(RATE * 0.5**2 / 2, rel=0.02)
        assert first.path_length + second.path_length == pytest.approx(SPEED * 1.0 - STOPPING, rel=0.02)
        assert (speed(simulator.end), third.path_length) == pytest.approx((SPEED, SPEED * 0.5), rel=0.01)

    def test_any_pace_is_kept(self, simulator: Alone, empty_world: WorldSpec) -> None:
        motions = drive(simulator, empty_world, [(0, 0.5)] * 3)
        assert speed(simulator.end) == pytest.approx(SPEED / 2, rel=0.01)
        assert motions[-1].path_length == pytest.approx(SPEED / 4, rel=0.01)

    def test_the_drives_own_speed_is_the_pace_if_none_is_given(self, simulator: Alone, empty_world: WorldSpec) -> None:
        turns = (0.4, -0.8, 0.3)
        simulator.reset(empty_world)
        plain = [simulator.advance(turn) for turn in turns]
        simulator.reset(empty_world)
        assert [simulator.advance(turn, speed_scale=1.0) for turn in turns] == plain

    def test_a_reset_has_it_at_speed_again(self, simulator: Alone, empty_world: WorldSpec) -> None:
        (plain,) = drive(simulator, empty_world, [(0, 1)])
        drive(simulator, empty_world, [(60, 0)] * 3)
        assert drive(simulator, empty_world, [(0, 1)]) == [plain]

    def test_a_trace_shows_it_slow_down(self, simulator: Alone, empty_world: WorldSpec) -> None:
        trace: list[Sample] = []
        simulator.reset(empty_world)
        for _ in range(2):
            simulator.advance(0.0, trace, 0.0)
        speeds = np.array([speed(sample) for sample in trace])
        times = np.array([sample.time for sample in trace])
        assert speeds == pytest.approx(np.maximum(SPEED - RATE * times, 0.0), abs=0.05)

    @pytest.mark.parametrize("short", [0.02, 0.3, 0.6])
    def test_a_wall_too_near_is_hit_at_what_is_left_of_the_speed(
        self, simulator: Alone, world_of: WorldOf, short: float
    ) -> None:
        gap = STOPPING - short
        wall = OrientedBox(MIDDLE.x + FRONT + gap + 0.5, MIDDLE.y, 0.5, 2.0)
        motions = drive(simulator, world_of(wall), [(0, 0)] * 4)
        assert motions[-1].touching
        took = (SPEED - sqrt(SPEED**2 - 2 * RATE * gap)) / RATE
        assert sum(motion.duration for motion in motions) == pytest.approx(took, abs=0.04)

    @pytest.mark.parametrize("spare", [0.05, 0.3])
    def test_a_wall_beyond_the_braking_distance_is_not_touched(
        self, simulator: Alone, world_of: WorldOf, spare: float
    ) -> None:
        wall = OrientedBox(MIDDLE.x + FRONT + STOPPING + spare + 0.5, MIDDLE.y, 0.5, 2.0)
        motions = drive(simulator, world_of(wall), [(0, 0)] * 4)
        assert not motions[-1].touching
        assert motions[-1].clearance == pytest.approx(spare, abs=0.01)


class TestPivot:
    @pytest.mark.parametrize("turn", [60, -60, 30])
    def test_on_the_spot_it_turns_by_what_is_asked_for(
        self, simulator: Alone, empty_world: WorldSpec, turn: float
    ) -> None:
        drive(simulator, empty_world, [(0, 0)] * 3)
        before, trace = simulator.pose, list[Sample]()
        simulator.advance(radians(turn), trace, 0.0)
        left = radians(turn) - (simulator.pose.yaw - before.yaw)
        simulator.advance(left, trace, 0.0)
        simulator.advance(0.0, trace, 0.0)
        assert degrees(simulator.pose.yaw - before.yaw) == pytest.approx(turn, abs=0.5)
        assert all(hypot(s.pose.x - before.x, s.pose.y - before.y) < 0.01 for s in trace)

    def test_half_a_second_turns_as_far_as_on_the_way(self, simulator: Alone, empty_world: WorldSpec) -> None:
        (rolling,) = drive(simulator, empty_world, [(60, 1)])
        standing = drive(simulator, empty_world, [(0, 0)] * 3 + [(60, 0)])[-1]
        assert standing.pose.yaw == pytest.approx(rolling.pose.yaw, abs=radians(1.0))
        assert standing.heading_error == pytest.approx(rolling.heading_error, abs=radians(1.0))

    def test_then_it_goes_where_it_points(self, simulator: Alone, empty_world: WorldSpec) -> None:
        drive(simulator, empty_world, [(0, 0)] * 3 + [(60, 0)] * 3)
        before = simulator.pose
        for _ in range(3):
            simulator.advance(0.0)
        after = simulator.pose
        assert before.yaw > radians(90)
        gone = np.array([after.x - before.x, after.y - before.y])
        ahead = np.array([cos(after.yaw), sin(after.yaw)])
        assert gone @ ahead == pytest.approx(SPEED * 1.5 - STOPPING, abs=0.12)

    @pytest.mark.parametrize(("beside", "touches"), [(0.36, True), (0.41, False)])
    def test_its_tail_swings_out(self, simulator: Alone, world_of: WorldOf, beside: float, touches: bool) -> None:
        """The vehicle's side is 0.325 m from its axle's centre; its rear corner goes round that at 0.382 m."""
        post = OrientedBox(MIDDLE.x + STOPPING, MIDDLE.y + beside, 0.01, 0.01)
        motions = drive(simulator, world_of(post), [(0, 0)] * 3 + [(-60, 0)] * 2)
        assert not motions[2].touching
        assert motions[-1].touching is touches


@pytest.mark.parametrize("name", NAMES)
def test_turns_while_the_speed_changes_follow_the_unicycle(
    vehicle: VehicleSpec, empty_world: WorldSpec, name: str
) -> None:
    """With a yaw acceleration that leaves the drives some torque to brake with."""
    commands = [(60, 0), (60, 0), (-30, 1), (0, 1), (30, 0.4), (-60, 0), (0, 0), (60, 1)]
    most_rate, slope = vehicle.limits.yaw_rate, 3.0
    gentle = replace(vehicle, limits=replace(vehicle.limits, yaw_acceleration=slope))
    with Alone(make(name, gentle)) as simulator:
        motions = drive(simulator, empty_world, commands)
    state = np.array([MIDDLE.x, MIDDLE.y, 0.0, SPEED, 0.0])
    for motion, (turn, wanted) in zip(motions, commands, strict=True):

        def derivative(
            _: float, s: Array, target: float = state[2] + radians(turn), goal: float = SPEED * wanted
        ) -> list[float]:
            # The quickest way to a heading: as hard as it goes, up to where ending the turn at once just reaches it.
            turning = np.clip(1e3 * (target - s[2] - s[4] * abs(s[4]) / (2 * slope)), -slope, slope)
            turning = 0.0 if abs(s[4]) >= most_rate and turning * s[4] > 0 else turning
            return [s[3] * cos(s[2]), s[3] * sin(s[2]), s[4], np.clip(1e3 * (goal - s[3]), -RATE, RATE), turning]

        state = solve_ivp(derivative, (0.0, 0.5), state, max_step=1e-3).y[:, -1]
        near, alike = (0.015, 1.0) if name == "kinematic" else (0.05, 2.0)
        assert hypot(motion.pose.x - state[0], motion.pose.y - state[1]) < near
        assert degrees(motion.pose.yaw) == pytest.approx(degrees(state[2]), abs=alike)


class TestPatrols:
    def test_a_standing_vehicle_is_hit_when_the_box_is_there(self, simulator: Alone, world_of: WorldOf) -> None:
        """The box comes at 1 m/s from 3 m ahead of where the front comes to stand."""
        x = MIDDLE.x + STOPPING + FRONT + 3.0 + 0.5
        patrol = Patrol(OrientedBox(x, 100.0, 0.5, 1.0), (x - 20.0, 100.0), 1.0, 0.0)
        motions = drive(simulator, replace(world_of(), patrols=(patrol,)), [(0, 0)] * 12)
        assert motions[-1].touching
        assert sum(motion.duration for motion in motions) == pytest.approx(3.0, abs=0.03)

    def test_one_that_turns_back_leaves_what_was_left(self, simulator: Alone, world_of: WorldOf) -> None:
        x = MIDDLE.x + STOPPING + FRONT + 3.0 + 0.5
        patrol = Patrol(OrientedBox(x, 100.0, 0.5, 1.0), (x - 2.7, 100.0), 1.0, 0.0)
        motions = drive(simulator, replace(world_of(), patrols=(patrol,)), [(0, 0)] * 12)
        assert not motions[-1].touching
        assert min(motion.clearance for motion in motions) == pytest.approx(0.3, abs=0.02)


@pytest.mark.parametrize("name", ["cover_20", "moving"])
@pytest.mark.parametrize("seed", range(6))
def test_the_kinematic_model_misses_no_clearance_at_any_speed(vehicle: VehicleSpec, name: str, seed: int) -> None:
    """It looks only where the clearance may have become the smallest; here it is taken after every command."""
    world = load_world(name).draw(seed, 0.8)
    footprint, chance = as_rows((vehicle.footprint,))[0], np.random.default_rng(seed)
    clock = 0
    with closing(KinematicSimulator(vehicle, DriveOptions(), 1, threads=1)) as fleet:
        fleet.reset({0: world})
        for _ in range(60):
            turn = chance.choice(np.radians([0, 30, 60, -30, -60]), 1)
            motions, _ = fleet.advance(turn, np.ones(1, np.bool_), chance.choice([0.0, 0.0, 0.4, 1.0, -0.3, -1.0], 1))
            path = fleet.path(0)
            taken = [
                clearance_at(*pose, footprint, world.solids_at((clock + k) / COMMAND_RATE))
                for k, pose in enumerate(path.tolist())
            ]
            clock += len(path) - 1
            assert motions.clearance[0] == pytest.approx(min(taken), abs=1e-9)
            assert motions.touching[0] == (min(taken) == 0.0)
            steps = np.hypot(*np.diff(path[:, :2], axis=0).T)
            assert motions.path_length[0] == pytest.approx(steps.sum(), abs=RATE / COMMAND_RATE**2)  # at its turning
            assert np.diff(steps, 2) == pytest.approx(0.0, abs=2 * RATE / COMMAND_RATE**2)
            if motions.touching[0] or motions.at_target[0]:
                break


@pytest.mark.parametrize("kind", [*NAMES, "workers"])
def test_several_vehicles_go_at_their_own_speeds(vehicle: VehicleSpec, world_of: WorldOf, kind: str) -> None:
    chance = np.random.default_rng(4)
    commands = [(chance.uniform(-1, 1, 3), chance.choice([0.0, 0.5, 1.0, -0.25, -1.0], 3)) for _ in range(8)]
    with closing(make(kind, vehicle, 3)) as several, Alone(make(kind.replace("workers", "bullet"), vehicle)) as alone:
        several.reset({i: world_of() for i in range(3)})
        together = [several.advance(turns, speed_scales=scales)[0] for turns, scales in commands]
        for i in range(3):
            alone.reset(world_of())
            for (turns, scales), motion in zip(commands, together, strict=True):
                assert row(motion, i) == alone.advance(float(turns[i]), speed_scale=float(scales[i]))


BACK = 0.25
"""Share of the speed at which the drive reverses."""
TURNING_BACK = SPEED * (1 + BACK) / RATE
"""Time from full speed ahead to that speed back [s]."""
AHEAD, BEHIND, TRAIL = 0.74, 0.2, 0.04
"""Of the swivel ahead of the axle, of the footprint behind it, and of the caster [m]."""


class TestReversing:
    def test_it_goes_through_zero_within_the_limit(self, simulator: Alone, empty_world: WorldSpec) -> None:
        motions = drive(simulator, empty_world, [(0, -BACK)] * 4)
        back = (BACK * SPEED) ** 2 / (2 * RATE) + BACK * SPEED * (2.0 - TURNING_BACK)
        assert simulator.pose.x - MIDDLE.x == pytest.approx(STOPPING - back, abs=0.01)
        assert way(motions) == pytest.approx(STOPPING + back, abs=0.01)
        assert [motion.speed for motion in motions[2:]] == pytest.approx([-BACK * SPEED] * 2, abs=0.005)
        assert speed(simulator.end) == pytest.approx(-BACK * SPEED, abs=0.005)
        assert abs(motions[0].speed - (SPEED - RATE * 0.5)) < 0.03

    def test_it_comes_back_to_where_it_was(self, simulator: Alone, empty_world: WorldSpec) -> None:
        drive(simulator, empty_world, [(0, -BACK)] * 2)
        begin = simulator.pose
        for scale in (-BACK, -BACK, BACK, BACK, BACK):
            simulator.advance(0.0, speed_scale=scale)
        change = 2 * BACK * SPEED / RATE  # the time to change from back to ahead, in which it gets nowhere
        ahead = BACK * SPEED * (3 * 0.5 - change) - BACK * SPEED * 2 * 0.5
        assert simulator.pose.x - begin.x == pytest.approx(ahead, abs=0.01)
        assert abs(simulator.pose.y - begin.y) < 0.005

    def test_it_rolls_back_along_its_heading_and_turns_as_asked(self, simulator: Alone, empty_world: WorldSpec) -> None:
        trace: list[Sample] = []
        drive(simulator, empty_world, [(0, -BACK)] * 2)
        for turn in (30, 30, 60, -30, -60, 0, 0):
            motion = simulator.advance(radians(turn), trace, -BACK)
        assert abs(motion.heading_error) < radians(0.2)
        x, y, yaw = np.array([(sample.pose.x, sample.pose.y, sample.pose.yaw) for sample in trace]).T
        middle = np.unwrap(yaw)[:-1] + np.diff(np.unwrap(yaw)) / 2
        along = np.diff(x) * np.cos(middle) + np.diff(y) * np.sin(middle)
        across = np.diff(y) * np.cos(middle) - np.diff(x) * np.sin(middle)
        assert along.mean() == pytest.approx(-BACK * SPEED / 30, rel=0.01)
        assert along == pytest.approx(-BACK * SPEED / 30, rel=0.15)  # where the caster is dragged round
        assert np.abs(across).max() < 5e-4

    @pytest.mark.parametrize("gap", [0.05, 0.2, 0.43])
    def test_it_touches_what_is_behind_where_it_stands(self, simulator: Alone, world_of: WorldOf, gap: float) -> None:
        behind = MIDDLE.x - BEHIND - gap - 0.5
        motions = drive(simulator, world_of(OrientedBox(behind, 100.0, 0.5, 2.0)), [(0, -BACK)] * 8)
        assert motions[-1].touching
        assert motions[-1].clearance == 0.0
        assert simulator.pose.x == pytest.approx(MIDDLE.x - gap, abs=0.012)
        until = TURNING_BACK + (gap + STOPPING - (BACK * SPEED) ** 2 / (2 * RATE)) / (BACK * SPEED)
        assert sum(motion.duration for motion in motions) == pytest.approx(until, abs=0.03)


class TestTheCasterOfTheKinematicModel:
    """Its angle is drawn only; the fidelity probe `reversing` compares contact physics with the same equation."""

    def angles(self, vehicle: VehicleSpec, world: WorldSpec, commands: list[tuple[float, float]]) -> Array:
        with Alone(KinematicSimulator(vehicle, DriveOptions(), 1, 1)) as alone:
            alone.reset(world)
            trace: list[Sample] = []
            for turn, scale in commands:
                alone.advance(radians(turn), trace, scale)
        return np.array([(sample.time, sample.joint_angles[2]) for sample in trace])

    def test_straight_back_it_swings_round_as_the_exponential_says(
        self, vehicle: VehicleSpec, empty_world: WorldSpec
    ) -> None:
        seen = self.angles(vehicle, empty_world, [(0, -BACK)] * 8)
        times, angles = seen[seen[:, 0] > TURNING_BACK].T
        rate = BACK * SPEED / TRAIL
        first = int(np.argmax(angles > 0.1))
        expected = 2 * np.arctan(tan(angles[first] / 2) * np.exp(rate * (times[first:] - times[first])))
        assert np.abs(angles[first:] - expected).max() < 0.2  # by steps of 1/120 s
        assert angles[-1] == pytest.approx(pi, abs=1e-6)
        swung = times[int(np.argmax(angles > pi / 2))] - TURNING_BACK
        assert 0.0 < swung < log(1 / tan(0.5e-3 / 2)) / rate + 0.1

    @pytest.mark.parametrize("side", [1, -1])
    def test_in_an_arc_it_follows_its_equation(self, vehicle: VehicleSpec, empty_world: WorldSpec, side: int) -> None:
        straight = [(0.0, 0.0)] * 2
        seen = self.angles(vehicle, empty_world, [*straight, *[(side * 60.0, -BACK)] * 3])

        def derivative(time: float, angle: Array) -> Array:
            speed = -min(BACK * SPEED, RATE * time)
            rate = side * min(7.4 * time, vehicle.limits.yaw_rate)
            return np.asarray((rate * AHEAD * np.cos(angle) - speed * np.sin(angle)) / TRAIL - rate)

        times = seen[:, 0] - 1.0
        during = (times > 0) & (times <= 0.3)
        found = solve_ivp(derivative, (0.0, 0.3), [0.0], t_eval=times[during], rtol=1e-9, atol=1e-9, max_step=0.005)
        assert np.abs(found.y[0] - seen[during, 1]).max() < 0.12

    def test_ahead_again_it_trails_again(self, vehicle: VehicleSpec, empty_world: WorldSpec) -> None:
        seen = self.angles(vehicle, empty_world, [*[(0, -BACK)] * 6, *[(0, 1)] * 3])
        assert cos(seen[-1, 1]) == pytest.approx(1.0, abs=exp(-10))


class TestManoeuvres:
    def test_they_are_the_same_turns_at_a_stand_and_backwards(self) -> None:
        actions, drive = np.arange(ACTIONS), DriveOptions(speed=3.0, reverse_share=0.2)
        for added, share in ((0, 1.0), (STOP, 0.0), (REVERSE, -0.2)):
            for bearing in (0.3, -2.0, 3.0):
                assert np.array_equal(heading_change(actions + added, bearing), heading_change(actions, bearing))
            assert speed_scale(actions + added, drive).tolist() == [share] * ACTIONS
            assert heading_change(TOWARD_TARGET + added, 0.3) == pytest.approx(0.3)
        assert (STOP, REVERSE, SLOW, MANOEUVRES, len(labels.MANOEUVRES)) == (6, 12, 18, 24, 24)
        assert labels.MANOEUVRES[REVERSE + 1] == "reverse, left 30°"

    @pytest.mark.parametrize("actions", [[-1, 0], [0, MANOEUVRES], [0], [0, 0, 0], [0.5, 1.0]])
    def test_no_other_number_is_one(self, vehicle: VehicleSpec, world_of: WorldOf, actions: list[Any]) -> None:
        with closing(KinematicSimulator(vehicle, DriveOptions(), 2, 1)) as simulator:
            navigation = Navigation(simulator, TaskOptions())
            navigation.reset({i: world_of() for i in range(2)})
            with pytest.raises(UserError, match="give 2 whole numbers from 0 to 23"):
                navigation.step(np.array(actions))

    def test_vehicles_carry_them_out(self, vehicle: VehicleSpec, world_of: WorldOf) -> None:
        actions = [STOP, STOP, TOWARD_TARGET + STOP, TOWARD_TARGET + STOP, TOWARD_TARGET, 1]
        with closing(KinematicSimulator(vehicle, DriveOptions(), 2)) as simulator:
            navigation = Navigation(simulator, TaskOptions())
            navigation.reset({i: world_of() for i in range(2)})
            for action in actions:
                path_length, other = navigation.step(np.array([action, 0])).motion.path_length.tolist()
                assert other == pytest.approx(1.0)
                if action == TOWARD_TARGET + STOP:
                    assert path_length < 1e-9
        assert path_length == pytest.approx(RATE * (1.0**2 - 0.5**2) / 2 - 0.5 * RATE * 0.2**2)


class TestStuck:
    """Of a vehicle 1.1 m long whose wheels turn at 120 Hz, in periods of 0.5 s."""

    def ended(self, vehicle: VehicleSpec, world: WorldSpec, actions: tuple[int, ...], **task: Any) -> tuple[str, int]:
        """How an episode ended in which `actions` are repeated, and after how many steps."""
        with closing(KinematicSimulator(vehicle, DriveOptions(), 1, 1)) as simulator:
            navigation = Navigation(simulator, TaskOptions(**task))
            navigation.reset({0: world})
            for step in range(500):
                t = navigation.step(np.array([actions[step % len(actions)]]))
                if t.ending[0] != NO_ENDING:
                    assert t.discount_t.tolist() == [1.0]
                    return ENDINGS[t.ending[0]], step + 1
        raise AssertionError("it never ended")

    @pytest.mark.parametrize("actions", [(STOP,), (STOP + 2,)])
    def test_it_stands_or_turns_on_the_spot(
        self, vehicle: VehicleSpec, empty_world: WorldSpec, actions: tuple[int, ...]
    ) -> None:
        assert self.ended(vehicle, empty_world, actions) == ("stuck", 1 + 60)  # the first step takes it elsewhere
        assert self.ended(vehicle, empty_world, actions, stuck_after=0.0) == ("timeout", 500)
        assert self.ended(vehicle, empty_world, actions, stuck_after=4.0) == ("stuck", 1 + 8)

    def test_it_goes_to_and_fro_within_the_radius(self, vehicle: VehicleSpec, empty_world: WorldSpec) -> None:
        ahead, back = (0, STOP, STOP), (REVERSE, REVERSE, STOP)  # 0.625 m, 0.5 m
        to_and_fro = (*ahead, *back, *ahead, REVERSE, *back)
        assert self.ended(vehicle, empty_world, to_and_fro, stuck_radius=1.5)[0] == "stuck"
        assert self.ended(vehicle, empty_world, to_and_fro, stuck_radius=0.1)[0] == "timeout"

    @pytest.mark.parametrize("action", [2, REVERSE, REVERSE + 1])
    def test_who_drives_in_circles_or_backs_is_not_stuck(
        self, vehicle: VehicleSpec, empty_world: WorldSpec, action: int
    ) -> None:
        assert self.ended(vehicle, empty_world, (action,), max_steps=80) == ("timeout", 80)

    def test_it_is_counted_anew_for_each_vehicle_and_episode(self, vehicle: VehicleSpec, world_of: WorldOf) -> None:
        with closing(KinematicSimulator(vehicle, DriveOptions(), 3, 1)) as simulator:
            navigation = Navigation(simulator, TaskOptions(stuck_after=5.0))
            navigation.reset({i: world_of() for i in range(3)})
            ends: list[list[int]] = []
            for step in range(14):
                if step == 6:
                    navigation.reset({1: world_of()})
                active = np.array([True, True, step % 2 == 0])
                ends.append(navigation.step(np.array([STOP] * 3), active).ending.tolist())
        stuck = np.array(ends) == ENDINGS.index("stuck")
        assert stuck.argmax(axis=0).tolist() == [10, 0, 0]
        assert stuck.any(axis=0).tolist() == [True, False, False]


class TestTheLimit:
    def test_grip_and_drives_have_room_for_it_in_the_worst_conditions(self, vehicle: VehicleSpec) -> None:
        for mass in (0.0, 40.0, 80.0):
            for friction in (0.5, 0.8):
                carrying = loaded(vehicle.gripping(friction), deck_load(vehicle, mass))
                assert braking(carrying).deceleration > 1.05 * vehicle.limits.acceleration
                assert braking_rear_load(carrying, vehicle.limits.acceleration) > 0.75

    @pytest.mark.parametrize(("friction", "payload"), [(0.5, 0.0), (0.5, 80.0), (0.8, 80.0)])
    def test_a_loaded_vehicle_stops_in_the_same_way(
        self, vehicle: VehicleSpec, empty_world: WorldSpec, friction: float, payload: float
    ) -> None:
        carrying = loaded(vehicle.gripping(friction), deck_load(vehicle, payload))
        with Alone(make("bullet", carrying)) as simulator:
            motions = drive(simulator, empty_world, [(0, 0)] * 3)
            assert way(motions) == pytest.approx(STOPPING, rel=0.03)
            assert abs(degrees(simulator.pose.yaw)) < 1.0
