"""Observations, actions, rewards and starts of the Gymnasium environments, each against what it is made from."""

from collections.abc import Callable, Iterator
from contextlib import closing
from math import cos, hypot, radians, sin
from typing import Any

import gymnasium
import numpy as np
import pytest

import nnql_bullet as nb
from nnql_bullet.agents.learning.double_dqn import DoubleDqn, DoubleDqnOptions
from nnql_bullet.env import MANOEUVRES, Transition, commands_of, nearest_manoeuvres
from nnql_bullet.errors import UserError
from nnql_bullet.gym_env.actions import ACTION_SETS
from nnql_bullet.gym_env.observations import OBSERVATIONS
from nnql_bullet.gym_env.rewards import REWARDS
from nnql_bullet.registration import VARIANTS
from nnql_bullet.vehicle.controller import DriveOptions

Make = Callable[..., Any]
TOWARD = 5


@pytest.fixture
def make() -> Iterator[Make]:
    """Makes ideal vehicles among boxes, and closes them."""
    made: list[Any] = []

    def one(**values: Any) -> Any:
        made.append(nb.make_env(**{"simulator": "kinematic", "world": "cover_20", **values}))
        return made[-1]

    yield one
    for env in made:
        env.close()


class TestObservations:
    @pytest.mark.parametrize("name", OBSERVATIONS)
    def test_is_in_its_space_and_the_same_for_one_and_many(self, make: Make, name: Any) -> None:
        values = {"observation": name, "reward": "sparse", "actions": "manoeuvres"}
        one, several = make(**values), make(n_envs=3, **values)
        assert several.single_observation_space == one.observation_space
        first, (rows, _) = one.reset(seed=4)[0], several.reset(seed=3)
        for action in (5, 1, 17, 8, 0, 5):
            assert first in one.observation_space
            assert rows in several.observation_space
            for key in first if isinstance(first, dict) else [...]:
                assert np.array_equal(first[key], (rows[key] if isinstance(rows, dict) else rows)[1])
            first, rows = one.step(action)[0], several.step(np.full(3, action))[0]

    @pytest.mark.parametrize("rays", [8, 24, 360])
    def test_rays_are_those_of_the_sensor(self, make: Make, rays: int) -> None:
        env = make(observation="rays", rays=rays)
        told, _ = env.reset(seed=1)
        told = env.step(TOWARD)[0]
        seen = env._fleet.navigation.observation
        assert told.shape == (rays + 4,)
        assert told[:rays] == pytest.approx(seen.ray_distances[0], abs=1e-5)
        assert told[rays:] == pytest.approx(
            [seen.target_distance[0], seen.target_bearing[0], seen.yaw_rate[0], seen.speed[0]], abs=1e-5
        )

    def test_goals_say_where_it_is_and_should_be(self, make: Make) -> None:
        env = make(observation="goal", reward="sparse")
        told, info = env.reset(seed=1)
        for _ in range(3):
            x, y, yaw = info["pose"]
            assert told["achieved_goal"] == pytest.approx([x, y, 0.0])
            assert told["desired_goal"].tolist() == [90.0, 90.0, 0.0]
            assert told["observation"][8:10] == pytest.approx([cos(yaw), sin(yaw)], abs=1e-6)
            told, *_, info = env.step(1)

    def test_frames_are_what_double_dqn_is_given(self, make: Make) -> None:
        """The agent, driving the vehicle beside it, has the same numbers in its memory."""
        env = make(observation="frames", conditions={"rays": 24}, actions="manoeuvres")
        told, info = env.reset(seed=2)
        experiment, navigation = env._fleet.experiment, env._fleet.navigation
        agent = DoubleDqn(DoubleDqnOptions(), 0, experiment.vehicle, experiment.config.drive)
        state = agent.reset(agent.initial_state(1), {0: info["world_seed"]})
        for action in (5, 1, 17, 8, 0, 5, 20, 3):
            _, state = agent.act(navigation.observation, state)
            assert told == pytest.approx(state.last.look.stacked[0] / 127.5 - 1.0, abs=1e-6)
            state = agent.override(state, np.array([action]))
            told, *_ = env.step(action)
        assert told.shape == (3 * (24 + 48 + 5 + 6),)


