"""`nnql-bullet envelope`."""

from pathlib import Path
from typing import Annotated

import tyro

from nnql_bullet.api import fidelity as api
from nnql_bullet.cli.console import progress, say
from nnql_bullet.cli.shared import ExecutorFlags
from nnql_bullet.sim.engines import EngineName, PhysicsName
from nnql_bullet.vehicle.urdf import load_vehicle


def envelope(
    robot: Annotated[str, tyro.conf.arg(metavar="NAME|FILE")] = "tricycle",
    speed: Annotated[float | None, tyro.conf.arg(metavar="M/S")] = None,
    sim: EngineName = "bullet",
    physics: PhysicsName = "reference",
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    *,
    pieces: ExecutorFlags,
) -> int:
    """Measure which turns a vehicle can follow, and how far it runs until it stands.

    Turns over speed, control period, heading change, friction and payload: heading error, slip, least wheel load and
    friction used, with the limits on paper drawn over the measured ones. Stops over speed, friction and payload: the
    largest speed from which the vehicle stops within what its sensors see. Evidence for an engineer, never a
    certificate; the standard that asks this question is ISO 3691-4.

    Leaves envelope.md and stopping.md, and each of them as a picture, CSV and JSON.

    For example:

        nnql-bullet envelope
        nnql-bullet envelope --robot my/robot.toml --out runs/mine

    Args:
        robot: Shipped robot or TOML file.
        speed: Speed in the middle of those that are measured; default its own.
        sim: Engine of contact physics.
        physics: Its solver settings.
        out: Folder of the report; default runs/envelope/ROBOT-ENGINE-PHYSICS.
        pieces: Where pieces of work run.
    """
    vehicle = load_vehicle(robot)
    at = "" if speed is None else f"-{speed:g}"
    folder = out or Path("runs") / "envelope" / f"{vehicle.name}{at}-{sim}-{physics}"
    with progress() as show:
        results = api.envelope(
            vehicle,
            speed=speed,
            simulator=sim,
            physics=physics,
            **pieces.asked,
            out=folder,
            on_progress=show,
        )
    say(results.table())
    say(f"reports: {folder / 'envelope.md'}, {folder / 'stopping.md'}")
    return 0
