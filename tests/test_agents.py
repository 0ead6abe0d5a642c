"""What every agent keeps to, over all kinds: what it does is a function of its options and of each vehicle's drive."""

from collections.abc import Callable
from contextlib import closing
from dataclasses import fields
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from helpers import Driving
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.agents import KINDS, RULES, AgentOptions, Trainable
from nnql_bullet.agents.base import Knowing, Overridable
from nnql_bullet.env import ACTIONS, MANOEUVRES, STOP, Navigation, Observation
from nnql_bullet.errors import UserError
from nnql_bullet.experiment import Experiment
from nnql_bullet.presets import load_config
from nnql_bullet.rollout import Policy, run_episodes
from nnql_bullet.run_config import RunConfig
from nnql_bullet.runs import load_policy
from nnql_bullet.sim.kinematic import KinematicSimulator
from nnql_bullet.task import StateProperty, TaskOptions
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.spec import WorldSpec

NEEDS_BASELINES = pytest.mark.skipif(
    find_spec("skfuzzy") is None, reason="needs the extra: pip install 'nnql-bullet[baselines]'"
)
BRAKES = ("dwa", "pure_pursuit", "mppi", "orca", "guided_search", "distilled")
"""Kinds that choose among all manoeuvres; the others know the six actions ahead alone."""
kinds = pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=NEEDS_BASELINES) if kind == "fuzzy" else kind for kind in KINDS]
)
rules = pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=NEEDS_BASELINES) if kind == "fuzzy" else kind for kind in RULES]
)
VEHICLES, DECISIONS = 5, 40

Drive = list[Observation]
"""What vehicles see at one decision after the other."""
Make = Callable[[str], Policy]


def options_of(kind: str, **changes: object) -> AgentOptions:
    """An agent's options as a configuration gives them."""
    return load_config("paper", {"agent": {"kind": kind, **changes}}).agent


@pytest.fixture
def make(vehicle: VehicleSpec) -> Make:
    """Makes agents by kind."""
    return lambda kind: options_of(kind).make_agent(3, vehicle, DriveOptions())


@pytest.fixture(scope="module")
def drive(vehicle: VehicleSpec) -> Drive:
    """Vehicle i in world i, where there is much to see, turning about; those that touch something stand there."""
    experiment = Experiment(RunConfig(world="cover_15", simulator="kinematic"))
    turns = np.random.default_rng(0).integers(ACTIONS, size=(DECISIONS, VEHICLES))
    with closing(KinematicSimulator(vehicle, DriveOptions(), VEHICLES)) as fleet:
        navigation = Navigation(fleet, TaskOptions())
        navigation.reset({seed: experiment.world(seed) for seed in range(VEHICLES)})
        seen = [navigation.observation]
        for actions in turns[1:]:
            navigation.step(actions, navigation.observation.state_property <= StateProperty.NON_SAFE)
            seen.append(navigation.observation)
    assert {StateProperty.SAFE, StateProperty.NON_SAFE} <= set(
        np.concatenate([one.state_property for one in seen]).tolist()
    )
    return seen


def rows(observations: Observation, vehicles: list[int]) -> Observation:
    """What some vehicles see, in another order."""
    return Observation(*(getattr(observations, field.name)[vehicles] for field in fields(Observation)))


def decided(agent: Policy, drive: Drive, vehicles: list[int], order: list[int] | None = None) -> NDArray[np.int64]:
    """What an agent does with some of the drive's vehicles (decisions, vehicles), begun in an `order`."""
    driving = Driving(agent, len(vehicles))
    for place in order or range(len(vehicles)):
        driving.state = agent.reset(driving.state, {place: vehicles[place]})  # a vehicle's number is its world's seed
    return np.array([driving.act(rows(observations, vehicles)) for observations in drive])


