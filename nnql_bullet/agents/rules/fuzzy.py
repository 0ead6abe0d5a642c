"""A fuzzy rule base for the turn, one of the alternatives that the paper names. It needs scikit-fuzzy.

The inference is that of Mamdani and Assilian, "An experiment in linguistic synthesis with a fuzzy logic controller"
(Int. J. Man-Machine Studies 7(1), 1975), made crisp by the centroid.
"""

from functools import reduce
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field

from nnql_bullet import paper
from nnql_bullet.agents.base import Rule
from nnql_bullet.agents.turns import nearest_actions
from nnql_bullet.config import options
from nnql_bullet.env import Observation
from nnql_bullet.errors import missing_library
from nnql_bullet.geometry import Array
from nnql_bullet.rollout import Actions
from nnql_bullet.sensing import FRONT, FRONT_LEFT, FRONT_RIGHT
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.scale import length_scale
from nnql_bullet.vehicle.spec import VehicleSpec

Reading = Annotated[float, Field(ge=0, le=paper.SENSOR_RANGE)]

VARIABLES = ("front", "side", "freer", "target")
"""The front reading; the smaller one of the two front sides; which front side is freer; where the target is."""
RULE_BASE = (
    (("far", "far", None, "left"), "hard left"),
    (("far", "far", None, "ahead"), "straight"),
    (("far", "far", None, "right"), "hard right"),
    (("near", None, "left", None), "left"),
    (("near", None, "right", None), "right"),
    (("near", None, "neither", "left"), "left"),
    (("near", None, "neither", "ahead"), "left"),
    (("near", None, "neither", "right"), "right"),
    (("far", "near", "left", None), "left"),
    (("far", "near", "right", None), "right"),
    (("far", "near", "neither", None), "straight"),
)
"""If these are the terms of `VARIABLES` (None: any), then this is the turn."""
TURNS_DEGREES = {"hard right": -60.0, "right": -30.0, "straight": 0.0, "left": 30.0, "hard left": 60.0}
"""Where each term of the turn is true in full. It is a triangle that ends 30 degrees to either side."""
UNIVERSE_DEGREES = np.arange(-90.0, 91.0, 3.0)
"""Turns that the centroid is taken over."""


@options
class FuzzyOptions:
    """Options of the terms: where each begins to hold, and where it holds in full."""

    kind: Literal["fuzzy"] = "fuzzy"
    front_near: Reading = 5.0
    """Reading up to which the front is near in full [m]."""
    front_far: Reading = 7.0
    """Reading from which the front is far in full [m]."""
    side_near: Reading = 1.0
    """Reading up to which a front side is near in full [m]."""
    side_far: Reading = 5.0
    """Reading from which a front side is far in full [m]."""
    freer_by: Annotated[float, Field(gt=0, le=paper.SENSOR_RANGE)] = 0.1
    """Difference of the front sides' readings from which one is freer in full [m]; the target decides a tie."""
    aside_degrees: Annotated[float, Field(gt=0, le=180)] = 40.0
    """Bearing of the target from which it is left or right in full [degrees]."""

    def __post_init__(self) -> None:
        """Refuses a near that is farther than far."""
        for name, near, far in (
            ("front", self.front_near, self.front_far),
            ("side", self.side_near, self.side_far),
        ):
            if near > far:
                raise ValueError(f"{name}_near {near:g} is above {name}_far {far:g}; swap them")

    def make_agent(self, seed: int, vehicle: VehicleSpec, drive: DriveOptions) -> "Fuzzy":
        """Builds the agent."""
        return Fuzzy(self, length_scale(vehicle.footprint))


class Fuzzy(Rule):
    """The centroid of the turns that the rules speak for; the action nearest to it is taken.

    It sees the three front ones of the eight readings and the target's bearing, and remembers nothing.
    """

    def __init__(self, options: FuzzyOptions, scale: float) -> None:
        """Sets up the terms.

        Args:
            options: Of the terms.
            scale: Of the vehicle's lengths; see `vehicle.scale`.

        Raises:
            UserError: If scikit-fuzzy is not installed.
        """
        try:
            import skfuzzy
        except ImportError:
            raise missing_library("scikit-fuzzy", "baselines") from None
        self.options = options
        self._scale = scale
        self._fuzz: Any = skfuzzy
        self._turns = {
            name: skfuzzy.trimf(UNIVERSE_DEGREES, [centre - 30.0, centre, centre + 30.0])
            for name, centre in TURNS_DEGREES.items()
        }

    def decide(self, observations: Observation) -> Actions:
        """What the rule base says."""
        readings = observations.readings / self._scale
        wanted = np.radians(self.turns_degrees(readings, observations.target_bearing))
        return nearest_actions(wanted, observations.target_bearing)

    def turns_degrees(self, readings: Array, target_bearing: Array) -> Array:
        """Crisp turns (n,) [degrees] for readings (n, 8) [m] and bearings of the target (n,) [rad]."""
        terms = self._memberships(readings, target_bearing)
        truth = np.zeros((len(readings), len(UNIVERSE_DEGREES)))
        for antecedent, turn in RULE_BASE:
            holding = [terms[variable][term] for variable, term in zip(VARIABLES, antecedent, strict=True) if term]
            fires = reduce(np.fmin, holding)
            truth = np.fmax(truth, np.fmin(fires[:, None], self._turns[turn]))
        universe = UNIVERSE_DEGREES.tolist()  # the centroid is a loop, three times as fast over plain numbers
        return np.array([self._fuzz.centroid(universe, row) for row in truth.tolist()])

    def _memberships(self, readings: Array, target_bearing: Array) -> dict[str, dict[str, Array]]:
        """How true each term of each of `VARIABLES` is, each (n,)."""
        o, fuzz = self.options, self._fuzz
        readings = np.minimum(readings, paper.SENSOR_RANGE)  # beyond it no term holds
        left, right = readings[:, FRONT_LEFT], readings[:, FRONT_RIGHT]
        more, bearing = left - right, np.degrees(target_bearing)
        near = fuzz.trapmf(readings[:, FRONT], [0.0, 0.0, o.front_near, o.front_far])
        beside = fuzz.trapmf(np.minimum(left, right), [0.0, 0.0, o.side_near, o.side_far])
        return {
            "front": {"near": near, "far": fuzz.fuzzy_not(near)},
            "side": {"near": beside, "far": fuzz.fuzzy_not(beside)},
            "freer": self._sides(more, o.freer_by, paper.SENSOR_RANGE, "neither"),
            "target": self._sides(bearing, o.aside_degrees, 180.0, "ahead"),
        }

    def _sides(self, values: Array, full: float, end: float, between: str) -> dict[str, Array]:
        """Left and right in full from `full` to `end` to either side, and what is between them."""
        return {
            "left": self._fuzz.trapmf(values, [0.0, full, end, end]),
            between: self._fuzz.trimf(values, [-full, 0.0, full]),
            "right": self._fuzz.trapmf(values, [-end, -end, -full, 0.0]),
        }
