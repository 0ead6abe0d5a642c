"""The simulator contract, the task over it, and the Gymnasium environment."""

import random
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from importlib.util import find_spec
from itertools import pairwise
from math import atan2, cos, degrees, hypot, pi, radians, sin
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from shapely.geometry import Polygon
from shapely.ops import unary_union

import nnql_bullet  # noqa: F401 (registers the environment)
from nnql_bullet.env import (
    ACTIONS,
    TOWARD_TARGET,
    Navigation,
    Navigation,
    Observation,
    heading_change,
    stacked,
)
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import OrientedBox, Pose
from nnql_bullet.sensing import RAYS, Scan, sector_readings
from nnql_bullet.sim.base import Motion, Sample, Simulator
from nnql_bullet.sim.bullet import PHYSICS, BulletEngine
from nnql_bullet.sim.engines import contact_simulator
from nnql_bullet.sim.kinematic import KinematicSimulator, KinematicSimulator
from nnql_bullet.task import StateProperty, TaskOptions
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.spec import WorldSpec

SIMULATORS: dict[str, Callable[[VehicleSpec, DriveOptions], Simulator]] = {
    "bullet, reference": lambda vehicle, drive: BulletEngine(vehicle, drive, PHYSICS["reference"]),
    "bullet, fast": lambda vehicle, drive: BulletEngine(vehicle, drive, PHYSICS["fast"]),
    "mujoco, reference": lambda vehicle, drive: contact_simulator("mujoco", "reference", vehicle, drive),
    "mujoco, fast": lambda vehicle, drive: contact_simulator("mujoco", "fast", vehicle, drive),
    "kinematic": KinematicSimulator,
}
"""Every simulator; a new one is added here and has to pass the contract below."""
NEEDS_MUJOCO = pytest.mark.skipif(
    find_spec("mujoco") is None, reason="needs the extra: pip install 'nnql-bullet[mujoco]'"
)
NAMES = [pytest.param(name, marks=NEEDS_MUJOCO) if "mujoco" in name else name for name in SIMULATORS]

WorldOf = Callable[..., WorldSpec]

BOXES = (
    OrientedBox(112.0, 103.0, 1.5, 0.5, 0.4),
    OrientedBox(105.0, 96.0, 2.0, 1.0, -0.3),
    OrientedBox(98.0, 106.0, 1.0, 1.0, 0.0),
)
TURNS = (0.4, -0.8, 0.3, 0.0, 1.0, -0.2)


@pytest.fixture(params=NAMES)
def simulator(request: pytest.FixtureRequest, vehicle: VehicleSpec) -> Iterator[Simulator]:
    made = SIMULATORS[request.param](vehicle, DriveOptions())
    yield made
    made.close()


def footprint_at(pose: Pose) -> Polygon:
    c, s = cos(pose.yaw), sin(pose.yaw)
    corners = [(0.90, 0.325), (-0.20, 0.325), (-0.20, -0.325), (0.90, -0.325)]
    return Polygon([(pose.x + c * x - s * y, pose.y + s * x + c * y) for x, y in corners])