@kinds
class TestEveryAgent:
    def test_same_options_and_drive_give_the_same_actions(self, kind: str, make: Make, drive: Drive) -> None:
        everybody = list(range(VEHICLES))
        assert np.array_equal(decided(make(kind), drive, everybody), decided(make(kind), drive, everybody))

    def test_actions_are_actions(self, kind: str, make: Make, drive: Drive) -> None:
        actions = Driving(make(kind), VEHICLES).reset(*range(VEHICLES)).act(drive[-1])
        assert (actions.shape, actions.dtype) == ((VEHICLES,), np.int64)
        assert set(actions.tolist()) <= set(range(MANOEUVRES if kind in BRAKES else ACTIONS))

    def test_a_vehicle_in_a_fleet_decides_as_alone(self, kind: str, make: Make, drive: Drive) -> None:
        together = decided(make(kind), drive, list(range(VEHICLES)))
        for vehicle in range(VEHICLES):
            assert np.array_equal(decided(make(kind), drive, [vehicle])[:, 0], together[:, vehicle])

    def test_it_does_not_matter_beside_whom_or_begun_in_which_order(self, kind: str, make: Make, drive: Drive) -> None:
        together = decided(make(kind), drive, list(range(VEHICLES)))
        shuffled = [3, 0, 4]
        assert np.array_equal(decided(make(kind), drive, shuffled, order=[2, 0, 1]), together[:, shuffled])

    def test_beginning_forgets_that_vehicle_and_no_other(self, kind: str, make: Make, drive: Drive) -> None:
        agent, half = Driving(make(kind), 2).reset(0, 1), DECISIONS // 2
        first = [agent.act(rows(observations, [0, 1])) for observations in drive[:half]]
        agent.state = agent.policy.reset(agent.state, {1: 2})  # another world in the midst of the drive of vehicle 0
        second = [agent.act(mixed(drive[half + k], drive[k])) for k in range(half)]
        alone, fresh = decided(make(kind), drive, [0]), decided(make(kind), drive[:half], [2])
        assert np.array_equal(np.concatenate([first, second])[:, 0], alone[:, 0])
        assert np.array_equal(np.array(second)[:, 1], fresh[:, 0])

    def test_observations_stay_as_they_were(self, kind: str, make: Make, drive: Drive) -> None:
        agent = Driving(make(kind), VEHICLES).reset(*range(VEHICLES))
        seen, kept = (rows(drive[-1], list(range(VEHICLES))) for _ in range(2))
        agent.act(seen)
        agent.action_values(seen)
        assert all(np.array_equal(getattr(seen, field.name), getattr(kept, field.name)) for field in fields(seen))

    def test_action_values_are_of_the_five_turns(self, kind: str, make: Make, drive: Drive) -> None:
        values = Driving(make(kind), VEHICLES).action_values(drive[-1])
        assert values.shape == (VEHICLES, len(paper.TURNS))
        assert np.isnan(values).all() == (kind in RULES)

    def test_what_it_remembers_deciding_by_is_what_it_would_say_anew(self, kind: str, make: Make, drive: Drive) -> None:
        agent = Driving(make(kind), VEHICLES).reset(*range(VEHICLES))
        if not isinstance(agent.policy, Knowing):
            pytest.skip("it is asked anew")
        for observations in drive[:3]:
            anew = agent.action_values(observations)
            chosen = agent.act(observations)
            assert np.array_equal(agent.policy.values_of(agent.state)[:, : len(paper.TURNS)], anew)
            agent.override((chosen + 1) % len(paper.TURNS))
            assert np.array_equal(agent.policy.values_of(agent.state)[:, : len(paper.TURNS)], anew)

    def test_asking_for_values_changes_no_drive(self, kind: str, make: Make, drive: Drive) -> None:
        agent, asked = Driving(make(kind)).reset(0), []
        for observations in drive:
            agent.action_values(rows(observations, [0]))
            asked.append(agent.act(rows(observations, [0])))
        assert np.array_equal(np.array(asked), decided(make(kind), drive, [0]))

    def test_one_that_remembers_what_it_did_can_be_told_what_was_done(
        self, kind: str, make: Make, drive: Drive
    ) -> None:
        """The same past in another order is another one to those that remember it, and to nobody else."""
        everybody, half = list(range(VEHICLES)), DECISIONS // 2
        shuffled = [drive[k] for k in np.random.default_rng(0).permutation(half).tolist()]
        agents = [opinionated(make(kind)) for _ in range(2)]
        later = [
            decided(agent, past + drive[half:], everybody)[half:]
            for agent, past in zip(agents, (drive[:half], shuffled), strict=True)
        ]
        assert isinstance(agents[0], Overridable) == (not np.array_equal(*later))

    def test_told_of_its_own_choice_it_goes_on_as_untold(self, kind: str, make: Make, drive: Drive) -> None:
        everybody = list(range(VEHICLES))
        agent, told = Driving(opinionated(make(kind)), VEHICLES).reset(*everybody), []
        for observations in drive:
            told.append(agent.act(observations))
            if isinstance(agent.policy, Overridable):
                agent.override(told[-1])
        assert np.array_equal(told, decided(opinionated(make(kind)), drive, everybody))

    def test_the_last_override_counts(self, kind: str, make: Make, drive: Drive) -> None:
        """Whatever it was told before, as a shield may tell it to stop."""
        everybody = list(range(VEHICLES))
        once, twice = (Driving(opinionated(make(kind)), VEHICLES).reset(*everybody) for _ in range(2))
        for observations in drive:
            assert np.array_equal(once.act(observations), twice.act(observations))
            if isinstance(once.policy, Overridable):
                twice.override(np.full(VEHICLES, STOP + 1))
                for driving in (once, twice):
                    driving.override(np.full(VEHICLES, STOP))

    def test_there_may_be_more_vehicles_than_worlds(
        self, kind: str, make: Make, vehicle: VehicleSpec, world_of: Callable[..., WorldSpec]
    ) -> None:
        world = world_of(target=(104.0, 100.0))
        with closing(KinematicSimulator(vehicle, DriveOptions(), 3)) as fleet:
            (summary,) = run_episodes(Navigation(fleet, TaskOptions()), [world], make(kind))
        assert summary.ending == "goal"

    def test_unknown_options_are_refused(self, kind: str) -> None:
        with pytest.raises(UserError, match=r"unknown key 'agent.colour'; valid keys: .*kind"):
            options_of(kind, colour=3)


