"""How a drive failed, as far as its recording shows: features of its end, and the one group that they put it in.

Collisions are told apart by what was touched, at what angle, and how the vehicle came there; drives that ran out of
time by how they spent their last minute. Groups describe what is seen; they are not causes.
"""

from dataclasses import dataclass
from math import acos, cos, pi, sin
from typing import Literal

import numpy as np

from nnql_bullet.geometry import Array, OrientedBox, Pose, bearing, moved
from nnql_bullet.recording import Recording
from nnql_bullet.worlds.spec import track_velocities

Group = Literal["struck", "flank", "dithering", "head-on", "target circling", "circling", "trapped", "wandering"]
GROUPS: dict[Group, str] = {
    "struck": "A moving box ran into the vehicle: most of the speed at which they met was the box's.",
    "flank": "It grazed something: with its side, or with a corner at a small angle.",
    "dithering": "It turned to one side, the other and back again, and so went straight on into what was ahead.",
    "head-on": "It ran into something ahead.",
    "target circling": "Time ran out near the target: round it, or past it again and again.",
    "circling": "Time ran out while it turned the same way, round after round.",
    "trapped": "Time ran out while it went, to and fro or in loops, where it had been before: it found no other way.",
    "wandering": "Time ran out on the way: it came to new places, but had not arrived.",
}
"""What each shows, in the order of the rules: a failure belongs to the first that fits."""

HEAD_ON = pi / 3
"""Largest angle from the heading to the way straight through what was touched, for it to be ahead [rad]: beyond it less
than half of the speed goes into the surface."""
STRUCK = 0.5
"""Least share of the speed at which vehicle and box meet that is the box's own, if it struck the vehicle."""
HESITATION = 4.0
"""Turns to and fro count so long before a collision [s]: time in which the paper's vehicle drives 8 m, and could have
turned right round."""
TURN = pi / 12
"""A smaller change of heading is no turn to a side [rad]: half of the smallest of the paper's."""
REVERSALS = 2
"""Changes of side that make dithering: left, right, left."""
LATE = 60.0
"""The end of a drive that ran out of time [s], in which the paper's vehicle could drive across its arena."""
NEAR_TARGET = 10.0
"""Who circles the target goes no farther from it [m]: as far as the sensors reach."""
ROUNDS = 2.0
"""Full turns to one side, less those to the other, in the last minute of a drive that circles: at the paper's speed
round something up to 19 m across, or on the spot up to 15 times."""
REVISITED = 0.75
"""Least share of the last minute that a trapped drive spends where it has been before."""
RETURN = 10.0
"""It has been somewhere before if it went on from there for so long before it came back [s]; the paper's vehicle needs
4 s to turn round on the spot."""
SAME = 1.0
"""Places closer than this are the same [m]: about the vehicle's length."""
_EVERY = 6
"""Of this many samples one is compared with others: five a second, 0.4 m apart at the paper's speed."""
_FLAT = 0.01
"""Corners that are level within this touch together [m]."""


@dataclass(frozen=True, slots=True)
class Contact:
    """What a drive that collided ended at."""

    touched: Literal["wall", "box", "moving box"]
    place: tuple[float, float]
    """Where, in the arena [m]."""
    bearing: float
    """Where on the footprint, seen from its middle, in the frame of the vehicle [rad], positive to the left."""
    angle: float
    """From the heading to the way straight through the surface that was touched, at least 0 [rad]."""
    share: float
    """Of the speed at which they met, what was the box's own; 1 where the vehicle did not come nearer by itself."""
    reversals: int
    """How often the turns asked for changed sides in the last `HESITATION`."""


@dataclass(frozen=True, slots=True)
class Lateness:
    """How a drive that ran out of time spent the last `LATE` of it."""

    extent: float
    """The longer side of the part of the arena that it stayed in, along the walls [m]."""
    rounds: float
    """Full turns to the left, less those to the right."""
    revisited: float
    """Share of it spent where it had been before."""
    farthest: float
    """From the target [m]."""
    progress: float
    """How much nearer to the target it was at the end than a `LATE` before [m]."""


@dataclass(frozen=True, slots=True)
class Features:
    """What a recording shows of a failure."""

    time: float
    """When it ended [s]."""
    target_distance: float
    """At the end [m]."""
    least_target_distance: float
    """Ever [m]."""
    end: Contact | Lateness
    """Of a collision, or of a drive that ran out of time."""


def features(recording: Recording) -> Features:
    """Of a drive that collided or ran out of time."""
    away = np.hypot(*(recording.sample_pose[:, :2] - recording.world.target).T)
    return Features(
        time=float(recording.state_time[-1]),
        target_distance=float(away[-1]),
        least_target_distance=float(away.min()),
        end=_contact(recording) if recording.about["ending"] == "collision" else _lateness(recording, away),
    )


def group(features: Features) -> Group:
    """The first of `GROUPS` that fits."""
    end = features.end
    return _group_of_contact(end) if isinstance(end, Contact) else _group_of_lateness(end)


