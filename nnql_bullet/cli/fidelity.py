"""`nnql-bullet fidelity`."""

from pathlib import Path
from typing import Annotated

import tyro

from nnql_bullet.api import fidelity as api
from nnql_bullet.cli.console import progress, say
from nnql_bullet.sim.engines import EngineName, PhysicsName
from nnql_bullet.vehicle.urdf import load_vehicle


def fidelity(
    robot: Annotated[str, tyro.conf.arg(metavar="NAME|FILE")] = "tricycle",
    speed: Annotated[float | None, tyro.conf.arg(metavar="M/S")] = None,
    sim: EngineName = "bullet",
    physics: PhysicsName = "reference",
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
) -> int:
    """Check an engine's physics against mechanics on paper.

    Every expectation follows from the vehicle's own URDF and TOML, so it works on yours too. Prints a table, and leaves
    fidelity.md, fidelity.json and pictures: how much of each tolerance is used, at the time step and at half of it; the
    five actions, ideal against contact; grip used, and the load on each wheel through the tightest turn. Exits 1 if a
    quantity is out of tolerance.

    For example:

        nnql-bullet fidelity
        nnql-bullet fidelity --robot my/robot.toml --sim mujoco --physics fast

    Args:
        robot: Shipped robot or TOML file.
        speed: Speed at which it drives; default its own.
        sim: Engine of contact physics.
        physics: Its solver settings.
        out: Folder of the report; default runs/fidelity/ROBOT-ENGINE-PHYSICS.
    """
    vehicle = load_vehicle(robot)
    at = "" if speed is None else f"-{speed:g}"
    folder = out or Path("runs") / "fidelity" / f"{vehicle.name}{at}-{sim}-{physics}"
    with progress() as show:
        results = api.check_fidelity(vehicle, speed=speed, simulator=sim, physics=physics, out=folder, on_progress=show)
    say(results.table())
    say(f"report: {folder / 'fidelity.md'}")
    return 0 if results.ok else 1
