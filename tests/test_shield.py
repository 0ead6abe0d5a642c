"""The shield: what it lets pass, what it does instead, what it remembers, and how it is asked for and reported."""

import json
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import asdict, replace
from math import cos, inf, pi, radians, sin
from pathlib import Path

import numpy as np
import pytest
import shapely
from helpers import Alone, Driving, begun, ending, row, step
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.agents.base import Rule
from nnql_bullet.agents.rules.vfh import Vfh, VfhOptions
from nnql_bullet.agents.turns import nearest_turns
from nnql_bullet.env import (
    ACTIONS,
    MANOEUVRES,
    REVERSE,
    SLOW,
    STOP,
    TOWARD_TARGET,
    Navigation,
    Observation,
    Transition,
    speed_scale,
)
from nnql_bullet.errors import UserError
from nnql_bullet.evaluation.policies import open_policies
from nnql_bullet.experiment import Experiment
from nnql_bullet.geometry import Array, OrientedBox, Pose, as_rows, ray_distances, wrap_angle
from nnql_bullet.mapping.localization import found_pose
from nnql_bullet.mapping.point_cloud import moving_points, point_cloud
from nnql_bullet.mapping.sector_faults import ENOUGH, completed, contradictions
from nnql_bullet.presets import load_config
from nnql_bullet.recording import Recorder, load_recording
from nnql_bullet.rollout import Decision, EpisodeSummary, decide, run_episode, run_episodes
from nnql_bullet.run_config import RunConfig
from nnql_bullet.sensing import RAYS, Sensor, ray_angles
from nnql_bullet.shield.courses import fill_drive, join, time_to_stop
from nnql_bullet.shield.lengths import ShieldOptions, lengths_of
from nnql_bullet.shield.prediction import can_stop
from nnql_bullet.shield.recovery import FIRST_GAIN, GAIN_GROWTH, STUCK_AFTER, Recovery
from nnql_bullet.shield.setting import KNOWN, MOVING, POINTS, STANDING, Memory, Setting, memory_of, setting_of
from nnql_bullet.shield.shield import Shield
from nnql_bullet.sim.base import Sample, Simulator
from nnql_bullet.sim.engines import contact_simulator
from nnql_bullet.sim.faults import FaultySimulator, SensorFaults
from nnql_bullet.sim.kinematic import KinematicSimulator
from nnql_bullet.task import TaskOptions
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.limits import turning_deceleration
from nnql_bullet.vehicle.payload import deck_load, loaded
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.source import load_world
from nnql_bullet.worlds.spec import Patrol, WorldSpec

DRIVE = DriveOptions()
MIDDLE = Pose(100.0, 100.0, 0.0)
MOUNTED = Sensor(position=(0.35, 0.0, 0.475))
SENSOR, RANGE = np.array([0.35, 0.0]), paper.SENSOR_RANGE
NOTHING = np.full(RAYS, paper.SENSOR_RANGE)
NO_POINTS = np.full((RAYS, 2), np.nan)

WorldOf = Callable[..., WorldSpec]
RunCli = Callable[..., tuple[int, str, str]]


class Wilful(Rule):
    """Chooses by a function of what it sees; its values are NaN or a fixed row."""

    def __init__(self, choose: Callable[[Observation], NDArray[np.int64]], values: Array | None = None) -> None:
        self._choose, self._values = choose, values

    def decide(self, observations: Observation) -> NDArray[np.int64]:
        return self._choose(observations)

    def action_values(self, observations: Observation, state: None) -> Array:
        nothing = super().action_values(observations, state)
        return nothing if self._values is None else np.broadcast_to(self._values, nothing.shape)


def always(action: int, values: Array | None = None) -> Wilful:
    return Wilful(lambda o: np.full(len(o.yaw_rate), action), values)


def suicidal(o: Observation) -> NDArray[np.int64]:
    """Toward whatever is nearest ahead."""
    bearings = np.angle(np.exp(1j * ray_angles()))
    ahead = np.where(np.abs(bearings) < pi / 2, o.ray_distances, inf)
    return nearest_turns(bearings[ahead.argmin(axis=-1)])


@pytest.fixture(scope="module")
def kinematic(vehicle: VehicleSpec) -> Iterator[KinematicSimulator]:
    with closing(KinematicSimulator(vehicle, DRIVE, 1)) as made:
        yield made


@pytest.fixture(scope="module")
def around(vehicle: VehicleSpec) -> Callable[..., Shield]:
    def make(agent: Rule, **options: float | bool) -> Shield:
        return Shield(ShieldOptions(**options), agent, vehicle, DRIVE, TaskOptions())  # type: ignore[arg-type]

    return make


class Noting:
    """Watches what is done, and from where."""

    trace = None

    def __init__(self) -> None:
        self.done: list[int] = []
        self.poses: list[Pose] = []

    def on_reset(self, world: WorldSpec, observation: Observation, vehicle: int) -> None:
        self.poses.append(world.start)

    def on_step(self, transition: Transition, decision: Decision, vehicle: int) -> None:
        self.done.append(int(transition.a_tm1[vehicle]))
        self.poses.append(row(transition.motion, vehicle).pose)


def drive(
    simulator: Simulator, world: WorldSpec, shield: Shield, steps: int = 500
) -> tuple[EpisodeSummary, list[int], list[Pose]]:
    """An episode, what was done, and where."""
    noting = Noting()
    summary = run_episode(Navigation(simulator, TaskOptions(max_steps=steps)), world, shield, noting)
    return summary, noting.done, noting.poses[:-1]


def setting_with(vehicle: VehicleSpec) -> Setting:
    """The setting of the usual shield around a vehicle."""
    return setting_of(lengths_of(ShieldOptions(), vehicle, DRIVE), vehicle, DRIVE, TaskOptions())


