"""What this machine allows this process: cores, children, a folder for what may be lost, streams, variables, wheels."""

import multiprocessing
import os
import stat
import sys
import tempfile
import warnings
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import cache
from math import ceil
from pathlib import Path


def allowed_cores(root: Path = Path("/")) -> int:
    """The number of processor cores that this process may use, at least 1.

    It is limited by the machine's cores, the process's affinity (`taskset`, Slurm) and the quotas of its control
    groups (containers), of version 1 or 2, rounded up.

    Args:
        root: Root of the file system; another one for tests.
    """
    try:
        cores = float(len(os.sched_getaffinity(0)))
    except AttributeError:  # systems without affinities
        cores = float(os.cpu_count() or 1)  # noqa: TID251
    return max(ceil(min([cores, *_quotas(root)])), 1)


def pybullet_package() -> str | None:
    """The package on PyPI whose wheels bring the module `pybullet` to this Python; None if none does."""
    if sys.version_info < (3, 12):
        return "pybullet"
    return "pybullet-arm64" if sys.version_info < (3, 14) else None  # whose wheels are not for ARM alone


def may_start_processes() -> bool:
    """Whether this process may have children: daemonic ones, such as workers of `multiprocessing.Pool`, may not."""
    return not multiprocessing.current_process().daemon


def python_command(program: str) -> list[str]:
    """The command that runs a program in another interpreter like this one, which finds the same modules.

    It does not look for them in the working directory, as `python -c` does, unless this one does.
    """
    return [sys.executable, "-c", f"import sys; sys.path[:] = {[str(place) for place in sys.path]!a}; {program}"]


def _quotas(root: Path) -> list[float]:
    """The quotas of processor time of this process's control groups and of their parents [cores]."""
    found = []
    for line in _text(root / "proc/self/cgroup").splitlines():
        _, controllers, group = line.split(":", 2)
        folders = ["", controllers] if not controllers else [controllers] if "cpu" in controllers.split(",") else []
        for folder in folders:
            place = root / "sys/fs/cgroup" / folder
            parts = Path(group.lstrip("/")).parts
            for depth in range(len(parts) + 1):  # in a container the group itself may be out of sight
                found.append(_quota(place.joinpath(*parts[:depth])))
    return [quota for quota in found if quota]


def _quota(folder: Path) -> float | None:
    """The quota of one control group [cores]; None if it has none."""
    limit = _text(folder / "cpu.max").split() or [
        _text(folder / f"cpu.cfs_{name}_us").strip() for name in ("quota", "period")
    ]
    try:
        quota, period = map(int, limit)
    except ValueError:  # "max", or no such files
        return None
    return quota / period if quota > 0 and period > 0 else None


def _text(file: Path) -> str:
    try:
        return file.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


@cache
def private_folder() -> Path | None:
    """The folder in the system's temporary folder that belongs to this user alone; None if there can be none.

    It serves as a cache where the home cannot be written to. Its name is known, so it is used only if it is a folder
    of this user's own to which no other user can write.
    """
    try:
        user = os.getuid()
        folder = Path(tempfile.gettempdir()) / f"nnql-bullet-{user}"
        folder.mkdir(mode=0o700, exist_ok=True)
        its = folder.lstat()
    except (AttributeError, OSError):  # systems without numbers of users; no folder that can be written to
        return None
    own = stat.S_ISDIR(its.st_mode) and its.st_uid == user and not its.st_mode & 0o022
    return folder if own and os.access(folder, os.W_OK | os.X_OK) else None


def cache_folder() -> Path | None:
    """The folder of this package in the user's cache, else `private_folder`; None if there can be none."""
    base = Path(os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache"))
    folder = base / "nnql-bullet"
    try:
        if base.is_absolute():  # not so without a home
            folder.mkdir(parents=True, exist_ok=True)
            if os.access(folder, os.W_OK | os.X_OK):
                return folder
    except OSError:
        pass
    return private_folder()


@contextmanager
def open_streams() -> Iterator[None]:
    """Opens the null device in place of closed standard streams (`>&-`), for this process and its children.

    Otherwise the next file that is opened takes a stream's number and gets what is printed.
    """
    opened = []
    while (one := os.open(os.devnull, os.O_RDWR)) <= 2:
        os.set_inheritable(one, True)
        opened.append(one)
    os.close(one)
    try:
        yield
    finally:
        for one in opened:
            os.close(one)


@contextmanager
def warned_once() -> Iterator[None]:
    """Ignores warnings in a worker process, for an import of which its parent has warned."""
    with warnings.catch_warnings():
        if multiprocessing.current_process().name != "MainProcess":  # its parent is not known before it has imported
            warnings.simplefilter("ignore")
        yield


@contextmanager
def variable(name: str, value: str) -> Iterator[None]:
    """Sets an environment variable that is not set, and takes it away again."""
    if name in os.environ:
        yield
        return
    os.environ[name] = value
    try:
        yield
    finally:
        os.environ.pop(name, None)


def one_thread_for_mesa() -> AbstractContextManager[None]:
    """Lets Mesa's software renderer, while it starts, choose one thread; several processes draw at a time."""
    return variable("LP_NUM_THREADS", "1")
