"""Expands xacros, the macros in which ROS writes URDFs, within limits of time and memory."""

import json
import signal
import subprocess
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path

from nnql_bullet.errors import UserError, missing_library
from nnql_bullet.files import is_file
from nnql_bullet.machine import python_command
from nnql_bullet.vehicle.description import MOST_BYTES

MOST_COMPUTING = 10.0
"""Longest processor time that a xacro may take [s]."""
MOST_WAITING = 30.0
"""Longest time that it may take, such as for reading a pipe [s]."""
MOST_MEMORY = 2_000_000_000
"""Largest memory that it may need [bytes]."""
_PROGRAM = "from nnql_bullet.vehicle.xacro_process import answer; answer()"


def expand(path: Path, arguments: Mapping[str, str]) -> tuple[str, list[str]]:
    """Expands a xacro, in a process of its own that ends at the limits of this module; see `xacro_process`.

    What a xacro may do within them is to read other files and environment variables.

    Args:
        path: The xacro.
        arguments: Values of its arguments by name.

    Returns:
        The URDF, and what xacro warns of.

    Raises:
        UserError: If xacrodoc is not installed, or the file cannot be expanded within the limits.
    """
    if not is_file(path):
        raise UserError(f"{path}: there is no such file")
    if find_spec("xacrodoc") is None:
        raise missing_library("xacrodoc, which expands xacros,", "robots")
    limits = {"computing": MOST_COMPUTING, "memory": MOST_MEMORY, "length": MOST_BYTES}
    request = json.dumps({"path": str(path), "arguments": dict(arguments), **limits})
    try:
        ended = subprocess.run(
            python_command(_PROGRAM),
            input=request.encode(),
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            timeout=MOST_WAITING,
        )
    except subprocess.TimeoutExpired:
        raise _too_long(path, MOST_WAITING) from None
    except OSError as error:
        raise UserError(f"{path}: Python, which expands it, does not start: {error.strerror}") from None
    if ended.returncode == -signal.SIGXCPU:
        raise _too_long(path, MOST_COMPUTING)
    if ended.returncode:
        raise UserError(f"{path}: xacro cannot expand it: its process ended with {ended.returncode}")
    answer = json.loads(ended.stdout)
    if "refused" in answer:
        raise UserError(f"{path}: xacro cannot expand it: {answer['refused']}")
    return answer["urdf"], answer["warned"]


def _too_long(path: Path, limit: float) -> UserError:
    return UserError(
        f"{path}: xacro cannot expand it: it takes longer than {limit:g} s; look in it for loops and powers of large "
        "numbers, macros that call others many times, and files that are pipes"
    )
