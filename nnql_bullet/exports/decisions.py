"""Whole decisions of exported policies, in the part of Python that `translation` writes as other languages."""

from typing import NamedTuple

import numpy as np

from nnql_bullet import paper
from nnql_bullet.agents.learning.genetic import GeneticOptions
from nnql_bullet.agents.learning.options import NnqlOptions
from nnql_bullet.agents.rules.straight import StraightOptions
from nnql_bullet.env import ACTIONS, FARTHEST, LARGEST_TURN, MOST_YAW_RATE, REVERSE, SLOW, STOP, TOWARD_TARGET
from nnql_bullet.errors import UserError
from nnql_bullet.experiment import Experiment
from nnql_bullet.exports.contract import STATUSES, STOPPED, WIDEST_BEARING, encoding_of
from nnql_bullet.geometry import Array
from nnql_bullet.shield.alone import choose
from nnql_bullet.shield.perception import perceive
from nnql_bullet.shield.setting import FASTEST, Memory, Setting
from nnql_bullet.vehicle.scale import length_scale

OK, BAD_DISTANCE, BAD_TARGET_DISTANCE, BAD_TARGET_BEARING, BAD_YAW_RATE = range(len(STATUSES))
BAD_SPEED = len(STATUSES)
MOST = 1e30
"""Reading of a ray from which on none is taken [m]."""


class Brain(NamedTuple):
    """An agent that chooses one of the paper's turns in states that are not safe, and toward the target in others."""

    range: float
    """What a ray reads that meets nothing [m]."""
    thresholds: Array
    """Of the safe state (8,) [m]."""
    w1: Array
    """Of the paper's network (hidden, 8); with `b1`, `w2` and `b2` empty for an agent that drives straight."""
    b1: Array
    w2: Array
    b2: Array
    full_scale: float
    """Reading that counts as nothing near [m]."""
    proximity: bool
    """Whether the network is given how near things are; else how far."""


def brain_of(experiment: Experiment, name: str, form: str) -> Brain:
    """The agent of an experiment.

    Args:
        experiment: Whose agent it is.
        name: Of the policy, for the message.
        form: What it is written in, for the message.

    Raises:
        UserError: If it is of another kind.
    """
    options, nothing = experiment.config.agent, np.empty((0, 0))
    network = isinstance(options, (NnqlOptions, GeneticOptions))
    if not network and not isinstance(options, StraightOptions):
        kinds = ", ".join(kind.kind for kind in (NnqlOptions, GeneticOptions, StraightOptions))
        raise UserError(f"{name}: a policy of kind '{options.kind}' cannot be written in {form}; these can: {kinds}")
    w1, b1, w2, b2 = nothing, nothing, nothing, nothing
    if network:
        learned = experiment.trainable.state_dict()
        w1, b1, w2, b2 = (
            np.asarray(learned[part], np.float64) for part in ("0.weight", "0.bias", "2.weight", "2.bias")
        )
    return Brain(
        experiment.vehicle.sensor.range,
        np.broadcast_to(np.asarray(experiment.task.thresholds, np.float64), (paper.SECTORS,)).copy(),
        w1,
        b1,
        w2,
        b2,
        full_scale=paper.SENSOR_RANGE * length_scale(experiment.vehicle.footprint),
        proximity=isinstance(options, (NnqlOptions, GeneticOptions)) and encoding_of(options) == "proximity",
    )


def decide(
    b: Brain, distances: Array, target_distance: float, target_bearing: float, yaw_rate: float, values: Array
) -> tuple[int, int, float, float, bool]:
    """Decides once by the readings of the sectors; on bad input it stops, and the status says what is bad.

    Args:
        b: The agent.
        distances: Readings (8,) [m]; those beyond the range are changed to it.
        target_distance: [m]
        target_bearing: [rad]
        yaw_rate: [rad/s]
        values: Room for the Q-values of the turns (5,).

    Returns:
        Status, action, heading change [rad], share of the drive's speed, and whether the state is safe.
    """
    for a in range(len(paper.TURNS)):
        values[a] = 0.0
    status = checked(distances, target_distance, target_bearing, yaw_rate, MOST_YAW_RATE)
    if status != OK:
        return status, STOPPED, 0.0, 0.0, False
    for k in range(len(distances)):
        distances[k] = min(distances[k], b.range)
    safe, action = wanted(b, distances, values)
    return status, action, turn_of(action, target_bearing), 1.0, safe