def beside(p: Setting, pole: Array) -> Memory:
    """What is known after one scan that met nothing, beside a thin pole (2,) that stands."""
    m = memory_of(p)
    m.numbers[KNOWN] = m.numbers[POINTS] = 1
    m.cloud[0], m.scans[0] = pole, NOTHING
    return m


def seen_from(pose: Array, points: Array) -> Array:
    """Points (n, 2) in the frame of a pose, by complex numbers."""
    there = (points @ [1, 1j] - complex(pose[0], pose[1])) * np.exp(-1j * pose[2])
    return np.stack([there.real, there.imag], axis=-1)


def rays_from(pose: Pose, *boxes: OrientedBox) -> Array:
    """What the rays read there, by the slab method."""
    x, y = pose.x + cos(pose.yaw) * SENSOR[0], pose.y + sin(pose.yaw) * SENSOR[0]
    return ray_distances((x, y), ray_angles() + pose.yaw, as_rows(boxes), paper.SENSOR_RANGE)


class TestWhatPasses:
    def test_in_the_open_the_agent_drives(
        self, kinematic: KinematicSimulator, around: Callable[..., Shield], empty_world: WorldSpec
    ) -> None:
        shield = around(Wilful(lambda o: nearest_turns(o.target_bearing)))
        summary, done, _ = drive(kinematic, empty_world, shield)
        assert summary.ending == "goal"
        assert all(action < len(paper.TURNS) for action in done)

    @pytest.mark.parametrize("seed", range(5))
    @pytest.mark.parametrize("name", ["cover_10", "cover_20", "aisles"])
    def test_no_agent_gets_it_to_touch_what_stands(
        self, kinematic: KinematicSimulator, around: Callable[..., Shield], name: str, seed: int
    ) -> None:
        world = load_world(name).draw(seed, 0.8)
        for recovers in (True, False):
            summary, _, _ = drive(kinematic, world, around(Wilful(suicidal), recovers=recovers), steps=120)
            assert summary.ending in ("timeout", "stuck")
            assert summary.clearance > 0.02
            assert summary.overridden_steps > 5

    @pytest.mark.parametrize("seed", range(4))
    @pytest.mark.parametrize("manner", [STOP, REVERSE, SLOW])
    def test_no_manoeuvre_gets_it_to_touch_what_stands(
        self, kinematic: KinematicSimulator, around: Callable[..., Shield], manner: int, seed: int
    ) -> None:
        chance, world = np.random.default_rng(seed), load_world("cover_20").draw(seed, 0.8)
        for agent in (always(manner), Wilful(lambda o: manner + chance.integers(ACTIONS, size=len(o.speed)))):
            summary, done, _ = drive(kinematic, world, around(agent), steps=100)
            assert summary.ending in ("timeout", "stuck")
            assert summary.clearance > 0.02
            assert any(action >= manner for action in done)

    def test_a_manoeuvre_is_done_where_the_vehicle_can_stop_after_it(
        self, kinematic: KinematicSimulator, around: Callable[..., Shield], world_of: WorldOf, empty_world: WorldSpec
    ) -> None:
        """Elsewhere its heading change counts: one that cannot go backwards goes ahead."""
        blocked = world_of(OrientedBox(MIDDLE.x - 0.6, MIDDLE.y, 0.2, 2.0), target=(190.0, 100.0))
        for wanted in range(ACTIONS, MANOEUVRES):
            for world in (empty_world, blocked):
                shield = Driving(around(always(wanted)))
                observed = replace(begun(Navigation(kinematic, TaskOptions()), world), speed=np.zeros(1))
                done = int(shield.act(observed)[0])
                if world is empty_world:
                    assert done == wanted
                elif REVERSE <= wanted < SLOW:
                    assert done < STOP
                assert shield.overridden == [done != wanted]

    @pytest.mark.parametrize("offset", [0.0, 0.4])
    @pytest.mark.parametrize("gap", np.linspace(3.0, 5.0, 7).tolist())
    def test_it_stops_before_a_wall_that_has_no_end(
        self, kinematic: KinematicSimulator, around: Callable[..., Shield], world_of: WorldOf, gap: float, offset: float
    ) -> None:
        wall = OrientedBox(MIDDLE.x + 0.9 + gap + 1.0, MIDDLE.y, 1.0, 80.0, offset)
        sides = [OrientedBox(MIDDLE.x, MIDDLE.y + side * 2.5, 40.0, 1.0) for side in (1, -1)]
        summary, done, _ = drive(kinematic, world_of(wall, *sides), around(always(0), recovers=False), steps=12)
        assert summary.ending == "timeout"
        assert any(action >= STOP for action in done)
        assert summary.clearance > 0.25

    def test_the_next_best_by_value_is_taken(
        self, kinematic: KinematicSimulator, around: Callable[..., Shield], world_of: WorldOf
    ) -> None:
        """A long wall close on the left: left turns lead into it, straight on and right turns do not."""
        wall = OrientedBox(MIDDLE.x + 10.0, MIDDLE.y + 1.6, 20.0, 0.5)
        navigation = Navigation(kinematic, TaskOptions())
        observed = begun(navigation, world_of(wall))
        for values, expected in (
            ([0.0, 5.0, 9.0, 3.0, 1.0], 3),
            ([4.0, 5.0, 9.0, 3.0, 1.0], 0),
            ([0.0, 5.0, 9.0, 3.0, 3.5], 4),
        ):
            shield = Driving(around(always(2, np.array(values))))
            assert shield.act(observed).tolist() == [expected]
            assert shield.overridden == [True]
        shield = Driving(around(always(4)))
        assert shield.act(observed).tolist() == [4]
        assert shield.overridden == [False]

    def test_without_values_the_nearest_turn_is_taken(
        self, kinematic: KinematicSimulator, around: Callable[..., Shield], world_of: WorldOf
    ) -> None:
        wall = OrientedBox(MIDDLE.x + 10.0, MIDDLE.y + 1.6, 20.0, 0.5)
        observed = begun(Navigation(kinematic, TaskOptions()), world_of(wall, target=(190.0, 100.0)))
        shield = Driving(around(always(2)))
        assert shield.act(observed)[0] in (0, TOWARD_TARGET)

    @pytest.mark.parametrize("seed", range(8))
    def test_what_it_admits_is_clear_by_another_reckoning(
        self, kinematic: KinematicSimulator, around: Callable[..., Shield], seed: int
    ) -> None:
        """Every action is driven for 2 m: its turn, then straight on."""
        world = load_world("cover_20").draw(seed, 0.8)
        solids = shapely.union_all([shapely.Polygon(box.corners()) for box in world.obstacles + world.walls])
        navigation, behind = Navigation(kinematic, TaskOptions()), [0] * (5 + 3 * seed)
        admitted = refused = 0
        for wanted in range(len(paper.TURNS)):
            observed = begun(navigation, world)
            for action in behind:
                transition = step(navigation, action)
                if ending(transition):
                    return
                observed = transition.s_t
            shield = Driving(around(always(wanted)))
            passes = int(shield.act(observed)[0]) == wanted
            trace: list[Sample] = []
            first = Alone(kinematic).advance(paper.TURNS[wanted], trace)
            if not first.touching:
                Alone(kinematic).advance(first.heading_error, trace)
            corners = [(0.9, 0.325), (-0.2, 0.325), (-0.2, -0.325), (0.9, -0.325)]
            nearest = inf
            for p in (sample.pose for sample in trace):
                c, s = cos(p.yaw), sin(p.yaw)
                footprint = shapely.Polygon([(p.x + c * x - s * y, p.y + s * x + c * y) for x, y in corners])
                nearest = min(nearest, footprint.distance(solids))
            admitted, refused = admitted + passes, refused + (not passes)
            if passes:
                assert nearest > 0.1
            else:
                assert nearest < 6.0
        assert admitted + refused == len(paper.TURNS)