class TestSimulatorContract:
    def test_reset_puts_the_vehicle_on_the_start(self, simulator: Simulator, world_of: WorldOf) -> None:
        start = Pose(50.0, 60.0, -2.5)
        simulator.reset(world_of(start=start))
        pose = simulator.pose()
        assert (pose.x, pose.y, pose.yaw) == pytest.approx((start.x, start.y, start.yaw), abs=1e-9)

    def test_it_starts_at_speed(self, simulator: Simulator, empty_world: WorldSpec) -> None:
        simulator.reset(empty_world)
        motion = simulator.advance(0.0)
        assert motion.path_length == pytest.approx(2.0 * simulator.control_period, rel=1e-3)
        assert motion.speed == pytest.approx(2.0, rel=1e-3)
        assert motion.wheel_speeds == pytest.approx((16.0, 16.0), rel=1e-3)
        assert motion.duration == pytest.approx(simulator.control_period)

    def test_a_positive_turn_goes_left(self, simulator: Simulator, empty_world: WorldSpec) -> None:
        simulator.reset(empty_world)
        left = simulator.advance(radians(30))
        simulator.reset(empty_world)
        right = simulator.advance(radians(-30))
        assert left.pose.y > 100.0 > right.pose.y
        assert left.pose.yaw > 0.0 > right.pose.yaw
        assert (right.pose.x, 200.0 - right.pose.y) == pytest.approx((left.pose.x, left.pose.y), abs=2e-3)

    def test_motion_tells_where_the_vehicle_is(self, simulator: Simulator, empty_world: WorldSpec) -> None:
        simulator.reset(empty_world)
        for turn in TURNS:
            before = simulator.pose()
            motion = simulator.advance(turn)
            assert motion.pose == simulator.pose()
            assert -pi < motion.pose.yaw <= pi
            straight = hypot(motion.pose.x - before.x, motion.pose.y - before.y)
            assert straight <= motion.path_length <= 1.05 * 2.0 * motion.duration
            left_over = (before.yaw + turn - motion.pose.yaw + pi) % (2 * pi) - pi
            assert motion.heading_error == pytest.approx(left_over, abs=1e-9)

    def test_it_follows_the_same_calls_with_the_same_bits(self, simulator: Simulator, world_of: WorldOf) -> None:
        def drive(world: WorldSpec) -> list[Any]:
            simulator.reset(world)
            return [(simulator.advance(turn), simulator.scan().tolist()) for turn in TURNS]

        first = drive(world_of(*BOXES))
        other = drive(world_of(start=Pose(30.0, 30.0, 1.0)))
        assert drive(world_of(*BOXES)) == first != other

    def test_a_trace_changes_nothing_and_runs_through_the_period(
        self, simulator: Simulator, empty_world: WorldSpec
    ) -> None:
        simulator.reset(empty_world)
        plain = [simulator.advance(turn) for turn in TURNS]
        trace: list[Sample] = []
        simulator.reset(empty_world)
        assert [simulator.advance(turn, trace) for turn in TURNS] == plain
        times = [sample.time for sample in trace]
        assert all(earlier < later for earlier, later in pairwise(times))
        assert 0.0 < times[0] <= 0.05
        assert times[-1] == pytest.approx(len(TURNS) * simulator.control_period)
        assert trace[-1].pose == plain[-1].pose
        assert len(trace) >= 20 * len(TURNS) * simulator.control_period

    def test_a_scan_has_72_rays_and_eight_sectors(self, simulator: Simulator, world_of: WorldOf) -> None:
        simulator.reset(world_of(*BOXES))
        scan = simulator.scan()
        assert (scan.distances.shape, scan.readings.shape) == ((72,), (8,))
        assert scan.distances.dtype == scan.readings.dtype == np.float64
        assert 0.0 <= scan.distances.min() < 10.0 == scan.distances.max()
        for sector in range(8):
            assert scan.readings[sector] == scan.distances[9 * sector : 9 * sector + 9].min()

    def test_a_scan_is_repeatable_and_stays_as_it_was(self, simulator: Simulator, world_of: WorldOf) -> None:
        simulator.reset(world_of(*BOXES))
        scan = simulator.scan()
        kept = scan.distances.copy(), scan.readings.copy()
        assert np.array_equal(simulator.scan(), scan.distances)
        simulator.advance(0.5)
        assert not np.array_equal(simulator.scan(), scan.distances)
        assert np.array_equal(scan.distances, kept[0])
        assert np.array_equal(scan.readings, kept[1])

    def test_clearance_is_the_smallest_along_the_way(self, simulator: Simulator, world_of: WorldOf) -> None:
        posts = [OrientedBox(102.0 + 3 * i, 100.0 + (1.4 if i % 2 else -1.2), 0.3, 0.4, 0.5 * i) for i in range(4)]
        solids = unary_union([Polygon(post.corners()) for post in posts])
        simulator.reset(world_of(*posts))
        for turn in (0.1, -0.1, 0.2, -0.25, 0.1, 0.0, 0.3, -0.2):
            trace: list[Sample] = []
            before = simulator.pose()
            motion = simulator.advance(turn, trace)
            assert not motion.touching
            poses = [before, *(sample.pose for sample in trace)]
            expected = min(footprint_at(pose).distance(solids) for pose in poses)
            assert motion.clearance == pytest.approx(expected, abs=0.02)  # samples are 67 mm apart

    def test_contact_and_target_end_the_period(self, simulator: Simulator, world_of: WorldOf) -> None:
        simulator.reset(world_of(OrientedBox(101.9, 100.0, 0.5, 1.0)))
        motion = simulator.advance(0.0)
        assert (motion.touching, motion.at_target, motion.clearance) == (True, False, 0.0)
        assert motion.duration == pytest.approx(0.25, abs=0.02)
        simulator.reset(world_of(target=(101.0, 100.0), target_radius=0.5))
        motion = simulator.advance(0.0)
        assert (motion.touching, motion.at_target) == (False, True)
        assert motion.duration == pytest.approx(0.25, abs=0.02)
        assert motion.clearance > 0.0

    @pytest.mark.parametrize("wall", ["left", "right", "top", "bottom"])
    def test_the_arena_is_walled_in(self, simulator: Simulator, world_of: WorldOf, wall: str) -> None:
        yaw = {"left": pi, "right": 0.0, "top": pi / 2, "bottom": -pi / 2}[wall]
        simulator.reset(world_of(side=8.0, start=Pose(4.0, 4.0, yaw), target=(7.9, 7.9), target_radius=0.1))
        motions = [simulator.advance(0.0) for _ in range(4)]
        assert [motion.touching for motion in motions] == [False, False, False, True]
        assert sum(motion.duration for motion in motions) == pytest.approx((4.0 - 0.9) / 2.0, abs=0.03)

    def test_a_period_may_be_followed_by_a_reset_after_a_contact(
        self, simulator: Simulator, world_of: WorldOf, empty_world: WorldSpec
    ) -> None:
        simulator.reset(empty_world)
        fresh = simulator.advance(0.3)
        simulator.reset(world_of(OrientedBox(101.9, 100.0, 0.5, 1.0)))
        assert simulator.advance(0.0).touching
        simulator.reset(empty_world)
        assert simulator.advance(0.3) == fresh

    @pytest.mark.parametrize("name", NAMES)
    def test_a_period_of_broken_steps_is_refused(self, vehicle: VehicleSpec, name: str) -> None:
        with pytest.raises(UserError, match=r"0\.123 s is not a whole number"):
            SIMULATORS[name](vehicle, DriveOptions(decision_period=0.123))