class TestActions:
    def test_sizes(self) -> None:
        sizes = {name: getattr(its.space, "n", None) for name, its in ACTION_SETS.items()}
        assert sizes == {"turns": 5, "six": 6, "braking": 12, "manoeuvres": 24, "continuous": None}

    def test_of_every_manoeuvre_the_nearest_is_itself(self) -> None:
        turning = np.array([a for a in range(MANOEUVRES) if a % 6 != TOWARD])
        commands = commands_of(turning, np.zeros(len(turning)), DriveOptions())
        assert (nearest_manoeuvres(commands.heading_changes, commands.speed_scales, DriveOptions()) == turning).all()

    @pytest.mark.parametrize(
        ("action", "turn", "speed"),
        [((1, 1), 60.0, 2.0), ((-0.5, 1), -30.0, 2.0), ((0, -1), 0.0, -0.5), ((0, 0), 0.0, 0.75)],
    )
    def test_continuous_ones_are_heading_change_and_speed(
        self, make: Make, action: tuple[float, float], turn: float, speed: float
    ) -> None:
        env = make(actions="continuous", world="empty", drive={"decision_period": 2.0})
        before = env.reset(seed=0)[1]["pose"]
        info = env.step(np.array(action, np.float32))[-1]
        assert info["pose"][2] - before[2] == pytest.approx(radians(turn), abs=0.02)
        for _ in range(4):
            env.step(np.array([0.0, action[1]], np.float32))
        assert env._fleet.navigation.observation.speed[0] == pytest.approx(speed)

    def test_a_continuous_one_that_is_a_manoeuvre_does_the_same(self, make: Make) -> None:
        smooth, named = make(actions="continuous"), make(actions="manoeuvres")
        smooth.reset(seed=0), named.reset(seed=0)
        for action, numbers in ((1, (0.5, 1.0)), (16, (-1.0, -1.0)), (0, (0.0, 1.0))):
            assert np.array_equal(smooth.step(numbers)[0], named.step(action)[0])

    @pytest.mark.parametrize(
        "wrong", [(0.0,), (0.0, 0.0, 0.0), (0.0, 1.1), (np.nan, 0.0), (np.inf, 0.0), ("a", "b"), None, 1, (0, None)]
    )
    def test_others_are_refused(self, make: Make, wrong: Any) -> None:
        env = make(actions="continuous")
        env.reset(seed=0)
        with pytest.raises(UserError, match="give 1 pairs of numbers from -1 to 1"):
            env.step(wrong)


def rewarded(transition: Transition) -> Any:
    return transition.s_tm1.target_distance - transition.s_t.target_distance


