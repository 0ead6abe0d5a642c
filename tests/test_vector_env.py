"""Many vehicles as one Gymnasium vector environment: row by row the single environment."""

from collections.abc import Iterator
from contextlib import closing
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, VectorEnv

import nnql_bullet  # noqa: F401 (makes the environment known)
from nnql_bullet.api.environment import make_vector_env
from nnql_bullet.errors import UserError
from nnql_bullet.gym_env.vector import TricycleVectorEnv
from nnql_bullet.run_config import RunConfig
from nnql_bullet.task import TaskOptions

NAME = "nnql_bullet/Tricycle-v0"
WORLD = "cover_20"
N = 3
TOWARD = 5
Env = VectorEnv[Any, Any, Any]


def make(simulator: str = "kinematic", **more: Any) -> Env:
    return gymnasium.make_vec(NAME, num_envs=N, simulator=simulator, world=WORLD, **more)


@pytest.fixture(scope="module")
def kinematic_ones() -> Iterator[Env]:
    """Three ideal vehicles; whoever takes them resets them."""
    with closing(make()) as env:
        yield env


@pytest.fixture(scope="module")
def singles() -> Iterator[Env]:
    """Gymnasium's own vector of single environments."""
    with closing(make(vectorization_mode="sync")) as env:
        yield env


@pytest.fixture(scope="module")
def short() -> Iterator[tuple[Env, Env]]:
    """Ours and Gymnasium's, with episodes of at most four steps."""
    config = RunConfig(task=TaskOptions(max_steps=4), simulator="kinematic", world=WORLD)
    with (
        closing(gymnasium.make_vec(NAME, num_envs=N, config=config)) as ours,
        closing(gymnasium.make_vec(NAME, num_envs=N, config=config, vectorization_mode="sync")) as theirs,
    ):
        yield ours, theirs


def assert_same_infos(ours: dict[str, Any], theirs: dict[str, Any]) -> None:
    assert set(ours) == set(theirs)
    for key, expected in theirs.items():
        found = ours[key]
        assert found.shape == expected.shape, key
        if expected.dtype == object or key.startswith("_"):
            assert found.dtype == expected.dtype, key
            assert found.tolist() == expected.tolist(), key
        else:
            assert found == pytest.approx(expected, abs=1e-9), key


def assert_same_step(ours: tuple[Any, ...], theirs: tuple[Any, ...]) -> None:
    for found, expected in zip(ours[:-1], theirs[:-1], strict=True):
        assert found.shape == expected.shape
        assert found.dtype == expected.dtype
        assert found == pytest.approx(expected, abs=1e-5)
    assert_same_infos(ours[-1], theirs[-1])


def drive_both(ours: Env, theirs: Env, steps: int, seed: int) -> list[str | None]:
    """The same seeds and actions for both; what the episodes ended in."""
    assert_same_step(ours.reset(seed=seed), theirs.reset(seed=seed))
    generator = np.random.default_rng(seed)
    endings: list[str | None] = []
    for _ in range(steps):
        actions = generator.choice(6, N, p=[0.3, 0.1, 0.1, 0.1, 0.1, 0.3])
        found = ours.step(actions)
        assert_same_step(found, theirs.step(actions))
        assert ours.single_observation_space.shape == (11,)
        assert found[0] in ours.observation_space
        endings += [ending for ending in found[-1].get("ending", np.array([])).tolist() if ending]
    return endings


class TestLikeSingles:
    def test_ideal_vehicles(self, kinematic_ones: Env, singles: Env) -> None:
        endings = drive_both(kinematic_ones, singles, steps=120, seed=7)
        assert endings.count("collision") >= 5

    @pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
    def test_contact_physics(self, workers: int) -> None:
        with closing(make("bullet", workers=workers)) as ours, closing(make("bullet", vectorization_mode="sync")) as b:
            assert drive_both(ours, b, steps=60, seed=7).count("collision") >= 2

    def test_episodes_that_are_cut_short(self, short: tuple[Env, Env]) -> None:
        assert drive_both(*short, steps=30, seed=3).count("timeout") >= 15

    def test_every_way_to_begin(self, kinematic_ones: Env, singles: Env) -> None:
        ways: list[dict[str, Any]] = [
            {"seed": 3},
            {"seed": [5, None, 9]},
            {},
            {"seed": [1, 2, 3], "options": {"reset_mask": np.array([True, False, True])}},
            {"options": {"reset_mask": np.array([False, True, False])}},
        ]
        for way in ways:
            again = (
                {**way, "options": dict(way["options"])} if "options" in way else way
            )  # Gymnasium takes the mask out
            assert_same_step(kinematic_ones.reset(**way), singles.reset(**again))
            for action in (TOWARD, 1, 3):
                actions = np.full(N, action)
                assert_same_step(kinematic_ones.step(actions), singles.step(actions))

    def test_a_world_that_is_named(self, kinematic_ones: Env, singles: Env) -> None:
        options = {"world_seed": 12}
        found = kinematic_ones.reset(seed=1, options=options)
        assert found[1]["world_seed"].tolist() == [12, 12, 12]
        assert options == {"world_seed": 12}
        assert_same_step(found, singles.reset(seed=1, options=dict(options)))
        assert_same_step(kinematic_ones.step(np.full(N, TOWARD)), singles.step(np.full(N, TOWARD)))


