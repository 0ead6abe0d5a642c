"""Learners of other libraries over the vehicles: the steps of single environments, and more goals than a rule."""

import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest

import nnql_bullet as nb
from nnql_bullet.errors import UserError
from nnql_bullet.rollout import run_episodes

try:
    import stable_baselines3 as sb3

    from nnql_bullet.integrations.sb3 import VehiclesVecEnv, make_vec_env
except ImportError:
    sb3 = None
needs_sb3 = pytest.mark.skipif(sb3 is None, reason="needs the extra [sb3]")

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


@needs_sb3
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


@needs_sb3
def test_it_needs_vehicles_that_begin_at_once() -> None:
    with (
        closing(nb.make_env(n_envs=2, **KINEMATIC)) as envs,
        pytest.raises(UserError, match=r"needs vehicles with autoreset_mode=AutoresetMode\.SAME_STEP"),
    ):
        VehiclesVecEnv(envs)


@needs_sb3
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


@pytest.mark.slow
def test_rllib_learns_to_beat_driving_straight(tmp_path: Path) -> None:
    """In a process of its own, as Ray has servers and warnings; the vehicles are in yet another."""
    for library in ("ray.rllib", "tree"):
        pytest.importorskip(library, reason="needs the extra [rllib]")
    done = subprocess.run([sys.executable, "-c", RLLIB], capture_output=True, text=True, check=False, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    learned, straight = map(float, done.stdout.split()[-2:])
    assert learned > straight + 30.0


RLLIB = """
import ray
import torch
from ray.rllib.algorithms.ppo import PPOConfig

import nnql_bullet as nb
from nnql_bullet.env import as_numbers
from nnql_bullet.integrations.rllib import register_env

torch.set_num_threads(1)
ray.init(num_cpus=2, include_dashboard=False, logging_level="ERROR")
register_env()
algorithm = (
    PPOConfig()
    .environment("nnql_bullet/Tricycle-v0", env_config={"simulator": "kinematic", "reward": "progress"})
    .env_runners(num_env_runners=1, num_envs_per_env_runner=64, gym_env_vectorize_mode="vector_entry_point")
    .training(train_batch_size_per_learner=4096, minibatch_size=512, num_epochs=10, lr=1e-3, vf_clip_param=100.0)
    .debugging(seed=0)
).build_algo()
for _ in range(7):
    algorithm.train()


class Learned:
    def act(self, observations):
        with torch.no_grad():
            told = algorithm.get_module().forward_inference({"obs": torch.from_numpy(as_numbers(observations))})
        return told["action_dist_inputs"].argmax(dim=1).numpy()


found = nb.evaluate([Learned(), "straight"], worlds=["paper"], n_worlds=30, simulator="kinematic").table()
algorithm.stop()
print(*(line.split()[2] for line in found.splitlines()[1:3]))
"""
