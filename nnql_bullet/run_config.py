"""The configuration of a run: which vehicle, world, simulator, task and agent, and how it is trained."""

import copy
from collections.abc import Iterable, Mapping
from dataclasses import fields, replace
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from nnql_bullet import paper
from nnql_bullet.agents import AnyAgentOptions
from nnql_bullet.agents.learning.options import NnqlOptions
from nnql_bullet.config import dotted, merged, options, parse, to_values
from nnql_bullet.planning.planner import PlanOptions
from nnql_bullet.sensing import BlindArc, RayCount, SensorRange
from nnql_bullet.shield.shield import ShieldOptions
from nnql_bullet.sim.domain_randomization import DomainRandomization
from nnql_bullet.sim.engines import EngineName, PhysicsName
from nnql_bullet.sim.faults import SensorFaults
from nnql_bullet.task import TaskOptions
from nnql_bullet.training.selection import SelectionOptions
from nnql_bullet.types import Count, Few, NonNegative, Number, Positive, Seed, Vehicles
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.payload import LOAD_HEIGHT, deck_load, loaded
from nnql_bullet.vehicle.spec import Delays, VehicleSpec
from nnql_bullet.worlds.source import Waypoints, WorldLike

DEFAULT_ROBOT = "tricycle"
SimulatorName = Literal[EngineName, "kinematic"]

RENAMED_KEYS = {
    "training.disturbances": "training.domain_randomization",
    "agent.seen_map": "agent.grid_map",
    "agent.steps": "agent.n_step",
    "agent.updates": "agent.gradient_steps",
    "agent.target_rate": "agent.tau",
    "agent.exploration": "agent.exploration_final",
    "shield.leads": "shield.recovers",
    "conditions.sensors.noise": "conditions.sensor_noise",
    "conditions.sensors.dead_sector": "conditions.dead_sector",
}
"""Names of keys in version 0.1, and their present names."""
REMOVED_KEYS = {"agent.paper_share": 0.0}
"""Keys of version 0.1 that no longer exist, and their values without effect."""
RENAMED_SIMULATORS = {"twin": "kinematic"}
"""Names of simulators in version 0.1, and their present names."""


@options
class Conditions:
    """Conditions of a drive. By default the vehicle is as its files describe it, and its sensors have no faults."""

    wheel_friction: Positive | None = None
    """Friction coefficient of every wheel against the ground; by default the vehicle's own."""
    payload: NonNegative = 0.0
    """Load on the middle of the deck [kg]."""
    payload_height: Positive = LOAD_HEIGHT
    """Height of the load's centre above the ground [m]."""
    sensor_noise: NonNegative = 0.0
    """Standard deviation of the noise of each ray that meets something [m]."""
    dead_sector: Annotated[int, Field(ge=0, lt=paper.SECTORS)] | None = None
    """Sensor that sees nothing, unknown to the policy; 0 is the front, the others follow counter-clockwise."""
    decision_latency: Annotated[float, Field(ge=0, le=60)] = 0.0
    """Time from a scan until the decision on it takes effect, less than a decision period [s]; in whole wheel commands
    of 1/120 s. Contact physics only."""
    wheel_lag: Annotated[float, Field(ge=0, le=60)] = 0.0
    """Time constant with which the wheel speeds follow their commands [s]. Contact physics only."""
    rays: RayCount | None = None
    """Number of the sensor's rays, a multiple of 4; by default the vehicle's own."""
    sensor_range: SensorRange | None = None
    """Distance from which on the sensor sees nothing [m]; by default the vehicle's own."""
    blind_arc_degrees: BlindArc | None = None
    """Angles, counter-clockwise from the first to the second, between which the sensor sees nothing; 0 is ahead, left
    is positive [degrees]. By default the vehicle's own."""

    @property
    def sensor_faults(self) -> SensorFaults:
        """The faults of the sensors."""
        return SensorFaults(noise=self.sensor_noise, dead_sector=self.dead_sector)

    @property
    def changes(self) -> dict[str, Any]:
        """The values that differ from the defaults."""
        return {f.name: getattr(self, f.name) for f in fields(self) if getattr(self, f.name) != f.default}

    @property
    def texts(self) -> dict[str, str]:
        """The values that differ from the defaults, as short texts."""
        return key_texts(self.changes)

    @property
    def title(self) -> str:
        """The values that differ from the defaults, in words; empty if there are none."""
        return asked_title(self, ())

    def applied_to(self, vehicle: VehicleSpec) -> VehicleSpec:
        """The vehicle under these conditions."""
        if self.wheel_friction is not None:
            vehicle = vehicle.gripping(self.wheel_friction)
        own = vehicle.sensor
        sensor = replace(
            own,
            rays=self.rays or own.rays,
            range=self.sensor_range or own.range,
            blind_arc_degrees=self.blind_arc_degrees or own.blind_arc_degrees,
        )
        vehicle = replace(vehicle, sensor=sensor, delays=Delays(self.decision_latency, self.wheel_lag))
        return loaded(vehicle, deck_load(vehicle, self.payload, self.payload_height))


