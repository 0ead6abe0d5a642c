"""The genetic search: every genome driven again on its own, breeding on a known fitness, and going on bit for bit."""

import random
import sys
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

import helpers
import numpy as np
import pytest
from helpers import Stop, going_on, same, stops
from numpy.typing import NDArray

from nnql_bullet.agents.base import Reflex
from nnql_bullet.agents.learning.genetic import (
    GENES,
    Genetic,
    GeneticOptions,
    first_generation,
    layers,
    network_outputs,
)
from nnql_bullet.agents.learning.nnql import Nnql
from nnql_bullet.agents.learning.options import NnqlOptions
from nnql_bullet.config import parse
from nnql_bullet.env import Navigation, Observation
from nnql_bullet.errors import UserError, WorkerDied
from nnql_bullet.experiment import Experiment
from nnql_bullet.rollout import EpisodeSummary, run_episode
from nnql_bullet.run_config import RunConfig
from nnql_bullet.seeding import Stream, rng, training_world_seed
from nnql_bullet.sensing import RAYS
from nnql_bullet.sim.base import Simulator
from nnql_bullet.sim.kinematic import KinematicSimulator
from nnql_bullet.task import StateProperty, TaskOptions
from nnql_bullet.training.base import LearningAgent, Trainable

evolution = pytest.importorskip("nnql_bullet.agents.learning.evolution", reason="needs the extra [baselines]")

Cli = Callable[..., tuple[int, str, str]]
Arrays = dict[str, NDArray[Any]]

SMALL = GeneticOptions(population=5, worlds=3, elites=2)
SIZE = 15
"""Episodes in a generation of these."""


def observed(readings: NDArray[np.float64], state: StateProperty = StateProperty.NON_SAFE) -> Observation:
    return helpers.observed(*((row, 50.0, 0.3, 0.0, 2.0, state, np.full(RAYS, 10.0)) for row in readings))


def by_hand(genome: NDArray[np.float64], readings: NDArray[np.float64]) -> NDArray[np.float64]:
    """The 8-6-5 network for one vehicle, gene by gene."""
    genes = iter(genome.tolist())
    w1 = [[next(genes) for _ in range(8)] for _ in range(6)]
    b1 = [next(genes) for _ in range(6)]
    w2 = [[next(genes) for _ in range(6)] for _ in range(5)]
    b2 = [next(genes) for _ in range(5)]
    inputs = [(10.0 - reading) / 10.0 for reading in readings]
    hidden = [
        1 / (1 + np.exp(-sum(w * x for w, x in zip(row, inputs, strict=True)) - b))
        for row, b in zip(w1, b1, strict=True)
    ]
    return np.array([sum(w * h for w, h in zip(row, hidden, strict=True)) + b for row, b in zip(w2, b2, strict=True)])


@dataclass
class Parts:
    """A search and what it is made of."""

    experiment: Experiment
    agent: Genetic
    training: Any


@pytest.fixture
def parts(small_world: Path) -> Iterator[Callable[..., Parts]]:
    """Makes searches in the small world, on the kinematic model."""
    fleets: list[Simulator] = []

    def make(vehicles: int = 4, seed: int = 5, options: GeneticOptions = SMALL) -> Parts:
        config = RunConfig(
            seed=seed,
            vehicles=vehicles,
            simulator="kinematic",
            world=str(small_world),
            task=TaskOptions(max_steps=60),
            agent=options,
        )
        experiment = Experiment(config)
        fleets.append(experiment.new_simulator(1))
        navigation = Navigation(fleets[-1], config.task)
        assert isinstance(experiment.agent, Genetic)
        return Parts(experiment, experiment.agent, experiment.trainer(navigation))

    yield make
    for fleet in fleets:
        fleet.close()


