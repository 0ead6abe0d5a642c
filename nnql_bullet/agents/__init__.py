"""Agents: each a module with its own options, told apart by their `kind`."""

from typing import Annotated

from pydantic import Field

from nnql_bullet.agents.base import Agent, Learner, Taught
from nnql_bullet.agents.genetic import Genetic, GeneticOptions
from nnql_bullet.agents.nnql import Nnql, NnqlOptions
from nnql_bullet.agents.q_table import QTable, QTableOptions
from nnql_bullet.agents.sb3_dqn import Sb3Dqn, Sb3DqnOptions
from nnql_bullet.agents.straight import Straight, StraightOptions
from nnql_bullet.sim.base import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec

AnyAgentOptions = Annotated[
    NnqlOptions | QTableOptions | GeneticOptions | Sb3DqnOptions | StraightOptions, Field(discriminator="kind")
]

RULES = ("straight",)
"""Kinds of agents that have nothing to learn."""
KINDS = ("nnql", "q_table", "genetic", "sb3_dqn", *RULES)


def make_agent(options: AnyAgentOptions, seed: int, vehicle: VehicleSpec, drive: DriveOptions) -> Agent:
    """The untrained agent that `options` describe, a function of its arguments.

    Args:
        options: Its kind and numbers.
        seed: Of all the chance in it.
        vehicle: What it drives; rules that foresee where a turn leads go by it.
        drive: How its decisions reach the wheels; likewise.
    """
    match options:
        case NnqlOptions():
            return Nnql(options, seed)
        case QTableOptions():
            return QTable(options)
        case GeneticOptions():
            return Genetic(options, seed)
        case Sb3DqnOptions():
            return Sb3Dqn(options, seed)
        case StraightOptions():
            return Straight()


__all__ = ["KINDS", "RULES", "Agent", "AnyAgentOptions", "Learner", "Taught", "make_agent"]
