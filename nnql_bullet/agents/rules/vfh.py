"""The vector field histogram VFH+, over the last scan alone: a ray's end is an occupied cell, and there is no map grid.

Ulrich and Borenstein, "VFH+: Reliable Obstacle Avoidance for Fast Mobile Robots" (IEEE ICRA 1998). As in the article,
the directions of histograms do not turn with the vehicle: they are those of the frame that it starts in.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import ceil, cos, floor, hypot, pi, radians, sin
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from nnql_bullet import paper
from nnql_bullet.agents.base import NoValues
from nnql_bullet.agents.turns import nearest_actions
from nnql_bullet.config import options
from nnql_bullet.env import Observation, heading_change
from nnql_bullet.geometry import Array, OrientedBox, wrap_angle, wrap_angles
from nnql_bullet.jit import njit
from nnql_bullet.mapping.point_cloud import seen_distances
from nnql_bullet.rollout import Actions
from nnql_bullet.sensing import RAYS
from nnql_bullet.types import NonNegative, Reach
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.profiles import turn_headings
from nnql_bullet.vehicle.scale import length_scale
from nnql_bullet.vehicle.spec import VehicleSpec

Blocked = NDArray[np.bool_]

BINS = 72
"""Number of bins of a histogram, 5 degrees each as in the article. Bin k is centred on the direction 5 k degrees."""
BIN = 2 * pi / BINS


@options
class VfhOptions:
    """The article's parameters."""

    kind: Literal["vfh"] = "vfh"
    window: Annotated[float, Field(gt=0, le=paper.SENSOR_RANGE)] = 8.0
    """Radius of the active window [m]. Points farther off do not count."""
    safety_distance: Reach = 0.2
    """d_s, clearance of the circle that holds the footprint [m]."""
    low_threshold: NonNegative = 2.0
    """tau_low, obstacle density below which a direction becomes free. A point at the window's edge counts 1, one at the
    distance d [m] 1 + window^2 - d^2, where there are 72 rays; of more rays each counts less."""
    high_threshold: NonNegative = 5.0
    """tau_high, obstacle density above which a direction becomes blocked; in between it stays as it was."""
    wide_degrees: Annotated[float, Field(gt=0, le=180)] = 40.0
    """s_max, width from which an opening is a wide valley [degrees]. A wide valley is entered half of this from its
    border."""
    target_weight: NonNegative = 5.0
    """mu_1, weight of the difference from the target's direction."""
    heading_weight: NonNegative = 3.0
    """mu_2, weight of the difference from the present heading."""
    previous_weight: NonNegative = 3.0
    """mu_3, weight of the difference from the direction chosen before. In the article mu_1 exceeds mu_2 + mu_3."""

    def __post_init__(self) -> None:
        """Refuses thresholds in the wrong order."""
        if self.low_threshold > self.high_threshold:
            raise ValueError(
                f"low_threshold {self.low_threshold:g} is above high_threshold {self.high_threshold:g}; swap them"
            )

    def make_agent(self, seed: int, vehicle: VehicleSpec, drive: DriveOptions) -> "Vfh":
        """Builds the agent."""
        return Vfh(self, vehicle, drive)


@dataclass(frozen=True, slots=True)
class LastDecision:
    """The last decision for n vehicles."""

    observations: Observation
    headings: Array
    """Headings at that time (n,) [rad]."""
    chosen: Array
    """Directions chosen (n,) [rad]."""
    actions: Actions
    """(n,)"""


@dataclass(frozen=True, slots=True)
class VfhState:
    """Memory of n vehicles. Directions are those of the frame that each vehicle starts in."""

    headings: Array
    """Headings at the next decision, by dead reckoning (n,) [rad]."""
    chosen: Array
    """Directions of the last actions (n,) [rad]."""
    blocked: Blocked
    """Binary histograms (n, 72)."""
    last: LastDecision | None = None
    """None before the first."""