class TestWhatItIs:
    def test_spaces_and_numbers(self, kinematic_ones: Env) -> None:
        assert isinstance(kinematic_ones.unwrapped, TricycleVectorEnv)
        assert kinematic_ones.num_envs == N
        assert kinematic_ones.single_action_space == gymnasium.spaces.Discrete(6)
        assert kinematic_ones.action_space == gymnasium.spaces.MultiDiscrete([6] * N)
        assert kinematic_ones.observation_space.shape == (N, 11)
        assert kinematic_ones.observation_space.dtype == np.float32
        assert kinematic_ones.metadata["autoreset_mode"] == AutoresetMode.NEXT_STEP
        with closing(gymnasium.make(NAME, simulator="kinematic", world=WORLD)) as single:
            assert kinematic_ones.single_observation_space == single.observation_space
            assert kinematic_ones.single_action_space == single.action_space

    def test_kinds_of_what_is_returned(self, kinematic_ones: Env) -> None:
        observations, infos = kinematic_ones.reset(seed=0)
        assert observations.dtype == np.float32
        assert observations in kinematic_ones.observation_space
        assert infos["_world_seed"].tolist() == [True] * N
        assert len(set(infos["world_seed"].tolist())) == N
        _, rewards, terminations, truncations, infos = kinematic_ones.step(np.zeros(N, np.int64))
        assert (rewards.dtype, terminations.dtype, truncations.dtype) == (np.float64, np.bool_, np.bool_)
        assert rewards.tolist() == pytest.approx(sum(infos[key] for key in infos if key.startswith("reward/")))

    def test_one_vehicle_is_enough(self) -> None:
        with closing(gymnasium.make_vec(NAME, num_envs=1, simulator="kinematic", world=WORLD)) as env:
            assert env.reset(seed=0)[0].shape == (1, 11)
            assert env.step(np.array([TOWARD]))[0].shape == (1, 11)

    def test_no_vehicle_is_refused(self) -> None:
        with pytest.raises(UserError):
            make_vector_env(0, simulator="kinematic")

    @pytest.mark.parametrize("changes", [{"world": "nowhere"}, {"simulator": "unity"}, {"robot": "bicycle"}])
    def test_a_wrong_configuration_is_refused(self, changes: dict[str, Any]) -> None:
        with pytest.raises(UserError):
            make_vector_env(2, **changes)


class TestActions:
    @pytest.mark.parametrize("actions", [[0], [0, 0, 6], [0, -1, 0], [0.0, 1.0, 2.7], ["0", "1", "2"], [[0, 0, 0]], 0])
    def test_what_are_none_is_refused(self, kinematic_ones: Env, actions: Any) -> None:
        kinematic_ones.reset(seed=0)
        with pytest.raises(UserError, match="give 3 whole numbers from 0 to 5 as actions"):
            kinematic_ones.step(np.array(actions))

    @pytest.mark.parametrize("action", [6, -1, 2.7, "1", None, [0, 1]])
    def test_nor_is_one_by_the_single_environment(self, action: Any) -> None:
        with closing(gymnasium.make(NAME, simulator="kinematic", world=WORLD)) as env:
            env.reset(seed=0)
            with pytest.raises((UserError, ValueError)):
                env.unwrapped.step(action)

    def test_with_manoeuvres_it_may_stop_and_reverse(self) -> None:
        options: dict[str, Any] = {"simulator": "kinematic", "world": "empty", "actions": "manoeuvres"}
        with closing(gymnasium.make(NAME, **options)) as env, closing(gymnasium.make_vec(NAME, 2, **options)) as envs:
            assert env.action_space == envs.single_action_space == gymnasium.spaces.Discrete(24)
            assert envs.action_space == gymnasium.spaces.MultiDiscrete([24, 24])
            env.reset(seed=0), envs.reset(seed=0)
            for _ in range(6):
                one, several = env.step(12 + 5), envs.step(np.array([12 + 5, 6 + 5]))
            assert several[0][0].tolist() == one[0].tolist()
            assert one[0][8] > several[0][1, 8]  # it backed away from the target, the other one stood
            with pytest.raises(UserError, match="give 2 whole numbers from 0 to 23 as actions"):
                envs.step(np.array([0, 24]))

    def test_one_that_stands_is_truncated_as_stuck(self) -> None:
        task = {"stuck_after": 3.0}
        options: dict[str, Any] = {"simulator": "kinematic", "world": "empty", "actions": "manoeuvres", "task": task}
        with closing(gymnasium.make_vec(NAME, 2, **options)) as envs:
            envs.reset(seed=0)
            for _ in range(7):
                _, _, terminated, truncated, infos = envs.step(np.array([6, 0]))
            assert (terminated.tolist(), truncated.tolist()) == ([False, False], [True, False])
            assert infos["ending"].tolist() == ["stuck", None]


