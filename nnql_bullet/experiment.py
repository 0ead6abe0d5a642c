"""From a run's configuration to the objects that run it. Nothing below reads a configuration file."""

from contextlib import closing
from functools import cached_property, partial
from os import cpu_count

from nnql_bullet.agents import Agent, LearningAgent, Trainable, make_agent
from nnql_bullet.agents.learning.genetic import Genetic
from nnql_bullet.agents.learning.sb3_dqn import Sb3Dqn
from nnql_bullet.env import FleetNavigation, Navigation
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import as_rows, clearance_at
from nnql_bullet.run_config import RunConfig, changed
from nnql_bullet.seeding import Stream, rng, training_world_seed
from nnql_bullet.shield.shield import Shield
from nnql_bullet.sim.base import Fleet, Simulator
from nnql_bullet.sim.domain_randomization import RandomizedFleet, turned
from nnql_bullet.sim.engines import contact_simulator
from nnql_bullet.sim.faults import FaultyFleet, FaultySimulator
from nnql_bullet.sim.kinematic import KinematicFleet, KinematicSimulator
from nnql_bullet.sim.local import local_fleet
from nnql_bullet.sim.workers import WorkerFleet
from nnql_bullet.training.base import Trainer
from nnql_bullet.training.loop import Training
from nnql_bullet.training.selection import Candidates, count_goals
from nnql_bullet.vehicle.spec import load_vehicle
from nnql_bullet.worlds.source import World
from nnql_bullet.worlds.spec import WorldSpec

PATH_MARGIN = 0.15
"""What a world's path is wider on either side than the circle around the vehicle [m]."""


class Experiment:
    """The objects of one run, made when first asked for."""

    def __init__(self, config: RunConfig, agent: Agent | None = None) -> None:
        """Reads vehicle and world.

        Args:
            config: The configuration.
            agent: An agent in place of the one that the configuration describes.

        Raises:
            UserError: If vehicle or world cannot be read.
        """
        self.config = config
        self._given = agent
        self.vehicle = config.conditions.applied_to(load_vehicle(config.robot))
        self.worlds = self._source(config.world)

    @property
    def room(self) -> float:
        """Half width of the path that every world has for the vehicle [m]."""
        return self.vehicle.clear_radius + PATH_MARGIN

    def _source(self, name: str | World) -> World:
        source, sensor_height = World.load(name), self.vehicle.sensor_height
        if source.obstacle_height <= sensor_height:
            raise UserError(
                f"world '{source.name}': obstacles of {source.obstacle_height:g} m do not reach up to the sensor "
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

    def _drawn(self, source: World, seed: int) -> WorldSpec:
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
    def _training_sources(self) -> list[World]:
        return [self._source(name) for name in self.config.training.worlds] or [self.worlds]

    @cached_property
    def simulator(self) -> Simulator:
        """The simulator."""
        c = self.config
        if c.simulator == "kinematic":
            simulator: Simulator = KinematicSimulator(self.vehicle, c.drive)
        else:
            simulator = contact_simulator(c.simulator, c.physics, self.vehicle, c.drive)
        return FaultySimulator(simulator, c.conditions.sensor_faults) if c.conditions.sensor_faults.any else simulator

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
        faults = self.config.conditions.sensor_faults
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
        """The agent that was given, or the untrained one that the configuration describes."""
        return self._given or make_agent(self.config.agent, self.config.seed, self.vehicle, self.config.drive)

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
            raise UserError(f"'{self.config.agent.kind}' is a rule and has nothing to learn; drive it as it is")
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
