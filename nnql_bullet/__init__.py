"""Neural-network Q-learning for an industrial three-wheeled vehicle, validated in contact physics.

    import nnql_bullet as nb

    run = nb.train("paper", simulator="kinematic", vehicles=64, out="runs/paper-0")
    recording = nb.drive(run.policy, world="traps", seed=1, shield=True)
    recording.render("drive.mp4")
    print(nb.evaluate([run.policy, "vfh"], worlds=["cover_10"], simulator="kinematic").table())

Every name is imported when it is first used. `gymnasium.make` knows the environment as `nnql_bullet/Tricycle-v0`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from nnql_bullet.registration import register_lazily

if TYPE_CHECKING:
    from nnql_bullet.api.ablate import ablate
    from nnql_bullet.api.barn import barn
    from nnql_bullet.api.environment import make_env
    from nnql_bullet.api.evaluate import evaluate
    from nnql_bullet.api.export import export
    from nnql_bullet.api.failures import failures
    from nnql_bullet.api.fidelity import check_fidelity, envelope
    from nnql_bullet.api.gap import gap
    from nnql_bullet.api.sweep import sweep
    from nnql_bullet.api.training import resume, train
    from nnql_bullet.api.worlds import export_world, import_world, view_world
    from nnql_bullet.driving import drive
    from nnql_bullet.errors import RobotWarning, UserError, WorkFailed
    from nnql_bullet.recording import Recording
    from nnql_bullet.run_config import Conditions
    from nnql_bullet.runs import load_policy, load_run
    from nnql_bullet.vehicle.spec import VehicleSpec as Vehicle
    from nnql_bullet.vehicle.translation import read_robot
    from nnql_bullet.work import Progress
    from nnql_bullet.worlds.source import World

__version__ = "0.2.0"

_HOMES = {
    "Conditions": "run_config",
    "Progress": "work",
    "Recording": "recording",
    "RobotWarning": "errors",
    "UserError": "errors",
    "Vehicle": "vehicle.spec",
    "WorkFailed": "errors",
    "World": "worlds.source",
    "ablate": "api.ablate",
    "barn": "api.barn",
    "check_fidelity": "api.fidelity",
    "drive": "driving",
    "envelope": "api.fidelity",
    "evaluate": "api.evaluate",
    "export": "api.export",
    "export_world": "api.worlds",
    "failures": "api.failures",
    "gap": "api.gap",
    "import_world": "api.worlds",
    "load_policy": "runs",
    "load_run": "runs",
    "make_env": "api.environment",
    "read_robot": "vehicle.translation",
    "resume": "api.training",
    "sweep": "api.sweep",
    "train": "api.training",
    "view_world": "api.worlds",
}
"""Module of each name."""

__all__ = [
    "Conditions",
    "Progress",
    "Recording",
    "RobotWarning",
    "UserError",
    "Vehicle",
    "WorkFailed",
    "World",
    "ablate",
    "barn",
    "check_fidelity",
    "drive",
    "envelope",
    "evaluate",
    "export",
    "export_world",
    "failures",
    "gap",
    "import_world",
    "load_policy",
    "load_run",
    "make_env",
    "read_robot",
    "resume",
    "sweep",
    "train",
    "view_world",
]


register_lazily()


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
