"""Vehicles as the environment that algorithms of RLlib take (needs the extra `rllib`)."""

from collections.abc import Mapping
from typing import Any

from ray.tune import registry

from nnql_bullet.api.environment import make_env, make_vector_env
from nnql_bullet.gym_env.single import TricycleEnv
from nnql_bullet.gym_env.vector import TricycleVectorEnv


def register_env(name: str = "nnql_bullet/Tricycle-v0") -> None:
    """Makes the environment known to RLlib, in every process of a Ray cluster.

    An algorithm takes it as `config.environment(name, env_config=...)`, with the options of `make_env`. With
    `config.env_runners(num_envs_per_env_runner=64, gym_env_vectorize_mode="vector_entry_point")` each runner drives its
    vehicles at once, without an environment for each.

    Args:
        name: Under which RLlib finds it.
    """
    registry.register_env(name, _make)


def _make(config: Mapping[str, Any]) -> TricycleEnv | TricycleVectorEnv:
    """One vehicle, or as many as RLlib asks for by the key `num_envs`."""
    options = dict(config)
    number = options.pop("num_envs", None)
    return make_env(**options) if number is None else make_vector_env(number, **options)
