"""Draws the frames of a recording, several at a time."""

import threading
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import floor
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from nnql_bullet.errors import WorkFailed
from nnql_bullet.executors import Executor, ThreadExecutor, at_once, make_executor
from nnql_bullet.recording import Recording, load_recording
from nnql_bullet.render.camera import PATHS, CameraName
from nnql_bullet.render.overlay import Overlay
from nnql_bullet.render.painter import Painter
from nnql_bullet.render.renderers import RendererName, make_renderer
from nnql_bullet.render.timeline import Timeline
from nnql_bullet.types import Bytes

T = TypeVar("T", bound=np.generic)

HOLD = 1.5
"""Time for which a video shows its last frame [s]."""
MAP_SHARE = 0.42
"""Width of the map over that of a split picture."""
PIECE = 3_000_000
"""Size of the frames of one task [bytes]."""


@dataclass(frozen=True, slots=True)
class Film:
    """A film: a recording with camera, size and renderer."""

    recording: Path
    camera: CameraName
    width: int
    height: int
    renderer: RendererName


def frame_times(begin: float, end: float, fps: float, speed: float, hold: float = HOLD) -> list[float]:
    """Computes the instants of a film's frames [s].

    Args:
        begin: First instant in the recording [s].
        end: Last instant in the recording [s].
        fps: Frame rate [Hz].
        speed: Playback speed; 1 is real time.
        hold: Time for which the film shows the last instant [s].
    """
    count = floor((end - begin) * fps / speed + 1e-9) + 1
    return [begin + k * speed / fps for k in range(count)] + [end] * max(round(hold * fps), 0)


@dataclass(frozen=True, slots=True)
class FrameTask:
    """Some frames of a film."""

    film: Film
    times: tuple[float, ...]
    """Their instants [s]."""
    first: int
    """Number of the first frame."""


def draw_frames(task: FrameTask) -> list[Bytes]:
    """Draws the frames of a task (height, width, 3)."""
    studio = studio_of(task.film)
    return [studio.frame(time) for time in task.times]


def film_executor(renderer: RendererName, workers: int | None) -> Executor:
    """Makes the executor of frames: threads where the renderer is compiled code of this package, else processes.

    Raises:
        UserError: If there is no worker.
    """
    if renderer != "raster" or workers == 1:
        return make_executor(workers=workers)
    return ThreadExecutor(at_once(workers))


def frames(film: Film, times: Sequence[float], executor: Executor) -> Iterator[Bytes]:
    """Yields frames (height, width, 3) in order, while later ones are drawn.

    Args:
        film: The film.
        times: Instants of the frames [s].
        executor: Executor that runs the tasks.

    Raises:
        WorkFailed: If drawing fails.
    """
    size = max(PIECE // (film.width * film.height * 3), 1)
    tasks = (FrameTask(film, tuple(times[k : k + size]), k) for k in range(0, len(times), size))
    ahead: dict[int, list[Bytes]] = {}
    wanted = 0
    for outcome in executor.map(draw_frames, tasks):
        if outcome.error:
            raise WorkFailed(f"frame {outcome.task.first + 1}: {outcome.error.message}")
        ahead[outcome.index] = outcome.value  # type: ignore[assignment]  # there is no error
        while wanted in ahead:
            yield from ahead.pop(wanted)
            wanted += 1


class Studio:
    """Draws frames of one episode."""

    def __init__(
        self, recording: Recording, camera: CameraName, width: int, height: int, renderer: RendererName
    ) -> None:
        self._height = height
        self._views = {str(camera): width}
        if camera == "split":
            left = round(width * (1 - MAP_SHARE))
            self._views = {"chase": left, "top": width - left}
        self._renderer = make_renderer(recording, renderer)
        self._painter = Painter(Timeline(recording), self._renderer)
        self.follow(recording)

    def follow(self, recording: Recording) -> None:
        """Takes up a later recording of the episode, as it has gone on."""
        self._timeline, self._time = Timeline(recording), np.nan
        self._painter.follow(self._timeline)
        self._overlay = Overlay(self._timeline, self._height)
        self._paths = [PATHS[name](self._timeline, width, self._height) for name, width in self._views.items()]

    def close(self) -> None:
        """Frees the renderer."""
        self._renderer.close()

    def frame(self, time: float) -> Bytes:
        """Draws a frame (height, width, 3); a repeated instant returns the last frame again."""
        if time != self._time:
            self._time, self._frame = time, self._draw(time)
        return self._frame

    def _draw(self, time: float) -> Bytes:
        moment = self._timeline.at(time)
        cameras = [path(moment) for path in self._paths]
        pictures, depths = zip(*(self._painter.paint(moment, camera) for camera in cameras), strict=True)
        return self._overlay.write(_abreast(pictures), _abreast(depths), moment, cameras)


def _abreast(views: Sequence[NDArray[T]]) -> NDArray[T]:
    """Joins views side by side; one alone is not copied."""
    return views[0] if len(views) == 1 else np.hstack(views)


class _Own(threading.local):
    """What this thread draws with: it draws many pieces of one film."""

    film: Film | None = None
    studio: Studio


_own = _Own()


def studio_of(film: Film) -> Studio:
    """What draws the frames of a film in this thread."""
    if _own.film != film:
        _own.studio = Studio(load_recording(film.recording), film.camera, film.width, film.height, film.renderer)
        _own.film = film
    return _own.studio
