"""The configuration of a run: which vehicle, world, simulator, task and agent, and how it is trained."""

import copy
from collections.abc import Mapping
from dataclasses import fields
from typing import Annotated, Any, Literal

from pydantic import Field

from nnql_bullet import paper
from nnql_bullet.agents import AnyAgentOptions
from nnql_bullet.agents.learning.nnql import NnqlOptions
from nnql_bullet.config import merged, options, parse, to_values
from nnql_bullet.shield.shield import ShieldOptions
from nnql_bullet.sim.domain_randomization import DomainRandomization
from nnql_bullet.sim.engines import EngineName, PhysicsName
from nnql_bullet.sim.faults import SensorFaults
from nnql_bullet.task import TaskOptions
from nnql_bullet.training.selection import SelectionOptions
from nnql_bullet.types import Count, NonNegative, Positive
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.payload import LOAD_HEIGHT, deck_load, loaded
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.source import WorldLike

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
"""Keys that version 0.1 wrote into configurations, and their names now."""
REMOVED_KEYS = {"agent.paper_share": 0.0}
"""Keys that version 0.1 wrote and that have gone, with the value at which they changed nothing."""
RENAMED_SIMULATORS = {"twin": "kinematic"}
"""Simulators as version 0.1 named them, and their names now."""


@options
class Conditions:
    """Conditions that a vehicle drives under. The defaults are those that its files state, with sound sensors."""

    wheel_friction: Positive | None = None
    """Friction coefficient of every wheel against the ground; by default the vehicle's own."""
    payload: NonNegative = 0.0
    """Load on the middle of the deck [kg]."""
    payload_height: Positive = LOAD_HEIGHT
    """Height of the load's centre above the ground [m]."""
    sensor_noise: NonNegative = 0.0
    """Standard deviation of each ray that meets something [m]."""
    dead_sector: Annotated[int, Field(ge=0, lt=paper.SECTORS)] | None = None
    """Sensor that sees nothing, without the policy being told; 0 is the front, counted counter-clockwise."""

    @property
    def sensor_faults(self) -> SensorFaults:
        """The part that concerns the sensors."""
        return SensorFaults(noise=self.sensor_noise, dead_sector=self.dead_sector)

    @property
    def changes(self) -> dict[str, Any]:
        """The values that differ from the defaults."""
        return {f.name: getattr(self, f.name) for f in fields(self) if getattr(self, f.name) != f.default}

    @property
    def title(self) -> str:
        """The values that differ from the defaults, in words; empty if there are none."""
        return ", ".join(f"{name.replace('_', ' ')} {value:g}" for name, value in self.changes.items())

    def applied_to(self, vehicle: VehicleSpec) -> VehicleSpec:
        """The vehicle under these conditions."""
        if self.wheel_friction is not None:
            vehicle = vehicle.gripping(self.wheel_friction)
        return loaded(vehicle, deck_load(vehicle, self.payload, self.payload_height))


@options
class TrainingOptions:
    """Options of the training episodes that go beyond the run's own world."""

    worlds: tuple[WorldLike, ...] = ()
    """Shipped worlds, TOML files or worlds in full; each episode draws one of them, in place of the run's world."""
    domain_randomization: DomainRandomization = DomainRandomization()
    selection: SelectionOptions | None = None
    """How the policy is selected among late states of the training; by default it is the last state."""


@options
class RunConfig:
    """Configuration of a training run. The defaults are the preset `paper`."""

    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of the whole run."""
    episodes: Count = paper.EPISODES
    """Training episodes in all."""
    world: WorldLike = "paper"
    """A shipped world, a path to a TOML file, or a world in full."""
    robot: str = "tricycle"
    """A shipped robot or a path to a TOML file."""
    simulator: SimulatorName = "bullet"
    """Contact physics in one of two engines, or the kinematic model."""
    physics: PhysicsName = "fast"
    """Solver settings of contact physics."""
    vehicles: Count = 1
    """Vehicles that one policy learns from in lockstep; 1 is the paper's online learning."""
    conditions: Conditions = Conditions()
    training: TrainingOptions = TrainingOptions()
    drive: DriveOptions = DriveOptions()
    task: TaskOptions = TaskOptions()
    agent: AnyAgentOptions = NnqlOptions()
    shield: ShieldOptions | None = None
    """Shield around the agent when it drives as a policy; it learns without one."""


def changed(config: RunConfig, **changes: Any) -> RunConfig:
    """Lays nested values over a configuration (see `config.merged`).

    Raises:
        UserError: If a key or value is wrong.
    """
    return parse(RunConfig, merged(to_values(config), changes), "configuration")


def conditions_of(values: Mapping[str, Any]) -> Conditions | None:
    """Conditions with some values; None if there are none.

    Raises:
        UserError: If a key or value is wrong.
    """
    return changed(RunConfig(), conditions=values).conditions if values else None


def migrated(values: Mapping[str, Any]) -> dict[str, Any]:
    """Renames keys of a configuration that version 0.1 wrote, and drops those that have gone and changed nothing."""
    new = copy.deepcopy(dict(values))
    if "simulator" in new:
        new["simulator"] = RENAMED_SIMULATORS.get(new["simulator"], new["simulator"])
    for old in outdated_keys(new):
        _table(new, RENAMED_KEYS[old])[_leaf(RENAMED_KEYS[old])] = _table(new, old).pop(_leaf(old))
    for old, unused in REMOVED_KEYS.items():
        if _table(new, old).get(_leaf(old)) == unused:
            del _table(new, old)[_leaf(old)]
    if not _table(new, "conditions.sensors.*"):
        new.get("conditions", {}).pop("sensors", None)
    return new


def outdated_keys(values: Mapping[str, Any]) -> list[str]:
    """The keys of `RENAMED_KEYS` that nested values use."""
    return [old for old in RENAMED_KEYS if _leaf(old) in _table(values, old)]


def _table(values: Mapping[str, Any], key: str) -> dict[str, Any]:
    """The table that a dotted key is in; an empty one if there is none."""
    table: Any = values
    for part in key.split(".")[:-1]:
        table = table.get(part) if isinstance(table, Mapping) else None
    return table if isinstance(table, dict) else {}


def _leaf(key: str) -> str:
    return key.rpartition(".")[2]