NOWHERE = Motion(Pose(50.0, 50.0, 0.0), 2.0, 0.0, (16.0, 16.0), 0.5, 1.0, 5.0, 0.0, False, False)
CLEAR = [10.0] * 8
NEAR = [4.0, *[10.0] * 7]
NEARER = [3.0, *[10.0] * 7]


@dataclass
class Puppet:
    """A simulator that plays a script: readings of each state, and the motion to each but the first."""

    readings: list[list[float]]
    motions: list[Motion]
    vehicle: VehicleSpec
    control_period: float = 0.5
    asked: list[float] = field(default_factory=list)

    def reset(self, world: WorldSpec) -> None:
        self._start = world.start
        self.asked.clear()

    def advance(self, heading_change: float, trace: list[Sample] | None = None, speed_scale: float = 1.0) -> Motion:
        self.asked.append(heading_change)
        return self.motions[len(self.asked) - 1]

    def pose(self) -> Pose:
        return self.motions[len(self.asked) - 1].pose if self.asked else self._start

    def scan(self) -> Scan:
        readings = np.array(self.readings[len(self.asked)])
        return Scan(np.repeat(readings, 9), readings)

    def close(self) -> None:
        pass


@pytest.fixture
def navigation_of(vehicle: VehicleSpec, empty_world: WorldSpec) -> Callable[..., Navigation]:
    def make(*states: list[float], motions: list[Motion] | None = None, task: TaskOptions | None = None) -> Navigation:
        script = motions or [NOWHERE] * (len(states) - 1)
        made = Navigation(Puppet(list(states), script, vehicle), task or TaskOptions())
        made.reset(empty_world)
        return made

    return make


