"""What several verbs share: flags, the arguments of the library's functions that they are, and words about maps."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any

import tyro

from nnql_bullet.cli.console import tell
from nnql_bullet.cli.flags import NUMBERS, SHORT_FLAGS, WAYPOINTS, KeyFlags
from nnql_bullet.executors import ExecutorArguments, ExecutorKind
from nnql_bullet.run_config import SimulatorName, conditions_of
from nnql_bullet.setting import DrivingArguments, PlaceArguments, SimulationArguments
from nnql_bullet.sim.engines import PhysicsName
from nnql_bullet.worlds.imported import import_file
from nnql_bullet.worlds.importers import is_foreign

DriveKeys = Annotated[
    Mapping[str, Any],
    KeyFlags(
        names=("robot", "conditions.", "drive.", "shield.", "plan.", "task.", "agent."),
        shown=("robot", *SHORT_FLAGS),
        title="vehicle",
        defaults=False,
        about=(
            "Conditions are flags too: --conditions.wheel-friction, --conditions.payload [kg], "
            "--conditions.payload-height [m], --conditions.sensor-noise [m], --conditions.dead-sector (0 to 7), "
            "--conditions.decision-latency [s], --conditions.wheel-lag [s]. So are keys of agent, drive, plan, shield, "
            "task: --shield.margin asks for a shield too. To list them: nnql-bullet keys shield"
        ),
    ),
]
"""Values of a verb that drives, in place of each policy's own."""
Place = Annotated[tuple[float, ...] | None, NUMBERS]
"""The numbers of a start or target."""
Waypoints = Annotated[tuple[tuple[float, float], ...] | None, WAYPOINTS]
"""The places to reach in turn."""


@dataclass(frozen=True)
class DrivingFlags:
    """How policies drive."""

    shield: bool = False
    """Drive in a shield (`evaluate`, `barn`: too): take the best action that leaves room to stop; else brake."""
    check: bool = True
    """Leave out the check of a robot of your own when it is first driven in contact physics."""
    keys: DriveKeys = field(default_factory=dict)
    """Values in place of each policy's own."""

    @property
    def asked(self) -> DrivingArguments:
        """What they ask for.

        Raises:
            UserError: If a value is wrong.
        """
        changes = {key: value for key, value in self.keys.items() if key != "conditions"}
        conditions = conditions_of(self.keys.get("conditions", {}))
        return {"shield": self.shield, "check": self.check, "conditions": conditions, "changes": changes}


@dataclass(frozen=True)
class SimulationFlags(DrivingFlags):
    """How policies drive, and in which simulator."""

    sim: SimulatorName = "bullet"
    """Simulator; bullet and mujoco are contact physics."""
    physics: PhysicsName = "reference"
    """Solver settings of contact physics."""

    @property
    def asked(self) -> SimulationArguments:
        """What they ask for; see `DrivingFlags`."""
        return {**super().asked, "simulator": self.sim, "physics": self.physics}


@dataclass(frozen=True)
class PlaceFlags(SimulationFlags):
    """How policies drive, in which simulator, and from where to where."""

    start: Annotated[Place, tyro.conf.arg(metavar="X,Y[,YAW]")] = None
    """Start, at rest, in the frame of the world's map [m, radians], in place of its own."""
    target: Annotated[Place, tyro.conf.arg(metavar="X,Y")] = None
    """Target in that frame, in place of its own."""
    waypoints: Annotated[Waypoints, tyro.conf.arg(metavar="FILE|X,Y;...")] = None
    """Places in that frame to reach in turn; the last is the target. A file is CSV (x,y a line) or JSON."""
    plan: bool = False
    """Lead policies along a plan of the way through the whole world, but for moving obstacles; for goals beyond sight.
    Its lengths: --plan.look-ahead [m], --plan.room [m], --plan.caution."""
    allow_impassable: bool = False
    """Drive even if every path is too narrow."""

    @property
    def asked(self) -> PlaceArguments:
        """What they ask for; see `DrivingFlags`."""
        return {
            **super().asked,
            "start": self.start,
            "target": self.target,
            "waypoints": self.waypoints,
            "plan": self.plan,
            "allow_impassable": self.allow_impassable,
        }

    @property
    def end(self) -> tuple[float, ...] | None:
        """Where a drive ends, if that is given."""
        return self.waypoints[-1] if self.waypoints else self.target


@dataclass(frozen=True)
class ExecutorFlags:
    """Where pieces of work run."""

    workers: Annotated[int | None, tyro.conf.arg(metavar="W")] = None
    """Pieces at a time; default one a core. They do not change the result."""
    executor: ExecutorKind = "processes"
    """Where pieces run; inline is this process."""
    address: Annotated[str | None, tyro.conf.arg(metavar="HOST:PORT")] = None
    """A running Ray cluster; without it Ray is started on this machine."""

    @property
    def asked(self) -> ExecutorArguments:
        """What they ask for."""
        return {"workers": self.workers, "executor": self.executor, "address": self.address}


def tell_warnings(names: Iterable[object], start: Place, target: Place) -> None:
    """Says on standard error what was chosen in maps of other programs, and what is left out of them."""
    for name in names:
        if isinstance(name, str | Path) and is_foreign(Path(name)):
            for warning in import_file(Path(name), start=start, target=target).warnings:
                tell(f"{name}: {warning}")
