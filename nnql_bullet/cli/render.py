"""`nnql-bullet render`."""

import re
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

import tyro

from nnql_bullet.cli.console import progress, say
from nnql_bullet.cli.shared import DriveKeys, Place, PlaceFlags
from nnql_bullet.commands import flags
from nnql_bullet.errors import UserError
from nnql_bullet.render import filming
from nnql_bullet.render.camera import CameraName
from nnql_bullet.render.filming import FPS, SIZE
from nnql_bullet.render.renderers import RendererName, check_renderer
from nnql_bullet.render.video import VideoFormat, check_encoder


def render(
    recording: Annotated[Path, tyro.conf.arg(metavar="RECORDING|RUN|RULE")],
    /,
    world: Annotated[str | None, tyro.conf.arg(metavar="NAME|FILE")] = None,
    start: Annotated[Place, tyro.conf.arg(metavar="X,Y[,YAW]")] = None,
    target: Annotated[Place, tyro.conf.arg(metavar="X,Y")] = None,
    seed: Annotated[int | None, tyro.conf.arg(metavar="S")] = None,
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    camera: CameraName = "chase",
    size: Annotated[str, tyro.conf.arg(metavar="WxH")] = f"{SIZE[0]}x{SIZE[1]}",
    fps: Annotated[float, tyro.conf.arg(metavar="F")] = FPS,
    speed: Annotated[float, tyro.conf.arg(metavar="X")] = 1.0,
    begin: Annotated[float, tyro.conf.arg(metavar="S")] = 0.0,
    end: Annotated[float | None, tyro.conf.arg(metavar="S")] = None,
    renderer: RendererName = "raster",
    format: VideoFormat | None = None,
    frames: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    sheet: Annotated[Path | None, tyro.conf.arg(metavar="FILE.png")] = None,
    workers: Annotated[int | None, tyro.conf.arg(metavar="W")] = None,
    keys: DriveKeys = MappingProxyType({}),
) -> int:
    """Draw a recorded drive as a video; nothing is simulated again.

    It shows the vehicle as it went, what its eight sensors read, the values of the five turns and which one was taken,
    safe and non-safe states, and how it ended. It needs no display and no graphics card.

    For example:

        nnql-bullet render runs/paper-0 --world traps --seed 1 --camera split --speed 2 --out traps.mp4
        nnql-bullet render drive.npz --format gif --size 640x360 --fps 15 --begin 20 --end 30
        nnql-bullet render drive.npz --sheet sheet.png

    Args:
        recording: A trajectory.npz, or a policy as `drive` takes it, which is then driven and recorded first.
        world: World of that drive; see `drive`.
        start: Start, at rest, in the frame of that world's map [m, radians], in place of its own.
        target: Target in that frame, in place of its own.
        seed: Seed of that drive's world; default 0.
        out: The video; default beside the recording. With --frames or --sheet alone there is none.
        camera: Behind the vehicle, over the whole arena, round the vehicle, or two views side by side.
        size: Width and height of the picture, even numbers of pixels.
        fps: Frames a second.
        speed: Factor by which the video is faster than the drive.
        begin: Where in the drive to begin [s].
        end: Where to end [s]; default with the drive.
        renderer: vtk has finer light and shadows, for papers, and is much slower; it needs the extra:
            pip install 'nnql-bullet[render]'.
        format: Default by the name given with --out, else mp4.
        frames: Leave every frame as a PNG in this folder.
        sheet: Leave the key moments of the drive as one picture.
        workers: Frames drawn at a time; default one a core. It does not change the result.
        keys: Values of that drive in place of the policy's own; its speed is --drive.speed here.
    """
    picture = _size(size)
    filming.check_pictures(picture, fps, speed)
    kind = filming.video_format(out, format)
    check_renderer(renderer)
    if out or not (frames or sheet):
        check_encoder()
    if recording.suffix == ".npz":
        given = flags({"world": world, "start": start, "target": target, "seed": seed, **keys})
        if given:
            raise UserError(f"{given[0]} is for a policy that is to be driven; this is a recording")
        path = recording
    else:
        path = _driven(recording, world, seed or 0, {"start": start, "target": target}, keys)
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


def _driven(policy: Path, world: str | None, seed: int, ends: Mapping[str, Any], keys: Mapping[str, Any]) -> Path:
    """Drives a policy as the verb `drive` does; returns the file of the recording."""
    from nnql_bullet.cli.kept import drive_folder, keep  # all that drives; to draw, none of it is needed
    from nnql_bullet.driving import drive
    from nnql_bullet.setting import Setting

    asked = PlaceFlags(**ends, keys=keys).asked
    recording = drive(policy, world=world, seed=seed, **asked)
    return keep(recording, drive_folder(policy, recording.world.name, seed, Setting.of(asked)))["recording"]


def _size(text: str) -> tuple[int, int]:
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text)
    if not match:
        raise UserError(f"--size: give WIDTHxHEIGHT, not '{text}'")
    return int(match[1]), int(match[2])