@options
class TrainingOptions:
    """Options of training episodes, of evaluations between them and of the selection of the policy."""

    worlds: tuple[WorldLike, ...] = ()
    """Kinds of worlds that replace the run's world; each episode draws one of them."""
    domain_randomization: DomainRandomization = DomainRandomization()
    selection: SelectionOptions | None = None
    """Selection of the policy among late states of the training; by default the last state is the policy."""
    evaluate_every: Count | None = None
    """Episodes from one evaluation in validation worlds, in the kinematic model, to the next; by default there is none.
    """
    evaluate_worlds: tuple[WorldLike, ...] | None = None
    """Shipped worlds or TOML files to evaluate in; by default those of the training."""
    evaluate_count: Few | None = None
    """Validation worlds of each kind; by default 20."""
    stop_at_success: Annotated[float, Field(gt=0, le=1)] | None = None
    """Share of targets reached in an evaluation that ends the training; by default none does."""
    patience: Few | None = None
    """Evaluations in a row, none better than the best before, that end the training; by default none do."""

    def __post_init__(self) -> None:
        """Refuses keys of evaluations where there are none."""
        needing = ("evaluate_worlds", "evaluate_count", "stop_at_success", "patience")
        given = [key for key in needing if getattr(self, key) is not None]
        if given and self.evaluate_every is None:
            raise ValueError(f"{given[0]} needs evaluations; give evaluate_every too")


@options
class RunConfig:
    """Configuration of a training run. The defaults are the preset `paper`."""

    seed: Seed = 0
    """Seed of the whole run."""
    episodes: Count = paper.EPISODES
    """Number of training episodes."""
    start_from: str | None = None
    """Run folder, policy file or shipped policy whose weights to begin with; schedules begin anew."""
    world: WorldLike = "paper"
    """A shipped world, a path to a TOML file or to a map or world of another program, or a `World`."""
    start: Annotated[tuple[Number, ...], Field(min_length=2, max_length=3)] | None = None
    """x, y [m] and, if given, yaw [rad] of the start in the frame of the world's map; by default the world's own."""
    target: Annotated[tuple[Number, ...], Field(min_length=2, max_length=2)] | None = None
    """x, y [m] of the target in that frame; by default its own."""
    waypoints: Waypoints | None = None
    """x, y [m] in that frame of several targets to reach in turn, in place of `target`: the last is the target."""
    allow_impassable: bool = False
    """Whether to take worlds as they are drawn, even if the vehicle is too wide for every path to the target."""
    robot: str = DEFAULT_ROBOT
    """A shipped robot or a path to a TOML file."""
    simulator: SimulatorName = "bullet"
    """Contact physics in one of two engines, or the kinematic model."""
    physics: PhysicsName = "fast"
    """Solver settings of contact physics."""
    vehicles: Vehicles = 1
    """Number of vehicles in lockstep from which one policy learns; 1 is the paper's online learning."""
    conditions: Conditions = Conditions()
    training: TrainingOptions = TrainingOptions()
    drive: DriveOptions = DriveOptions()
    task: TaskOptions = TaskOptions()
    agent: AnyAgentOptions = NnqlOptions()
    plan: PlanOptions | None = None
    """Plan of the way through the whole world, along which a vehicle is led; by default it is told the bearing of the
    target alone."""
    shield: ShieldOptions | None = None
    """Shield around the policy; the agent learns without one."""


