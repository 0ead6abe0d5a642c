"""The scan as a shield takes it: silent sensors completed, points of moving obstacles told apart.

Both are judged by the scan before: a sensor that reads nothing against all evidence counts as dead (`sector_faults`),
and a point where nothing was seen before belongs to a moving obstacle.
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
from nnql_bullet.sensing import Sensor
from nnql_bullet.task import StateProperty, TaskOptions, is_safe, readings_of


@dataclass(frozen=True, slots=True)
class LastScan:
    """One vehicle's scan at its last decision. The defaults are those of a vehicle without a scan."""

    points: Array = field(default_factory=lambda: np.full((1, 2), np.nan))
    """Points in the vehicle frame of then (rays, 2) [m]; NaN for none."""
    rays: Array = field(default_factory=lambda: np.full(paper.SECTORS, np.nan))
    """Ray distances (rays,) [m]; NaN where the sensor sees nothing."""
    target: TargetFix = field(default_factory=lambda: TargetFix(0.0, 0.0))
    """The target as seen then."""
    moved: Array = field(default_factory=lambda: np.zeros(3))
    """Predicted pose of now in the vehicle frame of then (3,)."""
    evidence: Array = field(default_factory=lambda: np.zeros(paper.SECTORS))
    """Contradictions against each sensor since it last read something (8,)."""

    @property
    def dead(self) -> NDArray[np.bool_]:
        """Whether each sensor counts as dead (8,)."""
        return np.asarray(self.evidence >= ENOUGH)


def perceived(
    o: Observation,
    last: Sequence[LastScan],
    standing: Sequence[bool],
    sensor: Sensor,
    task: TaskOptions,
) -> tuple[Observation, NDArray[np.bool_], list[LastScan]]:
    """Completes the scans of n vehicles, and finds what moves.

    Args:
        o: What the sensors read.
        last: The scan of each vehicle at its last decision.
        standing: Whether each vehicle stands. The same scan again is then no further evidence against a sensor.
        sensor: That reads them.
        task: Says what sensors read of rays, and which states are safe.

    Returns:
        The observation with dead sensors completed, whether each ray meets a moving obstacle (n, rays), and the scans
        for the next decision.
    """
    rays, moving = o.ray_distances.copy(), np.zeros(o.ray_distances.shape, np.bool_)
    origin, scans = np.array(sensor.position[:2]), []
    for i, before in enumerate(last):
        points = point_cloud(rays[i], sensor)
        target = TargetFix(float(o.target_distance[i]), float(o.target_bearing[i]))
        moved = found_pose(before.moved, before.target, target)
        strayed = float(np.hypot(*(moved - before.moved)[:2]))
        moving[i] = moving_points(points, before.rays, moved, strayed, origin)
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
        scans.append(replace(scan, rays=np.where(sensor.seen, rays[i], np.nan)))
    readings = readings_of(rays, task)
    unsafe = (o.state_property == StateProperty.SAFE) & ~is_safe(readings, task) & (readings < o.readings).any(axis=-1)
    state = np.where(unsafe, StateProperty.NON_SAFE, o.state_property)
    return replace(o, ray_distances=rays, readings=readings, state_property=state), moving, scans
