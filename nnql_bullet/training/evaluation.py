"""Evaluation while a training goes on, in validation worlds, and what ends a training early by it.

Evaluations change nothing about the training: they are driven greedily, in the kinematic model, in the worlds of
`selection`.
"""

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Evaluation:
    """How what was learned so far drives."""

    episodes: int
    """Training episodes behind it."""
    goals: int
    """Worlds in which it came to its target."""
    worlds: int
    """Of so many."""

    @property
    def success(self) -> float:
        """Share of the worlds in which it came to its target."""
        return self.goals / self.worlds


def reason_to_stop(evaluations: Sequence[Evaluation], success: float | None, patience: int | None) -> str:
    """Says why a training is over after some evaluations; empty if it goes on.

    Args:
        evaluations: In their order, in the same worlds.
        success: Share of worlds that is enough.
        patience: Number of evaluations in a row, none better than the best before them, that is enough.
    """
    if not evaluations:
        return ""
    last, best = evaluations[-1], max(evaluations, key=lambda one: one.goals)  # of equals, the first
    if success is not None and last.success >= success:
        return f"{last.goals} goals in {last.worlds} validation worlds are enough"
    if patience is not None and len(evaluations) - 1 - evaluations.index(best) >= patience:
        return (
            f"{best.goals} goals in {best.worlds} validation worlds, after {best.episodes} episodes, remained the most"
        )
    return ""
