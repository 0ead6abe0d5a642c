"""Draws recordings as files: a video, a picture of each frame, or a sheet of key moments."""

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from nnql_bullet.arguments import checked
from nnql_bullet.errors import UserError
from nnql_bullet.recording import Recording, load_recording
from nnql_bullet.render.camera import CameraName
from nnql_bullet.render.film import HOLD, Film, film_executor, frame_times, frames
from nnql_bullet.render.renderers import RendererName, check_renderer
from nnql_bullet.render.sheet import contact_sheet, key_moments
from nnql_bullet.render.timeline import Timeline
from nnql_bullet.render.video import VideoFormat, check_encoder, write_picture, write_pictures, write_video
from nnql_bullet.types import Bytes
from nnql_bullet.vehicle.visuals import recorded_urdf
from nnql_bullet.work import OnProgress, Progress, silent

SIZE = (1280, 720)
"""Default size of pictures [pixels]."""
FPS = 30.0
"""Default frame rate [Hz]."""
MOST_FRAMES = 200_000
"""Longest film [frames]."""
SMALLEST, LARGEST = 64, 7680
"""Limits of a picture's sides [pixels]."""


@checked
def render(
    recording: Recording | Path,
    video: Path | str | None = None,
    *,
    camera: CameraName = "chase",
    size: tuple[int, int] = SIZE,
    fps: float = FPS,
    speed: float = 1.0,
    begin: float = 0.0,
    end: float | None = None,
    hold: float = HOLD,
    renderer: RendererName = "raster",
    kind: VideoFormat | None = None,
    pictures: Path | str | None = None,
    sheet: Path | str | None = None,
    workers: int | None = 1,
    on_progress: OnProgress | None = None,
) -> None:
    """Draws a recording as files.

    Args:
        recording: The recording, or its file.
        video: File of the video, .mp4 or .gif; by default no video is written.
        camera: Behind the vehicle (chase), above the arena (top), round the vehicle (orbit), or chase and top (split).
        size: Width and height of the pictures, even numbers [pixels].
        fps: Frame rate [Hz].
        speed: Playback speed; 1 is real time.
        begin: Time in the drive at which the video begins [s].
        end: Time in the drive at which the video ends [s]; by default the end of the drive.
        hold: Time for which the video shows the last frame [s].
        renderer: Renderer of the solid bodies; "vtk" has finer light and shadows, and is much slower.
        kind: Format of the video; by default the suffix of its file decides.
        pictures: Folder for a PNG of each frame; by default none is written.
        sheet: File for a picture of the key moments; by default none is written.
        workers: Number of frames that are drawn at a time; None is one per core. The result does not depend on it.
        on_progress: Receives the progress.

    Raises:
        UserError: If an argument is out of range, a renderer or encoder is missing, or such pictures exist already.
        WorkFailed: If drawing fails.
    """
    check_pictures(size, fps, speed)
    chosen = video_format(video, kind)
    check_renderer(renderer)
    if video:
        check_encoder()
    with _as_file(recording) as (loaded, path):
        duration = Timeline(loaded).duration
        last = duration if end is None else min(end, duration)
        if not 0.0 <= begin < last:
            raise UserError(f"the drive takes {duration:.1f} s; nothing is between begin={begin:g} and end={last:g}")
        if (count := (last - begin) / speed * fps) > MOST_FRAMES:
            raise UserError(f"a film of {count:.3g} frames is longer than {MOST_FRAMES}; raise speed or lower fps")
        recorded_urdf(loaded.about["vehicle"])  # is refused here if it cannot be drawn
        film = Film(path, camera, *size, renderer)
        if video or pictures:
            times = frame_times(begin, last, fps, speed, hold)
            _write_film(film, times, video, chosen, fps, pictures, workers, on_progress)
        if sheet:
            moments = key_moments(Timeline(loaded))
            drawn = list(frames(film, [moment.time for moment in moments], film_executor(renderer, workers)))
            write_picture(Path(sheet), contact_sheet(moments, drawn))


def render_ending(recording: Path, video: Path, seconds: float, size: tuple[int, int], workers: int | None = 1) -> None:
    """Draws the last seconds of a recording as a video with the camera "split".

    Raises:
        UserError: If encoding fails.
        WorkFailed: If drawing fails.
    """
    times = frame_times(0.0, Timeline(load_recording(recording)).duration, FPS, 1.0)
    film = Film(recording, "split", *size, "raster")
    _write_film(film, times[-round((seconds + HOLD) * FPS) :], video, "mp4", FPS, None, workers, None)


def check_pictures(size: tuple[int, int], fps: float, speed: float) -> None:
    """Checks the size, frame rate and playback speed of a video.

    Raises:
        UserError: If a value is out of range.
    """
    if not all(SMALLEST <= side <= LARGEST and side % 2 == 0 for side in size):
        raise UserError(
            f"size: give width and height as even numbers from {SMALLEST} to {LARGEST}, not {size[0]}x{size[1]}"
        )
    if not 1.0 <= fps <= 240.0:
        raise UserError(f"fps: must be between 1 and 240, not {fps:g}")
    if not 0.0 < speed <= 1000.0:
        raise UserError(f"speed: must be above 0 and at most 1000, not {speed:g}")


def video_format(video: Path | str | None, kind: VideoFormat | None) -> VideoFormat:
    """Finds the format of a video from an argument or its file name.

    Raises:
        UserError: If they contradict each other, or the name ends in neither format.
    """
    if video is None:
        return kind or "mp4"
    suffix = Path(video).suffix.lower()
    if suffix not in (".mp4", ".gif") or (kind and suffix != f".{kind}"):
        raise UserError(f"{video}: give the video a name that ends in {f'.{kind}' if kind else '.mp4 or .gif'}")
    return "gif" if suffix == ".gif" else "mp4"


@contextmanager
def _as_file(recording: Recording | Path) -> Iterator[tuple[Recording, Path]]:
    """Yields a recording and a file of it, which processes can read."""
    if isinstance(recording, Path):
        yield load_recording(recording), recording
        return
    with TemporaryDirectory() as folder:
        path = Path(folder) / "recording.npz"
        recording.save(path)
        yield recording, path


def _write_film(
    film: Film,
    times: Sequence[float],
    video: Path | str | None,
    kind: VideoFormat,
    fps: float,
    pictures: Path | str | None,
    workers: int | None,
    on_progress: OnProgress | None,
) -> None:
    """Draws frames of a film and writes them as a video, as pictures, or both."""
    what = f"drawing {Path(video or pictures or film.recording).name}"
    drawn = frames(film, times, film_executor(film.renderer, workers))
    drawn = _reported(drawn, what, len(times), on_progress or silent)
    if pictures:
        drawn = write_pictures(Path(pictures), drawn)
    if video:
        write_video(Path(video), drawn, (film.width, film.height), fps, kind)
    else:
        for _ in drawn:
            pass


def _reported(drawn: Iterable[Bytes], what: str, total: int, report: OnProgress) -> Iterator[Bytes]:
    """Yields frames and reports the progress."""
    report(Progress(what, 0, total))
    for done, frame in enumerate(drawn, 1):
        yield frame
        report(Progress(what, done, total))
