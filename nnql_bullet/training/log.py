"""What a training tells a log after each episode."""

from collections.abc import Callable, Mapping, Sequence
from typing import Final

from nnql_bullet.task import ENDINGS
from nnql_bullet.training.base import RECENT, TrainingEpisode
from nnql_bullet.training.evaluation import Evaluation

Log = Callable[[int, Mapping[str, float]], None]
"""Receives how many episodes are finished, and numbers by name."""
TENSORBOARD: Final = "tensorboard"
"""Folder of TensorBoard's log in a run folder."""
VALIDATION: Final = "success/validation"
"""Name of the success of an evaluation, which is told after the episodes that it was made after."""


def scalars(episodes: Sequence[TrainingEpisode], evaluations: Sequence[Evaluation], done: int) -> dict[str, float]:
    """Returns the numbers of a training when so many of its episodes are finished, by name."""
    last, recent = episodes[done - 1], episodes[max(done - RECENT, 0) : done]
    shares = {name: sum(e.summary.ending == name for e in recent) / len(recent) for name in ENDINGS}
    numbers = {
        "episode/return": last.summary.episode_return,
        "episode/steps": float(last.summary.steps),
        f"success/last_{RECENT}": shares["goal"],
        **{f"endings_of_last_{RECENT}/{name}": share for name, share in shares.items()},
        **{f"learning/{name}": value for name, value in last.diagnostics.items()},
    }
    evaluated = [one.success for one in evaluations if one.episodes == done]
    return {**numbers, VALIDATION: evaluated[0]} if evaluated else numbers
