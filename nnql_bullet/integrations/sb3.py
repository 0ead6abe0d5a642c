"""Many vehicles as the `VecEnv` that learners of stable-baselines3 take (needs the extra `sb3`)."""

from typing import Any

from gymnasium.vector import AutoresetMode

from nnql_bullet.agents.learning.sb3_vehicles import VehiclesVecEnv
from nnql_bullet.api.environment import make_vector_env

__all__ = ["VehiclesVecEnv", "make_vec_env"]


def make_vec_env(n_envs: int = 64, **options: Any) -> VehiclesVecEnv:
    """Makes vehicles that a learner of stable-baselines3 drives at once.

    Args:
        n_envs: Number of vehicles.
        **options: Those of `make_env`, but for `autoreset_mode`.

    Raises:
        UserError: See `make_env`.
    """
    return VehiclesVecEnv(make_vector_env(n_envs, **options, autoreset_mode=AutoresetMode.SAME_STEP))
