"""Learners of other libraries over the vehicles: the steps of single environments, and more goals than a rule."""

from collections.abc import Iterator
from contextlib import closing
from typing import Any

import gymnasium
import numpy as np
import pytest

import nnql_bullet as nb
from nnql_bullet.errors import UserError
from nnql_bullet.rollout import run_episodes

sb3 = pytest.importorskip("stable_baselines3", reason="needs the extra [sb3]")
from nnql_bullet.integrations.sb3 import VehiclesVecEnv, make_vec_env  # noqa: E402

KINEMATIC: dict[str, Any] = {"simulator": "kinematic", "world": "cover_20"}


@pytest.fixture(params=["sectors", "goal"])
def both(request: pytest.FixtureRequest) -> Iterator[tuple[Any, Any]]:
    """Ours, and the library's own over single environments."""
    from stable_baselines3.common.monitor import Monitor
    from stable_baselines3.common.vec_env import DummyVecEnv

    values = {**KINEMATIC, "observation": request.param, "reward": "sparse", "max_episode_steps": 12}
    ours = make_vec_env(3, **values, workers=1)
    theirs = DummyVecEnv([lambda: Monitor(nb.make_env(**values)) for _ in range(3)])
    yield ours, theirs
    ours.close(), theirs.close()


def same(one: Any, other: Any) -> bool:
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(same(one[key], other[key]) for key in one)
    return np.allclose(one, other, atol=1e-5)


def test_it_does_what_the_librarys_own_does(both: tuple[Any, Any]) -> None:
    ours, theirs = both
    ours.seed(5), theirs.seed(5)
    assert same(ours.reset(), theirs.reset())
    generator, endings = np.random.default_rng(0), set()
    for _ in range(60):
        actions = generator.choice([0, 1, 3, 5], 3)
        found, expected = ours.step(actions), theirs.step(actions)
        assert same(found[0], expected[0])
        assert found[1] == pytest.approx(expected[1])
        assert found[2].tolist() == expected[2].tolist()
        for one, other, over in zip(found[3], expected[3], found[2], strict=True):
            if over:
                assert same(one["terminal_observation"], other["terminal_observation"])
                assert one["TimeLimit.truncated"] == other["TimeLimit.truncated"]
                assert one["ending"] == other["ending"]
                assert (one["episode"]["r"], one["episode"]["l"]) == (
                    pytest.approx(other["episode"]["r"], abs=1e-6),
                    other["episode"]["l"],
                )
                endings.add(one["ending"])
    assert endings == {"collision", "timeout"}


def test_it_needs_vehicles_that_begin_at_once() -> None:
    with (
        closing(nb.make_env(n_envs=2, **KINEMATIC)) as envs,
        pytest.raises(UserError, match=r"needs vehicles with autoreset_mode=AutoresetMode\.SAME_STEP"),
    ):
        VehiclesVecEnv(envs)


@pytest.mark.slow
def test_a_small_budget_beats_driving_straight() -> None:
    """Goals in 50 test worlds at 5 % cover."""
    from stable_baselines3.common.vec_env import VecNormalize

    seeds = np.arange(100_000, 100_050)
    worlds: dict[str, Any] = {"simulator": "kinematic", "world": "paper"}
    vehicles = VecNormalize(make_vec_env(64, reward="progress", **worlds))
    learner = sb3.PPO("MlpPolicy", vehicles, n_steps=64, batch_size=512, seed=0, device="cpu")
    learner.learn(60_000)
    vehicles.close()
    with closing(gymnasium.make_vec("nnql_bullet/Tricycle-v0", len(seeds), **worlds)) as envs:
        seen, _ = envs.reset(options={"world_seed": seeds})
        over, goals = np.zeros(len(seeds), bool), 0
        while not over.all():
            actions, _ = learner.predict(vehicles.normalize_obs(seen), deterministic=True)
            seen, _, terminated, truncated, infos = envs.step(actions)
            goals += int((infos["is_success"] & ~over).sum())
            over |= terminated | truncated
    rule = nb.load_policy("straight", worlds).experiment
    driven = run_episodes(rule.navigation, [rule.world(int(seed)) for seed in seeds], rule.policy)
    assert goals > sum(one.ending == "goal" for one in driven)