def _group_of_contact(contact: Contact) -> Group:
    if contact.touched == "moving box" and contact.share >= STRUCK:
        return "struck"
    if contact.angle > HEAD_ON:
        return "flank"
    return "dithering" if contact.reversals >= REVERSALS else "head-on"


def _group_of_lateness(late: Lateness) -> Group:
    if late.farthest <= NEAR_TARGET:
        return "target circling"
    if abs(late.rounds) >= ROUNDS:
        return "circling"
    return "trapped" if late.revisited >= REVISITED else "wandering"


def _contact(recording: Recording) -> Contact:
    end, pose = float(recording.state_time[-1]), Pose(*recording.state_pose[-1])
    footprint, walls, patrols = moved(recording.footprint, pose), recording.world.walls, recording.patrols
    solids = (*walls, *recording.boxes_at(end))
    surfaces = [_surface(footprint, box) for box in solids]
    touched = int(np.argmin([apart for apart, _ in surfaces]))
    normal, mover = surfaces[touched][1], touched - (len(solids) - len(patrols))
    x, y = _place(footprint, solids[touched], normal)
    angle = acos(np.clip(normal @ (cos(pose.yaw), sin(pose.yaw)), -1.0, 1.0))
    share = 0.0
    if mover >= 0:
        velocity = track_velocities(np.array([patrols[mover].track]), end)[0]
        its, own = max(-float(velocity @ normal), 0.0), max(_last_speed(recording) * cos(angle), 0.0)
        share = its / (its + own) if its > 0.0 else 0.0
    return Contact(
        touched="wall" if touched < len(walls) else "moving box" if mover >= 0 else "box",
        place=(x, y),
        bearing=bearing(Pose(footprint.x, footprint.y, pose.yaw), x, y),
        angle=angle,
        share=share,
        reversals=_reversals(recording.heading_command[recording.state_time[:-1] >= end - HESITATION]),
    )


def _surface(footprint: OrientedBox, box: OrientedBox) -> tuple[float, Array]:
    """The side through which a footprint and a box come least into each other (separating-axis theorem).

    Returns:
        How far they are apart that way, negative where they overlap [m], and the direction (2,) from the footprint to
        the box across that side.
    """
    yaws = [yaw + quarter * pi / 2 for yaw in (footprint.yaw, box.yaw) for quarter in range(4)]
    ways = np.column_stack([np.cos(yaws), np.sin(yaws)])  # (8, 2)
    apart = (ways @ box.corners().T).min(axis=1) - (ways @ footprint.corners().T).max(axis=1)
    return float(apart.max()), ways[np.argmax(apart)]


def _place(footprint: OrientedBox, box: OrientedBox, normal: Array) -> tuple[float, float]:
    """The middle of where a footprint and a box touch across a side: a corner, or what two sides share."""
    sideways = np.array([-normal[1], normal[0]])
    nearest = [_foremost(footprint.corners(), normal), _foremost(box.corners(), -normal)]
    ranges = np.array([[np.min(its @ sideways), np.max(its @ sideways)] for its in nearest])
    along, across = nearest[0][0] @ normal, (ranges[:, 0].max() + ranges[:, 1].min()) / 2
    x, y = along * normal + across * sideways
    return float(x), float(y)


def _foremost(corners: Array, way: Array) -> Array:
    """Those of some corners (4, 2) that are farthest in a direction: one, or two of a side that lies across."""
    far = corners @ way
    return np.asarray(corners[far >= far.max() - _FLAT])


def _last_speed(recording: Recording) -> float:
    """In the last step [m/s]."""
    begin, end = recording.state_time[-2:]
    return float(np.hypot(*(recording.state_pose[-1, :2] - recording.state_pose[-2, :2])) / (end - begin))


def _reversals(commands: Array) -> int:
    """How often turns (n,) [rad] change sides."""
    sides = np.sign(commands[np.abs(commands) >= TURN])
    return int(np.count_nonzero(np.diff(sides)))


def _lateness(recording: Recording, away: Array) -> Lateness:
    late = recording.sample_time >= recording.sample_time[-1] - LATE
    x, y, yaw = recording.sample_pose[late].T
    turned = np.unwrap(yaw)
    return Lateness(
        extent=float(max(np.ptp(x), np.ptp(y))),
        rounds=float(turned[-1] - turned[0]) / (2 * pi),
        revisited=_revisited(recording),
        farthest=float(away[late].max()),
        progress=float(away[late][0] - away[-1]),
    )


def _revisited(recording: Recording) -> float:
    times, places = recording.sample_time[::_EVERY], recording.sample_pose[::_EVERY, :2]
    late = times >= recording.sample_time[-1] - LATE
    earlier = times <= times[late, None] - RETURN  # (late, all)
    apart = np.hypot(*(places[late, None] - places).transpose(2, 0, 1))
    return float(np.mean(np.any(earlier & (apart < SAME), axis=1)))
