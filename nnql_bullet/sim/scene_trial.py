"""Tells whether PyBullet's window opens on this machine.

PyBullet is loaded in the process that tries it, and there alone.
"""

import os
from functools import cache
from subprocess import DEVNULL, TimeoutExpired, run

from nnql_bullet.machine import may_start_processes, python_command


@cache
def a_window_opens(timeout: float = 60.0) -> bool:
    """Whether a window opens. Another process tries it, because without a display the engine ends the process.

    Args:
        timeout: Longest time for the trial [s].
    """
    if not may_start_processes():
        return False
    # A new interpreter, as multiprocessing would run the caller's script again.
    program = f"from {__name__} import show_something; show_something()"
    try:
        return run(python_command(program), timeout=timeout, stdin=DEVNULL).returncode == 0
    except TimeoutExpired:
        return False


def show_something() -> None:
    """Shows a box; whether the process lives tells whether a window opens."""
    for stream in (1, 2):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream)  # the exit code reports a failure
    from nnql_bullet.sim.bullet_scene import BulletScene

    BulletScene().add_box((0.5, 0.5, 0.5), (1.0, 0.0, 0.0))