class TestNetworks:
    def test_many_at_once_are_each_on_its_own(self) -> None:
        generator = np.random.default_rng(0)
        genomes, readings = generator.normal(size=(7, GENES)), generator.uniform(0, 10, (7, 8))
        expected = [by_hand(genome, row) for genome, row in zip(genomes, readings, strict=True)]
        assert network_outputs(genomes, readings) == pytest.approx(np.array(expected), abs=1e-12)

    def test_the_weights_are_those_of_the_papers_network(self) -> None:
        agent, nnql = Genetic(GeneticOptions(), 3), Nnql(NnqlOptions(), 0)
        assert GENES == sum(weights.size for weights in nnql.state_dict().values()) == 89
        nnql.load_state_dict(agent.state_dict())
        seen = observed(np.random.default_rng(0).uniform(0, 10, (50, 8)))
        assert agent.action_values(seen, None) == pytest.approx(nnql.action_values(seen, None), abs=1e-12)
        assert agent.act(seen, None)[0].tolist() == nnql.act(seen, None)[0].tolist()

    def test_in_safe_states_it_turns_toward_the_target(self) -> None:
        agent = Genetic(GeneticOptions(), 3)
        seen = observed(np.full((2, 8), 9.0), StateProperty.SAFE)
        assert agent.act(seen, None)[0].tolist() == [5, 5]
        assert np.isnan(agent.action_values(seen, None)).all()

    def test_it_is_taught_but_not_step_by_step(self) -> None:
        agent = Genetic(GeneticOptions(), 3)
        assert isinstance(agent, Trainable)
        assert not isinstance(agent, LearningAgent)

    def test_weights_are_taken_back(self) -> None:
        agent, other = Genetic(GeneticOptions(), 3), Genetic(GeneticOptions(), 4)
        assert not same(agent.state_dict(), other.state_dict())
        other.load_state_dict(agent.state_dict())
        assert same(agent.state_dict(), other.state_dict())

    @pytest.mark.parametrize("change", [{"2.bias": np.zeros(6)}, {"2.bias": np.full(5, np.nan)}, {"more": np.zeros(1)}])
    def test_what_are_no_such_weights_is_refused(self, change: Arrays) -> None:
        agent = Genetic(GeneticOptions(), 3)
        finite = all(np.isfinite(value).all() for value in change.values())
        with pytest.raises(UserError, match="8-6-5" if finite else "is not finite"):
            agent.load_state_dict(agent.state_dict() | change)


def driven_alone(
    experiment: Experiment, simulator: KinematicSimulator, genome: NDArray[np.float64], world: int
) -> tuple[EpisodeSummary, float]:
    """An episode by one genome alone, and the share of the way that it was nearer when it last decided."""
    seen = []

    def policy(observations: Observation) -> NDArray[np.int64]:
        seen.append(float(observations.target_distance[0]))
        if observations.state_property[0] == StateProperty.SAFE:
            return np.array([5])
        return np.array([by_hand(genome, observations.readings[0]).argmax()])

    config = experiment.config
    spec = experiment.world(training_world_seed(config.seed, world))
    summary = run_episode(Navigation(simulator, config.task), spec, Reflex(policy))
    return summary, 1.0 - seen[-1] / seen[0]


def assert_alike(one: EpisodeSummary, other: EpisodeSummary) -> None:
    for name in ("world_seed", "ending", "steps", "non_safe_steps"):
        assert getattr(one, name) == getattr(other, name), name
    for name in ("duration", "path_length", "clearance", "mean_clearance", "episode_return"):
        assert getattr(one, name) == pytest.approx(getattr(other, name), abs=1e-9), name


class TestSearch:
    def test_every_genome_is_tried_as_if_it_were_alone_and_the_fittest_live_on(
        self, parts: Callable[..., Parts]
    ) -> None:
        made = parts(seed=7)
        record = np.zeros((5, 2))  # summed fitness and tries of each genome, in all generations that it lived through
        ever = set()
        with closing(KinematicSimulator(made.experiment.vehicle, made.experiment.config.drive, 1)) as simulator:
            for generation in range(3):
                genomes = made.training.state_dict()["genomes"]
                episodes = sorted(islice(made.training.episodes(), SIZE), key=lambda episode: episode.episode)
                first = generation * SIZE
                assert [episode.episode for episode in episodes] == list(range(first, first + SIZE))
                fits = []
                for episode in episodes:
                    genome, world = divmod(episode.episode - first, 3)
                    alone, nearer = driven_alone(made.experiment, simulator, genomes[genome], 3 * generation + world)
                    assert_alike(episode.summary, alone)
                    assert episode.diagnostics == {"generation": generation, "genome": genome}
                    fits.append(1.0 if alone.ending == "goal" else 0.5 * nearer)
                    record[genome] += fits[-1], 1
                    ever.add(alone.ending == "goal")
                fitness = [(total + 8.0 * np.mean(fits)) / (tries + 8.0) for total, tries in record]
                order = sorted(range(5), key=lambda genome: -fitness[genome])
                best = Genetic(SMALL, 0)
                best.load_state_dict({name: weights[0] for name, weights in layers(genomes[order[:1]]).items()})
                assert same(made.agent.state_dict(), best.state_dict())
                assert np.array_equal(made.training.state_dict()["genomes"][:2], genomes[order[:2]])
                record = np.concatenate([record[order[:2]], np.zeros((3, 2))])
        assert ever == {False, True}

    def test_the_number_of_vehicles_decides_on_nothing_but_the_order(self, parts: Callable[..., Parts]) -> None:
        found = []
        for vehicles in (1, 4, 20):
            made = parts(vehicles)
            episodes = list(islice(made.training.episodes(), 2 * SIZE))
            found.append(
                (sorted(episodes, key=lambda e: e.episode), made.agent.state_dict(), made.training.state_dict())
            )
        for episodes, learned, under_way in found[1:]:
            assert episodes == found[0][0]
            assert same(learned, found[0][1])
            assert same(under_way, found[0][2])

    def test_the_seed_decides(self, parts: Callable[..., Parts]) -> None:
        first, again, other = (list(islice(parts(seed=seed).training.episodes(), 20)) for seed in (5, 5, 6))
        assert first == again != other

    def test_nobody_elses_chance_is_touched(self, parts: Callable[..., Parts]) -> None:
        made = parts()
        random.seed(1)
        expected = random.random()
        random.seed(1)
        list(islice(made.training.episodes(), SIZE + 1))
        assert random.random() == expected

    def test_it_learns(self, parts: Callable[..., Parts]) -> None:
        made = parts(16, options=GeneticOptions(population=16, worlds=4, elites=2))
        ended = [episode.summary.ending == "goal" for episode in islice(made.training.episodes(), 10 * 64)]
        assert np.mean(ended[-3 * 64 :]) > np.mean(ended[:64]) + 0.15