class TestRewards:
    @pytest.mark.parametrize("reward", [*REWARDS, rewarded])
    def test_terms_are_told_and_one_and_many_agree(self, make: Make, reward: Any) -> None:
        one, several = make(reward=reward), make(reward=reward, n_envs=2)
        one.reset(seed=1), several.reset(seed=0)
        over = False
        while not over:
            _, r_t, terminated, truncated, info = one.step(TOWARD)
            _, rewards, *_, infos = several.step(np.full(2, TOWARD))
            over = terminated or truncated
            assert rewards[1] == r_t
            terms = {name: value for name, value in info.items() if name.startswith("reward/")}
            assert len(terms) > 1
            assert reward is rewarded or r_t == pytest.approx(sum(terms.values()))
            assert terms == {name: infos[name][1] for name in terms}
        assert info["ending"] == "collision"

    def test_progress_is_what_double_dqn_learns_from(self, make: Make) -> None:
        """Its own replay buffer holds the same rewards."""
        env = make(reward="progress")
        agent = DoubleDqn(DoubleDqnOptions(buffer_size=500), 0, env._fleet.experiment.vehicle, DriveOptions())
        given: list[float] = []
        seen: list[Transition] = []
        navigation = env._fleet.navigation
        carry_out = navigation.carry_out
        navigation.carry_out = lambda *a: seen.append(carry_out(*a)) or seen[-1]
        for seed in range(2):
            env.reset(seed=seed)
            state = agent.reset(agent.initial_state(1), {0: 0})
            over = False
            while not over:
                _, state = agent.act_exploring(navigation.observation, state, np.zeros(1, np.int64), np.zeros(1))
                state = agent.override(state, np.array([TOWARD]))
                _, r_t, terminated, truncated, _ = env.step(TOWARD)
                over = terminated or truncated
                given.append(r_t)
                agent.learn(seen[-1], state, np.zeros(1, np.int64))
        learned = agent._learning.replay._reward[: len(given), 0]
        assert given == pytest.approx(learned.tolist(), abs=1e-6)

    def test_sparse_is_the_end_alone(self, make: Make) -> None:
        env = make(reward="sparse", world="empty")
        env.reset(options={"start": (80.5, 90.0), "target": (90.0, 90.0)})
        rewards = [env.step(TOWARD)[1] for _ in range(9)]
        assert (rewards[-1], set(rewards[:-1])) == (1.0, {0.0})

    def test_goals_alone_decide_the_reward(self, make: Make) -> None:
        env = make(observation="goal", reward="sparse", n_envs=None)
        found = set()
        for start in ((80.0, 90.0), (95.0, 90.0, 0.0)):  # to the target, and away from it into the wall
            told, _ = env.reset(seed=0, options={"world": "empty", "start": start, "target": (90.0, 90.0)})
            over = False
            while not over:
                told, r_t, over, _, info = env.step(0)
                assert env.compute_reward(told["achieved_goal"], told["desired_goal"], info) == r_t
                found.add((r_t, info["ending"]))
        assert found == {(0.0, None), (1.0, "goal"), (-1.0, "collision")}
        goals = np.array([[10.0, 10.0, 0.0], [10.0, 12.5, 0.0], [10.0, 10.0, 1.0]])
        assert env.compute_reward(goals, np.tile(goals[0], (3, 1)), [{}] * 3).tolist() == [1.0, 0.0, -1.0]
        with pytest.raises(UserError, match="must follow from its goals"):
            make(observation="goal", reward="paper")

    @pytest.mark.parametrize("given", [lambda t: np.full(1, np.nan), lambda t: 1.0, lambda t: np.zeros(3)])
    def test_what_is_no_reward_is_refused(self, make: Make, given: Any) -> None:
        env = make(reward=given)
        env.reset(seed=0)
        with pytest.raises(UserError, match="the reward must be 1 finite numbers"):
            env.step(0)


