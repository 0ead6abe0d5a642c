"""Runs a verb and strikes it at a file operation. A fork server imports this once for all victims."""

import errno
import os
import signal
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any, Literal

from nnql_bullet import session
from nnql_bullet.cli import main
from nnql_bullet.cli.parser import VERBS, verb_of
from nnql_bullet.sim.kinematic import KinematicSimulator
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.urdf import load_vehicle

Kind = Literal["none", "kill", "term", "int_twice", "term_twice", "hup", "pipe", "full", "read_only"]
_SIGNALS = {
    "kill": [signal.SIGKILL],
    "term": [signal.SIGTERM],
    "hup": [signal.SIGHUP],
    "int_twice": [signal.SIGINT] * 2,
    "term_twice": [signal.SIGTERM] * 2,
}
_WRITING = {"os.rename", "os.mkdir", "os.truncate", "os.chmod"}
_REMOVING = {"os.remove", "os.rmdir"}


@dataclass(frozen=True)
class Blow:
    """What happens to a victim, and at which file operation, counted from 1."""

    kind: Kind
    operation: int = 0


def run(arguments: list[str], place: Path, blow: Blow) -> None:
    """Runs the verb in `place`/work; leaves what it prints, and the number of its file operations, in `place`."""
    os.chdir(place / "work")
    os.environ["TMPDIR"] = str(place / "tmp")
    log = os.open(place / "log", os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    for stream in (1, 2):
        os.dup2(log, stream)
    session.SAVE_EVERY = 0.0  # a checkpoint after every episode
    hook, count = _hook(place / "work", blow)
    sys.addaudithook(hook)
    sys.argv = ["nnql-bullet", *arguments]
    code = main()
    sys.stdout.flush()
    (place / "count").write_text(str(count()))
    os._exit(code)


def _hook(folder: Path, blow: Blow) -> tuple[Callable[[str, Any], None], Callable[[], int]]:
    """An audit hook that strikes at the operation in the folder, and what counts them."""
    count = 0
    within = str(folder)

    def strike(event: str, arguments: Any) -> None:
        nonlocal count
        if event == "open":
            writes = isinstance(arguments[2], int) and arguments[2] & (os.O_WRONLY | os.O_RDWR | os.O_CREAT)
        else:
            writes = event in _WRITING
        if not writes and event not in _REMOVING:
            return
        path = arguments[0]
        if isinstance(path, int):
            return
        if event in _REMOVING and arguments[1] != -1:  # relative to an open folder
            path = os.path.join(os.readlink(f"/proc/self/fd/{arguments[1]}"), os.fsdecode(path))
        if not os.path.abspath(os.fsdecode(path)).startswith(within):
            return
        count += 1
        if blow.kind in ("full", "read_only"):
            if count >= blow.operation and (writes or blow.kind == "read_only"):
                number = errno.ENOSPC if blow.kind == "full" else errno.EROFS
                raise OSError(number, os.strerror(number), os.fsdecode(path))
        elif count == blow.operation and blow.kind == "pipe":
            reader, writer = os.pipe()
            os.close(reader)
            for stream in (1, 2):
                os.dup2(writer, stream)
        elif count == blow.operation:
            for number in _SIGNALS[blow.kind]:
                os.kill(os.getpid(), number)

    return strike, lambda: count


_SLOW_TO_IMPORT = ("matplotlib.backends.backend_agg", "pybullet", "scipy.ndimage", "torch._dynamo", "tyro", "typeguard")

for _verb in VERBS:
    verb_of(_verb)
for _module in _SLOW_TO_IMPORT:
    import_module(_module)
KinematicSimulator(load_vehicle("tricycle"), DriveOptions(), 1).close()
