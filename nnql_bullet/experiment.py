"""From a run's configuration to the objects that run it. Nothing below reads a configuration file."""

import copy
from collections.abc import Mapping
from contextlib import closing
from dataclasses import asdict, dataclass
from functools import cached_property, partial
from os import cpu_count
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from nnql_bullet import paper
from nnql_bullet.agents import KINDS, Agent, AnyAgentOptions, LearningAgent, Trainable, make_agent
from nnql_bullet.agents.learning.genetic import Genetic
from nnql_bullet.agents.learning.nnql import NnqlOptions
from nnql_bullet.agents.learning.sb3_dqn import Sb3Dqn
from nnql_bullet.config import merged, options, parse, read_toml, to_values
from nnql_bullet.env import FleetNavigation, Navigation
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import as_rows, clearance_at
from nnql_bullet.seeding import Stream, rng, training_world_seed
from nnql_bullet.shield.shield import Shield, ShieldOptions
from nnql_bullet.sim.base import Fleet, Simulator
from nnql_bullet.sim.domain_randomization import DomainRandomization, RandomizedFleet, turned
from nnql_bullet.sim.engines import EngineName, PhysicsName, contact_simulator
from nnql_bullet.sim.faults import FaultyFleet, FaultySimulator, SensorFaults
from nnql_bullet.sim.kinematic import KinematicFleet, KinematicSimulator
from nnql_bullet.sim.local import local_fleet
from nnql_bullet.sim.workers import WorkerFleet
from nnql_bullet.task import TaskOptions
from nnql_bullet.training.base import Trainer
from nnql_bullet.training.loop import Training
from nnql_bullet.training.selection import Candidates, SelectionOptions, count_goals
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.payload import LOAD_HEIGHT, deck_load, loaded
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.vehicle.urdf import load_vehicle
from nnql_bullet.worlds.source import WorldSource, load_world
from nnql_bullet.worlds.spec import WorldSpec

SimulatorName = Literal[EngineName, "kinematic"]

PATH_MARGIN = 0.15
"""What a world's path is wider on either side than the circle around the vehicle [m]."""

PRESETS: dict[str, dict[str, Any]] = {
    # Every number that the paper states; where it leaves a choice, the one that the evidence supports. The defaults.
    "paper": {},
    # Where the paper leaves a choice, the most literal reading of its text.
    "literal": {
        "drive": {"decision_period": 1.0},  # a step long enough for the largest turn
        "task": {
            # "a high possibility of collision with some obstacles": near in any direction
            "front_distance": 4.0,
            "front_side_distance": 4.0,
            "other_distance": 4.0,
            "reward_non_safe_to_safe": 0.2,  # the opposite of safe to non-safe
        },
        "agent": {
            "encoding": "distance",  # "if no obstacle is found, then d = 0"
            "gradient_step": 1.0,  # the target of eq. (2) taken at its word
        },
    },
    # The paper's network, turns, rewards and update, but its numbers too by evidence: `nnql-bullet ablate tuned` says
    # what each is worth.
    "tuned": {
        "simulator": "kinematic",
        "vehicles": 64,
        "world": "cover_7.5",  # stated is a cover of 5 %
        "drive": {"decision_period": 0.6},
        "training": {"selection": {"worlds": ["cover_10", "cover_15"]}},
        "agent": {
            "kind": "nnql",
            "temperature_max": 0.4,  # stated is 0.8
            "temperature_min": 0.1,  # stated is 0.01
            "mirrored": True,
        },
    },
    # Another agent in the paper's place, all else being equal.
    **{kind: {"agent": {"kind": kind}} for kind in KINDS if kind != "nnql"},
    # A search learns from whole episodes where the others learn from steps, so it is given more of them.
    # Decides every step, and is given what that takes: the kinematic model, many at a time, and all kinds of worlds.
    "double_dqn": {
        "episodes": 12_000,
        "simulator": "kinematic",
        "vehicles": 64,
        "agent": {"kind": "double_dqn"},
        "training": {
            # The hardest twice.
            "worlds": ["cover_10", "cover_15", *["cover_20"] * 2, "traps", *["aisles"] * 2, "moving"],
            "domain_randomization": {
                "start_yaw": True,
                "noise": 0.05,
                "dead_sector": 0.05,
                "turn_scale": 0.1,
                "turn_noise_degrees": 3.0,
            },
        },
    },
    "genetic": {"episodes": 20 * paper.EPISODES, "agent": {"kind": "genetic"}},
}