class TestBreeding:
    def test_a_known_fitness_rises(self) -> None:
        """Genomes are to become this one; nothing random is in their fitness."""
        wanted = rng(7, Stream.WEIGHTS).uniform(-1, 1, GENES)
        options = GeneticOptions(population=40, elites=4, mutation_step=0.2)

        def fitness(genomes: NDArray[np.float64]) -> NDArray[np.float64]:
            return -np.linalg.norm(genomes - wanted, axis=1)

        genomes = first_generation(options, 0)
        best = [fitness(genomes).max()]
        for generation in range(60):
            children = evolution.bred(genomes, fitness(genomes), options, rng(0, Stream.POLICY, generation))
            assert children.shape == (36, GENES)
            genomes = np.concatenate([genomes[evolution.fittest(fitness(genomes), 4)], children])
            best.append(fitness(genomes).max())
        assert best == sorted(best)
        assert best[-1] > 0.4 * best[0]

    def test_parents_are_winners_of_tournaments(self) -> None:
        """The expected place of the best of three is 3/4 of the way up; a blend of two keeps their sum."""
        options = GeneticOptions(population=202, elites=2, tournament=3, mutation_share=0.0)
        genomes = np.repeat(np.arange(202.0)[:, None], GENES, axis=1)
        children = evolution.bred(genomes, np.arange(202.0), options, rng(0, Stream.POLICY))
        assert children.mean() == pytest.approx(0.75 * 201, abs=11.0)  # standard error 2.8

    def test_children_lie_between_their_parents_or_a_little_beyond(self) -> None:
        options = GeneticOptions(population=402, elites=2, tournament=1, crossover=1.0, blend=0.25, mutation_share=0.0)
        genomes = np.zeros((402, GENES))
        genomes[201:] = 1.0
        children = evolution.bred(genomes, np.zeros(402), options, rng(0, Stream.POLICY))
        assert -0.25 <= children.min() < -0.2
        assert 1.2 < children.max() <= 1.25
        assert children[::2] + children[1::2] == pytest.approx(np.round(children[::2] + children[1::2]), abs=1e-9)

    def test_mutations_are_as_large_and_as_many_as_asked_for(self) -> None:
        options = GeneticOptions(population=401, elites=1, mutation_share=0.2, mutation_step=0.3)
        children = evolution.bred(np.ones((401, GENES)), np.zeros(401), options, rng(0, Stream.POLICY))
        moved = (children - 1.0)[np.abs(children - 1.0) > 1e-12]
        assert len(moved) / (400 * GENES) == pytest.approx(0.2, abs=0.01)
        assert moved.std() == pytest.approx(0.3, rel=0.03)
        assert moved.mean() == pytest.approx(0.0, abs=0.015)

    def test_they_follow_from_the_arguments_alone(self) -> None:
        genomes, fitness = first_generation(SMALL, 0), np.arange(5.0)
        kept = genomes.copy()
        one, again, other = (
            evolution.bred(genomes, fitness, SMALL, rng(0, Stream.POLICY, index)) for index in (1, 1, 2)
        )
        assert np.array_equal(one, again)
        assert not np.array_equal(one, other)
        assert np.array_equal(genomes, kept)

    def test_of_equals_the_first_are_the_fittest(self) -> None:
        assert evolution.fittest(np.array([1.0, 3.0, 2.0, 3.0]), 3).tolist() == [1, 3, 2]

    def test_a_lucky_newcomer_does_not_beat_a_long_record(self) -> None:
        fitness = evolution.genome_fitness(np.array([3.0, 38.0]), np.array([3.0, 40.0]), 0.5, 8.0)
        assert fitness == pytest.approx([7 / 11, 42 / 48])

    @pytest.mark.parametrize(
        ("values", "words"),
        [
            ({"population": 5, "elites": 5}, "no room for children"),
            ({"population": 1}, "population"),
            ({"worlds": 0}, "worlds"),
            ({"mutation_share": 1.5}, "mutation_share"),
            ({"discount": 0.5}, "unknown key"),
        ],
    )
    def test_what_makes_no_sense_is_refused(self, values: dict[str, Any], words: str) -> None:
        with pytest.raises(UserError, match=words):
            parse(RunConfig, {"agent": {"kind": "genetic", **values}}, "x")