TOWARD = [(0.0, 0.0), (20.0, 20.0), (-35.0, -35.0), (60.0, 60.0), (61.0, 60.0), (180.0, 60.0), (-90.0, -60.0)]
"""Bearing of the target and the turn toward it [degrees]."""


class TestObservations:
    SEEN = (
        Observation(np.array(CLEAR), 30.0, 0.5, -0.1, StateProperty.SAFE, np.full(RAYS, 9.0)),
        Observation(np.array(NEAR), 20.0, -0.5, 0.2, StateProperty.NON_SAFE, np.full(RAYS, 5.0)),
        Observation(np.array(NEARER), 1.0, 0.0, 0.0, StateProperty.WINNING, np.full(RAYS, 1.0)),
    )

    def test_stacked_has_a_row_for_each_vehicle(self) -> None:
        many = stacked(self.SEEN)
        assert many.readings.tolist() == [CLEAR, NEAR, NEARER]
        assert many.target_distance.tolist() == [30.0, 20.0, 1.0]
        assert many.target_bearing.tolist() == [0.5, -0.5, 0.0]
        assert many.yaw_rate.tolist() == [-0.1, 0.2, 0.0]
        assert many.ray_distances.tolist() == [[9.0] * RAYS, [5.0] * RAYS, [1.0] * RAYS]
        assert many.state_property.tolist() == [StateProperty.SAFE, StateProperty.NON_SAFE, StateProperty.WINNING]


