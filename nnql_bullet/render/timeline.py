"""A recording as a function of time: where everything was at any instant, not only when it was sampled."""

from dataclasses import dataclass

import numpy as np

from nnql_bullet.geometry import Array, OrientedBox, Pose, wrap_angle
from nnql_bullet.recording import Recording


@dataclass(frozen=True, slots=True)
class Moment:
    """One instant of a recording."""

    time: float
    """Since the start [s]."""
    pose: Pose
    """Of the vehicle."""
    joint_angles: tuple[float, float, float, float]
    """Left and right drive, swivel, caster roll [rad]."""
    speed: float
    """Of the rear-axle centre [m/s]."""
    step: int
    """The decision that is being carried out; the last one when it is over."""
    over: bool
    """Whether the episode has ended."""
    movers: tuple[OrientedBox, ...]
    """The boxes that move, where they are."""


class Timeline:
    """What was recorded, between the samples too: places and angles are interpolated linearly, the short way round."""

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        start, first = recording.state_pose[0], recording.joint_angles[0]
        self._times = np.concatenate([[0.0], recording.sample_time])
        self._poses = np.concatenate([[start], recording.sample_pose])
        self._poses[:, 2] = np.unwrap(self._poses[:, 2])
        self._joints = np.unwrap(np.concatenate([[first], recording.joint_angles]), axis=0)
        ways = np.hypot(*np.diff(self._poses[:, :2], axis=0).T)
        self._speeds = ways / np.diff(self._times)

    @property
    def duration(self) -> float:
        """Of the episode [s]."""
        return float(self._times[-1])

    def at(self, time: float) -> Moment:
        """The instant at a time [s]; after the end, how it ended."""
        r = self.recording
        now = min(max(time, 0.0), self.duration)
        x, y, yaw = (float(np.interp(now, self._times, values)) for values in self._poses.T)
        left, right, swivel, roll = (float(np.interp(now, self._times, values)) for values in self._joints.T)
        sample = int(np.searchsorted(self._times[1:-1], now, side="left"))
        step = int(np.searchsorted(r.state_time[1:-1], now, side="right"))
        return Moment(
            time=now,
            pose=Pose(x, y, wrap_angle(yaw)),
            joint_angles=(left, right, swivel, roll),
            speed=float(self._speeds[sample]),
            step=step,
            over=time >= self.duration,
            movers=tuple(patrol.at(now) for patrol in r.patrols),
        )

    def path(self, time: float) -> Array:
        """The way up to a time [s]: places (k, 2) [m] at the start and at each sample until then."""
        return self._poses[: int(np.searchsorted(self._times, time, side="right")), :2]

    def safe(self) -> Array:
        """Whether the pieces of the way, from each of its places to the next, were driven in safe states (m,)."""
        r = self.recording
        decision = np.searchsorted(r.state_time, self._times[1:] - 1e-9, side="left") - 1
        return np.asarray(r.state_property[np.clip(decision, 0, None)] != "NS")
