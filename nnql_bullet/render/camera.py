"""Cameras: where they stand, how they follow, and where things of the world appear in their pictures."""

from collections.abc import Callable
from dataclasses import dataclass
from math import atan2, cos, radians, sin, tan
from typing import Literal

import numpy as np

from nnql_bullet.geometry import Array
from nnql_bullet.render.timeline import Moment, Timeline

CameraName = Literal["chase", "top", "orbit", "split"]

UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, slots=True)
class Camera:
    """A pinhole camera without roll; where it looks straight down, the world's y axis points up in its picture."""

    eye: tuple[float, float, float]
    """[m]"""
    target: tuple[float, float, float]
    """What is in the middle of the picture [m]."""
    field_of_view: float
    """From the lower edge to the upper one [rad]."""
    width: int
    height: int
    near: float
    """Nothing nearer is drawn [m]. The farther, the finer the depths: EGL tells them apart to 16 bits."""
    far: float = 400.0
    """Nor anything farther [m]."""

    @property
    def axes(self) -> Array:
        """Unit vectors to the right, up and ahead, as rows (3, 3)."""
        ahead = np.subtract(self.target, self.eye)
        ahead /= np.linalg.norm(ahead)
        up = UP if abs(ahead @ UP) < 1 - 1e-9 else np.array([0.0, 1.0, 0.0])
        right = np.cross(ahead, up)
        right /= np.linalg.norm(right)
        return np.array([right, np.cross(right, ahead), ahead])

    @property
    def half_extents(self) -> tuple[float, float]:
        """Of the picture, to the right and up, at distance 1."""
        up = tan(self.field_of_view / 2)
        return up * self.width / self.height, up

    @property
    def view(self) -> Array:
        """From the world to the camera's frame, which looks along -z (4, 4): OpenGL's view matrix."""
        right, up, ahead = self.axes
        matrix = np.eye(4)
        matrix[:3, :3] = right, up, -ahead
        matrix[:3, 3] = -matrix[:3, :3] @ self.eye
        return matrix

    @property
    def projection(self) -> Array:
        """From the camera's frame to clip coordinates (4, 4): OpenGL's perspective matrix."""
        (right, up), n, f = self.half_extents, self.near, self.far
        return np.array(
            [[1 / right, 0, 0, 0], [0, 1 / up, 0, 0], [0, 0, -(f + n) / (f - n), -2 * f * n / (f - n)], [0, 0, -1, 0]]
        )

    def project(self, points: Array) -> tuple[Array, Array]:
        """Where points appear.

        Args:
            points: (n, 3) [m]

        Returns:
            Pixels from the upper left corner of the picture, to the right and down (n, 2), and distances ahead of the
            eye (n,) [m]. Points that are not ahead of the camera appear nowhere: their pixels are NaN.
        """
        clip = np.column_stack([points, np.ones(len(points))]) @ (self.projection @ self.view).T
        ahead = clip[:, 3]
        with np.errstate(divide="ignore", invalid="ignore"):
            device = np.where(ahead[:, None] > self.near, clip[:, :2] / ahead[:, None], np.nan)
        return (device * (1, -1) + 1) / 2 * (self.width, self.height), ahead


Path = Callable[[Moment], Camera]
"""How a camera follows what happens."""

CHASE_TIME_CONSTANT = 0.7
"""Time constant with which a chasing camera turns after the vehicle [s]."""
STEP = 1 / 30
"""In which that is worked out [s]."""
LAP = 24.0
"""An orbiting camera is round once in so long [s]."""


def chase(timeline: Timeline, width: int, height: int) -> Path:
    """From behind and above, turning after the vehicle with a lag: a first-order filter of its yaw."""
    times = np.arange(0.0, timeline.duration + STEP, STEP)
    yaws = np.unwrap([timeline.at(time).pose.yaw for time in times])
    followed = np.empty_like(yaws)
    followed[0] = yaws[0]
    for k in range(1, len(yaws)):
        followed[k] = followed[k - 1] + (yaws[k] - followed[k - 1]) * STEP / CHASE_TIME_CONSTANT

    def camera(moment: Moment) -> Camera:
        yaw, (x, y) = float(np.interp(moment.time, times, followed)), (moment.pose.x, moment.pose.y)
        c, s = cos(yaw), sin(yaw)
        return Camera((x - 5.6 * c, y - 5.6 * s, 3.3), (x + 2.6 * c, y + 2.6 * s, 0.0), radians(52), width, height, 2.4)

    return camera


def orbit(timeline: Timeline, width: int, height: int) -> Path:
    """Round the vehicle."""

    def camera(moment: Moment) -> Camera:
        angle, (x, y) = 2 * np.pi * moment.time / LAP + np.pi * 1.25, (moment.pose.x, moment.pose.y)
        return Camera((x + 5 * cos(angle), y + 5 * sin(angle), 3.6), (x, y, 0.2), radians(50), width, height, 2.4)

    return camera


def top(timeline: Timeline, width: int, height: int) -> Path:
    """The whole arena from high above, north up."""
    world = timeline.recording.about["world"]
    margin = 1.12
    across, along = world["width"] * margin, world["depth"] * margin
    visible = max(along, across * height / width)
    up = 4 * visible
    x, y = world["width"] / 2, world["depth"] / 2
    still = Camera((x, y, up), (x, y, 0.0), 2 * atan2(visible / 2, up), width, height, up - 5.0, up + 5.0)
    return lambda moment: still


PATHS: dict[str, Callable[[Timeline, int, int], Path]] = {"chase": chase, "orbit": orbit, "top": top}
"""Cameras with one picture; `split` has two of them side by side."""
