"""Makes the engines of contact physics by name, and a simulator of n engines."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array
from nnql_bullet.sim.base import Motion, Traces, driving, no_motion
from nnql_bullet.sim.contact import ContactEngine
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.passages import Point
from nnql_bullet.worlds.spec import WorldSpec

EngineName = Literal["bullet", "mujoco"]
PhysicsName = Literal["reference", "fast"]
"""Names of settings; every engine has both."""


def contact_engine(
    engine: EngineName, physics: PhysicsName, vehicle: VehicleSpec, drive: DriveOptions, refinement: int = 1
) -> ContactEngine:
    """Makes an engine; its library is imported here and not before.

    Args:
        engine: Name of the engine.
        physics: Name of its settings.
        vehicle: The vehicle in it.
        drive: Options of the vehicle's controller.
        refinement: Divisor of the settings' time step.

    Raises:
        UserError: If the library is not installed.
    """
    if engine == "bullet":
        from nnql_bullet.sim import bullet

        plain = bullet.PHYSICS[physics]
        # The errors of all steps add up, and the residual is a squared error.
        finer = replace(plain, time_step=plain.time_step / refinement, residual=plain.residual / refinement**2)
        return bullet.BulletEngine(vehicle, drive, finer)
    try:
        from nnql_bullet.sim import mujoco
    except ImportError:
        raise UserError("MuJoCo is not installed; install it with: pip install 'nnql-bullet[mujoco]'") from None
    chosen = mujoco.PHYSICS[physics]
    return mujoco.MujocoEngine(vehicle, drive, replace(chosen, time_step=chosen.time_step / refinement))


class ContactSimulator:
    """A `Simulator` of n engines, which run one after another in this process."""

    def __init__(self, engines: Sequence[ContactEngine]) -> None:
        self.engines = engines
        self.size = len(engines)
        self.vehicle, self.drive = engines[0].vehicle, engines[0].drive

    def reset(self, worlds: Mapping[int, WorldSpec]) -> tuple[Array, Array]:
        """See `Simulator.reset`."""
        poses, ray_distances = np.empty((len(worlds), 3)), np.empty((len(worlds), self.vehicle.sensor.rays))
        for row, (i, world) in enumerate(worlds.items()):
            engine = self.engines[i]
            engine.reset(world)
            pose = engine.pose()
            poses[row] = pose.x, pose.y, pose.yaw
            ray_distances[row] = engine.scan()
        return poses, ray_distances

    def advance(
        self,
        heading_changes: Array,
        active: NDArray[np.bool_] | None = None,
        speed_scales: Array | None = None,
        traces: Traces | None = None,
    ) -> tuple[Motion, Array]:
        """See `Simulator.advance`."""
        motion, traces = no_motion(self.size), traces or {}
        ray_distances = np.zeros((self.size, self.vehicle.sensor.rays))
        for i in driving(active, self.size):
            engine, scale = self.engines[i], 1.0 if speed_scales is None else float(speed_scales[i])
            m = engine.advance(float(heading_changes[i]), traces.get(i), scale)
            motion.pose[i] = m.pose.x, m.pose.y, m.pose.yaw
            motion.yaw_rate[i], motion.speed[i] = m.yaw_rate, m.speed
            motion.duration[i], motion.path_length[i] = m.duration, m.path_length
            motion.clearance[i], motion.heading_error[i] = m.clearance, m.heading_error
            motion.touching[i], motion.at_target[i], motion.overturned[i] = m.touching, m.at_target, m.overturned
            ray_distances[i] = engine.scan()
        return motion, ray_distances

    def retarget(self, targets: Mapping[int, Point]) -> None:
        """See `Simulator.retarget`."""
        for i, target in targets.items():
            self.engines[i].retarget(target)

    def close(self) -> None:
        """Closes the engines."""
        for engine in self.engines:
            engine.close()


def contact_simulator(
    engine: EngineName, physics: PhysicsName, vehicle: VehicleSpec, drive: DriveOptions, size: int
) -> ContactSimulator:
    """Makes a simulator of n engines (see `contact_engine`).

    Raises:
        UserError: If the library is not installed.
    """
    return ContactSimulator([contact_engine(engine, physics, vehicle, drive) for _ in range(size)])
