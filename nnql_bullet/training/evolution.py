"""A genetic search: the same worlds for all genomes of a generation, and the fittest breed. The only module of DEAP.

Genomes drive greedily, each on its own, so what comes out depends on the configuration and the seed, and not even on
the number of vehicles; only the order in which episodes finish does.

What is kept of a generation under way is how many of its episodes were given out. Going on drives it again from its
beginning, which comes to the same, bit for bit.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from deap import tools
from numpy.typing import NDArray

from nnql_bullet.agents.base import TurnChooser
from nnql_bullet.agents.genetic import Genetic, GeneticOptions, first_generation, layers, network_outputs
from nnql_bullet.env import FleetNavigation, Observations
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array
from nnql_bullet.rollout import EpisodeSummary, finished_episodes
from nnql_bullet.seeding import Stream, fenced, rng
from nnql_bullet.training.base import TrainingEpisode
from nnql_bullet.worlds.spec import WorldSpec


class Evolution:
    """A `Trainer`. The agent is given the fittest genome whenever a generation is over."""

    def __init__(
        self, agent: Genetic, navigation: FleetNavigation, world_of: Callable[[int], WorldSpec], seed: int
    ) -> None:
        self._agent = agent
        self._navigation = navigation
        self._world_of = world_of
        self._seed = seed
        self._generation = 0
        self._genomes = first_generation(agent.options, seed)
        self._given = 0

    def episodes(self) -> Iterator[TrainingEpisode]:
        """See `Trainer`. Episode numbers count genome by genome, and within a genome world by world."""
        o = self._agent.options
        size = o.population * o.worlds
        while True:
            generation = self._generation
            worlds = [self._world_of(generation * o.worlds + i) for i in range(o.worlds)]
            crowd = Crowd(np.repeat(self._genomes, o.worlds, axis=0))
            fitness = np.zeros(size)
            ended = finished_episodes(self._navigation, worlds * o.population, crowd)
            for count, (place, summary) in enumerate(ended):
                fitness[place] = episode_fitness(summary)
                if count < self._given:
                    continue
                self._given += 1
                if self._given == size:
                    self._breed(fitness.reshape(o.population, o.worlds).mean(axis=1))
                numbers = {"generation": generation, "genome": place // o.worlds, "fitness": float(fitness[place])}
                yield TrainingEpisode(generation * size + place, summary, numbers)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The generation under way, and how many of its episodes were given out."""
        return {
            "generation": np.array([self._generation]),
            "genomes": self._genomes.copy(),
            "given": np.array([self._given]),
        }

    def load(self, arrays: dict[str, NDArray[Any]]) -> None:
        """Takes back what `arrays` gave."""
        try:
            (self._generation,), (self._given,) = arrays["generation"].tolist(), arrays["given"].tolist()
            if arrays["genomes"].shape != self._genomes.shape:
                raise ValueError
            self._genomes = arrays["genomes"]
        except (KeyError, ValueError, TypeError):
            raise UserError(f"this is not the state of a search with {len(self._genomes)} genomes") from None

    def _breed(self, fitness: Array) -> None:
        """Gives the agent the fittest genome, and begins the next generation."""
        self._agent.load({name: weights[0] for name, weights in layers(self._genomes[[fitness.argmax()]]).items()})
        self._generation += 1
        generator = rng(self._seed, Stream.WEIGHTS, self._generation)
        self._genomes = next_generation(self._genomes, fitness, self._agent.options, generator)
        self._given = 0


class Crowd(TurnChooser):
    """Drives one episode with each of several genomes, given in the order in which the episodes begin."""

    def __init__(self, genomes: Array) -> None:
        self._genomes = genomes
        self._begun = 0
        self._driving: dict[int, int] = {}

    def begin(self, vehicle: int, world_seed: int) -> None:
        """The vehicle is given the next genome."""
        self._driving[vehicle] = self._begun
        self._begun += 1

    def values(self, observations: Observations, asked: NDArray[np.bool_]) -> Array:
        """What each vehicle's network puts out."""
        genomes = [self._driving.get(vehicle, 0) for vehicle in np.flatnonzero(asked).tolist()]  # some stand by
        return network_outputs(self._genomes[genomes], observations.readings[asked])


@dataclass(frozen=True, slots=True)
class _Parent:
    genes: list[float]
    fitness: float


def episode_fitness(summary: EpisodeSummary) -> float:
    """1 for the goal."""
    return float(summary.ending == "goal")


def next_generation(genomes: Array, fitness: Array, options: GeneticOptions, generator: np.random.Generator) -> Array:
    """Genomes (m, 89) that follow on genomes (m, 89) of a fitness (m,): the elites, the fittest first, and children."""
    children = len(genomes) - options.elites
    parents = [_Parent(genes, one) for genes, one in zip(genomes.tolist(), fitness.tolist(), strict=True)]
    with fenced(generator):
        chosen = tools.selTournament(parents, children + children % 2, options.tournament)
        bred = [list(parent.genes) for parent in chosen]
        for one, other in zip(bred[::2], bred[1::2], strict=True):
            tools.cxBlend(one, other, options.blend)
        for child in bred:
            tools.mutGaussian(child, 0.0, options.mutation_step, options.mutation_share)
    elites = np.argsort(-fitness, kind="stable")[: options.elites]
    return np.concatenate([genomes[elites], bred[:children]])
