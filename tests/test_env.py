"""The task over a simulator, and the Gymnasium environment."""

import random
from collections.abc import Callable, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from functools import partial
from importlib.util import find_spec
from math import atan2, degrees, hypot, pi, radians
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium.utils.env_checker import check_env
from helpers import ending, step

import nnql_bullet  # noqa: F401 (registers the environment)
from nnql_bullet.env import ACTIONS, TOWARD_TARGET, Navigation, Transition, heading_change
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array, OrientedBox, Pose
from nnql_bullet.sensing import sector_readings
from nnql_bullet.sim.base import Motion, no_motion
from nnql_bullet.sim.engines import contact_simulator
from nnql_bullet.sim.kinematic import KinematicSimulator
from nnql_bullet.task import REWARD_TERMS, StateProperty, TaskOptions
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.vehicle.urdf import load_vehicle
from nnql_bullet.worlds.spec import WorldSpec

NEEDS_MUJOCO = pytest.mark.skipif(
    find_spec("mujoco") is None, reason="needs the extra: pip install 'nnql-bullet[mujoco]'"
)
WorldOf = Callable[..., WorldSpec]

CLEAR = [10.0] * 8
NEAR = [4.0, *[10.0] * 7]
NEARER = [3.0, *[10.0] * 7]


@dataclass
class Puppet:
    """A simulator of one vehicle that plays a script: readings of each state, and events on the way to them."""

    readings: list[list[float]]
    events: dict[str, bool] = field(default_factory=dict)
    asked: list[float] = field(default_factory=list)
    size: int = 1
    vehicle: VehicleSpec = field(default_factory=lambda: load_vehicle("tricycle"))
    drive: DriveOptions = field(default_factory=DriveOptions)

    def reset(self, worlds: Mapping[int, WorldSpec]) -> tuple[Array, Array]:
        self.asked.clear()
        start = worlds[0].start
        return np.array([[start.x, start.y, start.yaw]]), self._rays()

    def advance(
        self, heading_changes: Array, active: object = None, speed_scales: object = None, traces: object = None
    ) -> tuple[Motion, Array]:
        self.asked += heading_changes.tolist()
        events = {name: np.array([happens]) for name, happens in self.events.items()}
        return replace(no_motion(1), pose=np.array([[50.0, 50.0, 0.0]]), **events), self._rays()

    def _rays(self) -> Array:
        return np.repeat(self.readings[len(self.asked)], 9)[None]

    def close(self) -> None:
        pass


@pytest.fixture
def navigation_of(empty_world: WorldSpec) -> Callable[..., Navigation]:
    def make(*states: list[float], task: TaskOptions | None = None, **events: bool) -> Navigation:
        made = Navigation(Puppet(list(states), events), task or TaskOptions())
        made.reset({0: empty_world})
        return made

    return make


TOWARD = [(0.0, 0.0), (20.0, 20.0), (-35.0, -35.0), (60.0, 60.0), (61.0, 60.0), (180.0, 60.0), (-90.0, -60.0)]
"""Bearing of the target and the turn toward it [degrees]."""


