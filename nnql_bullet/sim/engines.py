"""The engines of contact physics by name."""

from dataclasses import replace
from typing import Literal

from nnql_bullet.errors import UserError
from nnql_bullet.sim.contact import ContactSimulator
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec

EngineName = Literal["bullet", "mujoco"]
PhysicsName = Literal["reference", "fast"]
"""Named settings, which every engine has."""


def contact_simulator(
    engine: EngineName, physics: PhysicsName, vehicle: VehicleSpec, drive: DriveOptions, refinement: int = 1
) -> ContactSimulator:
    """A new simulator. An engine is imported when it is asked for.

    Args:
        engine: Which.
        physics: Its settings.
        vehicle: What it moves.
        drive: How decisions reach the wheels.
        refinement: What the settings' time step is divided by.

    Raises:
        UserError: If the engine is not installed.
    """
    if engine == "bullet":
        from nnql_bullet.sim import bullet

        plain = bullet.PHYSICS[physics]
        # What is left over of each step adds up, and the residual is its square.
        finer = replace(plain, time_step=plain.time_step / refinement, residual=plain.residual / refinement**2)
        return bullet.BulletSimulator(vehicle, drive, finer)
    try:
        from nnql_bullet.sim import mujoco
    except ImportError:
        raise UserError("MuJoCo is not installed; install it with: pip install 'nnql-bullet[mujoco]'") from None
    chosen = mujoco.PHYSICS[physics]
    return mujoco.MujocoSimulator(vehicle, drive, replace(chosen, time_step=chosen.time_step / refinement))