class TestTransition:
    def test_one_vehicle_and_a_fleet_observe_the_same_to_the_last_bit(
        self, vehicle: VehicleSpec, world_of: WorldOf
    ) -> None:
        """Python's atan2 and NumPy's differ in the last bit for one input in twelve."""
        places = np.random.default_rng(0).uniform((5, 5, -3), (195, 195, 3), (300, 3)).tolist()
        worlds = [world_of(start=Pose(*place), target=(190.0, 150.0)) for place in places]
        navigation = Navigation(KinematicSimulator(vehicle, DriveOptions()), TaskOptions())
        alone = [navigation.reset(world) for world in worlds]
        fleet = Navigation(KinematicSimulator(vehicle, DriveOptions(), len(worlds)), TaskOptions())
        fleet.reset(dict(enumerate(worlds)))
        assert fleet.observations.target_bearing.tolist() == [one.target_bearing for one in alone]
        assert fleet.observations.target_distance.tolist() == [one.target_distance for one in alone]

    def test_the_first_observation_is_of_the_start(self, vehicle: VehicleSpec, world_of: WorldOf) -> None:
        world = world_of(start=Pose(10.0, 20.0, 0.5), target=(40.0, 60.0))
        observation = Navigation(Puppet([NEAR], [], vehicle), TaskOptions()).reset(world)
        assert observation.readings.tolist() == NEAR
        assert sector_readings(observation.ray_distances).tolist() == NEAR
        assert observation.target_distance == pytest.approx(50.0)
        assert observation.target_bearing == pytest.approx(atan2(40.0, 30.0) - 0.5)
        assert observation.yaw_rate == 0.0
        assert observation.state_property is StateProperty.NON_SAFE

    def test_states_are_chained(self, navigation_of: Callable[..., Navigation]) -> None:
        navigation = navigation_of(CLEAR, NEAR, NEARER)
        first, second = navigation.step(0), navigation.step(1)
        assert second.s_tm1 is first.s_t
        assert (first.a_tm1, second.a_tm1) == (0, 1)
        assert first.s_t.readings.tolist() == sector_readings(first.s_t.ray_distances).tolist() == NEAR

    @pytest.mark.parametrize(
        ("before", "after", "flags", "term", "reward"),
        [
            (CLEAR, CLEAR, {}, None, 0.0),
            (CLEAR, NEAR, {}, "safe_to_non_safe", -0.2),
            (NEAR, CLEAR, {}, "non_safe_to_safe", 0.4),
            (NEAR, NEARER, {}, "closer", -0.4),
            (NEARER, NEAR, {}, "away", 0.4),
            (NEAR, NEAR, {}, "away", 0.4),
            (NEAR, NEARER, {"touching": True}, "failure", -0.6),
            (CLEAR, CLEAR, {"at_target": True}, "winning", 1.0),
            (NEAR, CLEAR, {"at_target": True}, "winning", 1.0),
        ],
    )
    def test_the_reward_is_the_sum_of_its_terms(
        self,
        navigation_of: Callable[..., Navigation],
        before: list[float],
        after: list[float],
        flags: dict[str, bool],
        term: str | None,
        reward: float,
    ) -> None:
        transition = navigation_of(before, after, motions=[replace(NOWHERE, **flags)]).step(0)
        assert transition.r_t == reward == sum(transition.terms.values())
        assert {name: value for name, value in transition.terms.items() if value} == ({term: reward} if term else {})
        assert len(transition.terms) == 6

    @pytest.mark.parametrize(
        ("flags", "ending", "discount"),
        [({}, None, 1.0), ({"touching": True}, "collision", 0.0), ({"at_target": True}, "goal", 0.0)],
    )
    def test_the_discount_is_zero_where_the_episode_ends_for_good(
        self, navigation_of: Callable[..., Navigation], flags: dict[str, bool], ending: str | None, discount: float
    ) -> None:
        transition = navigation_of(CLEAR, CLEAR, motions=[replace(NOWHERE, **flags)]).step(0)
        assert (transition.ending, transition.discount_t) == (ending, discount)

    def test_a_timeout_ends_the_episode_with_discount_one(self, navigation_of: Callable[..., Navigation]) -> None:
        navigation = navigation_of(*[CLEAR] * 4, task=TaskOptions(max_steps=3))
        steps = [navigation.step(0) for _ in range(3)]
        assert [step.ending for step in steps] == [None, None, "timeout"]
        assert steps[-1].discount_t == 1.0

    def test_the_goal_at_the_last_step_is_no_timeout(self, navigation_of: Callable[..., Navigation]) -> None:
        motion = replace(NOWHERE, at_target=True)
        transition = navigation_of(CLEAR, CLEAR, motions=[motion], task=TaskOptions(max_steps=1)).step(0)
        assert (transition.ending, transition.discount_t) == ("goal", 0.0)

    def test_reset_counts_steps_anew(self, navigation_of: Callable[..., Navigation], empty_world: WorldSpec) -> None:
        navigation = navigation_of(*[CLEAR] * 3, task=TaskOptions(max_steps=2))
        navigation.step(0)
        navigation.reset(empty_world)
        assert navigation.step(0).ending is None
        assert navigation.step(0).ending == "timeout"

    @pytest.mark.parametrize(("bearing", "turn"), TOWARD)
    def test_toward_the_target_is_clipped_at_60_degrees(self, bearing: float, turn: float) -> None:
        assert degrees(heading_change(5, radians(bearing))) == pytest.approx(turn)

    def test_turns_of_many_vehicles_are_those_of_each(self) -> None:
        rows = [(5, bearing, turn) for bearing, turn in TOWARD]
        rows += [(action, 77.0, turn) for action, turn in enumerate((0.0, 30.0, 60.0, -30.0, -60.0))]
        actions, bearings, turns = (np.array(column) for column in zip(*rows, strict=True))
        got = heading_change(actions, np.radians(bearings))
        assert np.degrees(got) == pytest.approx(turns)
        assert got.tolist() == [float(heading_change(a, radians(b))) for a, b, _ in rows]

    def test_the_six_actions(self, vehicle: VehicleSpec, world_of: WorldOf) -> None:
        puppet = Puppet([CLEAR] * 7, [NOWHERE] * 6, vehicle)
        navigation = Navigation(puppet, TaskOptions())
        navigation.reset(world_of(start=Pose(50.0, 50.0, 0.0), target=(60.0, 40.0)))
        for action in range(ACTIONS):
            navigation.step(action)
        assert ACTIONS == 6
        assert TOWARD_TARGET == 5
        assert [degrees(turn) for turn in puppet.asked] == pytest.approx([0, 30, 60, -30, -60, -45])


