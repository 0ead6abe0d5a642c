"""Steps that are learned from again: n-step returns out of a ring of the vehicles' last decisions.

Everything is kept once: what a vehicle saw is a row of bytes, from which a stack of its last frames, and the one that
bootstraps a return, are put together when they are drawn (Mnih et al., Nature 518, 2015; Sutton, Machine Learning 3,
1988, for n-step returns).
"""

from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.geometry import Array
from nnql_bullet.types import Bytes

Counts = NDArray[np.int64]

CONTINUES, TERMINATED, TRUNCATED = 0, 1, 2
"""What a step does to its episode. A truncated episode (a timeout) says nothing about the rewards that would follow."""

_KEPT = ("seen", "age", "action", "reward", "ends")


@dataclass(frozen=True, slots=True)
class Batch:
    """m steps to learn from."""

    s_tm1: Bytes
    """What was seen before the steps (m, frames * width)."""
    a_tm1: Counts
    """Actions (m,)."""
    r_t: Array
    """n-step returns (m,): discounted sums of the rewards of n steps, or of those up to the end."""
    discount_t: Array
    """Discounts of the value of s_t (m,): 0 where the episode had ended."""
    s_t: Bytes
    """What was seen after n steps (m, frames * width)."""
    counts: NDArray[np.bool_]
    """Whether each step counts (m,): those whose episode was truncated do not."""

    def split(self, parts: int) -> "list[Batch]":
        """The batch in so many parts of equal size."""
        columns = (np.split(getattr(self, its.name), parts) for its in fields(self))
        return [Batch(*rows) for rows in zip(*columns, strict=True)]


class Replay:
    """The last `rows` decisions of n vehicles in lockstep."""

    def __init__(self, rows: int, vehicles: int, width: int, frames: int) -> None:
        """Makes room.

        Args:
            rows: Decisions of each vehicle that are kept.
            vehicles: n
            width: Bytes of a frame.
            frames: That make up what a vehicle sees: the last ones of its episode, the earliest repeated at its start.
        """
        self.rows, self.vehicles, self.frames = rows, vehicles, frames
        self.count = 0
        """Decisions of each vehicle so far."""
        self._seen = np.zeros((rows, vehicles, width), np.uint8)
        self._age = np.zeros((rows, vehicles), np.int16)
        self._action = np.zeros((rows, vehicles), np.int8)
        self._reward = np.zeros((rows, vehicles), np.float32)
        self._ends = np.zeros((rows, vehicles), np.int8)

    def add(
        self, seen: Bytes, age: Counts, actions: Counts, rewards: Array, ends: Counts, rewards_before: Array
    ) -> None:
        """One decision of every vehicle.

        Args:
            seen: Frames before it (n, width).
            age: Decisions before it in the same episode (n,).
            actions: (n,)
            rewards: (n,)
            ends: One of `CONTINUES`, `TERMINATED` and `TRUNCATED` (n,).
            rewards_before: What the decision before earned besides, as is known only now (n,); of no account where
                that was of another episode.
        """
        now, before = self.count % self.rows, (self.count - 1) % self.rows
        self._reward[before] += np.where(age > 0, rewards_before, 0.0)
        self._seen[now], self._age[now] = seen, age
        self._action[now], self._reward[now], self._ends[now] = actions, rewards, ends
        self.count += 1

    def choices(self, n_step: int) -> range:
        """The decisions that can be drawn: those with `n_step` decisions after them."""
        first = max(self.count - self.rows, 0)
        return range(first + (self.frames - 1 if first else 0), max(self.count - n_step, first))

    def sample(self, size: int, n_step: int, discount: float, generator: np.random.Generator) -> Batch:
        """Draws steps at random, each decision of each vehicle as likely.

        Args:
            size: Number of steps.
            n_step: See `batch`.
            discount: See `batch`.
            generator: Random numbers.
        """
        choices = self.choices(n_step)
        times = generator.integers(choices.start, choices.stop, size)
        return self.batch(times, generator.integers(self.vehicles, size=size), n_step, discount)

    def batch(self, times: Counts, vehicles: Counts, n_step: int, discount: float) -> Batch:
        """The n-step returns of some decisions.

        Args:
            times: Decisions among `choices` (m,).
            vehicles: Their vehicles (m,).
            n_step: Steps after which the return is bootstrapped.
            discount: gamma, of each step.
        """
        r_t, discount_t = np.zeros(len(times)), np.ones(len(times))
        counts = np.ones(len(times), np.bool_)
        for k in range(n_step):
            place = (times + k) % self.rows, vehicles
            r_t += discount_t * self._reward[place]
            counts &= (self._ends[place] != TRUNCATED) | (discount_t == 0)
            discount_t = np.where(self._ends[place] == CONTINUES, discount * discount_t, 0.0)
        return Batch(
            s_tm1=self._stacked(times, vehicles),
            a_tm1=self._action[times % self.rows, vehicles].astype(np.int64),
            r_t=r_t,
            discount_t=discount_t,
            s_t=self._stacked(times + n_step, vehicles),
            counts=counts,
        )

    def _stacked(self, times: Counts, vehicles: Counts) -> Bytes:
        """The last frames at some decisions (m, frames * width), the newest first."""
        age = self._age[times % self.rows, vehicles]
        back = [np.minimum(k, age) for k in range(self.frames)]
        return np.concatenate([self._seen[(times - k) % self.rows, vehicles] for k in back], axis=1)

    def state_dict(self) -> dict[str, NDArray[Any]]:
        """What it holds, by name."""
        filled = slice(0, min(self.count, self.rows))
        kept = {name: getattr(self, f"_{name}")[filled].copy() for name in _KEPT}
        return {"count": np.array([self.count]), **kept}

    def load_state_dict(self, arrays: dict[str, NDArray[Any]]) -> None:
        """Takes back what `state_dict` gave.

        Raises:
            KeyError, ValueError: If these are not arrays of such a memory.
        """
        (self.count,) = arrays["count"].tolist()
        filled = slice(0, min(self.count, self.rows))
        for name in _KEPT:
            getattr(self, f"_{name}")[filled] = arrays[name]
