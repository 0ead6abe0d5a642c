"""What all fleets are to stable-baselines3: vehicles without attributes, methods or wrappers of their own."""

from abc import ABC
from types import SimpleNamespace
from typing import Any

import gymnasium
from stable_baselines3.common.vec_env import VecEnv


class Vehicles(VecEnv, ABC):
    """A `VecEnv` of vehicles that share all they have."""

    shared: object = SimpleNamespace(render_mode=None)
    """Has the attributes that are asked for, `render_mode` among them: by default vehicles are not drawn."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """What they share under a name, for each."""
        return [getattr(self.shared, attr_name) for _ in self._get_indices(indices)]

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
