"""The paper's network with weights that a genetic search found (its alternative [5]); `evolution` searches."""

from collections.abc import Callable
from math import prod
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field
from scipy.special import expit

from nnql_bullet import paper
from nnql_bullet.agents.base import TurnChooser
from nnql_bullet.agents.learning.nnql import encode
from nnql_bullet.agents.learning.weights import check
from nnql_bullet.config import options
from nnql_bullet.env import Navigation, Observation
from nnql_bullet.errors import missing_library
from nnql_bullet.geometry import Array
from nnql_bullet.seeding import Stream, rng
from nnql_bullet.training.base import Trainer
from nnql_bullet.types import Count, NonNegative, Positive, UnitInterval
from nnql_bullet.vehicle.controller import DriveOptions
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
    """How genomes are tried, chosen and bred.

    What was tried, before `prior` was there (kinematic model, 10 000 episodes, 300 validation worlds at 10 % cover, 2
    seeds, which differ by as much as the choices do): the defaults gave 74 %, 100 genomes in 2 worlds each 71 %, 25 in
    8 gave 76 %; crossover of none or nine in ten 75 and 83 %; a mutation step of 0.2 gave 76 %, a mutation share of
    0.03 gave 73 %.
    """

    kind: Literal["genetic"] = "genetic"
    population: Annotated[int, Field(ge=2)] = 50
    """Genomes in a generation."""
    worlds: Count = 4
    """In which each of them is tried, the same for all of a generation."""
    elites: Count = 5
    """The fittest so many live on unchanged, and are tried again in the worlds of the next generation."""
    prior: NonNegative = 8.0
    """Tries of average fitness that are added to those of each genome, in all generations that it lived through. With
    8, 83 % reached the target at 10 % cover, with 0 it was 69 % (kinematic model, 10 000 episodes, 4 seeds)."""
    tournament: Count = 3
    """A parent is the fittest of so many drawn at random."""
    crossover: UnitInterval = 0.5
    """Share of pairs of parents whose genes are blended; the others are copied."""
    blend: NonNegative = 0.3
    """Two children lie between their parents, gene by gene, or beyond them by up to this share of the distance."""
    mutation_share: UnitInterval = 0.1
    """Of genes that mutate."""
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
        return Genetic(self, seed)


class Genetic(TurnChooser):
    """Drives greedily with the fittest genome."""

    def __init__(self, options: GeneticOptions, seed: int) -> None:
        self.options = options
        self._genome = first_generation(options, seed)[0]

    def values(self, observations: Observation, asked: NDArray[np.bool_]) -> Array:
        """What its network puts out."""
        readings = observations.readings[asked]
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
        self._genome = np.concatenate([arrays[name].ravel() for name in LAYERS])


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
    """What the networks of n genomes (n, 89) put out (n, 5), each for readings of its own (n, 8) [m]."""
    w1, b1, w2, b2 = layers(genomes).values()
    hidden = expit(np.einsum("nij,nj->ni", w1, encode(readings, "proximity")) + b1)
    return np.asarray(np.einsum("nij,nj->ni", w2, hidden) + b2)
