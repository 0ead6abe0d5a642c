"""Groups failed drives by features of their end, computed from recordings.

The group of a collision depends on the obstacle, the angle, and the turns before it; that of another failure on the
last minute of the drive. Groups describe observations, not causes.
"""

from dataclasses import dataclass
from math import acos, cos, pi, sin
from typing import Literal

import numpy as np

from nnql_bullet.geometry import Array, Circle, OrientedBox, Pose, Shape, as_rows, bearing, closest_points, moved
from nnql_bullet.recording import Recording
from nnql_bullet.vehicle.scale import length_scale
from nnql_bullet.worlds.spec import track_velocities

Group = Literal[
    "struck",
    "flank",
    "dithering",
    "head-on",
    "overturned",
    "stuck",
    "target circling",
    "circling",
    "trapped",
    "wandering",
]
GROUPS: dict[Group, str] = {
    "struck": "A moving box ran into the vehicle: most of the speed at which they met was the box's.",
    "flank": "It grazed something: with its side, or with a corner at a small angle.",
    "dithering": "It turned to one side, the other and back again, and so went straight on into what was ahead.",
    "head-on": "It ran into something ahead.",
    "overturned": "It tipped over, on its side, nose or roof.",
    "stuck": "It stayed about one place, turning or to and fro, until the episode was ended.",
    "target circling": "Time ran out near the target: round it, or past it again and again.",
    "circling": "Time ran out while it turned the same way, round after round.",
    "trapped": "Time ran out while it went, to and fro or in loops, where it had been before: it found no other way.",
    "wandering": "Time ran out on the way: it came to new places, but had not arrived.",
}
"""Description of each group. A failure belongs to the first group that fits."""

HEAD_ON = pi / 3
"""Largest angle between the heading and the normal into the touched surface in a head-on collision [rad]; at a larger
angle less than half of the speed is along the normal."""
STRUCK = 0.5
"""Smallest share of the closing speed from the box's own motion when a box struck the vehicle."""
HESITATION = 4.0
"""Time before a collision in which changes of side count [s]; the paper's vehicle can turn right round in it."""
SMALLEST_TURN = pi / 12
"""Smallest heading change that counts as a turn [rad]: half of the paper's smallest turn."""
REVERSALS = 2
"""Smallest number of changes of side in dithering: left, right, left."""
LAST_PART = 60.0
"""Length of the last part of a drive that ran out of time [s]; the paper's vehicle can cross its arena in it."""
NEAR_TARGET = 10.0
"""Largest distance from the target of a vehicle that circles it, for the shipped vehicle [m]: its sensor's range."""
ROUNDS = 2.0
"""Smallest number of full turns to one side, less those to the other, in the last part of circling."""
REVISITED = 0.75
"""Smallest share of the last part that a trapped vehicle spends at places where it was before."""
RETURN_AFTER = 10.0
"""Smallest time between two visits of a place [s]."""
SAME_PLACE = 1.0
"""Distance below which two places are the same, for the shipped vehicle [m]: about its length."""
_STRIDE = 6
"""Number of samples between those that are compared."""
_LEVEL = 0.01
"""Largest difference between distances along a normal of two corners that touch together [m]."""


@dataclass(frozen=True, slots=True)
class Contact:
    """The collision at the end of a drive."""

    touched: Literal["wall", "box", "moving box"]
    place: tuple[float, float]
    """x, y in the arena [m]."""
    bearing: float
    """Direction from the footprint's centre, in the vehicle frame [rad], positive to the left."""
    angle: float
    """Angle between the heading and the normal into the touched surface, at least 0 [rad]."""
    share: float
    """Share of the closing speed from the box's own motion; 1 if the vehicle did not move toward the box."""
    reversals: int
    """Number of changes of side of the commanded turns in the last `HESITATION`."""


@dataclass(frozen=True, slots=True)
class Timeout:
    """The last part of a drive that neither arrived nor collided, `LAST_PART` long."""

    ending: str
    """How it ended, one of `task.ENDINGS`."""
    extent: float
    """Longer side of the rectangle, parallel to the walls, around the path [m]."""
    rounds: float
    """Number of full turns to the left, less those to the right."""
    revisited: float
    """Share of the time at places where the vehicle was before."""
    farthest: float
    """Largest distance from the target [m]."""
    progress: float
    """Decrease of the distance to the target [m]."""
    scale: float = 1.0
    """Of the vehicle's lengths; see `vehicle.scale`."""


@dataclass(frozen=True, slots=True)
class Features:
    """Features of a failed drive."""

    time: float
    """Duration [s]."""
    target_distance: float
    """Distance to the target at the end [m]."""
    least_target_distance: float
    """Smallest distance to the target [m]."""
    end: Contact | Timeout


