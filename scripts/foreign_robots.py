"""Measures whether robots drive in contact physics as in the kinematic model: 8 m straight on, and the five turns.

    python scripts/foreign_robots.py mir100.urdf turtlebot3.urdf

Each description is translated as `nnql-bullet robot FILE --write` does, and driven at its own speed. Prints, for each
robot and engine, the largest distance between the two ends over the way driven, and the largest difference of heading.
Exits 1 if one is beyond 3 % or 3 degrees, or a robot is refused.
"""

import sys
from collections.abc import Sequence
from contextlib import closing
from math import ceil, degrees, hypot
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import get_args

import numpy as np

from nnql_bullet import paper
from nnql_bullet.errors import UserError
from nnql_bullet.fidelity.probe import open_ground
from nnql_bullet.geometry import wrap_angle
from nnql_bullet.sim.engines import EngineName, PhysicsName, contact_engine
from nnql_bullet.sim.kinematic import KinematicSimulator
from nnql_bullet.vehicle.controller import DriveOptions, own_speed
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.vehicle.translation import read_robot
from nnql_bullet.vehicle.urdf import load_vehicle

STRAIGHT = 8.0
"""Way straight on [m]."""
AFTERWARDS = 5
"""Decisions straight on after a turn."""
WAY, HEADING = 0.03, 3.0
"""Largest accepted difference of the ends over the way, and of the headings [degrees]."""


def differences(vehicle: VehicleSpec, engine: EngineName, physics: PhysicsName) -> tuple[float, float]:
    """Drives 8 m straight on, and each of the five turns, in an engine and in the kinematic model.

    Returns:
        The largest distance between the two ends over the way driven, and the largest difference of heading [degrees].
    """
    drive, world = DriveOptions(speed=own_speed(vehicle)), open_ground()
    straight = [0.0] * ceil(STRAIGHT / (drive.speed * drive.decision_period))
    plans = [straight, *([0.0, turn, *[0.0] * AFTERWARDS] for turn in paper.TURNS)]
    off, turned = 0.0, 0.0
    with closing(contact_engine(engine, physics, vehicle, drive)) as real:
        for plan in plans:
            with closing(KinematicSimulator(vehicle, drive, 1, threads=1)) as ideal:
                real.reset(world)
                ideal.reset({0: world})
                way = 0.0
                for turn in plan:
                    here, (there, _) = real.advance(turn), ideal.advance(np.array([turn]))
                    way += here.path_length
                    if here.touching or here.overturned:
                        return np.inf, np.inf
            x, y, yaw = there.pose[0].tolist()
            off = max(off, hypot(here.pose.x - x, here.pose.y - y) / way)
            turned = max(turned, abs(degrees(wrap_angle(here.pose.yaw - yaw))))
    return off, turned


def main(files: Sequence[str]) -> int:
    """Measures each robot; the exit code."""
    ok = True
    for file in files:
        try:
            with TemporaryDirectory() as folder:
                vehicle = load_vehicle(read_robot(file).save(Path(folder) / "robot.toml")[0])
        except UserError as error:
            print(f"refused: {error}")
            ok = False
            continue
        for engine in get_args(EngineName):
            for physics in get_args(PhysicsName):
                off, turned = differences(vehicle, engine, physics)
                good = off <= WAY and turned <= HEADING
                ok = ok and good
                verdict = "" if good else "  too far"
                name = Path(file).name.split(".")[0]
                print(
                    f"{name:<24} {engine:<8} {physics:<10} way {off:7.3%}  heading {turned:7.3f} deg{verdict}",
                    flush=True,
                )
    return 0 if ok else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
