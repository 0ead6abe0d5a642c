"""What a training is to those that run it, whatever is trained and how."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Protocol

from numpy.typing import NDArray

from nnql_bullet.rollout import EpisodeSummary

RECENT = 100
"""Episodes at the end of a training over which its success is shown."""


@dataclass(frozen=True, slots=True)
class TrainingEpisode:
    """One finished training episode."""

    episode: int
    """Counted from 0, in the order in which they began."""
    summary: EpisodeSummary
    diagnostics: dict[str, float]
    """Named numbers for the log."""


class Trainer(Protocol):
    """A training as far as it has come. What comes out depends on the configuration and the seed alone."""

    def episodes(self) -> Iterator[TrainingEpisode]:
        """Trains without end, and yields each episode as it finishes; `state_dict` may be asked for in between.

        Raises:
            WorkerDied: If a process that holds vehicles is gone; `state_dict` then gives a state to go on from.
        """

    def state_dict(self) -> dict[str, NDArray[Any]]:
        """What to go on from, beside what the agent has learned."""

    def load_state_dict(self, arrays: dict[str, NDArray[Any]]) -> None:
        """Takes back what `state_dict` gave, so that what follows is as if the training had never stopped.

        Raises:
            UserError: If these are not the arrays of such a training.
        """
