"""Selection of a policy among late states of a training: the one that reaches most targets in validation worlds.

What an agent drives like goes up and down from one episode of its training to the next, and where it happens to end is
no better than where it was a while before. So what it has learned is kept now and then, and in the end the last few of
these candidates are driven greedily. That is done in the kinematic model, whatever the training drove in: in contact
physics it would take as long as the training.

The worlds are the last of the split `validation`, whose first ones figures are made of: those stay figures of worlds
that nothing was chosen on.
"""

from collections.abc import Mapping, Sequence

from nnql_bullet.config import options
from nnql_bullet.env import Navigation
from nnql_bullet.geometry import Array
from nnql_bullet.rollout import run_episodes
from nnql_bullet.seeding import VALIDATION_WORLDS
from nnql_bullet.training.base import Trainable
from nnql_bullet.types import Count, Few
from nnql_bullet.worlds.source import WorldLike
from nnql_bullet.worlds.spec import WorldSpec

Candidates = dict[int, dict[str, Array]]
"""State dicts of the agent, by the number of training episodes behind them."""


@options
class SelectionOptions:
    """Options of the selection."""

    candidates: Few = 8
    """Number of states that are tried in the end, the last one among them; 1 takes the last state."""
    every: Count = 50
    """Episodes from one candidate to the next. They do not follow the number of training episodes, so that a run can be
    stopped and resumed."""
    worlds: tuple[WorldLike, ...] = ()
    """Shipped worlds or TOML files to try them in, each once; by default those of the training."""
    count: Few = 100
    """Validation worlds of each kind."""


def seeds(count: int) -> range:
    """Seeds of so many validation worlds of each kind."""
    return VALIDATION_WORLDS[-count:]


def keep(candidates: Candidates, episodes: int, agent: Trainable, options: SelectionOptions) -> None:
    """Adds the agent's state as a candidate every `options.every` episodes, and drops the oldest beyond the limit."""
    if episodes % options.every == 0:
        candidates[episodes] = agent.state_dict()
        for old in sorted(candidates)[: -options.candidates]:
            del candidates[old]


def finalists(candidates: Candidates, episodes: int, agent: Trainable, options: SelectionOptions) -> Candidates:
    """The last candidates of a training that ended after so many episodes, with the agent's present state."""
    known = {**candidates, episodes: agent.state_dict()}
    return {which: known[which] for which in sorted(known)[-options.candidates :]}


def count_goals(
    agent: Trainable, candidates: Candidates, navigation: Navigation, worlds: Sequence[WorldSpec]
) -> dict[int, int]:
    """Counts the worlds in which each candidate, driven greedily, reaches its target.

    Args:
        agent: Drives; what it has learned is replaced.
        candidates: To be tried.
        navigation: Where it drives.
        worlds: The same for all.
    """
    goals = {}
    for episodes, arrays in candidates.items():
        agent.load_state_dict(arrays)
        goals[episodes] = sum(summary.ending == "goal" for summary in run_episodes(navigation, worlds, agent))
    return goals


def most_goals(goals: Mapping[int, int]) -> int:
    """The candidate with the most goals, by its number of episodes; of equals, the later."""
    return max(goals, key=lambda episodes: (goals[episodes], episodes))