TRAIN_FLAGS = {
    "seed": "--seed",
    "episodes": "--episodes",
    "world": "--world",
    "simulator": "--sim",
    "physics": "--physics",
    "vehicles": "--vehicles",
}
"""Of `nnql-bullet train`, by the key of a configuration that each sets."""


RENAMED_KEYS = (
    ("training", "disturbances", "domain_randomization"),
    ("agent", "seen_map", "grid_map"),
    ("shield", "leads", "recovers"),
)
"""Keys of configurations as version 0.1 wrote them: table, key, and the key of now."""


@options
class Conditions:
    """How things depart from what the vehicle was made for. The defaults are what its files say."""

    wheel_friction: Annotated[float, Field(gt=0)] | None = None
    """Of every wheel against the ground."""
    payload: Annotated[float, Field(ge=0)] = 0.0
    """On the middle of the deck [kg]."""
    payload_height: Annotated[float, Field(gt=0)] = LOAD_HEIGHT
    """Of its centre, above the ground [m]."""
    sensors: SensorFaults = SensorFaults()

    def applied_to(self, vehicle: VehicleSpec) -> VehicleSpec:
        """The vehicle under these conditions."""
        if self.wheel_friction is not None:
            vehicle = vehicle.gripping(self.wheel_friction)
        return loaded(vehicle, deck_load(vehicle, self.payload, self.payload_height))


@dataclass(frozen=True, slots=True)
class Departures:
    """Conditions that a drive is asked for, on top of a policy's own; None leaves those."""

    friction: float | None = None
    """Of every wheel against the ground."""
    payload: float | None = None
    """[kg]"""
    noise: float | None = None
    """Standard deviation of each ray [m]."""
    dead_sector: int | None = None
    """That sees nothing."""

    @property
    def changes(self) -> dict[str, Any]:
        """What is laid over a policy's configuration."""
        sensors = {"noise": self.noise, "dead_sector": self.dead_sector}
        return {"conditions": {"wheel_friction": self.friction, "payload": self.payload, "sensors": sensors}}

    @property
    def given(self) -> dict[str, float]:
        """Those that are asked for, by the names of their flags."""
        return {name.replace("_", "-"): value for name, value in asdict(self).items() if value is not None}

    @property
    def flags(self) -> list[str]:
        """What asks for them on the command line."""
        return [text for name, value in self.given.items() for text in (f"--{name}", f"{value:g}")]


AS_TRAINED = Departures()


@options
class TrainingOptions:
    """What training episodes are, where they are not just episodes in the run's world."""

    worlds: tuple[str, ...] = ()
    """Shipped worlds or TOML files, of which each episode takes any, in place of the run's world."""
    domain_randomization: DomainRandomization = DomainRandomization()
    selection: SelectionOptions | None = None
    """How a late state is chosen as the policy; the last one is if this is not given."""


@options
class RunConfig:
    """A training run. The defaults are the preset `paper`."""

    seed: Annotated[int, Field(ge=0)] = 0
    episodes: Annotated[int, Field(ge=1)] = paper.EPISODES
    world: str = "paper"
    """A shipped world or a path to a TOML file."""
    robot: str = "tricycle"
    """A shipped robot or a path to a TOML file."""
    simulator: SimulatorName = "bullet"
    """Contact physics in one of two engines, or the kinematic model."""
    physics: PhysicsName = "fast"
    """Of contact physics."""
    vehicles: Annotated[int, Field(ge=1)] = 1
    """That one policy learns from in lockstep; 1 is the paper's online learning."""
    conditions: Conditions = Conditions()
    training: TrainingOptions = TrainingOptions()
    drive: DriveOptions = DriveOptions()
    task: TaskOptions = TaskOptions()
    agent: AnyAgentOptions = NnqlOptions()
    shield: ShieldOptions | None = None
    """Around the agent when it drives for good; it learns without."""


