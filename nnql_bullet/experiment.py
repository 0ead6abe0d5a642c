"""Makes the objects of a run from its configuration."""

import math
from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from functools import cached_property, partial
from itertools import pairwise
from typing import NoReturn

from nnql_bullet.agents import AgentOptions, LearningAgent, Trainable
from nnql_bullet.agents.foresight import SearchOptions
from nnql_bullet.agents.learning.options import DistilledOptions
from nnql_bullet.config import parse
from nnql_bullet.env import Navigation, Reward
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Pose, as_rows, bearing, clearance_at
from nnql_bullet.machine import allowed_cores, may_start_processes
from nnql_bullet.planning.course import Course
from nnql_bullet.planning.planner import Planner
from nnql_bullet.rollout import Policy, run_episodes
from nnql_bullet.run_config import RunConfig, SimulatorName, changed, migrated
from nnql_bullet.seeding import Stream, rng, training_world_seed
from nnql_bullet.shield.shield import Shield
from nnql_bullet.sim.base import Simulator
from nnql_bullet.sim.domain_randomization import RandomizedSimulator, turned
from nnql_bullet.sim.engines import contact_simulator
from nnql_bullet.sim.faults import FaultySimulator
from nnql_bullet.sim.kinematic import KinematicSimulator
from nnql_bullet.sim.workers import WorkerSimulator
from nnql_bullet.task import TaskOptions
from nnql_bullet.training.base import Trainer, TrainsItself
from nnql_bullet.training.checkpoint import Weights, load_weights, policy_file
from nnql_bullet.training.evaluation import Evaluation
from nnql_bullet.training.loop import Training
from nnql_bullet.training.selection import Candidates, count_goals, seeds
from nnql_bullet.vehicle.controller import DriveOptions, own_speed
from nnql_bullet.vehicle.scale import length_scale
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.vehicle.urdf import load_vehicle
from nnql_bullet.worlds.source import World, WorldLike
from nnql_bullet.worlds.spec import WorldSpec

EVALUATION_WORLDS = 20
"""Worlds of each kind that an evaluation between training episodes drives in, unless a number is given."""
EVALUATION_VEHICLES = 256
"""Most vehicles that an evaluation between training episodes drives at once."""


def at_own_speed(config: RunConfig, vehicle: VehicleSpec) -> RunConfig:
    """A configuration whose default speed is the vehicle's own, if it has one that is less.

    Raises:
        UserError: If another speed is asked for that is more than the vehicle's own.
    """
    own = own_speed(vehicle)
    if config.drive.speed <= own:
        return config
    if config.drive.speed != DriveOptions().speed:
        refuse_speed(vehicle, config.drive.speed)
    return replace(config, drive=replace(config.drive, speed=own))


def refuse_speed(vehicle: VehicleSpec, speed: float) -> NoReturn:
    """Refuses a speed that is more than the vehicle's own.

    Raises:
        UserError: Always.
    """
    raise UserError(
        f"robot '{vehicle.name}' drives at {own_speed(vehicle):g} m/s at most, not at {speed:g} m/s; lower the speed, "
        "or raise limits.speed in its TOML"
    )


