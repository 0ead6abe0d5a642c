"""`nnql-bullet view`."""

from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import tyro

from nnql_bullet.cli.console import say
from nnql_bullet.errors import UserError, missing_library
from nnql_bullet.recording import Recording, load_recording
from nnql_bullet.text import shell_line


def view(
    recording: Annotated[Path, tyro.conf.arg(metavar="RECORDING")],
    /,
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> int:
    """Put a recorded drive on a time line, in a file for the Rerun viewer, or for Foxglove and ROS 2.

    It shows the world and the vehicle in 3D with its path, rays and sectors. Curves show what the policy read, its
    values and actions, clearance, heading error, wheel speeds and rewards; texts show contacts and the ending. A file
    for Foxglove has the same drive as ROS 2 messages: scans, odometry, frames and markers.

    It needs an extra: pip install 'nnql-bullet[viz]' for .rrd, 'nnql-bullet[ros]' for .mcap. No viewer is started and
    nothing is sent. The viewer Rerun itself counts its use unless told: rerun analytics disable

    For example:

        nnql-bullet drive runs/paper-0 --world cover_10 --seed 4 --out drive
        nnql-bullet view drive/trajectory.npz
        rerun drive/trajectory.rrd
        nnql-bullet view drive/trajectory.npz --out drive/trajectory.mcap

    Args:
        recording: A trajectory.npz that `drive` left, or one that `evaluate` or `gap` kept of a drive.
        out: The file, whose name ends in .rrd or .mcap; default .rrd beside the recording.
    """
    loaded = load_recording(recording)
    path = out or recording.with_suffix(".rrd")
    if path.suffix not in _OPEN or path.is_dir():
        raise UserError(
            f"{path}: give --out the name of a file that ends in .rrd or .mcap, which is how the viewers know it"
        )
    write = _writer(path.suffix)
    path.parent.mkdir(parents=True, exist_ok=True)
    write(loaded, path)
    say(f"time line: {path}")
    say(f"open it: {_OPEN[path.suffix].format(shell_line(str(path)))}")
    return 0


_OPEN = {".rrd": "rerun {}", ".mcap": "in Foxglove, or: ros2 bag play {}"}
"""How a file is opened, by its suffix."""


def _writer(suffix: str) -> Callable[[Recording, Path], None]:
    """What writes such files.

    Raises:
        UserError: If its library is not installed.
    """
    if suffix == ".rrd":
        try:
            from nnql_bullet.reports.rrd import write_rrd
        except ImportError:
            raise missing_library("Rerun", "viz") from None
        return write_rrd
    try:
        from nnql_bullet.reports.mcap import write_mcap
    except ImportError:
        raise missing_library("mcap or rosbags", "ros") from None
    return write_mcap
