"""Checks a robot that is not shipped against mechanics on paper when it is first driven in contact physics."""

import hashlib
import json
import warnings
from collections.abc import Sequence
from contextlib import suppress
from importlib.metadata import packages_distributions, version
from math import isnan
from pathlib import Path
from shlex import quote

from nnql_bullet import __version__, assets
from nnql_bullet.errors import RobotWarning
from nnql_bullet.fidelity.probe import Bench, Measurement
from nnql_bullet.files import write_text
from nnql_bullet.machine import cache_folder
from nnql_bullet.sim.engines import EngineName, PhysicsName
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.vehicle.urdf import load_vehicle
from nnql_bullet.work import OnProgress, Progress, silent

NAMED = 4
"""Largest number of quantities that a warning names."""
_MODULES: dict[EngineName, str] = {"bullet": "pybullet", "mujoco": "mujoco"}
_checked: set[str] = set()  # digests of what this process has checked or found in the cache


def check_at_first_use(
    robot: str | Path | VehicleSpec, simulator: str, physics: PhysicsName, on_progress: OnProgress | None = None
) -> None:
    """Warns of what is off with a robot in an engine, the first time that it is used there.

    The probes of `fidelity` run once, at the engine's own time step. The verdict is kept in the user's cache under a
    digest of the robot, the engine and their versions, and neither the probes nor the warning are repeated. Where
    there is no cache they are not repeated in this process. Shipped robots, and the kinematic model, need no check.

    Args:
        robot: A shipped robot, a TOML file or a vehicle.
        simulator: An engine of contact physics, or the kinematic model.
        physics: The engine's solver settings.
        on_progress: Receives the progress.

    Warns:
        RobotWarning: In one line, which quantities are off.

    Raises:
        UserError: If the robot cannot be read, or the engine is not installed.
    """
    vehicle = load_vehicle(robot)
    if simulator not in _MODULES or assets.is_shipped("robots", vehicle.urdf):
        return
    bench = Bench(vehicle, simulator, physics)
    digest = digest_of(bench)
    cache = cache_folder()
    kept = cache / "robots" / f"{digest}.json" if cache else None
    if digest in _checked or (kept and kept.exists()):
        return
    off = _off(bench, on_progress or silent)
    _checked.add(digest)
    if kept:
        with suppress(OSError):
            kept.parent.mkdir(parents=True, exist_ok=True)
            write_text(kept, json.dumps({"robot": vehicle.name, "engine": simulator, "off": off}) + "\n")
    if off:
        warnings.warn(_sentence(bench, off), RobotWarning, stacklevel=3)


def digest_of(bench: Bench) -> str:
    """Hashes what the verdict on a robot depends on: the vehicle wherever its files are, engine and versions."""
    packages = packages_distributions().get(_MODULES[bench.engine], ())
    versions = [f"{name} {version(name)}" for name in sorted(set(packages))]
    depends = __version__, *versions, bench.engine, bench.physics, bench.vehicle.digest
    return hashlib.sha256(" ".join(map(str, depends)).encode()).hexdigest()[:24]


def _off(bench: Bench, report_to: OnProgress) -> list[str]:
    """States the quantities that are out of their tolerances."""
    from nnql_bullet.fidelity.probes import probes_for, run_probes  # not at the top: most drives need none

    what, total = f"checking robot '{bench.vehicle.name}', once", len(probes_for(bench.vehicle))
    report_to(Progress(what, 0, total))
    off: list[str] = []
    for done, (probe, measurements) in enumerate(run_probes(bench), 1):
        off += [f"{probe.name}: {_text(its)}" for its in measurements if not its.ok]
        report_to(Progress(what, done, total, probe.title))
    return off


def _text(off: Measurement) -> str:
    if isnan(off.expected):  # it broke off
        return off.quantity
    unit = off.unit and f" {off.unit}"
    return f"{off.quantity} {off.measured:.4g}{unit} ({off.expected:.4g}{unit} on paper)"


def _sentence(bench: Bench, off: Sequence[str]) -> str:
    vehicle = bench.vehicle
    named = "; ".join([*off[:NAMED], *([f"{len(off) - NAMED} more"] if len(off) > NAMED else [])])
    file = quote(vehicle.source or str(vehicle.urdf))
    return (
        f"robot '{vehicle.name}' does not move in {bench.engine} as mechanics says: {named}. To see all: nnql-bullet "
        f"fidelity --robot {file} --sim {bench.engine} --physics {bench.physics}"
    )