class Vfh(NoValues):
    """Finds the direction of least cost among the openings, and takes the action nearest to it.

    It sees the rays, the yaw rate and the target's bearing, and knows the circle around the sensor that holds the
    footprint, and the tightest turn. It remembers of a drive the direction that it chose last, which directions were
    blocked, and how far it has turned, reckoned by the drive's own profile.

    The article's robot stops where all directions are blocked. This vehicle cannot: it heads for the direction ahead
    with the smallest obstacle density.
    """

    def __init__(self, options: VfhOptions, vehicle: VehicleSpec, drive: DriveOptions) -> None:
        self.options = options
        self._limits = vehicle.limits
        self._period = np.array([drive.decision_period])
        self._scale = length_scale(vehicle.footprint)
        self._turning_radius = drive.speed / vehicle.limits.yaw_rate / self._scale
        self._sensor = vehicle.sensor
        ahead, left, _ = vehicle.sensor.position
        self._centre = ahead / self._scale, left / self._scale
        self._radius = _radius_about((ahead, left), vehicle.footprint) / self._scale + options.safety_distance
        self._bearings = wrap_angles(vehicle.sensor.angles)
        self._weights = np.array([options.target_weight, options.heading_weight, options.previous_weight])

    def initial_state(self, size: int) -> VfhState:
        """Returns a memory in which no direction is blocked and straight ahead was chosen last."""
        return VfhState(np.zeros(size), np.zeros(size), np.zeros((size, BINS), np.bool_))

    def reset(self, state: VfhState, world_seeds: Mapping[int, int]) -> VfhState:
        """Unblocks all directions of these vehicles; straight ahead counts as chosen last."""
        new = np.isin(np.arange(len(state.headings)), list(world_seeds))
        return replace(
            state,
            headings=np.where(new, 0.0, state.headings),
            chosen=np.where(new, 0.0, state.chosen),
            blocked=state.blocked & ~new[:, None],
        )

    def act(self, observations: Observation, state: VfhState) -> tuple[Actions, VfhState]:
        """Chooses the action nearest to the opening of least cost."""
        o, bearing, headings = self.options, observations.target_bearing, state.headings
        distances = seen_distances(observations.ray_distances, self._sensor) / self._scale
        density = primary_histograms(distances, headings[:, None] + self._bearings, o.window, self._radius)
        density *= RAYS / self._sensor.rays
        blocked = binary_histograms(density, state.blocked, o.low_threshold, o.high_threshold)
        limits = turning_limits(distances, self._bearings, o.window, self._radius, self._centre, self._turning_radius)
        masked = masked_histograms(blocked, headings, limits)
        chosen: Array = _chosen_directions(
            masked, density, headings, headings + bearing, state.chosen, radians(o.wide_degrees), self._weights
        )
        actions = nearest_actions(wrap_angles(chosen - headings), bearing)
        decision = LastDecision(observations, headings, chosen, actions)
        return actions, self._after(decision, actions, blocked)

    def override(self, state: VfhState, actions: Actions) -> VfhState:
        """Returns the state after these actions; where they differ, their directions count as chosen last."""
        return state if state.last is None else self._after(state.last, actions, state.blocked)

    def _after(self, last: LastDecision, actions: Actions, blocked: Blocked) -> VfhState:
        """Returns the state after a decision and the actions (n,) that were then carried out."""
        turns = heading_change(actions, last.observations.target_bearing)
        turned = turn_headings(last.observations.yaw_rate, turns, self._limits, self._period)
        chosen = np.where(actions == last.actions, last.chosen, last.headings + turns)
        return VfhState(last.headings + turned[:, 0], chosen, blocked, last)


def _radius_about(place: tuple[float, float], box: OrientedBox) -> float:
    """Radius of the circle around a place that holds a box [m]."""
    return float(np.hypot(*(box.corners() - place).T).max())


@njit()
def primary_histograms(distances: Array, bearings: Array, window: float, radius: float) -> Array:
    """Computes the primary polar histograms: obstacle density by direction (n, 72).

    An occupied cell at the distance d adds a - b d^2, where b is 1 / m2 and a such that it is 1 at the window's edge,
    to all directions within the enlargement angle arcsin(radius / d) of its own.

    Args:
        distances: Of the cells (n, m) [m]; NaN for none.
        bearings: Of the cells (n, m) [rad].
        window: Cells farther off add nothing [m].
        radius: What obstacles are enlarged by, the robot's radius and the safety distance [m].
    """
    density = np.zeros((len(distances), BINS))
    for i in range(len(distances)):
        for j in range(distances.shape[1]):
            distance, bearing = distances[i, j], bearings[i, j]
            if distance < window:
                enlargement = np.arcsin(radius / distance) if distance > radius else pi / 2
                first, last = ceil((bearing - enlargement) / BIN), floor((bearing + enlargement) / BIN)
                for k in range(first, last + 1):
                    density[i, k % BINS] += 1 + window * window - distance * distance
    return density


def binary_histograms(density: Array, before: Blocked, low: float, high: float) -> Blocked:
    """Whether each direction is blocked (n, 72); between the thresholds it stays as it was `before` (hysteresis)."""
    return np.where(density > high, True, np.where(density < low, False, before))


