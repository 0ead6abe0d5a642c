"""Agents: each a module with its own options, told apart by their `kind`."""

from typing import Annotated, TypeAlias

from pydantic import Field

from nnql_bullet.agents.base import Agent, LearningAgent, Trainable
from nnql_bullet.agents.learning.double_dqn import DoubleDqn, DoubleDqnOptions
from nnql_bullet.agents.learning.genetic import Genetic, GeneticOptions
from nnql_bullet.agents.learning.nnql import Nnql, NnqlOptions
from nnql_bullet.agents.learning.q_table import QTable, QTableOptions
from nnql_bullet.agents.learning.sb3_dqn import Sb3Dqn, Sb3DqnOptions
from nnql_bullet.agents.rules.fuzzy import Fuzzy, FuzzyOptions
from nnql_bullet.agents.rules.hand_rule import HandRule, HandRuleOptions
from nnql_bullet.agents.rules.look_ahead import LookAhead, LookAheadOptions
from nnql_bullet.agents.rules.potential_field import PotentialField, PotentialFieldOptions
from nnql_bullet.agents.rules.random_turns import RandomTurns, RandomTurnsOptions
from nnql_bullet.agents.rules.straight import Straight, StraightOptions
from nnql_bullet.agents.rules.vfh import Vfh, VfhOptions
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec

RuleOptions: TypeAlias = (
    StraightOptions
    | RandomTurnsOptions
    | HandRuleOptions
    | PotentialFieldOptions
    | FuzzyOptions
    | VfhOptions
    | LookAheadOptions
)
AgentOptions: TypeAlias = NnqlOptions | QTableOptions | GeneticOptions | DoubleDqnOptions | Sb3DqnOptions | RuleOptions
AnyAgentOptions = Annotated[AgentOptions, Field(discriminator="kind")]

RULES = ("straight", "random", "hand_rule", "potential_field", "fuzzy", "vfh", "look_ahead")
"""Kinds of agents that have nothing to learn."""
KINDS = ("nnql", "q_table", "genetic", "double_dqn", "sb3_dqn", *RULES)


def make_agent(options: AgentOptions, seed: int, vehicle: VehicleSpec, drive: DriveOptions) -> Agent:
    """The untrained agent that `options` describe, a function of its arguments.

    Args:
        options: Its kind and numbers.
        seed: Of all the chance in it.
        vehicle: What it drives; rules that foresee where a turn leads go by it.
        drive: How its decisions reach the wheels; likewise.

    Raises:
        UserError: If it needs a library that is not installed.
    """
    match options:
        case NnqlOptions():
            return Nnql(options, seed)
        case QTableOptions():
            return QTable(options)
        case GeneticOptions():
            return Genetic(options, seed)
        case DoubleDqnOptions():
            return DoubleDqn(options, seed, vehicle, drive)
        case Sb3DqnOptions():
            return Sb3Dqn(options, seed)
        case StraightOptions():
            return Straight()
        case RandomTurnsOptions():
            return RandomTurns()
        case HandRuleOptions():
            return HandRule(options)
        case PotentialFieldOptions():
            return PotentialField(options, vehicle)
        case FuzzyOptions():
            return Fuzzy(options)
        case VfhOptions():
            return Vfh(options, vehicle, drive)
        case LookAheadOptions():
            return LookAhead(options, vehicle, drive)


__all__ = ["KINDS", "RULES", "Agent", "AgentOptions", "AnyAgentOptions", "LearningAgent", "Trainable", "make_agent"]