class TestGoingOn:
    def test_it_is_as_if_it_had_never_stopped(self, parts: Callable[..., Parts]) -> None:
        whole = stops(parts(), 20)
        for stop in whole[2], whole[SIZE - 2], whole[SIZE - 1], whole[SIZE]:
            other = going_on(parts(), stop, 20)
            assert other.done == whole[-1].done
            assert same(other.learned, whole[-1].learned)
            assert same(other.under_way, whole[-1].under_way)

    def test_after_a_death(self, parts: Callable[..., Parts], monkeypatch: pytest.MonkeyPatch) -> None:
        whole = stops(parts(), 20)
        made, calls = parts(), []
        real = Navigation.step

        def step(self: Navigation, *args: Any) -> Any:
            calls.append(args)
            if len(calls) == 100:
                raise WorkerDied("worker 1 of 1 died")
            return real(self, *args)

        done = []
        with monkeypatch.context() as patch:
            patch.setattr(Navigation, "step", step)
            with pytest.raises(WorkerDied):
                for episode in made.training.episodes():
                    done.append(episode)
        assert 0 < len(done) < 20
        other = going_on(parts(), Stop(done, made.agent.state_dict(), made.training.state_dict()), 20)
        assert other.done == whole[-1].done
        assert same(other.learned, whole[-1].learned)

    def test_what_was_given_out_does_not_change_afterwards(self, parts: Callable[..., Parts]) -> None:
        made = parts()
        episodes = made.training.episodes()
        next(episodes)
        given = made.training.state_dict()
        kept = {name: values.copy() for name, values in given.items()}
        list(islice(episodes, SIZE))
        assert same(given, kept)

    def test_another_state_is_refused(self, parts: Callable[..., Parts]) -> None:
        made = parts()
        arrays = made.training.state_dict()
        for name in arrays:
            with pytest.raises(UserError, match="not the state of a search with 5 genomes"):
                made.training.load_state_dict({other: values for other, values in arrays.items() if other != name})
        with pytest.raises(UserError, match="not the state of a search with 5 genomes"):
            made.training.load_state_dict(arrays | {"genomes": np.zeros((6, GENES))})


@pytest.fixture
def config(small_config: Path, tmp_path: Path) -> Path:
    path = tmp_path / "search.toml"
    agent = "\n[agent]\nkind = 'genetic'\npopulation = 4\nworlds = 2\nelites = 1\n"
    path.write_text('preset = "genetic"\n' + small_config.read_text() + agent)
    return path


class TestCommandLine:
    def test_without_deap_it_is_refused_and_nothing_written(
        self, run_cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        monkeypatch.setitem(sys.modules, "nnql_bullet.agents.learning.evolution", None)
        code, _, err = run_cli("train", "--config", "genetic", "--sim", "kinematic", "--out", tmp_path / "run")
        assert code == 2
        assert "pip install 'nnql-bullet[baselines]'" in err
        assert not (tmp_path / "run").exists()

    def test_its_preset_gives_it_time(self) -> None:
        from nnql_bullet.presets import load_config

        assert load_config("genetic", {}).episodes == 20_000
        assert load_config("genetic", {"episodes": 7}).episodes == 7
