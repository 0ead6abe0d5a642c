"""Writes frames as a video, an animation, or separate pictures."""

import subprocess
from collections.abc import Generator, Iterable, Iterator
from contextlib import closing, contextmanager
from pathlib import Path
from typing import Literal

import imageio_ffmpeg
from PIL import Image

from nnql_bullet.errors import UserError
from nnql_bullet.files import write_atomically
from nnql_bullet.types import Bytes

VideoFormat = Literal["mp4", "gif"]

TIMEOUT = 60.0
"""Time limit for the answer of the encoder [s]."""
THREADS = 2
"""Number of the encoder's threads; it is fixed because the output depends on it."""
_PARAMETERS: dict[VideoFormat, list[str]] = {
    # `faststart` lets browsers play the file while they load it.
    "mp4": ["-preset", "veryfast", "-crf", "21", "-threads", str(THREADS), "-movflags", "+faststart"],
    # One palette for each frame; a common palette would need all frames first.
    "gif": ["-filter_complex", "split[a][b];[a]palettegen=stats_mode=single[p];[b][p]paletteuse=new=1:dither=none"],
}
_BITEXACT = ["-fflags", "+bitexact", "-flags:v", "+bitexact", "-map_metadata", "-1"]


def check_encoder() -> str:
    """Checks that ffmpeg, which encodes videos, starts; returns its name and version.

    Raises:
        UserError: If it does not.
    """
    try:
        program = imageio_ffmpeg.get_ffmpeg_exe()
        answer = subprocess.run([program, "-version"], capture_output=True, text=True, timeout=TIMEOUT, check=True)
    except (RuntimeError, OSError, subprocess.SubprocessError):
        raise UserError(
            "ffmpeg, which encodes videos, does not start; install it: pip install 'imageio[ffmpeg]'"
        ) from None
    return answer.stdout.partition("\n")[0].partition(" Copyright")[0]


def write_video(path: Path, frames: Iterable[Bytes], size: tuple[int, int], fps: float, kind: VideoFormat) -> None:
    """Encodes frames as they arrive, and writes the file atomically.

    Args:
        path: Path of the file.
        frames: Frames (h, w, 3).
        size: Width and height, even numbers [pixels].
        fps: Frame rate [Hz].
        kind: H.264 in MP4, or GIF.

    Raises:
        UserError: If there is no encoder, or it fails.
        OSError: If the file cannot be written.
    """

    def write(temporary: Path) -> None:
        with _encoder(temporary, size, fps, kind) as encoder:
            for frame in frames:
                encoder.send(frame)

    write_atomically(path, write)


def write_pictures(folder: Path, frames: Iterable[Bytes]) -> Iterator[Bytes]:
    """Writes the frames as frame_00001.png and so on, and yields each one again.

    Raises:
        UserError: If the folder contains such pictures.
        OSError: If a picture cannot be written.
    """
    if any(folder.glob("frame_*.png")):
        raise UserError(f"{folder}: holds frames already; give another folder, or empty this one")
    folder.mkdir(parents=True, exist_ok=True)
    for number, frame in enumerate(frames, 1):
        write_picture(folder / f"frame_{number:05d}.png", frame)
        yield frame


def write_picture(path: Path, picture: Bytes) -> None:
    """Writes a PNG atomically."""
    write_atomically(path, lambda temporary: Image.fromarray(picture).save(temporary))


@contextmanager
def _encoder(
    path: Path, size: tuple[int, int], fps: float, kind: VideoFormat
) -> Iterator[Generator[None, Bytes | None, None]]:
    mp4 = kind == "mp4"
    try:
        encoder = imageio_ffmpeg.write_frames(
            str(path),
            size,
            fps=fps,
            codec="libx264" if mp4 else "gif",
            pix_fmt_out="yuv420p" if mp4 else "pal8",
            quality=None,
            macro_block_size=2,
            ffmpeg_log_level="error",
            output_params=[*_PARAMETERS[kind], *_BITEXACT],
        )
        with closing(encoder):
            encoder.send(None)
            yield encoder
    except (RuntimeError, OSError) as error:
        if isinstance(error, OSError) and not isinstance(error, BrokenPipeError):
            raise
        reason = " ".join(str(error).split())[:200]
        raise UserError(f"{path.name}: cannot be encoded ({reason}); `nnql-bullet doctor` checks the encoder") from None