class Experiment:
    """The objects of one run; each is made at its first use."""

    def __init__(self, config: RunConfig, agent: Policy | None = None) -> None:
        """Reads vehicle and world.

        Args:
            config: The configuration.
            agent: Replaces the agent that the configuration describes.

        Raises:
            UserError: If vehicle or world cannot be read.
        """
        self._given = agent
        self.vehicle = config.conditions.applied_to(load_vehicle(config.robot))
        self.config = config = at_own_speed(config, self.vehicle)
        self.worlds = self.kind(config.world)

    def kind(self, name: str | World, own_ends: bool = False) -> World:
        """Reads a kind of worlds for this vehicle.

        Args:
            name: Its name.
            own_ends: Whether its start and target stay, whatever the configuration says.

        Raises:
            UserError: If it cannot be read, or its obstacles do not reach up to the vehicle's sensor.
        """
        source, sensor_height = World.load(name), self.vehicle.sensor_height
        if not own_ends:
            source = source.between(self.config.start, self.config.target, self.config.waypoints)
        if source.obstacle_height <= sensor_height:
            raise UserError(
                f"world '{source.name}': obstacles of {source.obstacle_height:g} m do not reach up to the sensor "
                f"of '{self.vehicle.name}' at {sensor_height:g} m; raise 'obstacle_height'"
            )
        return source

    def out_of_reach(self, world: World) -> str:
        """Says why no vehicle can reach the target of a world in an episode, however it drives; empty if one may.

        It compares the straight way, by way points, to the edge of the target with the way that the steps of an
        episode allow.
        """
        c = self.config
        way = c.task.max_steps * c.drive.decision_period * c.drive.speed
        places = (world.start, *world.waypoints, world.target)
        legs = [math.dist(*leg) for leg in pairwise(places)]
        straight = sum(legs) - (2 * len(legs) - 1) * world.target_radius
        if way >= straight:
            return ""
        return (
            f"world '{world.name}': {c.task.max_steps} steps of {c.drive.decision_period:g} s at {c.drive.speed:g} m/s "
            f"are {way:g} m, and the target is {straight:.0f} m away: no episode can reach it; raise 'task.max_steps' "
            "or 'drive.speed'"
        )

    @cached_property
    def task(self) -> TaskOptions:
        """The task, with distances that follow the vehicle."""
        return self.config.task.scaled(length_scale(self.vehicle.footprint), self.vehicle.sensor.range)

    def world(self, seed: int) -> WorldSpec:
        """Draws the world of a seed.

        Raises:
            UserError: If there is none, or the vehicle would stand in an obstacle at its start.
        """
        return self.draw(self.worlds, seed)

    @cached_property
    def selection_worlds(self) -> list[WorldSpec]:
        """The validation worlds in which candidates drive; none without a selection.

        Raises:
            UserError: If there is no such world.
        """
        selection = self.config.training.selection
        return self._validation_worlds(selection.worlds, selection.count) if selection else []

    @cached_property
    def evaluation_worlds(self) -> list[WorldSpec]:
        """The validation worlds of evaluations between training episodes; none without these.

        Raises:
            UserError: If there is no such world.
        """
        training = self.config.training
        if training.evaluate_every is None:
            return []
        return self._validation_worlds(training.evaluate_worlds or (), training.evaluate_count or EVALUATION_WORLDS)

    def _validation_worlds(self, names: Sequence[WorldLike], count: int) -> list[WorldSpec]:
        """Validation worlds of some kinds, or of those of the training if none is named."""
        named = names or self.config.training.worlds or (self.config.world,)
        sources = [self.kind(name, name != self.config.world) for name in dict.fromkeys(named)]
        return [self.draw(source, seed) for source in sources for seed in seeds(count)]

    def draw(self, source: World, seed: int) -> WorldSpec:
        """Draws the world of a seed, of a kind that `kind` read.

        Raises:
            UserError: See `world`.
        """
        world = source.draw(seed, self.vehicle.width, self.config.allow_impassable)
        if self.planner and source.start_yaw_degrees is None:  # the vehicle drives as it starts
            place = world.start.x, world.start.y
            aim = Course(world, world.targets, self.planner, *place).aim
            world = replace(world, start=replace(world.start, yaw=round(bearing(Pose(*place, 0.0), *aim), 6)))
        start = world.start
        if clearance_at(start.x, start.y, start.yaw, as_rows((self.vehicle.footprint,))[0], world.solids_at(0.0)) <= 0:
            raise UserError(f"world '{world.name}', seed {seed}: at its start the vehicle stands in a box; move one")
        return world

    def training_world(self, episode: int) -> WorldSpec:
        """Draws the world of a training episode."""
        sources, seed = self.training_sources, training_world_seed(self.config.seed, episode)
        source = sources[rng(self.config.seed, Stream.MIX, episode).integers(len(sources))]
        return turned(self.draw(source, seed), self.config.training.domain_randomization)

    @cached_property
    def training_sources(self) -> list[World]:
        """The kinds of worlds of training episodes.

        Raises:
            UserError: If one cannot be read.
        """
        return [self.kind(name, name != self.config.world) for name in self.config.training.worlds] or [self.worlds]

    @cached_property
    def simulator(self) -> Simulator:
        """A simulator of one vehicle in this process."""
        return self._simulator(self.config.simulator, 1, 1)

    @cached_property
    def navigation(self) -> Navigation:
        """The task over `simulator`."""
        return self.new_navigation(self.simulator)

    def new_navigation(self, simulator: Simulator, reward: Reward | None = None) -> Navigation:
        """Makes the task over a simulator, with the plan that the configuration asks for.

        Args:
            simulator: One that this experiment made.
            reward: A reward in place of the paper's.
        """
        return Navigation(simulator, self.task, reward, self.planner)

    @cached_property
    def planner(self) -> Planner | None:
        """The planner that the configuration asks for."""
        return Planner(self.config.plan, self.vehicle) if self.config.plan else None

    def new_simulator(self, workers: int | None = None) -> Simulator:
        """Makes a simulator with the configuration's number of vehicles; the caller closes it.

        Args:
            workers: Number of processes (contact physics) or threads (kinematic model) that share the vehicles, by
                default one per core that this process may use; a daemonic process, which may have no children,
                simulates all vehicles itself. The result does not depend on it.

        Raises:
            UserError: If the number of workers is not positive.
        """
        return self._simulator(self.config.simulator, self.config.vehicles, workers)

    def new_training_simulator(self, workers: int | None = None) -> Simulator:
        """Makes a simulator like `new_simulator`, with the domain randomization of the training."""
        simulator, randomization = self.new_simulator(workers), self.config.training.domain_randomization
        return RandomizedSimulator(simulator, randomization) if randomization.any else simulator

    def _simulator(self, name: SimulatorName, size: int, workers: int | None) -> Simulator:
        c, faults = self.config, self.config.conditions.sensor_faults
        workers = allowed_cores() if workers is None else workers
        if workers < 1:
            raise UserError(f"workers must be at least 1, not {workers}")
        if name == "kinematic":
            simulator: Simulator = KinematicSimulator(self.vehicle, c.drive, size, workers)
        else:
            make = partial(contact_simulator, name, c.physics, self.vehicle, c.drive)
            workers = min(workers, size) if may_start_processes() else 1
            simulator = make(size) if workers == 1 else WorkerSimulator(make, size, workers)
        return FaultySimulator(simulator, faults) if faults.any else simulator

    @cached_property
    def agent(self) -> Policy:
        """The given agent, or the untrained one that the configuration describes."""
        if self._given is not None:
            return self._given
        options: AgentOptions = self.config.agent
        if self.config.shield and isinstance(options, SearchOptions | DistilledOptions):
            options = options.in_shield()
        return options.make_agent(self.config.seed, self.vehicle, self.config.drive)

    @cached_property
    def policy(self) -> Policy:
        """The policy that drives after training: the agent, in its shield if it has one."""
        c, carrot = self.config, self.planner.look_ahead if self.planner else None
        return Shield(c.shield, self.agent, self.vehicle, c.drive, self.task, carrot) if c.shield else self.agent

    @property
    def trainable(self) -> Trainable:
        """The agent, as one that can be trained.

        Raises:
            UserError: If it is a rule, or the given agent lacks methods.
        """
        if not isinstance(self.agent, Trainable):
            if self._given is not None:
                raise UserError(f"a {type(self._given).__name__} cannot learn: it is no training.base.Trainable")
            raise UserError(f"'{self.config.agent.kind}' is a rule and has nothing to learn; drive it as it is")
        return self.agent

    @property
    def learning_agent(self) -> LearningAgent:
        """The agent, as one that learns step by step.

        Raises:
            UserError: If it is a rule.
        """
        if not isinstance(self.trainable, LearningAgent):
            raise UserError(f"'{self.config.agent.kind}' does not learn step by step")
        return self.trainable

    @cached_property
    def first_weights(self) -> Weights | None:
        """The weights that the training begins with; None if the agent draws its own.

        Raises:
            UserError: If they are not those of such an agent.
        """
        policy, mine = self.config.start_from, self.config.agent
        if policy is None:
            return None
        if self._given is not None:
            raise UserError("start_from: an agent of your own begins with what it has learned; leave this key out")
        file = policy_file(policy)
        weights = load_weights(file)
        its = parse(RunConfig, migrated(weights.config), str(file)).agent
        if its.kind != mine.kind:
            remedy = f"train a {its.kind}, such as with the preset of that kind, or start from a {mine.kind}"
            raise UserError(f"start_from '{policy}': it is a {its.kind}, and this run trains a {mine.kind}; {remedy}")
        for key in getattr(mine, "network", ()):
            if getattr(its, key) != getattr(mine, key):
                raise UserError(
                    f"start_from '{policy}': its weights are for agent.{key} {getattr(its, key)}, and this run has "
                    f"{getattr(mine, key)}; give this run the same, or start from another policy"
                )
        return weights

    def trainer(self, navigation: Navigation) -> Trainer:
        """Makes the trainer of the agent's kind.

        Raises:
            UserError: If the agent is a rule, a package that its training needs is not installed, or the training
                cannot begin with the weights that it should.
        """
        agent, world_of, seed = self.trainable, self.training_world, self.config.seed
        if self.first_weights:
            agent.load_state_dict(self.first_weights.arrays)
        if isinstance(agent, TrainsItself):
            return agent.make_trainer(navigation, world_of, seed)
        return Training(self.learning_agent, navigation, world_of, seed)

    def evaluate(self, episodes: int, workers: int | None = None) -> Evaluation:
        """Drives the agent greedily, as it is after so many episodes, in `evaluation_worlds`, in the kinematic model.

        Raises:
            UserError: If there is no worker.
        """
        worlds = self.evaluation_worlds
        with closing(self._simulator("kinematic", min(len(worlds), EVALUATION_VEHICLES), workers)) as simulator:
            summaries = run_episodes(self.new_navigation(simulator), worlds, self.trainable)
        return Evaluation(episodes, sum(summary.ending == "goal" for summary in summaries), len(worlds))

    def try_out(self, candidates: Candidates, workers: int | None = None) -> dict[int, int]:
        """Counts the `selection_worlds` in which each candidate reaches its target, in the kinematic model.

        The agent does not change.

        Raises:
            UserError: If there is no worker.
        """
        worlds = self.selection_worlds
        kinematic = Experiment(changed(self.config, simulator="kinematic", vehicles=len(worlds)))
        with closing(kinematic.new_simulator(workers)) as simulator:
            return count_goals(kinematic.trainable, candidates, self.new_navigation(simulator), worlds)