def changed(config: RunConfig, **changes: Any) -> RunConfig:
    """Changes nested values of a configuration (see `config.merged`).

    Raises:
        UserError: If a key or value is wrong.
    """
    return parse(RunConfig, merged(to_values(config), changes), "configuration")


def key_texts(values: Mapping[str, Any]) -> dict[str, str]:
    """Returns values by dotted names as short texts; a robot's is its name, wherever its file is."""
    found = {}
    for name, value in values.items():
        its = value if isinstance(value, list | tuple) else (value,)
        texts = [f"{one:g}" if isinstance(one, float) else str(one) for one in its]
        found[name.removeprefix("drive.")] = Path(texts[0]).stem if name == "robot" else "..".join(texts)
    return found


DRIVING = ("robot", "drive", "shield", "plan", "task", "agent")
"""The keys and tables of how a policy drives, besides the conditions."""


Keys = tuple[tuple[str, Any], ...]
"""Values by dotted names, as a record can hold them."""


def frozen_keys(values: Mapping[str, Any]) -> Keys:
    """Returns nested values as a record can hold them; `config.nested` is the inverse."""
    plain = {name: tuple(its) if isinstance(its, list) else its for name, its in dotted(merged({}, values)).items()}
    given = [(name, its) for name, its in plain.items() if its is not None]
    return tuple(sorted(given, key=lambda pair: (DRIVING.index(pair[0].partition(".")[0]), pair[0])))


def asked_title(conditions: Conditions | None, keys: Keys, robots: Iterable[str] = ()) -> str:
    """Returns what is asked for in place of the policies' own, in words; empty if that is nothing.

    Args:
        conditions: What is asked for.
        keys: What is asked for besides.
        robots: Names of the vehicles that drive; the shipped one's is not worth a word.
    """
    own = sorted({*robots} - {DEFAULT_ROBOT, ""}) if "robot" not in dict(keys) else []
    texts = {"robot": " and ".join(own)} if own else {}
    texts |= key_texts(dict(keys)) | (conditions.texts if conditions else {})
    return ", ".join(f"{name.replace('_', ' ')} {text}" for name, text in texts.items())


def conditions_of(values: Mapping[str, Any]) -> Conditions | None:
    """Makes conditions with some values; returns None if there are no values.

    Raises:
        UserError: If a key or value is wrong.
    """
    return changed(RunConfig(), conditions=values).conditions if values else None


def migrated(values: Mapping[str, Any]) -> dict[str, Any]:
    """Renames keys in a configuration of version 0.1, and removes keys without effect that no longer exist."""
    new = copy.deepcopy(dict(values))
    if isinstance(new.get("simulator"), str):
        new["simulator"] = RENAMED_SIMULATORS.get(new["simulator"], new["simulator"])
    for old in outdated_keys(new):
        _table(new, RENAMED_KEYS[old])[_leaf(RENAMED_KEYS[old])] = _table(new, old).pop(_leaf(old))
    for old, unused in REMOVED_KEYS.items():
        if _table(new, old).get(_leaf(old)) == unused:
            del _table(new, old)[_leaf(old)]
    if not _table(new, "conditions.sensors.*"):
        _table(new, "conditions.*").pop("sensors", None)
    return new


def outdated_keys(values: Mapping[str, Any]) -> list[str]:
    """Lists the keys of `RENAMED_KEYS` that nested values use."""
    return [old for old in RENAMED_KEYS if _leaf(old) in _table(values, old)]


def _table(values: Mapping[str, Any], key: str) -> dict[str, Any]:
    """Finds the table of a dotted key; an empty one if there is none."""
    table: Any = values
    for part in key.split(".")[:-1]:
        table = table.get(part) if isinstance(table, Mapping) else None
    return table if isinstance(table, dict) else {}


def _leaf(key: str) -> str:
    return key.rpartition(".")[2]
