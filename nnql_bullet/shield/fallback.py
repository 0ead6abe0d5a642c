"""What a vehicle does when no action stays clear: it brakes, and once it stands it turns on the spot.

Where it cannot, or has turned all round in vain, it backs out the way it came until it can turn round.
"""

from dataclasses import dataclass, replace

import numpy as np

from nnql_bullet.agents.symmetry import LEFT_TURNS, RIGHT_TURNS
from nnql_bullet.env import STOP
from nnql_bullet.geometry import Array
from nnql_bullet.mapping.seen_space import RecentScans
from nnql_bullet.shield.prediction import Predictor, Situation

FULL_TURN = 14
"""Decisions to turn on the spot after which a vehicle has looked all round, and makes do with less clearance."""


@dataclass(frozen=True, slots=True)
class Spin:
    """How one vehicle turns on the spot."""

    side: int = 0
    """Side to which it turns: 1 left, -1 right, 0 while it does not turn on the spot."""
    decisions: int = 0
    """Decisions to turn on the spot since it last drove on."""
    backs: bool = False
    """Whether it backs out of where it can neither drive on nor turn round."""


def fallback(
    predictor: Predictor,
    situation: Situation,
    scans: RecentScans,
    ranks: Array,
    margin: float,
    spin: Spin,
    preferred_side: int,
    target_bearing: float,
) -> tuple[int, Spin]:
    """Brakes or turns one vehicle on the spot; beside a moving obstacle, what stays out of contact longest.

    A vehicle that slides when it turns on the spot has no tighter margin than the one it keeps elsewhere.

    Args:
        predictor: Predicts clearances.
        situation: Of this vehicle alone.
        scans: Its recent scans.
        ranks: How good each action is held to be (6,).
        margin: Clearance that it keeps if it can [m].
        spin: Its turning on the spot so far.
        preferred_side: Side to which it turns on the spot if it has none yet: 1 left, -1 right, 0 for none.
        target_bearing: Bearing of the target [rad].

    Returns:
        The manoeuvre, and the turning on the spot with it.
    """
    lengths = predictor.lengths
    tight = margin if predictor.slides else min(margin, lengths.tight_margin)
    stops = predictor.stop_clearances(situation)
    if situation.moving.any():
        courses = np.concatenate([predictor.drive_clearances(situation), stops])
        safe = np.concatenate([predictor.can_stop_after(situation, scans, manner, tight) for manner in (0, STOP)])
        safe[STOP:] |= not safe.any()
        return int(np.where(safe, course_scores(courses, lengths.margin), -1.0).argmax()), spin
    if situation.speed[0] >= lengths.standstill:
        order = np.argsort(np.abs(situation.turns[0]), kind="stable")
        enough = lengths.tight_margin if predictor.slides else lengths.margin  # sliding, it brakes best straight ahead
        scores = course_scores(stops, enough) + predictor.can_stop_after(situation, scans, STOP, tight)
        return STOP + int(order[scores[order].argmax()]), spin
    if spin.backs and not predictor.can_turn_round(situation):
        action = predictor.reverses(situation, scans, tight)
        if action >= 0:
            return action, spin
    side = spin.side or preferred_side or predictor.open_side(situation, target_bearing)
    spin = Spin(side, spin.decisions + 1)
    clearances = stops.min(axis=-1)
    turns = (*LEFT_TURNS, *RIGHT_TURNS) if side > 0 else (*RIGHT_TURNS, *LEFT_TURNS)
    possible = (turn for turn in turns if clearances[turn] >= tight)
    turn = next((turn for turn in possible if predictor.can_stop(situation, scans, STOP + turn, tight)), None)
    if turn is None or spin.decisions > FULL_TURN:
        for distance in (margin, margin / 2, tight):
            clear = predictor.stays_clear(situation, np.array([distance]), turns_round=False)[0]
            action = predictor.first_safe(situation, scans, ranks, clear, clear, tight)
            if action >= 0:
                return action, spin
        action = predictor.reverses(situation, scans, tight)
        if action >= 0:
            return action, Spin(side, backs=True)
    if turn is None:
        return STOP, spin
    return STOP + turn, replace(spin, side=1 if turn in LEFT_TURNS else -1)


def course_scores(clearances: Array, margin: float) -> Array:
    """Scores of courses with these clearances (m, k): the number of steps without contact, then the clearance (m,).

    The second part is less than 1, so that it decides only between courses with the same number of steps.
    """
    smallest = clearances.min(axis=-1)
    lasts = np.where(smallest > 0, clearances.shape[-1], (clearances <= 0).argmax(axis=-1))
    return np.asarray(lasts + np.minimum(smallest, min(margin, 0.99)))
