"""Searches network weights genetically: all genomes of a generation drive in the same worlds, and the fittest breed.

The only module that imports DEAP.

Each genome drives greedily by itself, so the result does not depend on the number of vehicles; only the order in which
episodes finish does.

A genome scores 1 in a world in which it reaches the target; otherwise half of the share of the distance by which it
came nearer. The paper's return is not the fitness, because it pays for driving around obstacles.

A checkpoint holds the number of episodes of the generation that have finished. Resuming drives the generation again
from its beginning, with the same results bit for bit.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from deap import tools
from numpy.typing import NDArray

from nnql_bullet.agents.base import NoValues, TurnChooser
from nnql_bullet.agents.learning.genetic import Genetic, GeneticOptions, first_generation, layers, network_outputs
from nnql_bullet.env import Navigation, Observation
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array, distance
from nnql_bullet.rollout import Actions, finished_episodes
from nnql_bullet.seeding import Stream, fenced, rng
from nnql_bullet.training.base import TrainingEpisode
from nnql_bullet.worlds.spec import WorldSpec


class Evolution:
    """A `Trainer`. After each generation the agent gets the fittest genome."""

    def __init__(self, agent: Genetic, navigation: Navigation, world_of: Callable[[int], WorldSpec], seed: int) -> None:
        self._agent = agent
        self._navigation = navigation
        self._world_of = world_of
        self._seed = seed
        self._generation = 0
        self._genomes = first_generation(agent.options, seed)
        if agent.start is not None:
            self._genomes = mutants(agent.start, agent.options, rng(seed, Stream.WEIGHTS))
        self._sums = np.zeros(len(self._genomes))
        self._tries = np.zeros(len(self._genomes))
        self._given = 0

    def episodes(self) -> Iterator[TrainingEpisode]:
        """See `Trainer`. Episode numbers count genome by genome, and within a genome world by world."""
        o = self._agent.options
        size = o.population * o.worlds
        while True:
            generation = self._generation
            worlds = [self._world_of(generation * o.worlds + i) for i in range(o.worlds)]
            crowd = Crowd(np.repeat(self._genomes, o.worlds, axis=0), self._agent.scale)
            fitness = np.zeros(size)
            ended = finished_episodes(self._navigation, worlds * o.population, crowd)
            for count, (place, summary) in enumerate(ended):
                world = worlds[place % o.worlds]
                nearer = 1.0 - crowd.remaining[place] / distance(world.start, *world.target)
                fitness[place] = episode_fitness(summary.ending, nearer)
                if count < self._given:
                    continue
                self._given += 1
                if self._given == size:
                    self._breed(fitness.reshape(o.population, o.worlds).sum(axis=1))
                numbers = {"generation": float(generation), "genome": float(place // o.worlds)}
                yield TrainingEpisode(generation * size + place, summary, numbers)

    def state_dict(self) -> dict[str, NDArray[Any]]:
        """Copies the present generation, the scores of its elites, and how many of its episodes were yielded."""
        return {
            "generation": np.array([self._generation]),
            "genomes": self._genomes.copy(),
            "sums": self._sums.copy(),
            "tries": self._tries.copy(),
            "given": np.array([self._given]),
        }

    def load_state_dict(self, arrays: dict[str, NDArray[Any]]) -> None:
        """Resumes from what `state_dict` gave."""
        try:
            if arrays["genomes"].shape != self._genomes.shape:
                raise ValueError
            (self._generation,), (self._given,) = arrays["generation"].tolist(), arrays["given"].tolist()
            self._genomes[:], self._sums[:], self._tries[:] = (arrays[name] for name in ("genomes", "sums", "tries"))
        except (KeyError, ValueError, TypeError):
            raise UserError(f"this is not the state of a search with {len(self._genomes)} genomes") from None

    def _breed(self, sums: Array) -> None:
        """Gives the agent the fittest genome, and begins the next generation."""
        o = self._agent.options
        self._sums += sums
        self._tries += o.worlds
        fitness = genome_fitness(self._sums, self._tries, sums.mean() / o.worlds, o.prior)
        elites = fittest(fitness, o.elites)
        self._agent.load_state_dict({name: weights[0] for name, weights in layers(self._genomes[elites[:1]]).items()})
        self._generation += 1
        self._given = 0
        children = bred(self._genomes, fitness, o, rng(self._seed, Stream.WEIGHTS, self._generation))
        self._genomes = np.concatenate([self._genomes[elites], children])
        nothing = np.zeros(len(children))
        self._sums = np.concatenate([self._sums[elites], nothing])
        self._tries = np.concatenate([self._tries[elites], nothing])


class Networks(TurnChooser):
    """Drives each of n vehicles by a network of its own, given by its genome (n, 89)."""

    def __init__(self, genomes: Array, scale: float) -> None:
        self._genomes, self._scale = genomes, scale

    def values(self, observations: Observation, asked: NDArray[np.bool_]) -> Array:
        """Returns the outputs of the networks."""
        return network_outputs(self._genomes[asked], observations.readings[asked] / self._scale)


@dataclass(frozen=True, slots=True)
class CrowdState:
    """Which genome drives which of n vehicles."""

    genomes: NDArray[np.int64]
    """Index of each vehicle's genome (n,); -1 before its first episode."""
    begun: int = 0
    """Number of genomes that have begun their episode."""


