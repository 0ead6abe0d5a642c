"""Recovery of a vehicle that gets no nearer to its target: it is led the shortest way through what it has seen.

The lengths are those of the shipped vehicle (see `vehicle.scale`); another's are multiples of them. The way is that of
`mapping.way`; the vehicle learns it as it goes, from the decision on at which it began to be led.
"""

from dataclasses import dataclass, replace
from math import inf

from nnql_bullet.mapping.way import Surroundings

STUCK_AFTER = 12.0
"""Time without progress after which a vehicle is stuck [s]."""
PROGRESS = 0.5
"""Distance by which the vehicle has to be nearer to the target than ever before to make progress [m]."""
FIRST_GAIN, GAIN_GROWTH = 10.0, 4.0
"""How much nearer than ever a vehicle is led before its agent ranks actions again [m], and what that is multiplied by
with each further recovery: an agent that gets stuck again and again does not know the way."""


@dataclass(frozen=True, slots=True)
class Recovery:
    """One vehicle's progress, and its recovery."""

    closest: float = inf
    """Smallest distance to the target so far, in steps of `PROGRESS` [m]."""
    waited: float = 0.0
    """Time since then without a recovery [s]."""
    recoveries: int = 0
    """Recoveries so far."""
    led_until: float = inf
    """Distance to the target up to which the vehicle is led [m]; infinite before the first recovery."""
    surroundings: Surroundings | None = None
    """What the vehicle has seen since it is led; none while it is not."""

    def updated(self, distance: float, period: float, scale: float) -> "Recovery":
        """Returns progress and recovery at the next decision.

        Args:
            distance: Distance to the target [m].
            period: Time since the last decision [s].
            scale: Of lengths, see `lengths.Lengths`.
        """
        nearer = distance < self.closest - PROGRESS * scale
        closest = distance if nearer else self.closest
        waited = 0.0 if nearer or self.leads(distance) else self.waited + period
        if waited <= STUCK_AFTER:
            return replace(self, closest=closest, waited=waited)
        gain = FIRST_GAIN * scale * GAIN_GROWTH**self.recoveries
        return replace(self, closest=closest, waited=0.0, recoveries=self.recoveries + 1, led_until=closest - gain)

    def leads(self, distance: float) -> bool:
        """Whether the recovery, not the agent, leads the vehicle at a distance to the target [m]."""
        return self.recoveries > 0 and distance > self.led_until
