"""Registers the environments with Gymnasium, as soon as somebody imports Gymnasium."""

import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType

from nnql_bullet.paper import STEPS_PER_EPISODE

VARIANTS: dict[str, dict[str, str]] = {
    "nnql_bullet/Tricycle-v0": {},
    "nnql_bullet/TricycleRays-v0": {"observation": "rays", "actions": "braking", "reward": "progress"},
    "nnql_bullet/TricycleGoal-v0": {"observation": "goal", "reward": "sparse"},
    "nnql_bullet/TricycleFrames-v0": {"observation": "frames", "reward": "progress"},
    "nnql_bullet/TricycleContinuous-v0": {"observation": "rays", "actions": "continuous", "reward": "progress"},
}
"""The environments that Gymnasium knows, and the arguments of `make_env` in which they differ from its defaults."""
_REGISTRATION = "gymnasium.envs.registration"


def register_lazily() -> None:
    """Registers now if Gymnasium has been imported, else when it is.

    Importing Gymnasium takes longer than all else that `import nnql_bullet` does.
    """
    if _REGISTRATION in sys.modules:
        register()
    else:
        sys.meta_path.insert(0, _Waiting())


def register() -> None:
    """Makes the `VARIANTS` known to `gymnasium.make` and `gymnasium.make_vec`."""
    gymnasium = import_module(_REGISTRATION)
    for name, arguments in VARIANTS.items():
        if name not in gymnasium.registry:
            gymnasium.register(
                id=name,
                entry_point="nnql_bullet.api.environment:make_env",
                vector_entry_point="nnql_bullet.api.environment:make_vector_env",
                max_episode_steps=STEPS_PER_EPISODE,
                kwargs=dict(arguments),
            )


class _Waiting(MetaPathFinder):
    """Waits for the import of Gymnasium's registration, and then takes itself out of the way."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        """The spec of Gymnasium's registration, with a loader that registers after it; None for all else."""
        if fullname != _REGISTRATION:
            return None
        sys.meta_path.remove(self)
        spec = find_spec(fullname)
        if spec is not None and spec.loader is not None:
            execute = spec.loader.exec_module

            def exec_module(module: ModuleType) -> None:
                execute(module)
                register()

            spec.loader.exec_module = exec_module  # type: ignore[method-assign]
        return spec
