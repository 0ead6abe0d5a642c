"""Registers the environment with Gymnasium, as soon as somebody imports Gymnasium."""

import sys
from collections.abc import Sequence
from importlib import import_module
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec
from importlib.util import find_spec
from types import ModuleType

ENVIRONMENT = "nnql_bullet/Tricycle-v0"
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
    """Makes `ENVIRONMENT` known to `gymnasium.make` and `gymnasium.make_vec`."""
    gymnasium = import_module(_REGISTRATION)
    if ENVIRONMENT not in gymnasium.registry:
        gymnasium.register(
            id=ENVIRONMENT,
            entry_point="nnql_bullet.gym_env:TricycleEnv",
            vector_entry_point="nnql_bullet.gym_env:TricycleVectorEnv",
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
