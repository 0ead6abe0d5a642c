"""`nnql-bullet view`."""

from pathlib import Path
from typing import Annotated

import tyro

from nnql_bullet.cli.console import say
from nnql_bullet.errors import UserError
from nnql_bullet.recording import load_recording
from nnql_bullet.text import shell_line


def view(
    recording: Annotated[Path, tyro.conf.arg(metavar="RECORDING")],
    /,
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> int:
    """Put a recorded drive on a time line, in a file for the Rerun viewer.

    It shows the world and the vehicle in 3D with its path, rays and sectors. Curves show what the policy read, its
    values and actions, clearance, heading error, wheel speeds and rewards; texts show contacts and the ending. It needs
    the extra: pip install 'nnql-bullet[viz]'. No viewer is started and nothing is sent. The viewer itself counts its
    use unless told: rerun analytics disable

    For example:

        nnql-bullet drive runs/paper-0 --world cover_10 --seed 4 --out drive
        nnql-bullet view drive/trajectory.npz
        rerun drive/trajectory.rrd

    Args:
        recording: A trajectory.npz that `drive` left, or one that `evaluate` or `gap` kept of a drive.
        out: The file, whose name ends in .rrd; default beside the recording.
    """
    loaded = load_recording(recording)
    path = out or recording.with_suffix(".rrd")
    if path.suffix != ".rrd" or path.is_dir():
        raise UserError(f"{path}: give --out the name of a file that ends in .rrd, which is how the viewer knows it")
    try:
        from nnql_bullet.reports.rrd import write_rrd
    except ImportError:
        raise UserError("Rerun is not installed; install it with: pip install 'nnql-bullet[viz]'") from None
    path.parent.mkdir(parents=True, exist_ok=True)
    write_rrd(loaded, path)
    say(f"time line: {path}")
    say(f"open it: {shell_line('rerun', str(path))}")
    return 0