class TestTransition:
    def test_who_stands_by_keeps_what_it_saw_and_others_are_in_their_rows(
        self, vehicle: VehicleSpec, world_of: WorldOf
    ) -> None:
        worlds = [world_of(start=Pose(50.0 + 9 * i, 60.0, 0.3 * i)) for i in range(3)]
        with closing(KinematicSimulator(vehicle, DriveOptions(), 3)) as simulator:
            navigation = Navigation(simulator, TaskOptions())
            navigation.reset({2: worlds[2], 0: worlds[0], 1: worlds[1]})
            first = navigation.observation
            assert first.target_distance == pytest.approx([hypot(140.0 - 9 * i, 130.0) for i in range(3)])
            t = navigation.step(np.full(3, 1), np.array([True, False, True]))
            assert t.s_tm1 is first
            assert t.s_t is navigation.observation
            assert (t.s_t.target_distance != first.target_distance).tolist() == [True, False, True]
            navigation.reset({1: worlds[0]})
            assert navigation.observation.target_distance.tolist() == [
                t.s_t.target_distance[0],
                first.target_distance[0],
                t.s_t.target_distance[2],
            ]

    def test_the_first_observation_is_of_the_start(self, world_of: WorldOf) -> None:
        navigation = Navigation(Puppet([NEAR]), TaskOptions())
        navigation.reset({0: world_of(start=Pose(10.0, 20.0, 0.5), target=(40.0, 60.0))})
        o = navigation.observation
        assert o.readings.tolist() == sector_readings(o.ray_distances).tolist() == [NEAR]
        assert o.target_distance == pytest.approx(50.0)
        assert o.target_bearing == pytest.approx(atan2(40.0, 30.0) - 0.5)
        assert (o.yaw_rate.tolist(), o.state_property.tolist()) == ([0.0], [StateProperty.NON_SAFE])

    def test_states_are_chained(self, navigation_of: Callable[..., Navigation]) -> None:
        navigation = navigation_of(CLEAR, NEAR, NEARER)
        first, second = step(navigation, 0), step(navigation, 1)
        assert second.s_tm1 is first.s_t
        assert (first.a_tm1, second.a_tm1) == (0, 1)
        assert first.heading_command.tolist() == [0.0]
        assert second.heading_command == pytest.approx(radians(30))
        assert first.s_t.readings.tolist() == [NEAR]

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
        transition = step(navigation_of(before, after, **flags), 0)
        assert transition.r_t.tolist() == [reward]
        terms = dict(zip(REWARD_TERMS, *transition.terms.tolist(), strict=True))
        assert {name: value for name, value in terms.items() if value} == ({term: reward} if term else {})
        assert len(terms) == 6

    @pytest.mark.parametrize(
        ("flags", "end", "discount"),
        [({}, None, 1.0), ({"touching": True}, "collision", 0.0), ({"at_target": True}, "goal", 0.0)],
    )
    def test_the_discount_is_zero_where_the_episode_ends_for_good(
        self, navigation_of: Callable[..., Navigation], flags: dict[str, bool], end: str | None, discount: float
    ) -> None:
        transition = step(navigation_of(CLEAR, CLEAR, **flags), 0)
        assert (ending(transition), transition.discount_t) == (end, discount)

    def test_a_timeout_ends_the_episode_with_discount_one(self, navigation_of: Callable[..., Navigation]) -> None:
        navigation = navigation_of(*[CLEAR] * 4, task=TaskOptions(max_steps=3))
        steps = [step(navigation, 0) for _ in range(3)]
        assert [ending(one) for one in steps] == [None, None, "timeout"]
        assert steps[-1].discount_t == 1.0

    def test_the_goal_at_the_last_step_is_no_timeout(self, navigation_of: Callable[..., Navigation]) -> None:
        transition = step(navigation_of(CLEAR, CLEAR, task=TaskOptions(max_steps=1), at_target=True), 0)
        assert (ending(transition), transition.discount_t) == ("goal", 0.0)

    def test_reset_counts_steps_anew(self, navigation_of: Callable[..., Navigation], empty_world: WorldSpec) -> None:
        navigation = navigation_of(*[CLEAR] * 3, task=TaskOptions(max_steps=2))
        step(navigation, 0)
        navigation.reset({0: empty_world})
        assert ending(step(navigation, 0)) is None
        assert ending(step(navigation, 0)) == "timeout"

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

    def test_the_six_actions(self, world_of: WorldOf) -> None:
        puppet = Puppet([CLEAR] * 7)
        navigation = Navigation(puppet, TaskOptions())
        navigation.reset({0: world_of(start=Pose(50.0, 50.0, 0.0), target=(60.0, 40.0))})
        for action in range(ACTIONS):
            step(navigation, action)
        assert ACTIONS == 6
        assert TOWARD_TARGET == 5
        assert [degrees(turn) for turn in puppet.asked] == pytest.approx([0, 30, 60, -30, -60, -45])