def opinionated(agent: Policy) -> Policy:
    """The agent with some chance in its weights: untrained, some do the same whatever they see."""
    if isinstance(agent, Trainable):
        chance = np.random.default_rng(1)
        arrays = agent.state_dict().items()
        agent.load_state_dict({name: (a + chance.normal(size=a.shape)).astype(a.dtype) for name, a in arrays})
    return agent


def mixed(one: Observation, other: Observation) -> Observation:
    """What vehicle 0 sees in one record, beside what vehicle 2 sees in another."""
    both = ((getattr(one, field.name)[:1], getattr(other, field.name)[2:3]) for field in fields(Observation))
    return Observation(*(np.concatenate(pair) for pair in both))


@rules
class TestEveryRule:
    def test_it_has_nothing_to_learn(self, kind: str, make: Make) -> None:
        assert not isinstance(make(kind), Trainable)

    def test_its_name_opens_it(self, kind: str) -> None:
        policy = load_policy(Path(kind), {"world": "cover_10", "simulator": "kinematic"})
        config = policy.experiment.config
        assert (config.agent.kind, config.world, policy.episodes) == (kind, "cover_10", 0)

    def test_a_toml_file_configures_it(self, kind: str, tmp_path: Path) -> None:
        path = tmp_path / "mine.toml"
        path.write_text(f'preset = "{kind}"\nworld = "cover_15"\n')
        policy = load_policy(path, {"simulator": "kinematic"})
        config = policy.experiment.config
        assert (config.agent.kind, config.world, policy.episodes) == (kind, "cover_15", 0)

    def test_what_it_does_is_no_function_of_the_runs_seed(self, kind: str, vehicle: VehicleSpec, drive: Drive) -> None:
        one, other = (options_of(kind).make_agent(seed, vehicle, DriveOptions()) for seed in (0, 1))
        assert np.array_equal(decided(one, drive, [0, 1]), decided(other, drive, [0, 1]))


SUCCESS = {
    "straight": (0.0, 0.2),
    "random": (0.0, 0.2),
    "hand_rule": (0.85, 1.0),
    "potential_field": (0.8, 1.0),
    "fuzzy": (0.85, 1.0),
    "vfh": (0.9, 1.0),
    "look_ahead": (0.9, 1.0),
    "dwa": (0.7, 1.0),
    "pure_pursuit": (0.0, 0.2),
    "mppi": (0.7, 1.0),
    "orca": (0.2, 0.9),
    "guided_search": (0.95, 1.0),
}
"""Least and largest share of goals in the first 60 validation worlds at 10 % cover."""


@rules
def test_it_drives_as_well_as_it_was_chosen_to(kind: str, vehicle: VehicleSpec) -> None:
    experiment = load_policy(Path(kind), {"world": "cover_10", "simulator": "kinematic"}).experiment
    worlds = [experiment.world(seed) for seed in range(60)]
    with closing(KinematicSimulator(vehicle, DriveOptions(), len(worlds))) as fleet:
        summaries = run_episodes(Navigation(fleet, TaskOptions()), worlds, experiment.agent)
    least, largest = SUCCESS[kind]
    assert least <= np.mean([summary.ending == "goal" for summary in summaries]) <= largest
