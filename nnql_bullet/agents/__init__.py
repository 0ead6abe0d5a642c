"""Agents: each is a module whose options, told apart by their `kind`, build it.

The two unions are the registry: an agent or a rule is added by its module and one line there.
"""

from typing import Annotated, TypeAlias, get_args

from pydantic import Field

from nnql_bullet.agents.learning.genetic import GeneticOptions
from nnql_bullet.agents.learning.options import DistilledOptions, DoubleDqnOptions, NnqlOptions, Sb3DqnOptions
from nnql_bullet.agents.learning.q_table import QTableOptions
from nnql_bullet.agents.rules.dwa import DwaOptions
from nnql_bullet.agents.rules.fuzzy import FuzzyOptions
from nnql_bullet.agents.rules.guided_search import GuidedSearchOptions
from nnql_bullet.agents.rules.hand_rule import HandRuleOptions
from nnql_bullet.agents.rules.look_ahead import LookAheadOptions
from nnql_bullet.agents.rules.mppi import MppiOptions
from nnql_bullet.agents.rules.orca import OrcaOptions
from nnql_bullet.agents.rules.potential_field import PotentialFieldOptions
from nnql_bullet.agents.rules.pure_pursuit import PurePursuitOptions
from nnql_bullet.agents.rules.random_turns import RandomTurnsOptions
from nnql_bullet.agents.rules.straight import StraightOptions
from nnql_bullet.agents.rules.vfh import VfhOptions
from nnql_bullet.training.base import LearningAgent, Trainable

LearnerOptions: TypeAlias = (
    NnqlOptions | QTableOptions | GeneticOptions | DoubleDqnOptions | DistilledOptions | Sb3DqnOptions
)
RuleOptions: TypeAlias = (
    StraightOptions
    | RandomTurnsOptions
    | HandRuleOptions
    | PotentialFieldOptions
    | FuzzyOptions
    | VfhOptions
    | LookAheadOptions
    | DwaOptions
    | PurePursuitOptions
    | MppiOptions
    | OrcaOptions
    | GuidedSearchOptions
)
AgentOptions: TypeAlias = LearnerOptions | RuleOptions
AnyAgentOptions = Annotated[AgentOptions, Field(discriminator="kind")]

RULES: tuple[str, ...] = tuple(options.kind for options in get_args(RuleOptions))
"""Kinds of agents that have nothing to learn."""
KINDS: tuple[str, ...] = tuple(options.kind for options in get_args(AgentOptions))

__all__ = [
    "KINDS",
    "RULES",
    "AgentOptions",
    "AnyAgentOptions",
    "LearningAgent",
    "RuleOptions",
    "Trainable",
]