def decide_shielded(
    b: Brain,
    p: Setting,
    m: Memory,
    distances: Array,
    target_distance: float,
    target_bearing: float,
    yaw_rate: float,
    speed: float,
) -> tuple[int, int, float, float, bool]:
    """Decides once in the shield by the rays; on bad input it stops, and the memory is as it was.

    Args:
        b: The agent.
        p: The shield.
        m: Its memory.
        distances: Of the rays (rays,) [m]; they may be changed.
        target_distance: Of the target, which stays [m].
        target_bearing: [rad]
        yaw_rate: [rad/s]
        speed: Measured speed, negative backwards [m/s].

    Returns:
        Status, manoeuvre, heading change [rad], share of the drive's speed, and whether the shield overrode the agent.
    """
    status = checked(distances, target_distance, target_bearing, yaw_rate, p.most_yaw_rate)
    if status == OK and not (speed >= -FASTEST * p.speed and speed <= FASTEST * p.speed):
        status = BAD_SPEED
    if status != OK:
        return status, STOPPED, 0.0, 0.0, False
    for k in range(len(distances)):
        distances[k] = min(distances[k], p.range)
    readings, values = np.empty(paper.SECTORS), np.empty(len(paper.TURNS))
    perceive(p, m, distances, target_distance, target_bearing, speed, readings)
    safe, action = wanted(b, readings, values)
    valued = not safe and len(b.b1) > 0
    chosen = choose(p, m, values, valued, action, target_bearing, yaw_rate, speed)
    return status, chosen, turn_of(chosen, target_bearing), share_of(p, chosen), chosen != action


def checked(
    distances: Array, target_distance: float, target_bearing: float, yaw_rate: float, most_yaw_rate: float
) -> int:
    """The status of an input."""
    status = OK
    for k in range(len(distances)):
        if not (distances[k] >= 0.0 and distances[k] <= MOST):
            status = BAD_DISTANCE
    if status != OK:
        return status
    if not (target_distance >= 0.0 and target_distance <= FARTHEST):
        return BAD_TARGET_DISTANCE
    if not (target_bearing >= -WIDEST_BEARING and target_bearing <= WIDEST_BEARING):
        return BAD_TARGET_BEARING
    if not (yaw_rate >= -most_yaw_rate and yaw_rate <= most_yaw_rate):
        return BAD_YAW_RATE
    return OK


def wanted(b: Brain, readings: Array, values: Array) -> tuple[bool, int]:
    """Whether the state is safe, and the action that the agent wants; the Q-values of the turns go into `values`."""
    safe = True
    for k in range(paper.SECTORS):
        if readings[k] < b.thresholds[k]:
            safe = False
    action = TOWARD_TARGET
    if len(b.b1) > 0:
        value(b, readings, values)
        if not safe:
            action = largest(values)
    return safe, action


def value(b: Brain, readings: Array, values: Array) -> None:
    """Q-values of the turns: a network with a layer of sigmoid units."""
    inputs, hidden = np.empty(paper.SECTORS), np.empty(len(b.b1))
    for k in range(paper.SECTORS):
        if b.proximity:
            inputs[k] = 1.0 - min(readings[k], b.full_scale) / b.full_scale
        else:
            inputs[k] = readings[k] / b.full_scale if readings[k] < b.full_scale else 0.0
    for j in range(len(b.b1)):
        total = b.b1[j]
        for k in range(paper.SECTORS):
            total += b.w1[j, k] * inputs[k]
        hidden[j] = 1.0 / (1.0 + np.exp(-total))
    for j in range(len(paper.TURNS)):
        total = b.b2[j]
        for k in range(len(b.b1)):
            total += b.w2[j, k] * hidden[k]
        values[j] = total


def largest(values: Array) -> int:
    """The turn with the largest value; of equal ones the first."""
    best = 0
    for a in range(1, len(paper.TURNS)):
        if values[a] > values[best]:
            best = a
    return best


def turn_of(manoeuvre: int, target_bearing: float) -> float:
    """The heading change of a manoeuvre [rad]."""
    action = manoeuvre % ACTIONS
    if action == TOWARD_TARGET:
        return min(max(target_bearing, -LARGEST_TURN), LARGEST_TURN)
    return paper.TURNS[action]


def share_of(p: Setting, manoeuvre: int) -> float:
    """The speed of a manoeuvre as a share of the drive's, negative backwards."""
    if manoeuvre < STOP:
        return 1.0
    if manoeuvre < REVERSE:
        return 0.0
    return -p.reverse_share if manoeuvre < SLOW else p.reverse_share