class TestStarts:
    def test_options_say_where(self, make: Make) -> None:
        env = make()
        _, info = env.reset(seed=0, options={"start": (30.0, 40.0, 1.0), "target": (60.0, 70.0), "world": "empty"})
        assert info["pose"].tolist() == [30.0, 40.0, 1.0]
        assert env._fleet.navigation.observation.target_distance[0] == pytest.approx(hypot(30.0, 30.0))
        assert info["clearance"] > 25
        info = env.reset(seed=0)[1]
        assert info["pose"][:2].tolist() == [20.0, 20.0]  # for one episode alone
        same = make(world=nb.World.load("empty"), start=(30.0, 40.0, 1.0), target=(60.0, 70.0))
        assert same.reset()[1]["pose"].tolist() == [30.0, 40.0, 1.0]

    def test_each_vehicle_may_have_its_own(self, make: Make) -> None:
        env = make(n_envs=2)
        options = {"world": ["empty", "traps"], "world_seed": np.array([3, 4]), "start": [(30.0, 40.0), (20.0, 20.0)]}
        infos = env.reset(options=options)[1]
        assert infos["world_seed"].tolist() == [3, 4]
        assert infos["pose"][:, :2].tolist() == [[30.0, 40.0], [20.0, 20.0]]
        assert env.reset(options={"world": "empty", "start": (50.0, 40.0)})[1]["pose"][:, 0].tolist() == [50.0, 50.0]

    @pytest.mark.parametrize(
        ("options", "message"),
        [
            ({"wold_seed": 1}, r"unknown option 'wold_seed' of reset \(did you mean 'world_seed'\?\)"),
            ({"low": 0}, "unknown option 'low' of reset; valid options: world_seed, world, start, target"),
            ({"world_seed": 1.5}, "'world_seed' must be a whole number, not 1.5"),
            ({"world_seed": True}, "'world_seed' must be a whole number"),
            ({"world_seed": -1}, "a world seed must be from 0"),
            ({"world": 3}, "'world' must be a name, a path or a World"),
            ({"world": "nowhere"}, "nowhere"),
            ({"start": (500.0, 0.0)}, "start"),
            ({"target": "here"}, "target"),
            ([1], "options must be a dictionary or None"),
        ],
    )
    def test_others_are_refused(self, make: Make, options: Any, message: str) -> None:
        env = make()
        with pytest.raises(UserError, match=message):
            env.reset(options=options)

    def test_a_larger_world_is_refused(self, make: Make) -> None:
        larger = nb.World.from_boxes([(50.0, 50.0, 4.0, 4.0)], name="wide", width=300.0)
        with pytest.raises(UserError, match=r"'wide' is larger than 'cover_20'.* with world='wide'"):
            make().reset(options={"world": larger})

    @pytest.mark.parametrize("seed", [np.int64(7), np.uint8(7), 7])
    def test_seeds_of_numpy_are_seeds(self, make: Make, seed: Any) -> None:
        env = make()
        assert env.reset(seed=seed)[1]["world_seed"] == env.reset(seed=7)[1]["world_seed"]
        assert env.np_random_seed == 7

    def test_seed_sequences_are_seeds(self, make: Make) -> None:
        one, several, sequence = make(), make(n_envs=2), np.random.SeedSequence

        def drawn(env: Any, seed: Any) -> Any:
            return env.reset(seed=seed)[1]["world_seed"]

        assert drawn(one, sequence(1)) == drawn(one, sequence(1)) != drawn(one, sequence(2))
        assert drawn(several, sequence(1))[0] == drawn(one, sequence(1))
        assert drawn(several, sequence(5).spawn(2))[1] == drawn(one, sequence(5).spawn(2)[1])
        assert drawn(several, np.array([7, 9]))[1] == drawn(one, 9)

    @pytest.mark.parametrize("seed", [-1, 1.0, True, "1"])
    def test_other_seeds_are_refused(self, make: Make, seed: Any) -> None:
        for env in (make(), make(n_envs=2)):
            with pytest.raises(UserError, match="a seed must be a whole number"):
                env.reset(seed=seed)


class TestOrder:
    @pytest.mark.parametrize("simulator", ["kinematic", "bullet"])
    def test_a_step_needs_an_episode(self, make: Make, simulator: Any) -> None:
        env = make(simulator=simulator)
        with pytest.raises(UserError, match="no episode has begun; call reset"):
            env.step(0)
        env.reset(seed=0)
        while not env.step(TOWARD)[2]:
            pass
        with pytest.raises(UserError, match="the episode is over; call reset"):
            env.step(0)
        env.reset()
        env.step(0)
        env.close()
        for call in (lambda: env.step(0), env.reset):
            with pytest.raises(UserError, match="closed"):
                call()
        env.close()

    def test_close_before_reset_is_harmless(self, make: Make) -> None:
        for env in (make(simulator="bullet"), make(n_envs=2)):
            env.close()
            env.close()

    def test_limits_of_length_agree(self, make: Make) -> None:
        three: dict[str, Any] = {"task": {"max_steps": 3}}
        for limits in (three, {"max_episode_steps": 3}, {"max_episode_steps": 9, **three}):
            env = make(world="empty", **limits)
            env.reset(seed=0)
            steps = [env.step(0) for _ in range(3)]
            assert [step[3] for step in steps] == [False, False, True]
            assert steps[-1][-1]["ending"] == "timeout"


def test_every_variant_is_made_and_has_its_length() -> None:
    for name in VARIANTS:
        assert gymnasium.spec(name).max_episode_steps == 500
        with closing(gymnasium.make(name, simulator="kinematic")) as env:
            assert env.reset(seed=0)[0] in env.observation_space
            assert env.step(env.action_space.sample())[0] in env.observation_space