@njit()
def turning_limits(
    distances: Array,
    bearings: Array,
    window: float,
    radius: float,
    sensor: tuple[float, float],
    turning_radius: float,
) -> Array:
    """Computes how far to the right and left turns lead past the obstacles, from the present heading (n, 2) [rad].

    A cell on one side bars what lies beyond it if, enlarged, it meets the circle on which the sensor goes in the
    tightest turn to that side, or lies inside.

    Args:
        distances: Of the cells from the sensor (n, m) [m]; NaN for none.
        bearings: Of the cells in the vehicle frame (m,), in (-pi, pi] [rad].
        window: Cells farther off bar nothing [m].
        radius: What obstacles are enlarged by [m].
        sensor: In the vehicle frame [m].
        turning_radius: Of the tightest turn, of the axle's centre [m].
    """
    limits = np.empty((len(distances), 2))
    ahead, left = sensor
    right_reach = hypot(ahead, left + turning_radius) + radius
    left_reach = hypot(ahead, left - turning_radius) + radius
    for i in range(len(distances)):
        limits[i] = -pi, pi
        for j in range(len(bearings)):
            if distances[i, j] < window:
                x = ahead + distances[i, j] * cos(bearings[j])
                y = left + distances[i, j] * sin(bearings[j])
                if bearings[j] <= 0 and hypot(x, y + turning_radius) < right_reach:
                    limits[i, 0] = max(limits[i, 0], bearings[j])
                if bearings[j] >= 0 and hypot(x, y - turning_radius) < left_reach:
                    limits[i, 1] = min(limits[i, 1], bearings[j])
    return limits


def masked_histograms(blocked: Blocked, headings: Array, limits: Array) -> Blocked:
    """Which directions are blocked, or out of the reach of turns (n, 72).

    Args:
        blocked: The binary histograms (n, 72).
        headings: Of the vehicles (n,) [rad].
        limits: Of their turns, as `turning_limits` gives them (n, 2) [rad].
    """
    turns = wrap_angles(np.arange(BINS) * BIN - headings[:, None])
    return blocked | (turns < limits[:, :1]) | (turns > limits[:, 1:])


@njit()
def candidate_directions(masked: Blocked, target: float, wide: float) -> Array:
    """Lists the directions that lead through the openings of one masked histogram [rad].

    They are the middle of a narrow opening; of a wide one, what is half of `wide` from either border, and the target's
    direction if it lies in between. Without obstacles there is the target's direction alone, and without openings none.

    Args:
        masked: (72,)
        target: Its direction [rad].
        wide: From which angle on an opening is wide [rad].
    """
    start = np.argmax(masked)
    if not masked[start]:
        return np.array([target])
    candidates, count, right = np.empty(2 * BINS), 0, -1
    for k in range(start + 1, start + BINS + 1):
        if not masked[k % BINS]:
            right = k if right < 0 else right
        elif right >= 0:
            first, last = right * BIN, (k - 1) * BIN
            if last - first < wide:
                candidates[count] = (first + last) / 2
                count += 1
            else:
                first, last = first + wide / 2, last - wide / 2
                candidates[count], candidates[count + 1] = first, last
                count += 2
                inside = (target - first) % (2 * pi)
                if inside < last - first:
                    candidates[count] = first + inside
                    count += 1
            right = -1
    return candidates[:count]


@njit()
def _chosen_directions(
    masked: Blocked,
    density: Array,
    headings: Array,
    targets: Array,
    previous: Array,
    wide: float,
    weights: Array,
) -> Array:
    """The candidates of least cost (n,) [rad]; where there is none, the direction ahead of least density."""
    chosen = np.empty(len(masked))
    for i in range(len(masked)):
        least = np.inf
        for direction in candidate_directions(masked[i], targets[i], wide):
            cost = (
                weights[0] * abs(wrap_angle(direction - targets[i]))
                + weights[1] * abs(wrap_angle(direction - headings[i]))
                + weights[2] * abs(wrap_angle(direction - previous[i]))
            )
            if cost < least:
                least, chosen[i] = cost, direction
        if least == np.inf:
            chosen[i] = _least_dense_ahead(density[i], headings[i])
    return chosen


@njit()
def _least_dense_ahead(density: Array, heading: float) -> float:
    """The direction of least density within a right angle of the heading [rad]; of several the one nearest to it."""
    least, least_turn, best = np.inf, np.inf, heading
    for k in range(BINS):
        turn = abs(wrap_angle(k * BIN - heading))
        if turn <= pi / 2 and (density[k] < least or (density[k] == least and turn < least_turn)):
            least, least_turn, best = density[k], turn, k * BIN
    return best
