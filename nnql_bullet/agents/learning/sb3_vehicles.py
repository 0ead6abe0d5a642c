"""Many vehicles as the `VecEnv` that learners of stable-baselines3 take."""

import time
from collections.abc import Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode, VectorEnv
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv

from nnql_bullet.errors import UserError


class VehiclesVecEnv(VecEnv):
    """Vehicles of a vector environment as a `VecEnv`, without an environment or a process for each vehicle."""

    def __init__(self, envs: VectorEnv[Any, Any, Any]) -> None:
        """Takes the vehicles, and closes them with itself.

        Args:
            envs: The vehicles; a vehicle whose episode is over must be in its next world at once (`SAME_STEP`), and
                `final_info` tell its ending and whether that is a success.

        Raises:
            UserError: If their autoreset mode is another.
        """
        if envs.metadata["autoreset_mode"] != AutoresetMode.SAME_STEP:
            raise UserError("stable-baselines3 needs vehicles with autoreset_mode=AutoresetMode.SAME_STEP")
        self._envs = envs
        self._actions: NDArray[Any] = np.zeros(0)
        self._returns, self._lengths = np.zeros(envs.num_envs), np.zeros(envs.num_envs, np.int64)
        self._begun = time.monotonic()
        super().__init__(envs.num_envs, envs.single_observation_space, envs.single_action_space)

    def reset(self) -> Any:
        """Starts an episode for every vehicle."""
        given = [seed for seed in self._seeds if seed is not None]
        told, _ = self._envs.reset(seed=given if len(given) == self.num_envs else None)  # type: ignore[arg-type]
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
        pictures: Any = self._envs.render()
        return list(pictures or [None] * self.num_envs)

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """What they share under a name, for each."""
        return [getattr(self._envs, attr_name) for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Raises an AttributeError: vehicles have no attributes of their own to set."""
        raise AttributeError(attr_name)

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Raises an AttributeError: vehicles have no methods of their own to call."""
        raise AttributeError(method_name)

    def env_is_wrapped(
        self, wrapper_class: type[gymnasium.Wrapper[Any, Any, Any, Any]], indices: Any = None
    ) -> list[bool]:
        """False for each: no vehicle is wrapped."""
        return [False for _ in self._get_indices(indices)]
