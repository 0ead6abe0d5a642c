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
from nnql_bullet.rollout import finished_episodes
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
        self._goals = np.zeros(len(self._genomes))
        self._tries = np.zeros(len(self._genomes))
        self._given = 0

    def episodes(self) -> Iterator[TrainingEpisode]:
        """See `Trainer`. Episode numbers count genome by genome, and within a genome world by world."""
        o = self._agent.options
        size = o.population * o.worlds
        while True:
            generation = self._generation
            worlds = [self._world_of(generation * o.worlds + i) for i in range(o.worlds)]
            crowd = Crowd(np.repeat(self._genomes, o.worlds, axis=0))
            goals = np.zeros(size)
            ended = finished_episodes(self._navigation, worlds * o.population, crowd)
            for count, (place, summary) in enumerate(ended):
                goals[place] = summary.ending == "goal"
                if count < self._given:
                    continue
                self._given += 1
                if self._given == size:
                    self._breed(goals.reshape(o.population, o.worlds).sum(axis=1))
                numbers = {"generation": float(generation), "genome": float(place // o.worlds)}
                yield TrainingEpisode(generation * size + place, summary, numbers)

    def arrays(self) -> dict[str, NDArray[Any]]:
        """The generation under way, what its elites did before, and how many of its episodes were given out."""
        return {
            "generation": np.array([self._generation]),
            "genomes": self._genomes.copy(),
            "goals": self._goals.copy(),
            "tries": self._tries.copy(),
            "given": np.array([self._given]),
        }

    def load(self, arrays: dict[str, NDArray[Any]]) -> None:
        """Takes back what `arrays` gave."""
        try:
            if arrays["genomes"].shape != self._genomes.shape:
                raise ValueError
            (self._generation,), (self._given,) = arrays["generation"].tolist(), arrays["given"].tolist()
            self._genomes[:], self._goals[:], self._tries[:] = (arrays[name] for name in ("genomes", "goals", "tries"))
        except (KeyError, ValueError, TypeError):
            raise UserError(f"this is not the state of a search with {len(self._genomes)} genomes") from None

    def _breed(self, goals: Array) -> None:
        """Gives the agent the fittest genome, and begins the next generation."""
        o = self._agent.options
        self._goals += goals
        self._tries += o.worlds
        fitness = genome_fitness(self._goals, self._tries, goals.mean() / o.worlds, o.prior)
        elites = fittest(fitness, o.elites)
        self._agent.load({name: weights[0] for name, weights in layers(self._genomes[elites[:1]]).items()})
        self._generation += 1
        self._given = 0
        children = bred(self._genomes, fitness, o, rng(self._seed, Stream.WEIGHTS, self._generation))
        self._genomes = np.concatenate([self._genomes[elites], children])
        nothing = np.zeros(len(children))
        self._goals = np.concatenate([self._goals[elites], nothing])
        self._tries = np.concatenate([self._tries[elites], nothing])


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


def genome_fitness(goals: Array, tries: Array, average: float, prior: float) -> Array:
    """Success of genomes (m,) that reached the target so often (m,) in so many tries (m,).

    As many tries as `prior` says are added to each, with the success of the average genome: three of three may be luck.
    """
    return np.asarray((goals + prior * average) / (tries + prior))


def fittest(fitness: Array, count: int) -> NDArray[np.int64]:
    """The best `count` of a fitness (m,), the best first; of equals, those that came first."""
    return np.argsort(-fitness, kind="stable")[:count]


def bred(genomes: Array, fitness: Array, options: GeneticOptions, generator: np.random.Generator) -> Array:
    """Children that fill the places beside the elites, of genomes (m, 89) with a fitness (m,)."""
    places = len(genomes) - options.elites
    parents = [_Parent(genes, one) for genes, one in zip(genomes.tolist(), fitness.tolist(), strict=True)]
    with fenced(generator):
        chosen = tools.selTournament(parents, places + places % 2, options.tournament)
        children = [list(parent.genes) for parent in chosen]
        for one, other in zip(children[::2], children[1::2], strict=True):
            tools.cxBlend(one, other, options.blend)
        for child in children:
            tools.mutGaussian(child, 0.0, options.mutation_step, options.mutation_share)
    return np.array(children[:places])
