"""The vehicle's controller: how the decisions of an agent become wheel-speed commands."""

from nnql_bullet import paper
from nnql_bullet.config import options
from nnql_bullet.errors import UserError
from nnql_bullet.types import NonNegative, Positive

COMMAND_RATE = 120.0
"""Wheel-speed commands per second [Hz], in every simulator."""


@options
class DriveOptions:
    """How the agent's decisions reach the wheels."""

    decision_period: Positive = 0.5
    """From one decision to the next [s]. The paper's "one step" has no length; a kinematic study before this program
    got 97 % with 0.5 s and 55 % with 1.0 s at 10 % cover. A turn goes on over several decisions."""
    speed: Positive = paper.SPEED
    """Of the rear-axle centre, but where it is told to go slower [m/s]."""
    heading_gain: NonNegative = 4.0
    """Yaw rate per heading error [1/s]."""


def whole_steps(period: float, time_step: float) -> int:
    """How many physics steps make a control period.

    Raises:
        UserError: If it is not a whole number of at least one.
    """
    steps = round(period / time_step)
    if steps < 1 or abs(steps * time_step - period) > 1e-9:
        raise UserError(f"a control period of {period:g} s is not a whole number of physics steps of {time_step:g} s")
    return steps
