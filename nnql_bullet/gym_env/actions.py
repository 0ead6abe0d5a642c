"""What may be chosen in an environment: a registry of sets of actions, each a space and a reading of its actions."""

from dataclasses import dataclass
from typing import Any, Literal, Protocol

import gymnasium
import numpy as np

from nnql_bullet import paper
from nnql_bullet.env import (
    ACTIONS,
    LARGEST_TURN,
    MANOEUVRES,
    REVERSE,
    Commands,
    as_actions,
    commands_of,
    nearest_manoeuvres,
)
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array
from nnql_bullet.vehicle.controller import DriveOptions

ActionsName = Literal["turns", "six", "braking", "manoeuvres", "continuous"]

ROUNDING = 1e-5
"""How far beyond its bound a continuous action may be: what rescaling in float32 leaves."""


class ActionSet(Protocol):
    """Actions that an environment may offer."""

    @property
    def space(self) -> gymnasium.spaces.Space[Any]:
        """The actions of one vehicle."""

    def read(self, given: object, target_bearing: Array, drive: DriveOptions) -> Commands:
        """Reads the actions (n, ...) of n vehicles, whose targets are at bearings (n,) [rad].

        Raises:
            UserError: If they are not n actions of the space.
        """


@dataclass(frozen=True, slots=True)
class Discrete:
    """The first so many of `env.MANOEUVRES`."""

    count: int

    @property
    def space(self) -> gymnasium.spaces.Space[Any]:
        """See `ActionSet.space`."""
        return gymnasium.spaces.Discrete(self.count)

    def read(self, given: object, target_bearing: Array, drive: DriveOptions) -> Commands:
        """See `ActionSet.read`."""
        return commands_of(as_actions(given, len(target_bearing), self.count), target_bearing, drive)


@dataclass(frozen=True, slots=True)
class Continuous:
    """Heading change and speed, as two numbers from -1 to 1.

    The first is the heading change over the paper's largest. The second is linear in the speed: 1 is the drive's, -1
    its `reverse_share`, backwards.
    """

    @property
    def space(self) -> gymnasium.spaces.Space[Any]:
        """See `ActionSet.space`."""
        return gymnasium.spaces.Box(-1.0, 1.0, (2,), np.float32)

    def read(self, given: object, target_bearing: Array, drive: DriveOptions) -> Commands:
        """See `ActionSet.read`."""
        try:
            numbers = np.asarray(given)
        except ValueError:  # of lists of several lengths
            numbers = np.empty(())
        right = numbers.shape == (len(target_bearing), 2) and numbers.dtype.kind in "fiu"
        if not right or not (np.abs(numbers) <= 1.0 + ROUNDING).all():  # NaN is not
            raise UserError(
                f"give {len(target_bearing)} pairs of numbers from -1 to 1, of heading change and speed, as actions, "
                f"not {given}"
            )
        turn, speed = np.clip(numbers.astype(np.float64), -1.0, 1.0).T
        turns, scales = LARGEST_TURN * turn, (speed + 1) / 2 * (1 + drive.reverse_share) - drive.reverse_share
        return Commands(nearest_manoeuvres(turns, scales, drive), turns, scales)


ACTION_SETS: dict[ActionsName, ActionSet] = {
    "turns": Discrete(len(paper.TURNS)),
    "six": Discrete(ACTIONS),
    "braking": Discrete(REVERSE),
    "manoeuvres": Discrete(MANOEUVRES),
    "continuous": Continuous(),
}
"""The sets of actions that an environment may offer, by name."""
