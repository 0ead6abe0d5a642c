"""How policies drive in place of their own way: what the functions that drive are asked for, and the record of it."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

from typing_extensions import TypedDict

from nnql_bullet.commands import flags
from nnql_bullet.config import merged, nested
from nnql_bullet.errors import UserError
from nnql_bullet.run_config import DRIVING, Conditions, Keys, SimulatorName, asked_title, frozen_keys
from nnql_bullet.sim.engines import PhysicsName
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.vehicle.urdf import robot_name
from nnql_bullet.worlds.passages import Point
from nnql_bullet.worlds.waypoints import as_waypoints


class DrivingArguments(TypedDict, total=False):
    """How policies drive.

    Attributes:
        robot: A shipped robot, a TOML file or a `Vehicle`; by default each policy's own, of `barn` one of its own.
        speed: Speed [m/s]; by default that of each policy, or the robot's own if that is less.
        conditions: Conditions in place of each policy's own.
        shield: Whether to put policies into a shield; `evaluate` and `barn` drive each without one too, and `ablate`
            trains without one.
        changes: Nested values laid over the tables drive, shield, plan, task and agent of each policy's configuration;
            those of a shield hold for policies in a shield.
        check: Whether a robot of your own is checked when it is first driven in contact physics, as is the default (see
            `RobotWarning`).
    """

    robot: str | Path | VehicleSpec | None
    speed: float | None
    conditions: Conditions | None
    shield: bool
    changes: Mapping[str, Any]
    check: bool


class SimulationArguments(DrivingArguments, total=False):
    """How policies drive, and in which simulator.

    Attributes:
        simulator: Where policies drive, wherever they were trained: "bullet", the default, or "mujoco", which are
            contact physics, or "kinematic". Of `gap` it is the second simulator, which is one of contact physics.
        physics: Solver settings of contact physics: "reference", the default, or "fast".
    """

    simulator: SimulatorName
    physics: PhysicsName


class PlaceArguments(SimulationArguments, total=False):
    """How policies drive, in which simulator, and from where to where.

    Attributes:
        start: x, y [m] and, if given, yaw [rad] of the start in the frame of the world's map, in place of its own.
        target: x, y [m] of the target in that frame, in place of its own.
        waypoints: x, y [m] in that frame of several targets to reach in turn, of which the last is the target; or a
            file of them (see `waypoints.read_waypoints`).
        plan: Whether a plan of the way through the whole world leads policies; for its lengths see the keys `plan` in
            `changes`.
        allow_impassable: Whether to drive even if the vehicle is too wide for every path to the target.
    """

    start: Sequence[float] | None
    target: Sequence[float] | None
    waypoints: str | Path | Sequence[Sequence[float]] | None
    plan: bool
    allow_impassable: bool


def asked_tables(asked: DrivingArguments) -> dict[str, Any]:
    """Returns what is asked for besides conditions as nested values of a configuration, checked.

    Raises:
        UserError: If a value is of something else than how a policy drives, or the vehicle has no file.
    """
    changes, robot, speed = asked.get("changes", {}), asked.get("robot"), asked.get("speed")
    others = [key for key in changes if key not in DRIVING]
    if others:
        raise UserError(f"changes: '{others[0]}' is not of how a policy drives; these are: {', '.join(DRIVING)}")
    tables = merged({"shield": {}} if asked.get("shield") else {}, changes)
    own = {"robot": None if robot is None else robot_name(robot), "drive": {} if speed is None else {"speed": speed}}
    return merged(tables, own)


@dataclass(frozen=True, slots=True)
class Setting:
    """How policies drive in place of their own way."""

    simulator: SimulatorName
    physics: PhysicsName
    conditions: Conditions | None = None
    """Conditions that replace each policy's own; None keeps those."""
    allow_impassable: bool = False
    """Whether worlds are taken as they are drawn, even if the vehicle is too wide for every path."""
    start: tuple[float, ...] | None = None
    """In place of each world's own: x, y [m] and, if given, yaw [rad], in the frame of its map."""
    target: tuple[float, ...] | None = None
    """In place of each world's own [m]."""
    waypoints: tuple[Point, ...] | None = None
    """Places to reach in turn, in place of each world's own target [m]; the last is the target."""
    plan: bool = False
    """Whether a plan leads each policy."""
    keys: Keys = ()
    """What else each policy drives with in place of its own configuration: robot, speed, keys of the shield, ..."""
    shield: bool = False
    """Whether policies drive in a shield."""

    @classmethod
    def of(cls, asked: SimulationArguments) -> "Setting":
        """Makes the record of what is asked for, places among it where a function takes them.

        Raises:
            UserError: See `asked_tables`; or if way points are wrong.
        """
        tables, places = asked_tables(asked), cast(PlaceArguments, asked)
        start, target, waypoints = places.get("start"), places.get("target"), places.get("waypoints")
        return cls(
            simulator=asked.get("simulator", "bullet"),
            physics=asked.get("physics", "reference"),
            conditions=asked.get("conditions"),
            allow_impassable=places.get("allow_impassable", False),
            start=None if start is None else tuple(start),
            target=None if target is None else tuple(target),
            waypoints=None if waypoints is None else as_waypoints(waypoints),
            plan=places.get("plan", False) or "plan" in tables,
            keys=frozen_keys(tables),
            shield="shield" in tables,
        )

    @property
    def changes(self) -> dict[str, Any]:
        """Changes to a policy's configuration, besides the ends of its world."""
        tables = (("plan", self.plan), ("shield", self.shield))
        return {
            "simulator": self.simulator,
            "physics": self.physics,
            "conditions": self.conditions,
            "allow_impassable": self.allow_impassable,
            **merged({name: {} for name, its in tables if its}, nested(dict(self.keys))),
        }

    @property
    def ends(self) -> dict[str, Any]:
        """What each world has in place of its own ends, by the keys of a configuration."""
        return {"start": self.start, "target": self.target, "waypoints": self.waypoints}

    def title(self, robots: Iterable[str] = ()) -> str:
        """Title for people, with the vehicles that drive."""
        where = "the kinematic model" if self.simulator == "kinematic" else f"{self.simulator}, {self.physics}"
        plan = "with a plan" if self.plan else ""
        return ", ".join(filter(None, (where, plan, asked_title(self.conditions, self.keys, robots))))

    @property
    def robot(self) -> str | None:
        """What all policies drive; None if each drives its own vehicle."""
        robot: str | None = dict(self.keys).get("robot")
        return robot

    @property
    def flags(self) -> list[str]:
        """Flags of the setting on a command line."""
        shield = ["--shield"] if self.shield else []
        physics = [] if self.simulator == "kinematic" else ["--physics", self.physics]
        impassable = ["--allow-impassable"] if self.allow_impassable else []
        plan = ["--plan"] if self.plan else []
        changes = {**self.ends, "conditions": self.conditions, **nested(dict(self.keys))}
        return [*shield, "--sim", self.simulator, *physics, *impassable, *plan, *flags(changes)]
