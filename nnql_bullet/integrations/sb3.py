"""Many vehicles as the `VecEnv` that learners of stable-baselines3 take (needs the extra `sb3`)."""

import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

from nnql_bullet.agents.learning.sb3_vehicles import Vehicles
from nnql_bullet.api.environment import make_vector_env
from nnql_bullet.errors import UserError
from nnql_bullet.gym_env.vector import TricycleVectorEnv


def make_vec_env(n_envs: int = 64, **options: Any) -> "VehiclesVecEnv":
    """Makes vehicles that a learner of stable-baselines3 drives at once.

    Args:
        n_envs: Number of vehicles.
        **options: Those of `make_env`, but for `autoreset_mode`.

    Raises:
        UserError: See `make_env`.
    """
    return VehiclesVecEnv(make_vector_env(n_envs, **options, autoreset_mode=AutoresetMode.SAME_STEP))


class VehiclesVecEnv(Vehicles):
    """A `TricycleVectorEnv` as a `VecEnv`, without an environment or a process for each vehicle."""

    def __init__(self, envs: TricycleVectorEnv) -> None:
        """Takes the vehicles, and closes them with itself.

        Args:
            envs: The vehicles; a vehicle whose episode is over must be in its next world at once (`SAME_STEP`).

        Raises:
            UserError: If their autoreset mode is another.
        """
        if envs.metadata["autoreset_mode"] != AutoresetMode.SAME_STEP:
            raise UserError("stable-baselines3 needs vehicles with autoreset_mode=AutoresetMode.SAME_STEP")
        self._envs = self.shared = envs
        self._actions: NDArray[Any] = np.zeros(0)
        self._returns, self._lengths = np.zeros(envs.num_envs), np.zeros(envs.num_envs, np.int64)
        self._begun = time.monotonic()
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)

    def reset(self) -> Any:
        """Starts an episode for every vehicle."""
        given = [seed for seed in self._seeds if seed is not None]
        told, _ = self._envs.reset(seed=given if len(given) == self.num_envs else None)
        self._reset_seeds()
        self._returns[:], self._lengths[:] = 0.0, 0
        return told

    def step_async(self, actions: NDArray[Any]) -> None:
        """Takes down what they are to do (n, ...)."""
        self._actions = actions

    def step_wait(self) -> tuple[Any, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Carries out one decision of each vehicle."""
        told, rewards, terminated, truncated, values = self._envs.step(self._actions)
        over = terminated | truncated
        self._returns += rewards
        self._lengths += 1
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for i in np.flatnonzero(over).tolist():
            final = values["final_info"]
            infos[i] = {
                "terminal_observation": values["final_obs"][i],
                "TimeLimit.truncated": bool(truncated[i]),
                "episode": {
                    "r": float(self._returns[i]),
                    "l": int(self._lengths[i]),
                    "t": time.monotonic() - self._begun,
                },
                "ending": final["ending"][i],
                "is_success": bool(final["is_success"][i]),
            }
        self._returns[over], self._lengths[over] = 0.0, 0
        return told, rewards.astype(np.float32), over, infos

    def close(self) -> None:
        """Frees the vehicles."""
        self._envs.close()

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """A picture of each vehicle, if the `render_mode` is `rgb_array`."""
        return list(self._envs.render() or [None] * self.num_envs)