class TestNavigationInContactPhysics:
    def test_toward_the_target_over_open_ground_ends_at_the_goal(self, simulator: Simulator, world_of: WorldOf) -> None:
        navigation = Navigation(simulator, TaskOptions())
        navigation.reset(world_of(start=Pose(100.0, 100.0, 2.0), target=(112.0, 100.0)))
        steps = [navigation.step(TOWARD_TARGET)]
        while not steps[-1].ending:
            steps.append(navigation.step(TOWARD_TARGET))
        assert steps[-1].ending == "goal"
        assert steps[-1].s_t.state_property is StateProperty.WINNING
        assert steps[-1].s_t.target_distance <= 2.0
        assert (steps[-1].discount_t, steps[-1].r_t) == (0.0, 1.0)
        assert all(step.discount_t == 1.0 and step.r_t == 0.0 for step in steps[:-1])

    def test_straight_into_a_box_ends_in_a_collision(self, simulator: Simulator, world_of: WorldOf) -> None:
        navigation = Navigation(simulator, TaskOptions())
        navigation.reset(world_of(OrientedBox(108.0, 100.0, 1.0, 3.0)))
        steps = [navigation.step(0)]
        while not steps[-1].ending:
            steps.append(navigation.step(0))
        assert steps[-1].ending == "collision"
        assert steps[-1].s_t.state_property is StateProperty.FAILURE
        assert (steps[-1].discount_t, steps[-1].r_t) == (0.0, -0.6)
        assert len(steps) == 7  # the face is 6.1 m from the nose, 1 m a step
        assert steps[-2].s_t.state_property is StateProperty.NON_SAFE
        assert sum(step.r_t for step in steps) == pytest.approx(sum(sum(step.terms.values()) for step in steps))


@pytest.fixture
def env() -> Iterator[gymnasium.Env[Any, Any]]:
    made = gymnasium.make("nnql_bullet/Tricycle-v0")
    yield made
    made.close()


def episode(env: gymnasium.Env[Any, Any], seed: int, steps: int = 40) -> list[Any]:
    observation, info = env.reset(seed=seed)
    generator = np.random.default_rng(seed)
    seen: list[Any] = [observation.tolist(), info]
    for _ in range(steps):
        observation, reward, terminated, truncated, info = env.step(generator.integers(6))
        seen.append((observation.tolist(), reward, terminated, truncated, info))
        if terminated or truncated:
            break
    return seen


