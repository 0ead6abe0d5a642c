"""Agents: each a module with its own options, told apart by their `kind`."""

from nnql_bullet.agents.base import Agent
from nnql_bullet.agents.nnql import Nnql, NnqlOptions

AnyAgentOptions = NnqlOptions


def make_agent(options: AnyAgentOptions, seed: int) -> Agent:
    """The untrained agent that `options` describe, a function of its arguments."""
    return Nnql(options, seed)


__all__ = ["Agent", "AnyAgentOptions", "make_agent"]