class TestStops:
    def pocket(self, world_of: WorldOf) -> WorldSpec:
        """A dead end in which the vehicle can only turn round on the spot, its target behind the back wall."""
        back = OrientedBox(MIDDLE.x + 6.0, MIDDLE.y, 0.5, 2.5)
        sides = [OrientedBox(MIDDLE.x + 2.0, MIDDLE.y + side * 2.0, 4.0, 0.5) for side in (1, -1)]
        return world_of(back, *sides, target=(120.0, 100.0))

    @pytest.mark.parametrize("engine", ["kinematic", "bullet"])
    def test_it_turns_round_in_a_dead_end_to_one_side_and_finds_the_way(
        self, vehicle: VehicleSpec, around: Callable[..., Shield], world_of: WorldOf, engine: str
    ) -> None:
        made = (
            KinematicSimulator(vehicle, DRIVE, 1)
            if engine == "kinematic"
            else contact_simulator("bullet", "fast", vehicle, DRIVE, 1)
        )
        with closing(made) as simulator:
            summary, done, _ = drive(simulator, self.pocket(world_of), around(always(TOWARD_TARGET)), steps=200)
        assert summary.ending == "goal"
        stops = [action for action in done if STOP <= action < REVERSE]
        pivots = [action - STOP for action in stops if action not in (STOP, STOP + TOWARD_TARGET)]
        assert pivots
        first = pivots[: max(1, len(pivots) // 2)]
        assert all(turn in (1, 2) for turn in first) or all(turn in (3, 4) for turn in first)
        assert summary.stop_steps == len(stops)
        assert summary.overridden_steps >= summary.stop_steps > 0
        assert 0 < summary.standing_time < summary.duration / 2

    def test_it_backs_out_of_a_dead_end_that_is_too_narrow_to_turn_in(
        self, kinematic: KinematicSimulator, around: Callable[..., Shield], world_of: WorldOf
    ) -> None:
        end = OrientedBox(MIDDLE.x + 4.5, MIDDLE.y, 0.5, 2.0)
        sides = [OrientedBox(MIDDLE.x + 1.5, MIDDLE.y + side * 1.2, 3.0, 0.5) for side in (1, -1)]
        world = world_of(end, *sides, target=(70.0, 100.0))
        summary, done, poses = drive(kinematic, world, around(always(TOWARD_TARGET)), steps=120)
        assert summary.ending == "goal"
        turned = next(pose for pose in poses if abs(pose.yaw) > pi / 2)
        assert turned.x < MIDDLE.x - 1.0
        assert sum(REVERSE <= action < SLOW for action in done) > 3

    @pytest.mark.parametrize("speed", [-0.5, 0.0, 0.7, 2.0])
    @pytest.mark.parametrize("goal", [-0.5, 0.0, 0.5, 2.0])
    def test_the_way_until_it_stands_is_that_of_even_acceleration(self, speed: float, goal: float) -> None:
        period, acceleration, deceleration = 0.5, 2.5, 2.0
        change = acceleration if goal > speed else deceleration
        ramp = min(abs(goal - speed) / change, period)
        after = speed + np.sign(goal - speed) * change * ramp
        way = (speed + after) / 2 * ramp + after * (period - ramp) + after * abs(after) / (2 * deceleration)
        for turn in (0.0, 0.3):
            driven, then, course = np.empty((9, 5)), np.empty((99, 5)), np.empty((108, 3))
            count = fill_drive(driven, 0.0, speed, turn, goal, period, 1.5, 7.0, change, False)
            rate, after_all = driven[count - 1, 3:]
            stop = time_to_stop(rate, after_all, 0.0, 1.5, 7.0, deceleration, False)
            more = fill_drive(then, rate, after_all, 0.0, 0.0, stop, 1.5, 7.0, deceleration, False)
            course = course[: join(course, driven, count, then, more)]
            assert course[-1, 2] == pytest.approx(turn)
            assert turn or course[-1] == pytest.approx([way, 0.0, 0.0], abs=0.01)

    @pytest.mark.parametrize("rate", [-1.0, 0.0, 1.0])
    @pytest.mark.parametrize("speed", [0.0, 0.5, 1.0])
    def test_after_what_is_admitted_the_next_decision_admits_a_stop(
        self, vehicle: VehicleSpec, speed: float, rate: float
    ) -> None:
        """Beside a thin pole, for a vehicle that turns just as asked and may yet fall behind while it brakes."""
        p, limits, driven = setting_with(vehicle), vehicle.limits, np.empty((9, 5))
        chance, admitted = np.random.default_rng(4), 0
        for _ in range(400):
            manoeuvre, pole = int(chance.choice([1, 2, SLOW + 1, SLOW + 2])), chance.uniform([0.3, 0.3], [1.6, 1.5])
            goal, turn = float(speed_scale(manoeuvre, DRIVE)) * DRIVE.speed, paper.TURNS[manoeuvre % ACTIONS]
            if not can_stop(p, beside(p, pole), manoeuvre, turn, rate, speed, 0.06):
                continue
            asked = limits.yaw_rate, limits.yaw_acceleration, limits.acceleration
            count = fill_drive(driven, rate, speed, turn, goal, DRIVE.decision_period, *asked, False)
            *pose, after, slower = driven[count - 1]
            there = beside(p, seen_from(np.array(pose), pole[None])[0])
            straight = paper.TURNS[0]
            assert can_stop(
                p, there, STOP, straight, after, slower, 0.02
            )  # less: for what lies between predicted poses
            admitted += 1
        assert admitted > 50

    @pytest.mark.parametrize(("friction", "load"), [(0.4, 0.0), (0.4, 80.0), (0.8, 80.0)])
    def test_slippery_ground_and_a_load_take_more_room(
        self, vehicle: VehicleSpec, world_of: WorldOf, friction: float, load: float
    ) -> None:
        """As much as a control period and stopping take, and that is enough for contact physics."""
        laden = loaded(vehicle.gripping(friction), deck_load(vehicle, load))
        for its in (vehicle, laden):
            shield = Driving(Shield(ShieldOptions(recovers=False), always(0), its, DRIVE, TaskOptions()))
            with closing(KinematicSimulator(its, DRIVE, 1)) as simulator:
                passes = []
                for gap in np.arange(1.5, 6.0, 0.1):
                    wall = world_of(OrientedBox(MIDDLE.x + 0.9 + gap + 1.0, MIDDLE.y, 1.0, 60.0))
                    shield.reset(0)
                    observed = begun(Navigation(simulator, TaskOptions()), wall)
                    passes.append(shield.act(observed)[0] == 0)
            assert passes == sorted(passes)
            deceleration = min(its.limits.acceleration, 0.9 * turning_deceleration(its, DRIVE.speed))
            needed = max(2.0, DRIVE.speed * 0.5 + DRIVE.speed**2 / (2 * deceleration)) + 0.3
            assert 1.5 + 0.1 * passes.index(True) == pytest.approx(needed, abs=0.3)
        with closing(contact_simulator("bullet", "fast", laden, DRIVE, 1)) as simulator:
            world = load_world("cover_10").draw(9, 0.8)
            assert drive(simulator, world, shield.policy, steps=120)[0].ending in ("timeout", "stuck")

    def test_a_slow_vehicle_that_slides_stops_before_what_it_was_foreseen_to_clear(
        self, vehicle: VehicleSpec, empty_world: WorldSpec
    ) -> None:
        """In contact physics: a slow turn and a stop, after others, beside poles that could stand anywhere."""
        laden, chance = loaded(vehicle.gripping(0.4), deck_load(vehicle, 80.0)), np.random.default_rng(2)
        p, share, box, admitted = setting_with(laden), DRIVE.reverse_share, laden.footprint, 0
        with Alone(contact_simulator("bullet", "fast", laden, DRIVE, 1)) as driven:
            for before, turn in chance.integers(5, size=(10, 2)):
                driven.reset(empty_world)
                for turned, scale in [(0.0, 0.0)] * 5 + [(0.0, share)] * 4 + [(paper.TURNS[before], share)]:
                    now = driven.advance(turned, speed_scale=scale)
                start, trace = driven.pose, list[Sample]()
                for turned, scale in [(paper.TURNS[turn], share)] + [(0.0, 0.0)] * 4:
                    driven.advance(turned, trace, speed_scale=scale)
                poses = np.array([(its.pose.x, its.pose.y, its.pose.yaw) for its in trace])
                places = seen_from(np.array([start.x, start.y, start.yaw]), poses[:, :2])
                poles = chance.uniform([0.0, -1.2], [2.0, 1.2], size=(40, 2))
                for pole in poles:
                    motion = paper.TURNS[turn], now.yaw_rate, now.speed
                    if not can_stop(p, beside(p, pole), SLOW + int(turn), *motion, 0.06):
                        continue
                    admitted += 1
                    away = [
                        seen_from(np.array([*at, yaw - start.yaw]), pole[None])[0]
                        for at, yaw in zip(places, poses[:, 2], strict=True)
                    ]
                    ahead, left = np.transpose(away)
                    inside = (np.abs(ahead - box.x) < box.half_length) & (np.abs(left - box.y) < box.half_width)
                    assert not inside.any()
        assert admitted > 80

    def test_a_standing_vehicle_makes_way_for_what_comes(
        self, kinematic: KinematicSimulator, around: Callable[..., Shield], world_of: WorldOf
    ) -> None:
        """A box comes at 1 m/s along the vehicle's way; an agent that goes straight on would be hit."""
        patrol = Patrol(OrientedBox(MIDDLE.x + 14.0, MIDDLE.y, 0.5, 1.5), (MIDDLE.x - 20.0, MIDDLE.y), 1.0, 0.0)
        world = replace(world_of(target=(190.0, 100.0)), patrols=(patrol,))
        summary, _, _ = drive(kinematic, world, around(always(TOWARD_TARGET)), steps=200)
        assert summary.ending == "goal"
        assert summary.clearance > 0.3


class TestMemory:
    def test_it_reckons_where_the_kinematic_model_goes(
        self, kinematic: KinematicSimulator, around: Callable[..., Shield], empty_world: WorldSpec
    ) -> None:
        wanted = iter([0, 1, 2, 4, TOWARD_TARGET, 3, 0, 2])
        shield = Driving(around(Wilful(lambda o: np.array([next(wanted)]))))
        navigation = Navigation(kinematic, TaskOptions())
        observed, before = begun(navigation, empty_world), empty_world.start
        for _ in range(8):
            transition = navigation.step(shield.act(observed))
            pose, observed = row(transition.motion, 0).pose, transition.s_t
            memory, dx, dy = shield.state.memories[0], pose.x - before.x, pose.y - before.y
            c, s = cos(before.yaw), sin(before.yaw)
            assert memory.known.moved[:2] == pytest.approx([c * dx + s * dy, c * dy - s * dx], abs=2e-3)
            before = pose

    @pytest.mark.parametrize("seed", range(3))
    def test_what_it_remembers_stands_where_it_remembers_it(
        self, kinematic: KinematicSimulator, around: Callable[..., Shield], seed: int
    ) -> None:
        world = load_world("cover_20").draw(seed, 0.8)
        solids = shapely.union_all([shapely.Polygon(box.corners()) for box in world.obstacles + world.walls])
        shield, navigation = Driving(around(Wilful(suicidal))), Navigation(kinematic, TaskOptions())
        observed, pose, missed = begun(navigation, world), world.start, 0
        for _ in range(40):
            actions = shield.act(observed)
            known = shield.state.memories[0].known
            points = known.standing[: known.numbers[STANDING]]
            places = (points[:, :2] @ [1, 1j]) * np.exp(1j * pose.yaw) + complex(pose.x, pose.y)
            apart = shapely.distance(shapely.points(places.real, places.imag), solids.boundary)
            assert (apart < 0.05).all()
            missed += int((points[:, 2] > 0).sum())
            transition = navigation.step(actions)
            observed, pose = transition.s_t, row(transition.motion, 0).pose
        assert missed > 40

    def test_an_agent_that_remembers_is_told_what_was_done(
        self, kinematic: KinematicSimulator, around: Callable[..., Shield], world_of: WorldOf
    ) -> None:
        class Remembering(Wilful):
            def decide(self, observations: Observation) -> NDArray[np.int64]:
                wanted.append(int(super().decide(observations)[0]))
                return np.array(wanted[-1:])

            def override(self, state: None, actions: NDArray[np.int64]) -> None:
                told.extend(actions.tolist())

        wanted: list[int] = []
        told: list[int] = []
        world = world_of(OrientedBox(115.0, 100.0, 1.0, 8.0), target=(190.0, 100.0))
        _, done, _ = drive(kinematic, world, around(Remembering(suicidal)), steps=40)
        assert told == done
        assert wanted != done

    def test_one_that_reckons_its_heading_does_not_lose_it(
        self, vehicle: VehicleSpec, kinematic: KinematicSimulator, around: Callable[..., Shield]
    ) -> None:
        """Against the simulator's, though the shield turns it, at speed and on the spot."""
        agent = Vfh(VfhOptions(), vehicle, DRIVE)
        shield, navigation = Driving(around(agent)), Navigation(kinematic, TaskOptions())
        world = load_world("traps").draw(0, 0.8)
        observed = begun(navigation, world)
        instead = []
        for _ in range(150):
            actions = shield.act(observed)
            instead += actions.tolist() if shield.overridden[0] else []
            transition = navigation.step(actions)
            observed, turned = transition.s_t, float(transition.motion.pose[0, 2]) - world.start.yaw
            assert wrap_angle(float(shield.state.agent.headings[0]) - turned) == pytest.approx(0.0, abs=1e-6)
        assert min(instead) < STOP < max(instead)

    def test_vehicles_of_a_fleet_are_driven_as_each_alone(
        self, vehicle: VehicleSpec, kinematic: KinematicSimulator, around: Callable[..., Shield]
    ) -> None:
        worlds = [load_world(name).draw(seed, 0.8) for name in ("cover_20", "moving") for seed in (1, 2)]
        task = TaskOptions(max_steps=60)
        alone = [run_episode(Navigation(kinematic, task), world, around(Wilful(suicidal))) for world in worlds]
        with closing(KinematicSimulator(vehicle, DRIVE, 6)) as fleet:  # two have nothing to do
            together = run_episodes(Navigation(fleet, task), worlds, around(Wilful(suicidal)))
        for one, other in zip(alone, together, strict=True):
            expected, found = asdict(one), asdict(other)
            assert found.pop("terms") == pytest.approx(expected.pop("terms"))
            assert found.pop("episode_return") == pytest.approx(expected.pop("episode_return"))
            assert found == expected

    def test_an_agent_without_a_shield_is_never_overridden(
        self, kinematic: KinematicSimulator, empty_world: WorldSpec
    ) -> None:
        decision, _ = decide(always(0), begun(Navigation(kinematic, TaskOptions()), empty_world), None)
        assert decision.overridden.tolist() == [False]


def arc(way: float, turn: float) -> Array:
    """Where a vehicle gets that turns evenly on its way (3,)."""
    chord = way * np.sinc(turn / 2 / pi)
    return np.array([chord * cos(turn / 2), chord * sin(turn / 2), turn])


def found(reckoned: Array, target: complex, pose: Array) -> Array:
    """The pose that is found by a target that is seen from the true one."""
    seen = (target - complex(pose[0], pose[1])) * np.exp(-1j * pose[2])
    corrected = np.empty(3)
    found_pose(corrected, reckoned, np.array([target.real, target.imag]), abs(seen), float(np.angle(seen)))
    return corrected


class TestReckoning:
    @given(st.floats(0.2, 1.0), st.floats(-0.8, 0.8), st.floats(3.0, 100.0), st.floats(-pi, pi))
    def test_who_went_as_reckoned_is_found_there(
        self, way: float, turn: float, distance: float, bearing: float
    ) -> None:
        pose, target = arc(way, turn), distance * np.exp(1j * bearing)
        assert found(pose, target, pose) == pytest.approx(pose, abs=1e-9)

    @given(
        st.tuples(st.floats(0.5, 1.0), st.floats(-0.6, 0.6)),
        st.tuples(st.floats(-0.1, 0.1), st.floats(-0.4, 0.4)),
        st.floats(10.0, 100.0),
        st.floats(-1.0, 1.0),
    )
    def test_who_went_another_way_is_found_on_it(
        self, way: tuple[float, float], off: tuple[float, float], distance: float, bearing: float
    ) -> None:
        """With a target ahead: the length of the way shows in its distance as far as that is along it."""
        true, target = arc(way[0] + off[0], way[1] + off[1]), distance * np.exp(1j * bearing)
        went = found(arc(*way), target, true)
        across = abs(off[0]) * abs(sin(bearing - true[2] / 2))
        assert np.hypot(*(went - true)[:2]) < across + 0.03
        assert went[2] == pytest.approx(true[2], abs=2 * (across + 0.03) / distance)

    @pytest.mark.parametrize(("friction", "load"), [(0.4, 0.0), (0.8, 80.0)])
    def test_what_slips_takes_nothing_that_stands_for_what_moves(
        self, vehicle: VehicleSpec, friction: float, load: float
    ) -> None:
        """A vehicle that cannot follow what is asked of it, in contact physics, among boxes of which none moves."""
        laden, shares = loaded(vehicle.gripping(friction), deck_load(vehicle, load)), []
        with closing(contact_simulator("bullet", "fast", laden, DRIVE, 1)) as simulator:
            for seed in (1, 8, 16):
                bare = Shield(ShieldOptions(), always(TOWARD_TARGET), laden, DRIVE, TaskOptions())
                shield = Driving(bare)
                navigation = Navigation(simulator, TaskOptions())
                observed, moving = begun(navigation, load_world("cover_20").draw(seed, 0.8)), 0
                for _ in range(80):
                    moving += int(bare.perceived(observed, shield.state.memories)[1][0].known.numbers[MOVING] > 0)
                    transition = navigation.step(shield.act(observed))
                    assert not transition.motion.touching
                    observed = transition.s_t
                shares.append(moving / 80)
        assert np.mean(shares) < 0.05  # corners, seen between two rays


class TestNewcomers:
    @pytest.mark.parametrize("seed", range(6))
    def test_nothing_that_stands_has_come(self, kinematic: KinematicSimulator, seed: int) -> None:
        world = load_world("cover_20").draw(seed, 0.8)
        alone = Alone(kinematic)
        alone.reset(world)
        chance = np.random.default_rng(seed)
        before, then, found = alone.rays, alone.pose, 0
        for _ in range(40):
            if alone.advance(float(chance.choice(paper.TURNS))).touching:
                break
            now, rays = alone.pose, alone.rays
            c, s = cos(then.yaw), sin(then.yaw)
            dx, dy = now.x - then.x, now.y - then.y
            moved = np.array([c * dx + s * dy, c * dy - s * dx, now.yaw - then.yaw])
            found += int(moving_points(point_cloud(rays, MOUNTED), before, moved, 0.0, SENSOR).sum())
            before, then = rays, now
        assert found <= 4  # a corner, seen between two rays

    @pytest.mark.parametrize(("speed", "strayed"), [(0.5, 0.0), (1.0, 0.0), (1.0, 0.2)])
    def test_a_box_that_has_come_nearer_has(self, speed: float, strayed: float) -> None:
        box = OrientedBox(MIDDLE.x + 5.0, MIDDLE.y, 0.5, 1.0)
        came = replace(box, x=box.x - 0.5 * speed)
        before, now = rays_from(MIDDLE, box), rays_from(MIDDLE, came)
        points = point_cloud(now, MOUNTED)
        found = moving_points(points, before, np.zeros(3), strayed, SENSOR)
        assert found.sum() >= 0.8 * np.isfinite(points[:, 0]).sum() > 0
        gone = point_cloud(rays_from(MIDDLE, replace(box, x=box.x + 0.5 * speed)), MOUNTED)
        assert not moving_points(gone, before, np.zeros(3), strayed, SENSOR).any()
        assert not moving_points(points, np.full(RAYS, np.nan), np.zeros(3), strayed, SENSOR).any()


class TestSectorFaults:
    def dead(self, rays: Array, sector: int) -> Array:
        silenced = rays.copy()
        silenced[9 * sector : 9 * sector + 9] = paper.SENSOR_RANGE
        return silenced

    def test_open_ground_speaks_against_nobody(self) -> None:
        assert contradictions(NOTHING, NO_POINTS, SENSOR, RANGE).tolist() == [0.0] * 8

    @pytest.mark.parametrize("sector", range(8))
    def test_a_wall_that_goes_on_inside_speaks_against_a_sector(self, sector: int) -> None:
        angle = sector * paper.SECTOR_ANGLE
        wall = OrientedBox(MIDDLE.x + 4.0 * cos(angle), MIDDLE.y + 4.0 * sin(angle), 1.0, 8.0, angle)
        rays = self.dead(rays_from(MIDDLE, wall), sector)
        against = contradictions(rays, NO_POINTS, SENSOR, RANGE)
        assert against[sector] == 1.0
        assert np.delete(against, sector).max() <= 0.5  # where the wall ends, it may end at a border

    @pytest.mark.parametrize("sector", range(8))
    def test_points_that_should_be_there_speak_against_it(self, sector: int) -> None:
        angle = sector * paper.SECTOR_ANGLE
        expected = NO_POINTS.copy()
        expected[:3] = SENSOR + 5.0 * np.array([[cos(angle + d), sin(angle + d)] for d in (-0.1, 0.0, 0.1)])
        assert contradictions(NOTHING, expected, SENSOR, RANGE)[sector] == 3.0
        heard = NOTHING.copy()
        heard[9 * sector + 2] = 9.5
        assert contradictions(heard, expected, SENSOR, RANGE)[sector] == 0.0
        expected[:3] = SENSOR + 9.0 * (expected[:3] - SENSOR) / 5.0
        assert contradictions(NOTHING, expected, SENSOR, RANGE)[sector] == 0.0  # it may have got out of range

    def test_a_dead_sector_reads_as_the_nearer_of_its_borders_and_what_was_there(self) -> None:
        rays = NOTHING.copy()
        rays[8], rays[18] = 6.0, 4.0  # left of the front sector, and left of the sector at 45 degrees
        dead = np.zeros(8, np.bool_)
        dead[1] = True
        expected = NO_POINTS.copy()
        expected[40] = SENSOR + 2.0 * np.array([cos(radians(45)), sin(radians(45))])
        expected[41] = SENSOR + 1.0 * np.array([cos(radians(90)), sin(radians(90))])  # in a sector that sees
        whole, remembered = completed(rays, dead, expected, SENSOR, RANGE)
        inside = [4.0, 4.0, 4.0, 4.0, 2.0, 4.0, 4.0, 4.0, 4.0]
        assert whole[9:18] == pytest.approx(inside)
        assert np.delete(whole, range(9, 18)) == pytest.approx(np.delete(rays, range(9, 18)))
        assert np.flatnonzero(np.isfinite(remembered[:, 0])).tolist() == [13]
        assert remembered[13] == pytest.approx(expected[40])

    @pytest.mark.parametrize("sector", [0, 1, 7])
    def test_untold_it_finds_out_and_survives(
        self, kinematic: KinematicSimulator, around: Callable[..., Shield], sector: int
    ) -> None:
        """Where the bare agent, which heads for the target, does not."""
        faulty = FaultySimulator(kinematic, SensorFaults(dead_sector=sector))
        for seed in (0, 1, 2, 3):
            world, shield = load_world("cover_10").draw(seed, 0.8), around(always(TOWARD_TARGET))
            summary, _, _ = drive(faulty, world, shield)
            assert summary.ending == "goal"

    def test_sound_sensors_are_hardly_ever_doubted(
        self, kinematic: KinematicSimulator, around: Callable[..., Shield]
    ) -> None:
        doubted = decisions = 0
        for seed in range(4):
            shield = Driving(around(always(TOWARD_TARGET)))
            navigation = Navigation(kinematic, TaskOptions())
            observed = begun(navigation, load_world("cover_10").draw(seed, 0.8))
            for _ in range(90):
                transition = navigation.step(shield.act(observed))
                doubted += int((shield.state.memories[0].known.evidence >= ENOUGH).any())
                decisions += 1
                if ending(transition):
                    break
                observed = transition.s_t
        assert doubted < 0.03 * decisions


class TestEscape:
    def waiting(self, recovery: Recovery, seconds: float, distance: float = 50.0) -> Recovery:
        for _ in range(round(seconds / 0.5)):
            recovery = recovery.updated(distance, 0.5, 1.0)
        return recovery

    def test_it_leads_after_some_time_without_progress_until_it_is_nearer_than_ever(self) -> None:
        recovery = self.waiting(Recovery(), STUCK_AFTER + 0.5)
        assert not recovery.leads(50.0)
        recovery = self.waiting(recovery, 0.5)
        assert recovery.leads(50.0)
        assert recovery.leads(90.0)
        assert recovery.leads(50.0 - FIRST_GAIN + 0.1)
        assert not recovery.leads(50.0 - FIRST_GAIN - 0.1)

    def test_each_leads_farther_than_the_one_before(self) -> None:
        recovery, distance = Recovery(), 1000.0
        for count in range(1, 4):
            recovery = self.waiting(recovery, STUCK_AFTER + 1.0, distance)
            assert recovery.recoveries == count
            assert recovery.led_until == pytest.approx(distance - FIRST_GAIN * GAIN_GROWTH ** (count - 1))
            recovery = self.waiting(recovery, 2 * STUCK_AFTER, distance)
            assert recovery.recoveries == count
            distance = recovery.led_until - 1.0

    @pytest.mark.parametrize(("width", "place"), [(1.0, 0.5), (1.3, -4.05), (2.0, -3.7)])
    def test_it_finds_the_only_way_out_of_a_room(
        self,
        kinematic: KinematicSimulator,
        around: Callable[..., Shield],
        world_of: WorldOf,
        width: float,
        place: float,
    ) -> None:
        """A door behind the vehicle, in the middle or in a corner, hardly wider than its width and margins."""
        front = OrientedBox(MIDDLE.x + 5.0, MIDDLE.y, 0.3, 5.3)
        sides = [OrientedBox(MIDDLE.x, MIDDLE.y + side * 5.0, 5.0, 0.3) for side in (1, -1)]
        back = [(-4.7, place - width / 2), (place + width / 2, 4.7)]
        behind = [
            OrientedBox(MIDDLE.x - 5.0, MIDDLE.y + (low + high) / 2, 0.3, (high - low) / 2)
            for low, high in back
            if high > low + 1e-6
        ]
        world = world_of(front, *behind, *sides, target=(125.0, 100.0))
        summary, _, _ = drive(kinematic, world, around(always(TOWARD_TARGET)), steps=300)
        assert summary.ending == "goal"
        assert summary.clearance > 0.03


class TestRecords:
    def test_a_recording_keeps_where_it_intervened_and_older_ones_load(
        self, vehicle: VehicleSpec, kinematic: KinematicSimulator, around: Callable[..., Shield], tmp_path: Path
    ) -> None:
        shield = around(Wilful(suicidal))
        recorder = Recorder(vehicle)
        world = load_world("cover_20").draw(2, 0.8)
        summary = run_episode(Navigation(kinematic, TaskOptions(max_steps=40)), world, shield, watcher=recorder)
        recording = recorder.recording()
        assert recording.overridden.shape == recording.action.shape
        assert recording.overridden.sum() == summary.overridden_steps > 0
        assert ((recording.action >= STOP) & (recording.action < REVERSE)).sum() == summary.stop_steps
        recording.save(tmp_path / "new.npz")
        assert np.array_equal(load_recording(tmp_path / "new.npz").overridden, recording.overridden)
        with np.load(tmp_path / "new.npz") as stored:
            np.savez(tmp_path / "old.npz", **{name: stored[name] for name in stored.files if name != "overridden"})
        older = load_recording(tmp_path / "old.npz")
        assert older.overridden.tolist() == [False] * len(older.action)

    def test_it_is_part_of_the_configuration(self, tmp_path: Path) -> None:
        (tmp_path / "mine.toml").write_text("[agent]\nkind = 'straight'\n\n[shield]\nmargin = 0.4\n")
        config = load_config(str(tmp_path / "mine.toml"), {})
        assert config.shield == ShieldOptions(margin=0.4)
        assert RunConfig().shield is None
        policy = Experiment(config).policy
        assert isinstance(policy, Shield)
        assert policy.options.margin == 0.4
        with pytest.raises(UserError, match=r"unknown key 'shield.margins' .*; valid keys: box_speed"):
            load_config("paper", {"shield": {"margins": 1}})

    def test_each_policy_is_followed_by_itself_in_a_shield(self, tmp_path: Path) -> None:
        found = open_policies([Path("straight"), Path("hand_rule")], shield=True)
        assert [p.name for p in found] == ["straight", "straight+shield", "hand_rule", "hand_rule+shield"]
        assert [p.method for p in found] == [p.name for p in found]
        assert len({p.fingerprint for p in found}) == 4
        assert [p.fingerprint for p in found[::2]] == [
            p.fingerprint for p in open_policies([Path("straight"), Path("hand_rule")])
        ]

    def test_drive_drives_in_it(
        self, run_cli: RunCli, small_world: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.chdir(tmp_path)
        code, out, err = run_cli("drive", "straight", "--world", small_world, "--sim", "kinematic", "--shield")
        assert code == 0, err
        recording = load_recording(Path("runs/straight/drives/small-0-kinematic-shield/trajectory.npz"))
        assert recording.about["policy"] == "straight + shield"
        assert "goal" in out

    def test_evaluate_reports_it_beside_the_bare_policy(
        self, run_cli: RunCli, small_world: Path, tmp_path: Path
    ) -> None:
        arguments = ("straight", "--world", small_world, "--worlds", 12, "--sim", "kinematic", "--executor", "inline")
        code, out, err = run_cli("evaluate", *arguments, "--shield", "--out", tmp_path)
        assert code == 0, err
        assert "straight+shield" in out
        values = json.loads((tmp_path / "results.json").read_text())
        bare, shielded = values["rows"]
        assert (bare["overridden"], bare["stops"]) == (0.0, 0.0)
        assert shielded["overridden"] > 0.0
        assert shielded["outcomes"]["collision"][0] <= bare["outcomes"]["collision"][0]
        assert shielded["outcomes"]["goal"][0] == 1.0
        assert values["command"].count("straight") == 1
        assert "--shield" in values["command"]
        report = (tmp_path / "evaluation.md").read_text()
        assert "## The shield" in report
        code, _, _ = run_cli("evaluate", *arguments, "--out", tmp_path / "bare")
        assert code == 0
        assert "## The shield" not in (tmp_path / "bare" / "evaluation.md").read_text()
        again = json.loads((tmp_path / "bare" / "results.json").read_text())["rows"]
        assert again == [bare]


def test_actions_are_still_six() -> None:
    assert (ACTIONS, STOP) == (6, 6)