class TestGymnasium:
    def test_it_passes_gymnasiums_own_check(self, env: gymnasium.Env[Any, Any]) -> None:
        check_env(env.unwrapped)  # a warning is an error here

    def test_spaces(self, env: gymnasium.Env[Any, Any]) -> None:
        space: Any = env.observation_space
        assert (space.shape, space.dtype) == ((11,), np.float32)
        assert space.low.tolist() == pytest.approx([0.0] * 9 + [-pi, -10.0])
        assert space.high.tolist() == pytest.approx([10.0] * 8 + [hypot(100.0, 100.0), pi, 10.0])
        assert env.action_space == gymnasium.spaces.Discrete(6)

    def test_the_observation_is_in_the_order_of_its_table(self, env: gymnasium.Env[Any, Any]) -> None:
        inner: Any = env.unwrapped
        observation, _ = env.reset(seed=3)
        for action in (1, 5, 4, 2, 0, 3, 5):
            scan, pose = inner.simulator.scan(), inner.simulator.pose()
            dx, dy = 90.0 - pose.x, 90.0 - pose.y
            bearing = (atan2(dy, dx) - pose.yaw + pi) % (2 * pi) - pi
            assert observation[:8] == pytest.approx(scan.readings, abs=1e-5)
            assert observation[8] == pytest.approx(hypot(dx, dy), rel=1e-6)
            assert observation[9] == pytest.approx(bearing, abs=1e-5)
            assert observation[10] == pytest.approx(inner.simulator.yaw_rate(), abs=1e-5)
            observation, *_ = env.step(action)

    def test_a_left_turn_shows_in_yaw_rate_and_bearing(self, env: gymnasium.Env[Any, Any]) -> None:
        before, _ = env.reset(seed=0)
        after, *_ = env.step(2)
        assert after[10] == pytest.approx(1.5708, rel=0.01)
        assert after[9] < before[9] - 0.5

    def test_info_names_ending_property_and_terms(self, env: gymnasium.Env[Any, Any]) -> None:
        _, info = env.reset(seed=0)
        assert info.keys() == {"world_seed"}
        _, reward, terminated, truncated, info = env.step(0)
        assert (terminated, truncated) == (False, False)
        terms = {name: value for name, value in info.items() if name.startswith("reward/")}
        assert len(terms) == 6
        assert sum(terms.values()) == reward
        assert info.keys() - terms.keys() == {"ending", "state_property", "heading_error"}
        assert info["state_property"] in ("SS", "NS")

    def test_the_same_seed_gives_the_same_episode(self, env: gymnasium.Env[Any, Any]) -> None:
        first = episode(env, seed=1)
        assert episode(env, seed=2) != first
        assert episode(env, seed=1) == first

    def test_environments_side_by_side_agree(self, env: gymnasium.Env[Any, Any]) -> None:
        other = gymnasium.make("nnql_bullet/Tricycle-v0")
        assert episode(other, seed=4) == episode(env, seed=4)
        other.close()

    def test_seed_once_then_every_reset_is_another_world(self, env: gymnasium.Env[Any, Any]) -> None:
        def seeds() -> list[int]:
            first = env.reset(seed=7)[1]["world_seed"]
            return [first, *(env.reset()[1]["world_seed"] for _ in range(3))]

        drawn = seeds()
        assert len(set(drawn)) == 4
        assert seeds() == drawn
        assert all(1_000_000 <= seed < 1_000_000_000 for seed in drawn)

    def test_an_option_names_the_world(self, env: gymnasium.Env[Any, Any]) -> None:
        def readings(world: int, **reset: Any) -> list[list[float]]:
            observation, info = env.reset(options={"world_seed": world}, **reset)
            assert info == {"world_seed": world}
            return [observation.tolist(), *(env.step(5)[0].tolist() for _ in range(20))]

        first = readings(123)
        assert readings(123, seed=5) == first != readings(124, seed=5)

    def test_global_random_state_is_left_alone(self, env: gymnasium.Env[Any, Any]) -> None:
        def states() -> list[Any]:
            name, keys, *rest = np.random.get_state()  # noqa: NPY002 (the very thing that must not be touched)
            return [name, keys.tolist(), *rest, random.getstate(), torch.get_rng_state().tolist()]

        before = states()
        episode(env, seed=0)
        assert states() == before

    def test_global_random_state_has_no_influence(self, env: gymnasium.Env[Any, Any]) -> None:
        first = episode(env, seed=0)
        np.random.seed(99)  # noqa: NPY002
        random.seed(99)
        assert episode(env, seed=0) == first

    def test_it_truncates_after_500_steps(self) -> None:
        env = gymnasium.make("nnql_bullet/Tricycle-v0", world="empty")
        env.reset(seed=0)
        steps, truncated = 0, False
        while not truncated:  # a circle to the left, around the start
            _, _, terminated, truncated, info = env.step(2)
            steps += 1
            assert not terminated
        env.close()
        assert (steps, info["ending"]) == (500, "timeout")

    def test_it_terminates_at_the_goal(self) -> None:
        env = gymnasium.make("nnql_bullet/Tricycle-v0", world="empty")
        env.reset(seed=0)
        over = False
        while not over:
            _, reward, over, truncated, info = env.step(5)
            assert not truncated
        env.close()
        assert (info["ending"], info["state_property"], reward) == ("goal", "WS", 1.0)

    def test_unknown_options_are_refused_in_one_line(self) -> None:
        with pytest.raises(UserError, match=r"unknown key 'gravity'; valid keys: .*world"):
            gymnasium.make("nnql_bullet/Tricycle-v0", gravity=1.6)
