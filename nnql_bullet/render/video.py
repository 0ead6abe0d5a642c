"""Writes frames as a video, an animation, or separate pictures."""

import subprocess
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from fractions import Fraction
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Literal, cast

import imageio_ffmpeg
import numpy as np
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
    # About the likeness (SSIM) of "veryfast" with 21, in half its time and a file half as large again. `faststart` lets
    # browsers play the file while they load it.
    "mp4": [*("-preset", "superfast", "-crf", "24", "-bf", "0", "-threads", str(THREADS)), "-movflags", "+faststart"],
    # One palette for each frame; a common palette would need all frames first.
    "gif": ["-filter_complex", "split[a][b];[a]palettegen=stats_mode=single[p];[b][p]paletteuse=new=1:dither=none"],
}
_BITEXACT = ["-fflags", "+bitexact", "-flags:v", "+bitexact", "-map_metadata", "-1"]


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
        with _encoder(temporary, path.name, size, fps, kind) as encode:
            for frame in frames:
                encode(frame)

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


class _EncoderEnded(Exception):
    """Raised when the encoder takes no more frames."""


def check_encoder() -> str:
    """Returns the version of ffmpeg.

    Raises:
        UserError: If it is missing, does not run, or cannot encode H.264.
    """
    program = _program()
    try:
        answer = subprocess.run([program, "-encoders"], capture_output=True, timeout=TIMEOUT, check=True)
    except subprocess.CalledProcessError as error:
        raise _broken(program, f"it ends with exit code {error.returncode}") from None
    except (OSError, subprocess.SubprocessError) as error:
        raise _broken(program, str(error)) from None
    if b" libx264 " not in answer.stdout:
        raise _broken(program, "it has no encoder of H.264, libx264")
    return answer.stderr.decode(errors="replace").partition("\n")[0].partition(" Copyright")[0]


def _program() -> str:
    try:
        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except RuntimeError:
        raise UserError("ffmpeg, which encodes videos, is missing: pip install 'imageio[ffmpeg]'") from None


def _broken(program: str, reason: str) -> UserError:
    return UserError(
        f"ffmpeg at {program} does not work: {reason}; set IMAGEIO_FFMPEG_EXE to one that does, or unset it"
    )


@contextmanager
def _encoder(
    path: Path, name: str, size: tuple[int, int], fps: float, kind: VideoFormat
) -> Iterator[Callable[[Bytes], None]]:
    """Yields the function that encodes a frame; `name` is that of the film in errors."""
    mp4, program = kind == "mp4", _program()
    rate, shape = str(Fraction(fps).limit_denominator()), f"{size[0]}x{size[1]}"
    frames = ["-f", "rawvideo", "-vcodec", "rawvideo", "-s", shape, "-pix_fmt", "rgb24", "-r", rate, "-i", "-", "-an"]
    codec = ["-vcodec", "libx264", "-pix_fmt", "yuv420p"] if mp4 else ["-vcodec", "gif", "-pix_fmt", "pal8"]
    film = f"file:{path.absolute()}"  # else a colon in the path would end the name of a protocol
    command = [program, "-y", *frames, *codec, "-v", "error", *_PARAMETERS[kind], *_BITEXACT, film]
    with TemporaryFile() as said:
        try:
            process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=said, start_new_session=True
            )
        except OSError as error:
            raise _broken(program, str(error)) from None
        pipe = cast(IO[bytes], process.stdin)

        def encode(frame: Bytes) -> None:
            try:
                pipe.write(np.ascontiguousarray(frame).data)
            except BrokenPipeError:
                raise _EncoderEnded from None

        try:
            with suppress(_EncoderEnded):  # its exit code tells why
                yield encode
            with suppress(BrokenPipeError):
                pipe.close()
            process.wait()
        except BaseException:
            process.kill()
            process.wait()
            with suppress(BrokenPipeError):
                pipe.close()
            raise
        if process.returncode:
            said.seek(0)
            reason = " ".join(said.read().decode(errors="replace").split())[:200] or f"exit code {process.returncode}"
            raise UserError(f"{name}: ffmpeg cannot encode it ({reason}); `nnql-bullet doctor` checks ffmpeg")