def features(recording: Recording) -> Features:
    """Computes the features of a recorded drive that did not end at the target."""
    away = np.hypot(*(recording.sample_pose[:, :2] - recording.world.target).T)
    return Features(
        time=float(recording.state_time[-1]),
        target_distance=float(away[-1]),
        least_target_distance=float(away.min()),
        end=_contact(recording) if recording.about["ending"] == "collision" else _timeout(recording, away),
    )


def group(features: Features) -> Group:
    """Finds the first of `GROUPS` that fits the features."""
    end = features.end
    return _group_of_contact(end) if isinstance(end, Contact) else _group_of_timeout(end)


def _group_of_contact(contact: Contact) -> Group:
    if contact.touched == "moving box" and contact.share >= STRUCK:
        return "struck"
    if contact.angle > HEAD_ON:
        return "flank"
    return "dithering" if contact.reversals >= REVERSALS else "head-on"


def _group_of_timeout(late: Timeout) -> Group:
    if late.ending == "overturned":
        return "overturned"
    if late.ending == "stuck":
        return "stuck"
    if late.farthest <= NEAR_TARGET * late.scale:
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


def _surface(footprint: OrientedBox, solid: Shape) -> tuple[float, Array]:
    """Finds the side across which a footprint and a solid are farthest apart (separating-axis theorem).

    Returns:
        Their distance along the normal of that side, negative where they overlap [m], and the normal (2,) from the
        footprint to the solid.
    """
    if isinstance(solid, Circle):
        x, y, _, _ = closest_points(as_rows([footprint])[0], as_rows([Circle(solid.x, solid.y, 0.0)])[0])
        normal = np.array([solid.x - x, solid.y - y])
        if (apart := float(np.hypot(*normal))) > 0.0:
            return apart - solid.radius, normal / apart
        box = OrientedBox(solid.x, solid.y, solid.radius, solid.radius, footprint.yaw)  # its centre is inside
    else:
        box = solid
    yaws = [yaw + quarter * pi / 2 for yaw in (footprint.yaw, box.yaw) for quarter in range(4)]
    normals = np.column_stack([np.cos(yaws), np.sin(yaws)])  # (8, 2)
    apart = (normals @ box.corners().T).min(axis=1) - (normals @ footprint.corners().T).max(axis=1)
    return float(apart.max()), normals[np.argmax(apart)]


def _place(footprint: OrientedBox, box: Shape, normal: Array) -> tuple[float, float]:
    """Finds x, y of the middle of the contact between a footprint and a box: a corner or a common piece of a side.

    It touches a circle at one point.
    """
    if isinstance(box, Circle):
        return box.x - box.radius * float(normal[0]), box.y - box.radius * float(normal[1])
    sideways = np.array([-normal[1], normal[0]])
    nearest = [_foremost(footprint.corners(), normal), _foremost(box.corners(), -normal)]
    ranges = np.array([[np.min(its @ sideways), np.max(its @ sideways)] for its in nearest])
    along, across = nearest[0][0] @ normal, (ranges[:, 0].max() + ranges[:, 1].min()) / 2
    x, y = along * normal + across * sideways
    return float(x), float(y)


def _foremost(corners: Array, direction: Array) -> Array:
    """Selects the one or two of four corners (4, 2) that are farthest in a direction (2,)."""
    far = corners @ direction
    return np.asarray(corners[far >= far.max() - _LEVEL])


def _last_speed(recording: Recording) -> float:
    """Computes the mean speed in the last step [m/s]."""
    begin, end = recording.state_time[-2:]
    return float(np.hypot(*(recording.state_pose[-1, :2] - recording.state_pose[-2, :2])) / (end - begin))


def _reversals(commands: Array) -> int:
    """Counts the changes of side in heading changes (n,) [rad]."""
    sides = np.sign(commands[np.abs(commands) >= SMALLEST_TURN])
    return int(np.count_nonzero(np.diff(sides)))


def _timeout(recording: Recording, away: Array) -> Timeout:
    late = recording.sample_time >= recording.sample_time[-1] - LAST_PART
    x, y, yaw = recording.sample_pose[late].T
    turned = np.unwrap(yaw)
    return Timeout(
        ending=recording.about["ending"],
        extent=float(max(np.ptp(x), np.ptp(y))),
        rounds=float(turned[-1] - turned[0]) / (2 * pi),
        revisited=_revisited(recording),
        farthest=float(away[late].max()),
        progress=float(away[late][0] - away[-1]),
        scale=length_scale(recording.footprint),
    )


def _revisited(recording: Recording) -> float:
    times, places = recording.sample_time[::_STRIDE], recording.sample_pose[::_STRIDE, :2]
    late = times >= recording.sample_time[-1] - LAST_PART
    earlier = times <= times[late, None] - RETURN_AFTER  # (late, all)
    apart = np.hypot(*(places[late, None] - places).transpose(2, 0, 1))
    return float(np.mean(np.any(earlier & (apart < SAME_PLACE * length_scale(recording.footprint)), axis=1)))