@pytest.mark.parametrize("name", ["kinematic", "bullet", pytest.param("mujoco", marks=NEEDS_MUJOCO)])
class TestEpisodes:
    def drive(self, name: str, vehicle: VehicleSpec, world: WorldSpec, action: int) -> list[Transition]:
        make = KinematicSimulator if name == "kinematic" else partial(contact_simulator, name, "fast")
        with closing(make(vehicle, DriveOptions(), 1)) as simulator:
            navigation = Navigation(simulator, TaskOptions())
            navigation.reset({0: world})
            steps = [step(navigation, action)]
            while not ending(steps[-1]):
                steps.append(step(navigation, action))
        return steps

    def test_toward_the_target_over_open_ground_ends_at_the_goal(
        self, vehicle: VehicleSpec, world_of: WorldOf, name: str
    ) -> None:
        world = world_of(start=Pose(100.0, 100.0, 2.0), target=(112.0, 100.0))
        *before, last = self.drive(name, vehicle, world, TOWARD_TARGET)
        assert (ending(last), last.discount_t, last.r_t) == ("goal", 0.0, 1.0)
        assert last.s_t.state_property == StateProperty.WINNING
        assert last.s_t.target_distance <= 2.0
        assert all(one.discount_t == 1.0 and one.r_t == 0.0 for one in before)

    def test_straight_into_a_box_ends_in_a_collision(self, vehicle: VehicleSpec, world_of: WorldOf, name: str) -> None:
        *before, last = self.drive(name, vehicle, world_of(OrientedBox(108.0, 100.0, 1.0, 3.0)), 0)
        assert (ending(last), last.discount_t, last.r_t) == ("collision", 0.0, -0.6)
        assert last.s_t.state_property == StateProperty.FAILURE
        assert len(before) == 6  # the face is 6.1 m from the nose, 1 m a step
        assert before[-1].s_t.state_property == StateProperty.NON_SAFE


@pytest.fixture
def env() -> Iterator[gymnasium.Env[Any, Any]]:
    made = gymnasium.make("nnql_bullet/Tricycle-v0")
    yield made
    made.close()


def plain(info: dict[str, Any]) -> dict[str, Any]:
    return {**info, "pose": info["pose"].tolist()}


def episode(env: gymnasium.Env[Any, Any], seed: int, steps: int = 40) -> list[Any]:
    observation, info = env.reset(seed=seed)
    generator = np.random.default_rng(seed)
    seen: list[Any] = [observation.tolist(), plain(info)]
    for _ in range(steps):
        observation, reward, terminated, truncated, info = env.step(generator.integers(6))
        seen.append((observation.tolist(), reward, terminated, truncated, plain(info)))
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
            (engine,) = inner.simulator.engines
            pose = engine.pose()
            dx, dy = 90.0 - pose.x, 90.0 - pose.y
            bearing = (atan2(dy, dx) - pose.yaw + pi) % (2 * pi) - pi
            assert observation[:8] == pytest.approx(sector_readings(engine.scan()), abs=1e-5)
            assert observation[8] == pytest.approx(hypot(dx, dy), rel=1e-6)
            assert observation[9] == pytest.approx(bearing, abs=1e-5)
            assert observation[10] == pytest.approx(engine.yaw_rate(), abs=1e-5)
            observation, *_ = env.step(action)

    def test_a_left_turn_shows_in_yaw_rate_and_bearing(self, env: gymnasium.Env[Any, Any]) -> None:
        before, _ = env.reset(seed=0)
        after, *_ = env.step(2)
        assert after[10] == pytest.approx(1.5708, rel=0.01)
        assert after[9] < before[9] - 0.5

    def test_info_names_ending_property_and_terms(self, env: gymnasium.Env[Any, Any]) -> None:
        _, info = env.reset(seed=0)
        assert info.keys() == {"world_seed", "pose", "clearance"}
        _, reward, terminated, truncated, info = env.step(0)
        assert (terminated, truncated) == (False, False)
        terms = {name: value for name, value in info.items() if name.startswith("reward/")}
        assert len(terms) == 6
        assert sum(terms.values()) == reward
        others = {"ending", "is_success", "state_property", "heading_error", "pose", "clearance"}
        assert info.keys() - terms.keys() == others
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
            assert info["world_seed"] == world
            return [observation.tolist(), *(env.step(1)[0].tolist() for _ in range(20))]

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
        with pytest.raises(TypeError, match="unexpected keyword argument 'gravity'"):
            gymnasium.make("nnql_bullet/Tricycle-v0", gravity=1.6)
        with pytest.raises(UserError, match=r"unknown key 'conditions.wheels'; valid keys: .*payload"):
            gymnasium.make("nnql_bullet/Tricycle-v0", conditions={"wheels": 4})
