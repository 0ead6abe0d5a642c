"""The paper's network with weights that a genetic search found (its alternative [5]); `evolution` searches."""

from collections.abc import Callable
from math import prod
from typing import ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.agents.base import TurnChooser
from nnql_bullet.agents.learning.q_learning import encode
from nnql_bullet.agents.learning.weights import check
from nnql_bullet.config import options
from nnql_bullet.env import Navigation, Observation
from nnql_bullet.errors import missing_library
from nnql_bullet.geometry import Array
from nnql_bullet.seeding import Stream, rng
from nnql_bullet.training.base import Trainer
from nnql_bullet.types import Count, Few, NonNegative, Population, Positive, UnitInterval
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.scale import length_scale
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.spec import WorldSpec

LAYERS = {
    "0.weight": (paper.HIDDEN_UNITS, paper.SECTORS),
    "0.bias": (paper.HIDDEN_UNITS,),
    "2.weight": (len(paper.TURNS), paper.HIDDEN_UNITS),
    "2.bias": (len(paper.TURNS),),
}
"""Names and shapes of the network's weights, as NNQL's have them, in the order of the genes."""
GENES = sum(prod(shape) for shape in LAYERS.values())
"""89."""


@options
class GeneticOptions:
    """Options of the genetic search."""

    network: ClassVar[tuple[str, ...]] = ()
    """Keys that two agents have to share for the weights of one to be those of the other."""
    kind: Literal["genetic"] = "genetic"
    population: Population = 50
    """Genomes in a generation."""
    worlds: Few = 4
    """Worlds in which each genome is tried; they are the same for all of a generation."""
    elites: Count = 5
    """Fittest genomes that live on unchanged. They are tried again in the worlds of the next generation."""
    prior: NonNegative = 8.0
    """Tries of average fitness that are added to those of each genome, in all generations that it lived through."""
    tournament: Few = 3
    """Genomes drawn at random for each parent, which is the fittest of them."""
    crossover: UnitInterval = 0.5
    """Fraction of pairs of parents whose genes are blended; the others are copied."""
    blend: NonNegative = 0.3
    """Fraction of the parents' distance by which a child's gene may lie beyond them."""
    mutation_share: UnitInterval = 0.1
    """Probability that a gene mutates."""
    mutation_step: NonNegative = 0.5
    """Standard deviation of a mutation."""
    initial_weights: Positive = 1.0
    """The first genes are uniform within +- this."""

    def __post_init__(self) -> None:
        """Refuses a population that cannot change."""
        if self.elites >= self.population:
            raise ValueError(f"{self.elites} elites leave no room for children in a population of {self.population}")

    def make_agent(self, seed: int, vehicle: VehicleSpec, drive: DriveOptions) -> "Genetic":
        """Builds the agent."""
        return Genetic(self, seed, length_scale(vehicle.footprint))


class Genetic(TurnChooser):
    """Drives greedily with the fittest genome."""

    def __init__(self, options: GeneticOptions, seed: int, scale: float = 1.0) -> None:
        self.options, self.scale = options, scale
        self._genome = first_generation(options, seed)[0]
        self.start: Array | None = None
        """Genome that it was given last, whose mutants a search begins with; by default with random ones."""

    def values(self, observations: Observation, asked: NDArray[np.bool_]) -> Array:
        """What its network puts out."""
        readings = observations.readings[asked] / self.scale
        return network_outputs(np.repeat(self._genome[None], len(readings), axis=0), readings)

    def make_trainer(self, navigation: Navigation, world_of: Callable[[int], WorldSpec], seed: int) -> Trainer:
        """Builds the training.

        Raises:
            UserError: If DEAP is not installed.
        """
        try:
            from nnql_bullet.agents.learning.evolution import Evolution
        except ImportError:
            raise missing_library("DEAP", "baselines") from None
        return Evolution(self, navigation, world_of, seed)

    def state_dict(self) -> dict[str, Array]:
        """Weights W1 and W2 and their biases."""
        return {name: weights[0].copy() for name, weights in layers(self._genome[None]).items()}

    def load_state_dict(self, arrays: dict[str, Array]) -> None:
        """Replaces weights and biases."""
        check(arrays, LAYERS, "a network", (paper.SECTORS, paper.HIDDEN_UNITS, len(paper.TURNS)))
        self._genome = self.start = np.concatenate([arrays[name].ravel() for name in LAYERS])


def first_generation(options: GeneticOptions, seed: int) -> Array:
    """Genomes (m, 89) to begin with."""
    limit = options.initial_weights
    return rng(seed, Stream.WEIGHTS).uniform(-limit, limit, (options.population, GENES))


def layers(genomes: Array) -> dict[str, Array]:
    """The weights (n, ...) that genomes (n, 89) stand for, by name."""
    ends = np.cumsum([prod(shape) for shape in LAYERS.values()])[:-1]
    parts = zip(LAYERS.items(), np.split(genomes, ends, axis=-1), strict=True)
    return {name: genes.reshape(-1, *shape) for (name, shape), genes in parts}


def network_outputs(genomes: Array, readings: Array) -> Array:
    """What the networks of n genomes (n, 89) put out (n, 5), each for readings of its own (n, 8) [m], scaled."""
    from scipy.special import expit  # takes long to load

    w1, b1, w2, b2 = layers(genomes).values()
    hidden = expit(np.einsum("nij,nj->ni", w1, encode(readings, "proximity")) + b1)
    return np.asarray(np.einsum("nij,nj->ni", w2, hidden) + b2)
