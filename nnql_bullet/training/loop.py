"""Training (III.C): episode after episode in a new world each, learning at every step."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

from nnql_bullet.agents import Agent
from nnql_bullet.env import Navigation
from nnql_bullet.rollout import EpisodeSummary, run_episode
from nnql_bullet.seeding import Stream, rng
from nnql_bullet.worlds.spec import WorldSpec


@dataclass(frozen=True, slots=True)
class TrainingEpisode:
    """One finished training episode."""

    episode: int
    """Counted from 0."""
    summary: EpisodeSummary
    diagnostics: dict[str, float]
    """Of the agent."""


def train(
    agent: Agent, navigation: Navigation, world_of: Callable[[int], WorldSpec], seed: int, episodes: range
) -> Iterator[TrainingEpisode]:
    """Runs `episodes` one by one, and yields after each; between two, the agent is all the state there is.

    Every episode draws from generators of its own, so one that starts at episode 50 goes on exactly as one that came
    there.
    """
    for episode in episodes:
        generator = rng(seed, Stream.POLICY, episode)
        agent.begin_episode(episode)
        summary = run_episode(
            navigation,
            world_of(episode),
            policy=lambda observation, generator=generator: agent.explore(observation, generator),  # type: ignore[misc]
            learn=agent.learn,
        )
        yield TrainingEpisode(episode, summary, agent.diagnostics())
