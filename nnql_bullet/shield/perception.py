"""The scan as a shield takes it: silent sensors completed, points of moving obstacles told apart, the past remembered.

The scan before judges both: a sensor that reads nothing against all evidence counts as dead (`sector_faults`), and a
point where nothing was seen before belongs to a moving obstacle. Points that stand still are remembered where the rays
miss them for a while, and whole scans for what they showed to be free (`seen_space`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.env import Observation
from nnql_bullet.geometry import Array
from nnql_bullet.mapping.localization import TargetFix, found_pose, seen_from
from nnql_bullet.mapping.point_cloud import moving_points, point_cloud
from nnql_bullet.mapping.sector_faults import ENOUGH, completed, contradictions, silent_sectors
from nnql_bullet.mapping.seen_space import RecentScans, missed, no_scans
from nnql_bullet.sensing import Sensor
from nnql_bullet.shield.lengths import Lengths
from nnql_bullet.task import StateProperty, TaskOptions, is_safe, readings_of

REMEMBERED = 20
"""Number of scans for which a point is remembered that their rays miss."""


@dataclass(frozen=True, slots=True)
class LastScan:
    """One vehicle's scan at its last decision, and what it remembers. The defaults are those without a scan."""

    points: Array = field(default_factory=lambda: np.full((1, 2), np.nan))
    """Points in the vehicle frame of then (rays, 2) [m]; NaN for none."""
    rays: Array = field(default_factory=lambda: np.full(paper.SECTORS, np.nan))
    """Ray distances (rays,) [m]; NaN where the sensor sees nothing."""
    target: TargetFix = field(default_factory=lambda: TargetFix(0.0, 0.0))
    """The landmark as seen then."""
    moved: Array = field(default_factory=lambda: np.zeros(3))
    """Predicted pose of now in the vehicle frame of then (3,)."""
    evidence: Array = field(default_factory=lambda: np.zeros(paper.SECTORS))
    """Contradictions against each sensor since it last read something (8,)."""
    standing: Array = field(default_factory=lambda: np.empty((0, 3)))
    """Points that stand still: x, y in the vehicle frame of then [m], and the number of scans since they were seen
    (k, 3)."""
    recent: RecentScans = field(default_factory=no_scans)
    """That scan and those before."""

    @property
    def dead(self) -> NDArray[np.bool_]:
        """Whether each sensor counts as dead (8,)."""
        return np.asarray(self.evidence >= ENOUGH)


@dataclass(frozen=True, slots=True)
class Perception:
    """What a shield knows of the surroundings of n vehicles."""

    observation: Observation
    """With dead sensors completed."""
    points: Array
    """Points of obstacles in the vehicle frame, seen or remembered (n, m, 2) [m]; NaN for none."""
    moving: NDArray[np.bool_]
    """Whether they belong to moving obstacles (n, m)."""
    moved: Array
    """Present poses in the vehicle frames of the decisions before (n, 3)."""
    scans: list[LastScan]
    """The scans for the next decision."""


def perceived(
    o: Observation,
    last: Sequence[LastScan],
    standing: Sequence[bool],
    sensor: Sensor,
    lengths: Lengths,
    task: TaskOptions,
) -> Perception:
    """Completes the scans of n vehicles, finds what moves, and remembers.

    Args:
        o: What the sensors read.
        last: The scan of each vehicle at its last decision.
        standing: Whether each vehicle stands. The same scan again is then no further evidence against a sensor.
        sensor: That reads them.
        lengths: Of the shield.
        task: Says what sensors read of rays, and which states are safe.
    """
    rays, origin = o.ray_distances.copy(), np.array(sensor.position[:2])
    scans, clouds, movers, moves = [], [], [], []
    for i, before in enumerate(last):
        points = point_cloud(rays[i], sensor)
        target = TargetFix(float(o.landmark_distance[i]), float(o.landmark_bearing[i]))
        moved = found_pose(before.moved, before.target, target)
        strayed = float(np.hypot(*(moved - before.moved)[:2]))
        moving = moving_points(points, before.rays, moved, strayed, origin)
        expected = seen_from(moved, before.points)
        evidence = (
            before.evidence
            if standing[i]
            else before.evidence + contradictions(rays[i], expected, origin, sensor.range)
        )
        evidence = np.where(silent_sectors(rays[i], sensor.range), evidence, 0.0)
        scan = LastScan(points, rays[i], target, before.moved, evidence)
        if scan.dead.any():
            rays[i], remembered = completed(rays[i], scan.dead, expected, origin, sensor.range)
            scan = replace(scan, points=np.where(np.isnan(remembered), points, remembered))
            points = point_cloud(rays[i], sensor)
        telling = np.where(sensor.seen, rays[i], 0.0)
        kept = remembered_points(before.standing, moved, telling, sensor, lengths)
        stands = points[~moving & np.isfinite(points[:, 0])]
        stands = np.concatenate([np.c_[stands, np.zeros(len(stands))], kept])
        recent = before.recent.followed_by(telling, moved, strayed)
        scans.append(replace(scan, rays=np.where(sensor.seen, rays[i], np.nan), standing=stands, recent=recent))
        clouds.append(np.concatenate([points, kept[:, :2]]))
        movers.append(moving)
        moves.append(moved)
    cloud = np.full((len(clouds), max(map(len, clouds)), 2), np.nan)
    mover = np.zeros(cloud.shape[:2], np.bool_)
    for i, (some, moving) in enumerate(zip(clouds, movers, strict=True)):
        cloud[i, : len(some)], mover[i, : len(moving)] = some, moving
    readings = readings_of(rays, task)
    unsafe = (o.state_property == StateProperty.SAFE) & ~is_safe(readings, task) & (readings < o.readings).any(axis=-1)
    state = np.where(unsafe, StateProperty.NON_SAFE, o.state_property)
    completed_o = replace(o, ray_distances=rays, readings=readings, state_property=state)
    return Perception(completed_o, cloud, mover, np.array(moves), scans)


def remembered_points(standing: Array, moved: Array, rays: Array, sensor: Sensor, lengths: Lengths) -> Array:
    """The points to remember that a scan misses, see `LastScan.standing` (k, 3).

    Args:
        standing: Points at the last decision (m, 3).
        moved: The present pose in the vehicle frame of then (3,).
        rays: The scan (r,) [m]; 0 for a ray that tells nothing.
        sensor: That made it.
        lengths: Of the shield.
    """
    places = seen_from(moved, standing[:, :2])
    origin, slack, close = np.array(sensor.position[:2]), lengths.least_width / 4, lengths.margin / 2
    kept = missed(places, rays, origin, float(sensor.angles[0]), lengths.corridor, slack, close)
    kept &= standing[:, 2] < REMEMBERED
    return np.concatenate([places, standing[:, 2:] + 1], axis=-1)[kept]