class Crowd(NoValues):
    """Drives one episode with each of several genomes, in the order in which the episodes begin."""

    def __init__(self, genomes: Array, scale: float) -> None:
        self._genomes, self._scale = genomes, scale
        self.remaining = np.zeros(len(genomes))
        """Distance of each genome's vehicle from its target at its last decision [m]; `act` writes it."""

    def initial_state(self, size: int) -> CrowdState:
        """Returns a state in which no genome drives."""
        return CrowdState(np.full(size, -1))

    def reset(self, state: CrowdState, world_seeds: Mapping[int, int]) -> CrowdState:
        """Gives each of these vehicles the next genome."""
        genomes = state.genomes.copy()
        genomes[list(world_seeds)] = state.begun + np.arange(len(world_seeds))
        return CrowdState(genomes, state.begun + len(world_seeds))

    def act(self, observations: Observation, state: CrowdState) -> tuple[Actions, CrowdState]:
        """Chooses the action with the largest output of each vehicle's network."""
        driven = state.genomes >= 0
        self.remaining[state.genomes[driven]] = observations.distance_left[driven]
        actions, _ = Networks(self._genomes[state.genomes], self._scale).act(observations, None)
        return actions, state


@dataclass(frozen=True, slots=True)
class _Parent:
    genes: list[float]
    fitness: float


def episode_fitness(ending: str, nearer: float) -> float:
    """Scores an episode: 1 at the target, else half of the share of the distance by which the vehicle came nearer."""
    return 1.0 if ending == "goal" else 0.5 * nearer


def genome_fitness(sums: Array, tries: Array, average: float, prior: float) -> Array:
    """Computes the fitness of genomes (m,) from the sums (m,) of the scores of their `tries` (m,).

    `prior` tries with the average score are added to each genome, because three successes of three may be luck.
    """
    return np.asarray((sums + prior * average) / (tries + prior))


def fittest(fitness: Array, count: int) -> NDArray[np.int64]:
    """The best `count` of a fitness (m,), the best first; of equals, those that came first."""
    return np.argsort(-fitness, kind="stable")[:count]


def mutants(genome: Array, options: GeneticOptions, generator: np.random.Generator) -> Array:
    """A generation (m, 89) of a genome (89,), which comes first, and of mutants of it."""
    same = np.repeat(genome[None], options.population, axis=0)
    return np.concatenate([same[:1], bred(same, np.zeros(len(same)), replace(options, elites=1), generator)])


def bred(genomes: Array, fitness: Array, options: GeneticOptions, generator: np.random.Generator) -> Array:
    """Children that fill the places beside the elites, of genomes (m, 89) with a fitness (m,)."""
    places = len(genomes) - options.elites
    parents = [_Parent(genes, one) for genes, one in zip(genomes.tolist(), fitness.tolist(), strict=True)]
    with fenced(generator):
        chosen = tools.selTournament(parents, places + places % 2, options.tournament)
        children = [list(parent.genes) for parent in chosen]
        for pair in np.flatnonzero(generator.random(len(children) // 2) < options.crossover).tolist():
            tools.cxBlend(children[2 * pair], children[2 * pair + 1], options.blend)
        for child in children:
            tools.mutGaussian(child, 0.0, options.mutation_step, options.mutation_share)
    return np.array(children[:places])
