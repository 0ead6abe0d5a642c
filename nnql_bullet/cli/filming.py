"""Recordings drawn as videos and pictures, with progress: what several verbs do."""

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path

from nnql_bullet.cli.console import progress
from nnql_bullet.cli.work import WorkFailed
from nnql_bullet.executors import ProcessExecutor
from nnql_bullet.recording import load_recording
from nnql_bullet.render.camera import CameraName
from nnql_bullet.render.film import Film, FramesLost, frame_times, frames
from nnql_bullet.render.renderers import best_renderer
from nnql_bullet.render.sheet import contact_sheet, key_moments
from nnql_bullet.render.timeline import Timeline
from nnql_bullet.render.video import VideoFormat, write_picture, write_pictures, write_video
from nnql_bullet.types import Bytes

SIZE = (1280, 720)
"""Of pictures, where nothing else is asked for."""
FPS = 30.0
"""Frames a second, likewise."""


def film_of(recording: Path, camera: CameraName = "chase", size: tuple[int, int] = SIZE) -> Film:
    """A film by the best renderer that works here."""
    return Film(recording, camera, *size, best_renderer(*size))


def shoot(
    film: Film,
    times: Sequence[float],
    video: Path | None,
    kind: VideoFormat = "mp4",
    fps: float = FPS,
    pictures: Path | None = None,
    workers: int | None = None,
) -> None:
    """Draws a film and writes it.

    Args:
        film: What is drawn.
        times: Of its frames [s].
        video: Where it goes, if it is wanted.
        kind: Of the video.
        fps: Frames a second.
        pictures: Where each frame goes as a picture, if they are wanted.
        workers: Processes that draw; one a core if not given.

    Raises:
        WorkFailed: If drawing fails.
        UserError: If encoding fails, or there are such pictures already.
    """
    name = (video or pictures or film.recording).name
    with progress(f"drawing {name}", len(times)) as show:
        drawn = _shown(_drawn(film, times, workers), show)
        if pictures:
            drawn = write_pictures(pictures, drawn)
        if video:
            write_video(video, drawn, (film.width, film.height), fps, kind)
        else:
            for _ in drawn:
                pass


def shoot_sheet(film: Film, path: Path, workers: int | None = None) -> None:
    """Draws the key moments of a recording as one picture.

    Raises:
        WorkFailed: If drawing fails.
    """
    moments = key_moments(Timeline(load_recording(film.recording)))
    pictures = list(_drawn(film, [moment.time for moment in moments], workers))
    write_picture(path, contact_sheet(moments, pictures))


def whole(recording: Path, fps: float = FPS, speed: float = 1.0) -> list[float]:
    """Times of the frames that show all of a recording."""
    return frame_times(0.0, Timeline(load_recording(recording)).duration, fps, speed)


def _drawn(film: Film, times: Sequence[float], workers: int | None) -> Iterator[Bytes]:
    try:
        yield from frames(film, times, ProcessExecutor(workers or os.cpu_count() or 1))
    except FramesLost as error:
        raise WorkFailed(str(error)) from None


def _shown(drawn: Iterable[Bytes], show: Callable[[int, str], None]) -> Iterator[Bytes]:
    for count, frame in enumerate(drawn, 1):
        yield frame
        show(count, "")
