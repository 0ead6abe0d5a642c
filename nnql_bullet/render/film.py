"""A recording as frames: at which instants, and drawn in pieces that processes can share."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import floor
from pathlib import Path

import numpy as np

from nnql_bullet.errors import WorkFailed
from nnql_bullet.executors import Executor
from nnql_bullet.recording import load_recording
from nnql_bullet.render.camera import PATHS, CameraName
from nnql_bullet.render.overlay import Overlay
from nnql_bullet.render.painter import Painter
from nnql_bullet.render.renderers import RendererName, make_renderer
from nnql_bullet.render.timeline import Timeline
from nnql_bullet.types import Bytes

HOLD = 1.5
"""How long the ending stays in the picture [s]."""
MAP_SHARE = 0.42
"""Of the width of a split picture."""
PIECE = 3_000_000
"""Bytes of frames that are drawn, and held, at a time."""


@dataclass(frozen=True, slots=True)
class Film:
    """What is drawn, and how."""

    recording: Path
    camera: CameraName
    width: int
    height: int
    renderer: RendererName


def frame_times(begin: float, end: float, fps: float, speed: float, hold: float = HOLD) -> list[float]:
    """Instants of a film's frames [s].

    Args:
        begin: In the recording [s].
        end: In the recording [s].
        fps: Frames a second.
        speed: How much faster than it happened it is shown.
        hold: How long the last instant stays [s].
    """
    count = floor((end - begin) * fps / speed + 1e-9) + 1
    return [begin + k * speed / fps for k in range(count)] + [end] * max(round(hold * fps), 0)


@dataclass(frozen=True, slots=True)
class FrameTask:
    """Some frames of a film."""

    film: Film
    times: tuple[float, ...]
    """Of the instants [s]."""
    first: int
    """Number of the first frame."""


def draw_frames(task: FrameTask) -> Bytes:
    """Frames (n, height, width, 3)."""
    studio = _studio(task.film)
    return np.stack([studio.frame(time) for time in task.times])


def frames(film: Film, times: Sequence[float], executor: Executor) -> Iterator[Bytes]:
    """Frames (height, width, 3) one by one, in order, while others are drawn ahead.

    Args:
        film: What is drawn.
        times: Of the instants [s].
        executor: Where they are drawn.

    Raises:
        WorkFailed: If drawing fails.
    """
    size = max(PIECE // (film.width * film.height * 3), 1)
    tasks = (FrameTask(film, tuple(times[k : k + size]), k) for k in range(0, len(times), size))
    ahead: dict[int, Bytes] = {}
    wanted = 0
    for outcome in executor.map(draw_frames, tasks):
        if outcome.error:
            raise WorkFailed(f"frame {outcome.task.first + 1}: {outcome.error.message}")
        ahead[outcome.index] = outcome.value  # type: ignore[assignment]  # there is no error
        while wanted in ahead:
            yield from ahead.pop(wanted)
            wanted += 1


class Studio:
    """Everything that draws a film."""

    def __init__(self, film: Film) -> None:
        self._timeline = Timeline(load_recording(film.recording))
        self._painter = Painter(self._timeline, make_renderer(self._timeline.recording, film.renderer))
        self._overlay = Overlay(self._timeline, film.height)
        self._time = np.nan
        views = {str(film.camera): film.width}
        if film.camera == "split":
            left = round(film.width * (1 - MAP_SHARE))
            views = {"chase": left, "top": film.width - left}
        self._paths = [PATHS[name](self._timeline, width, film.height) for name, width in views.items()]

    def frame(self, time: float) -> Bytes:
        """A frame (height, width, 3); one that is asked for again in a row is not drawn again."""
        if time != self._time:
            self._time, self._frame = time, self._draw(time)
        return self._frame

    def _draw(self, time: float) -> Bytes:
        moment = self._timeline.at(time)
        cameras = [path(moment) for path in self._paths]
        pictures, depths = zip(*(self._painter.paint(moment, camera) for camera in cameras), strict=True)
        return self._overlay.write(np.hstack(pictures), np.hstack(depths), moment, cameras)


@lru_cache(maxsize=1)  # a process draws many pieces of one film
def _studio(film: Film) -> Studio:
    return Studio(film)