class TestEpisodes:
    def test_a_vehicle_whose_time_is_up_is_put_into_its_next_world_by_the_step_after(self) -> None:
        config = RunConfig(task=TaskOptions(max_steps=4), simulator="kinematic", world="empty")
        with closing(gymnasium.make_vec(NAME, num_envs=N, config=config)) as env:
            first, infos = env.reset(seed=1)
            seeds = infos["world_seed"].copy()
            for step in range(1, 11):
                observations, rewards, terminations, truncations, infos = env.step(np.full(N, step % 5))
                begins = step % 5 == 0  # four steps, and one that only puts the vehicles into their worlds
                assert truncations.tolist() == [step % 5 == 4] * N
                assert not terminations.any()
                if not begins:
                    assert infos["_ending"].tolist() == [True] * N
                    assert infos["ending"].tolist() == ["timeout" if step % 5 == 4 else None] * N
                assert ("world_seed" in infos) is begins
                if begins:
                    assert rewards.tolist() == [0.0] * N
                    assert (infos["world_seed"] != seeds).all()
                    seeds = infos["world_seed"].copy()
                    assert observations == pytest.approx(first)  # an empty world looks like any other

    def test_named_worlds_for_each_vehicle(self, kinematic_ones: Env) -> None:
        alike = kinematic_ones.reset(options={"world_seed": 11})[0][0]
        observations, infos = kinematic_ones.reset(options={"world_seed": [10, 11, 12]})
        assert infos["world_seed"].tolist() == [10, 11, 12]
        assert observations[1].tolist() == alike.tolist()
        assert observations[0].tolist() != alike.tolist()
        observations, infos = kinematic_ones.reset(options={"world_seed": np.array([12, 11, 10])})
        assert infos["world_seed"].tolist() == [12, 11, 10]

    def test_only_some_begin_anew(self, kinematic_ones: Env) -> None:
        kinematic_ones.reset(seed=2)
        going = kinematic_ones.step(np.full(N, TOWARD))[0]
        mask = np.array([False, True, False])
        observations, infos = kinematic_ones.reset(options={"reset_mask": mask, "world_seed": 30})
        assert infos["_world_seed"].tolist() == mask.tolist()
        assert infos["world_seed"].tolist() == [0, 30, 0]
        assert observations[[0, 2]].tolist() == going[[0, 2]].tolist()
        assert observations[1].tolist() == kinematic_ones.reset(options={"world_seed": 30})[0][0].tolist()

    def test_the_seed_decides(self, kinematic_ones: Env) -> None:
        worlds = [kinematic_ones.reset(seed=seed)[1]["world_seed"].tolist() for seed in (4, 4, 5)]
        assert worlds[0] == worlds[1]
        assert worlds[2][:2] == worlds[0][1:]  # vehicle i has the seed of the first and i
        assert kinematic_ones.reset()[1]["world_seed"].tolist() != worlds[2]

    @pytest.mark.parametrize(
        "wrong",
        [
            {"seed": [1, 2]},
            {"seed": [1, 2, 3, 4]},
            {"options": {"reset_mask": np.ones(2, np.bool_)}},
            {"options": {"reset_mask": np.ones((N, 1), np.bool_)}},
            {"options": {"world_seed": [1, 2]}},
            {"options": {"world_seed": -1}},
        ],
    )
    def test_wrong_sizes_are_refused(self, kinematic_ones: Env, wrong: dict[str, Any]) -> None:
        with pytest.raises(UserError):
            kinematic_ones.reset(**wrong)

    def test_what_was_returned_does_not_change_later(self, kinematic_ones: Env) -> None:
        given: list[Any] = [*kinematic_ones.reset(seed=8)]
        for step in range(40):
            given += kinematic_ones.step(np.full(N, (TOWARD, 1, 0)[step % 3]))
            if step == 20:
                kept = [copied(part) for part in given]
        assert all(unchanged(part, then) for part, then in zip(given, kept, strict=False))

    @pytest.mark.parametrize("simulator", ["kinematic", "bullet"])
    def test_it_may_be_closed_twice(self, simulator: str) -> None:
        env = make(simulator, workers=1)
        env.reset(seed=0)
        env.close()
        env.close()
        assert env.unwrapped.closed


def copied(part: Any) -> Any:
    return {key: values.copy() for key, values in part.items()} if isinstance(part, dict) else part.copy()


def unchanged(part: Any, then: Any) -> bool:
    if isinstance(part, dict):
        return part.keys() == then.keys() and all(np.array_equal(part[key], then[key]) for key in part)
    return np.array_equal(part, then)
