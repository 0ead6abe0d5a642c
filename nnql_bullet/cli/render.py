"""`nnql-bullet render`."""

import re
from pathlib import Path
from typing import Annotated, Literal

import tyro

from nnql_bullet.cli.console import progress, say
from nnql_bullet.errors import UserError
from nnql_bullet.render import filming
from nnql_bullet.render.camera import CameraName
from nnql_bullet.render.filming import FPS, SIZE
from nnql_bullet.render.renderers import RendererName
from nnql_bullet.render.video import VideoFormat


def render(
    recording: Annotated[Path, tyro.conf.arg(metavar="RECORDING|RUN|RULE")],
    /,
    world: Annotated[str | None, tyro.conf.arg(metavar="NAME|FILE")] = None,
    seed: Annotated[int | None, tyro.conf.arg(metavar="S")] = None,
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    camera: CameraName = "chase",
    size: Annotated[str, tyro.conf.arg(metavar="WxH")] = f"{SIZE[0]}x{SIZE[1]}",
    fps: Annotated[float, tyro.conf.arg(metavar="F")] = FPS,
    speed: Annotated[float, tyro.conf.arg(metavar="X")] = 1.0,
    begin: Annotated[float, tyro.conf.arg(metavar="S")] = 0.0,
    end: Annotated[float | None, tyro.conf.arg(metavar="S")] = None,
    renderer: Literal["auto"] | RendererName = "auto",
    format: VideoFormat | None = None,
    frames: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    sheet: Annotated[Path | None, tyro.conf.arg(metavar="FILE.png")] = None,
    workers: Annotated[int | None, tyro.conf.arg(metavar="W")] = None,
) -> int:
    """Draw a recorded drive as a video: what was recorded, without simulating anything again.

    It shows the vehicle as it went, what its eight sensors read, the values of the five turns and which one was taken,
    safe and non-safe states, and how it ended. Nothing of this needs a display or a graphics card.

    For example:

        nnql-bullet drive runs/paper-0 --world cover_10 --seed 4
        nnql-bullet render runs/paper-0/drives/cover_10-4/trajectory.npz
        nnql-bullet render runs/paper-0 --world traps --seed 1 --camera split --speed 2 --out traps.mp4
        nnql-bullet render drive.npz --format gif --size 640x360 --fps 15 --begin 20 --end 30
        nnql-bullet render drive.npz --sheet sheet.png

    Args:
        recording: A trajectory.npz, or what `drive` takes: a run folder, policy file or rule, which is then driven
            and recorded first, as `drive` does.
        world: Of that drive; see `drive`.
        seed: Of that drive; default 0.
        out: The video; default beside the recording, under its name. With --frames or --sheet alone there is none.
        camera: Behind the vehicle (chase, the default), the whole arena from above (top), round the vehicle (orbit), or
            chase and top side by side (split).
        size: Of the picture, even numbers of pixels; default 1280x720.
        fps: Frames a second; default 30.
        speed: How much faster than it happened; default 1.
        begin: Where in the drive to begin [s].
        end: Where to end [s]; default with the drive.
        renderer: What draws the solid things: EGL where it works and pictures are larger than 640x360, else
            TinyRenderer (auto, the default), or either; or vtk, for pictures that go into papers: finer, and with the
            light as it falls, but some 20 times slower. Needs the extra: pip install 'nnql-bullet[render]'.
        format: MP4 (H.264, plays in browsers) or GIF; default by the name given with --out, else mp4.
        frames: Leave every frame as a PNG in this folder.
        sheet: Leave the key moments of the drive as one picture.
        workers: Processes that draw; default one a core. The result does not depend on it.
    """
    picture = _size(size)
    filming.check_pictures(picture, fps, speed)
    kind = filming.video_format(out, format)
    if recording.suffix == ".npz":
        if world is not None or seed is not None:
            raise UserError("--world and --seed are for a policy that is to be driven; this is a recording")
        path = recording
    else:
        path = _driven(recording, world, seed or 0)
    video = out or (None if frames or sheet else path.with_suffix(f".{kind}"))
    with progress() as show:
        filming.render(
            path,
            video,
            camera=camera,
            size=picture,
            fps=fps,
            speed=speed,
            begin=begin,
            end=end,
            renderer=renderer,
            kind=kind,
            pictures=frames,
            sheet=sheet,
            workers=workers,
            on_progress=show,
        )
    for what, where in (("video", video), ("frames", frames), ("sheet", sheet)):
        if where:
            say(f"{what}: {where}")
    return 0


def _driven(policy: Path, world: str | None, seed: int) -> Path:
    """Drives a policy as the verb `drive` does; returns the file of the recording."""
    from nnql_bullet.driving import RECORDING, drive, drive_folder  # all that drives; to draw, none of it is needed

    recording = drive(policy, world=world, seed=seed)
    folder = drive_folder(policy, recording.world.name, seed)
    folder.mkdir(parents=True, exist_ok=True)
    recording.save(folder / RECORDING)
    return folder / RECORDING


def _size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    if not match:
        raise UserError(f"--size: give WIDTHxHEIGHT, not '{text}'")
    return int(match[1]), int(match[2])
