"""Neural-network Q-learning for an industrial three-wheeled vehicle, validated in contact physics.

    import nnql_bullet as nb

    run = nb.train("paper", simulator="kinematic", vehicles=64, out="runs/paper-0")
    recording = nb.drive(run.policy, world="traps", seed=1, shield=True)
    recording.render("drive.mp4")
    print(nb.evaluate([run.policy, "vfh"], worlds=["cover_10"], simulator="kinematic").table())

Every name is imported when it is first used. Gymnasium knows the environment as `nnql_bullet/Tricycle-v0`.
"""

import sys
from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nnql_bullet.api.ablate import ablate
    from nnql_bullet.api.environment import make_env
    from nnql_bullet.api.evaluate import evaluate
    from nnql_bullet.api.failures import failures
    from nnql_bullet.api.fidelity import envelope, fidelity
    from nnql_bullet.api.gap import gap
    from nnql_bullet.api.training import resume, train
    from nnql_bullet.driving import drive
    from nnql_bullet.errors import UserError, WorkFailed
    from nnql_bullet.recording import Recording
    from nnql_bullet.run_config import Conditions
    from nnql_bullet.runs import load_policy, load_run
    from nnql_bullet.vehicle.spec import VehicleSpec as Vehicle
    from nnql_bullet.work import Progress
    from nnql_bullet.worlds.source import World

__version__ = "0.2.0"

_ENVIRONMENT = "nnql_bullet/Tricycle-v0"
_HOMES = {
    "Conditions": "run_config",
    "Progress": "work",
    "Recording": "recording",
    "UserError": "errors",
    "Vehicle": "vehicle.spec",
    "WorkFailed": "errors",
    "World": "worlds.source",
    "ablate": "api.ablate",
    "drive": "driving",
    "envelope": "api.fidelity",
    "evaluate": "api.evaluate",
    "failures": "api.failures",
    "fidelity": "api.fidelity",
    "gap": "api.gap",
    "load_policy": "runs",
    "load_run": "runs",
    "make_env": "api.environment",
    "resume": "api.training",
    "train": "api.training",
}
"""Module of each name."""

__all__ = [
    "Conditions",
    "Progress",
    "Recording",
    "UserError",
    "Vehicle",
    "WorkFailed",
    "World",
    "ablate",
    "drive",
    "envelope",
    "evaluate",
    "failures",
    "fidelity",
    "gap",
    "load_policy",
    "load_run",
    "make_env",
    "resume",
    "train",
]


def register() -> None:
    """Makes `nnql_bullet/Tricycle-v0` known to Gymnasium, which calls this when it is imported."""
    registration = import_module("gymnasium.envs.registration")
    if _ENVIRONMENT not in registration.registry:
        registration.register(
            id=_ENVIRONMENT,
            entry_point="nnql_bullet.gym_env:TricycleEnv",
            vector_entry_point="nnql_bullet.gym_env:TricycleVectorEnv",
        )


if "gymnasium.envs.registration" in sys.modules:  # Gymnasium was imported before, perhaps without its plugins
    register()


def __getattr__(name: str) -> Any:
    """Imports a name from its module."""
    if name not in _HOMES:
        raise AttributeError(f"module 'nnql_bullet' has no attribute '{name}'")
    value = getattr(import_module(f"nnql_bullet.{_HOMES[name]}"), {"Vehicle": "VehicleSpec"}.get(name, name))
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """The public names."""
    return [*__all__, "__version__"]
