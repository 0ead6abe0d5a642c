"""Draws an episode while it goes on."""

import os
import time
from dataclasses import replace
from typing import Any, Literal, get_args

import numpy as np

from nnql_bullet import paper
from nnql_bullet.env import Observation, Transition
from nnql_bullet.recording import Recorder, Recording
from nnql_bullet.render.camera import CameraName
from nnql_bullet.render.film import Studio
from nnql_bullet.render.filming import FPS, check_pictures
from nnql_bullet.render.window import RATE, Window, check_window
from nnql_bullet.rollout import Decision
from nnql_bullet.sim.base import Sample
from nnql_bullet.sim.c_library import silenced
from nnql_bullet.types import Bytes
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.spec import WorldSpec

RenderMode = Literal["rgb_array", "rgb_array_list", "human"]
"""A picture of now, one of each state since the last time, or a window."""

SIZE = (640, 360)
"""Default size of pictures [pixels]."""
INSTANT = 1e-6
"""Time after the start of an episode that stands for its first step before there is one [s]."""


def modes_here() -> list[RenderMode]:
    """The modes that there may be on this machine: a window needs a display."""
    return [mode for mode in get_args(RenderMode) if mode != "human" or os.environ.get("DISPLAY")]


def check_mode(mode: RenderMode, size: tuple[int, int]) -> None:
    """Checks that episodes can be shown so here.

    Raises:
        UserError: If the size is out of range, or no window can open.
    """
    check_pictures(size, FPS, 1.0)
    if mode == "human":
        check_window("take render_mode='rgb_array', or a virtual display (xvfb-run)")


class Live:
    """Shows the episodes of one vehicle as they go on. It costs little until it is asked for a picture.

    A copy shows the same, but has a renderer of its own, and no window.
    """

    def __init__(
        self, mode: RenderMode, vehicle: VehicleSpec, camera: CameraName, size: tuple[int, int], **about: Any
    ) -> None:
        """Decides how to draw; see `check_mode`.

        Args:
            mode: What is asked for.
            vehicle: The vehicle.
            camera: See `camera`.
            size: Width and height of pictures [pixels].
            **about: What the title says: see `recording.Recording.about`.
        """
        self._mode, self._vehicle, self._camera, self._size, self._about = mode, vehicle, camera, size, about
        self._recorder = Recorder(vehicle)
        self._clearance, self._speed, self._shown = 0.0, 0.0, 0
        self._studio: Studio | None = None
        self._window: Window | None = None
        self._was_closed = False

    @property
    def trace(self) -> list[Sample]:
        """The list that receives samples between decisions."""
        return self._recorder.trace

    def on_reset(self, world: WorldSpec, observation: Observation, vehicle: int, clearance: float) -> None:
        """Is told of the start of an episode of a vehicle, and of its clearance there [m]."""
        self._recorder.on_reset(world, observation, vehicle)
        self._clearance, self._speed, self._shown = clearance, float(observation.speed[vehicle]), 0
        self.close()
        self._show()

    def on_step(self, transition: Transition, vehicle: int) -> None:
        """Is told of a step of n vehicles, and of which of them it shows."""
        before = self._recorder.times[-1]
        decision = Decision(transition.a_tm1, np.zeros(len(transition.a_tm1), np.bool_), None)
        self._recorder.on_step(transition, decision, vehicle)
        self._show(before)

    def render(self) -> Bytes | list[Bytes]:
        """Draws the vehicle as it is now (height, width, 3).

        Where the mode is a list, it draws each state of this episode since the last call.
        """
        if self._mode != "rgb_array_list":
            return self._drawn([self._recorder.times[-1]])[0]
        times = self._recorder.times[self._shown :]
        self._shown += len(times)
        return self._drawn(times)

    def close(self) -> None:
        """Frees what draws; the next picture makes it anew."""
        if self._studio:
            self._studio.close()
        if self._window and self._window.is_open:
            self._window.close()
        self._studio = self._window = None

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_studio": None, "_window": None, "_was_closed": True}

    def _drawn(self, times: list[float]) -> list[Bytes]:
        recording = self._recording()
        if self._studio is None:
            self._studio = Studio(recording, self._camera, *self._size, "raster")
        self._studio.follow(recording)
        return [self._studio.frame(time) for time in times]

    def _show(self, begin: float = 0.0) -> None:
        """Plays what happened since a time in the window, in real time; a window that was closed stays closed."""
        if self._mode != "human" or self._was_closed:
            return
        recording = self._recording()
        with silenced():  # PyBullet's threads print messages while the window is open
            if self._window is None:
                self._window = Window(recording)
            self._window.follow(recording)
            began, now, end = time.monotonic(), begin, self._recorder.times[-1]
            while now < end and self._window.is_open:
                now = min(begin + time.monotonic() - began, end)
                self._window.show(now)
                time.sleep(1 / RATE)
            self._was_closed = not self._window.is_open

    def _recording(self) -> Recording:
        """The episode so far. If it goes on, its last step is one that takes no time yet, from the present state."""
        recording = self._recorder.recording(**self._about)
        if recording.about["ending"] is not None:
            return recording
        begun = len(recording.action) > 0
        states = "state_time", "state_pose", "readings", "ray_distances", "state_property"
        again = {name: _repeated(getattr(recording, name)) for name in states}
        if begun:
            again |= {name: _repeated(getattr(recording, name)) for name in ("action", "clearance", "overridden")}
            return replace(recording, **again, q_values=np.full((len(again["action"]), len(paper.TURNS)), np.nan))
        (start,) = recording.state_pose
        ahead = self._speed * INSTANT * np.array([np.cos(start[2]), np.sin(start[2]), 0.0])
        return replace(
            recording,
            **again,
            action=np.zeros(1, np.int64),
            clearance=np.array([self._clearance]),
            overridden=np.zeros(1, np.bool_),
            q_values=np.full((1, len(paper.TURNS)), np.nan),
            sample_time=np.array([INSTANT]),
            sample_pose=(start + ahead)[None],
            joint_angles=np.zeros((1, len(self._vehicle.joints))),
        )


def _repeated(rows: Any) -> Any:
    """The rows, and the last of them again."""
    return np.concatenate([rows, rows[-1:]])