def load_config(name: str, changes: Mapping[str, Any]) -> RunConfig:
    """The configuration of a preset or TOML file, with changes laid over it.

    Args:
        name: A preset, or a path to a TOML file; its key `preset` names what it is laid over (default `paper`).
        changes: Nested values; None leaves what is there.

    Raises:
        UserError: If there is no such preset or file, or a key or value is wrong.
    """
    values: Mapping[str, Any] = {}
    preset = name
    if name not in PRESETS:
        if not Path(name).is_file():
            raise UserError(f"there is no preset or file '{name}'; give a TOML file or one of: {', '.join(PRESETS)}")
        values = read_toml(Path(name))
        preset = values.pop("preset", "paper")
        if preset not in PRESETS:
            raise UserError(f"{name}: 'preset' must be one of: {', '.join(PRESETS)}")
    known_kind = {"agent": {"kind": RunConfig().agent.kind}}
    return parse(RunConfig, merged(merged(merged(known_kind, PRESETS[preset]), values), changes), name)


def changed(config: RunConfig, **changes: Any) -> RunConfig:
    """The configuration with nested values laid over it; None leaves what is there."""
    return parse(RunConfig, merged(to_values(config), changes), "command line")


def migrated(values: Mapping[str, Any]) -> dict[str, Any]:
    """The values of a configuration that an older version wrote, under the names of now."""
    new = copy.deepcopy(dict(values))
    if new.get("simulator") == "twin":
        new["simulator"] = "kinematic"
    for table, old, now in RENAMED_KEYS:
        group = new.get(table)
        if isinstance(group, dict) and old in group:
            group[now] = group.pop(old)
    return new


def preset_of(config: RunConfig) -> tuple[str, list[str]] | None:
    """The preset and the flags of `nnql-bullet train` that make up the whole configuration; None if there is none."""
    given = {key: getattr(config, key) for key in TRAIN_FLAGS}
    for preset in PRESETS:
        if load_config(preset, given) == config:
            usual = load_config(preset, {})
            departing = [key for key, value in given.items() if value != getattr(usual, key)]
            return preset, [part for key in departing for part in (TRAIN_FLAGS[key], str(given[key]))]
    return None


class Experiment:
    """The objects of one run, made when first asked for."""

    def __init__(self, config: RunConfig) -> None:
        self.config = config
        self.vehicle = config.conditions.applied_to(load_vehicle(config.robot))
        self.worlds = self._source(config.world)

    @property
    def room(self) -> float:
        """Half width of the path that every world has for the vehicle [m]."""
        return self.vehicle.clear_radius + PATH_MARGIN

    def _source(self, name: str) -> WorldSource:
        source, sensor_height = load_world(name), self.vehicle.sensor_height
        if source.file.obstacle_height <= sensor_height:
            raise UserError(
                f"world '{source.name}': obstacles of {source.file.obstacle_height:g} m do not reach up to the sensor "
                f"of '{self.vehicle.name}' at {sensor_height:g} m; raise 'obstacle_height'"
            )
        return source

    def world(self, seed: int) -> WorldSpec:
        """The world of a seed.

        Raises:
            UserError: If there is none, or the vehicle would stand in an obstacle at its start.
        """
        return self._drawn(self.worlds, seed)

    @cached_property
    def selection_worlds(self) -> list[WorldSpec]:
        """The validation worlds that candidates are tried in; none without a selection.

        Raises:
            UserError: If there is no such world.
        """
        selection = self.config.training.selection
        if selection is None:
            return []
        names = selection.worlds or self.config.training.worlds or (self.config.world,)
        sources = [self._source(name) for name in dict.fromkeys(names)]
        return [self._drawn(source, seed) for source in sources for seed in selection.seeds]

    def _drawn(self, source: WorldSource, seed: int) -> WorldSpec:
        if seed < 0:
            raise UserError(f"world seed {seed}: world seeds are not negative")
        world = source.draw(seed, self.room)
        start = world.start
        if clearance_at(start.x, start.y, start.yaw, as_rows((self.vehicle.footprint,))[0], world.solids_at(0.0)) <= 0:
            raise UserError(f"world '{world.name}', seed {seed}: at its start the vehicle stands in a box; move one")
        return world

    def training_world(self, episode: int) -> WorldSpec:
        """The world of a training episode."""
        sources, seed = self._training_sources, training_world_seed(self.config.seed, episode)
        source = sources[rng(self.config.seed, Stream.MIX, episode).integers(len(sources))]
        return turned(self._drawn(source, seed), self.config.training.domain_randomization)

    @cached_property
    def _training_sources(self) -> list[WorldSource]:
        return [self._source(name) for name in self.config.training.worlds] or [self.worlds]

    @cached_property
    def simulator(self) -> Simulator:
        """The simulator."""
        c = self.config
        if c.simulator == "kinematic":
            simulator: Simulator = KinematicSimulator(self.vehicle, c.drive)
        else:
            simulator = contact_simulator(c.simulator, c.physics, self.vehicle, c.drive)
        return FaultySimulator(simulator, c.conditions.sensors) if c.conditions.sensors.any else simulator

    def fleet(self, workers: int | None = None) -> Fleet:
        """As many vehicles as the configuration says.

        Args:
            workers: Processes (contact physics) or threads (kinematic model) to share them among, whatever the result;
                one a core
                if not given.

        Raises:
            UserError: If there is no worker.
        """
        workers = cpu_count() or 1 if workers is None else workers
        if workers < 1:
            raise UserError(f"workers must be at least 1, not {workers}")
        fleet = self._sound_fleet(workers)
        faults = self.config.conditions.sensors
        return FaultyFleet(fleet, faults) if faults.any else fleet

    def training_fleet(self, workers: int | None = None) -> Fleet:
        """The same as `fleet` gives, disturbed as training asks for."""
        fleet, domain_randomization = self.fleet(workers), self.config.training.domain_randomization
        return RandomizedFleet(fleet, domain_randomization) if domain_randomization.any else fleet

    def _sound_fleet(self, workers: int) -> Fleet:
        c, size = self.config, self.config.vehicles
        if c.simulator == "kinematic":
            return KinematicFleet(self.vehicle, c.drive, size, workers)
        make = partial(local_fleet, partial(contact_simulator, c.simulator, c.physics, self.vehicle, c.drive))
        return make(size) if min(workers, size) == 1 else WorkerFleet(make, size, min(workers, size))

    @cached_property
    def navigation(self) -> Navigation:
        """The task over the simulator."""
        return Navigation(self.simulator, self.config.task)

    @cached_property
    def agent(self) -> Agent:
        """The agent, untrained."""
        return make_agent(self.config.agent, self.config.seed, self.vehicle, self.config.drive)

    @cached_property
    def policy(self) -> Agent:
        """What drives for good: the agent, in its shield if it has one."""
        c = self.config
        return Shield(c.shield, self.agent, self.vehicle, c.drive, c.task) if c.shield else self.agent

    @property
    def trainable(self) -> Trainable:
        """The agent as one that can be taught.

        Raises:
            UserError: If it is a rule.
        """
        if not isinstance(self.agent, Trainable):
            kind = self.config.agent.kind
            raise UserError(f"'{kind}' has nothing to learn; drive it with: nnql-bullet drive {kind}")
        return self.agent

    @property
    def learning_agent(self) -> LearningAgent:
        """The agent as one that learns step by step.

        Raises:
            UserError: If it is a rule.
        """
        if not isinstance(self.trainable, LearningAgent):
            raise UserError(f"'{self.config.agent.kind}' does not learn step by step")
        return self.trainable

    def trainer(self, navigation: FleetNavigation) -> Trainer:
        """What trains the agent, in the way of its kind.

        Raises:
            UserError: If it is a rule, or what its training needs is not installed.
        """
        agent, world_of, seed = self.trainable, self.training_world, self.config.seed
        if isinstance(agent, Genetic):
            try:
                from nnql_bullet.training.evolution import Evolution
            except ImportError:
                raise _missing("DEAP", "baselines") from None
            return Evolution(agent, navigation, world_of, seed)
        if isinstance(agent, Sb3Dqn):
            try:
                from nnql_bullet.training.sb3 import DqnTraining
            except ImportError:
                raise _missing("stable-baselines3", "sb3") from None
            return DqnTraining(agent, navigation, world_of, seed)
        return Training(self.learning_agent, navigation, world_of, seed)

    def try_out(self, candidates: Candidates, workers: int | None = None) -> dict[int, int]:
        """In how many of `selection_worlds` each candidate comes to its target, in the kinematic model.

        The agent stays as it is.

        Raises:
            UserError: If there is no worker.
        """
        worlds = self.selection_worlds
        kinematic = Experiment(changed(self.config, simulator="kinematic", vehicles=len(worlds)))
        with closing(kinematic.fleet(workers)) as fleet:
            return count_goals(kinematic.trainable, candidates, FleetNavigation(fleet, self.config.task), worlds)


def _missing(library: str, extra: str) -> UserError:
    return UserError(f"{library} is not installed; install it with: pip install 'nnql-bullet[{extra}]'")
