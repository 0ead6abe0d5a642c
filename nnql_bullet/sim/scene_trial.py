"""Tells whether PyBullet's renderers work on this machine.

PyBullet is loaded in the process that tries them, and there alone.
"""

import os
from functools import cache
from subprocess import DEVNULL, TimeoutExpired, run
from typing import Literal

import numpy as np

from nnql_bullet.machine import may_start_processes, python_command

SceneKind = Literal["tiny", "egl", "window"]
"""TinyRenderer, which works everywhere; EGL, which is faster; or a window."""

NO_EGL = "EGL does not work here; choose the renderer 'tiny', or install EGL (Debian: libegl1)"


@cache
def works(kind: SceneKind, timeout: float = 60.0) -> bool:
    """Whether a renderer works on this machine. Another process tries it, because a bad driver may end the process.

    A process that may have no children takes TinyRenderer, which needs no driver.

    Args:
        kind: Of renderer, or a window.
        timeout: Longest time for the trial [s].
    """
    if not may_start_processes():
        return kind == "tiny"
    # A new interpreter, as multiprocessing would run the caller's script again.
    program = f"from {__name__} import draw_something; draw_something({kind!r})"
    try:
        return run(python_command(program), timeout=timeout, stdin=DEVNULL).returncode == 0
    except TimeoutExpired:
        return False


def draw_something(kind: SceneKind) -> None:
    """Draws a box; whether the process lives tells whether the renderer works."""
    for stream in (1, 2):
        os.dup2(os.open(os.devnull, os.O_WRONLY), stream)  # the exit code reports a failure
    from nnql_bullet.sim.bullet_scene import BulletScene

    scene = BulletScene(kind)
    scene.add_box((0.5, 0.5, 0.5), (1.0, 0.0, 0.0))
    ahead = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, -3], [0, 0, 0, 1]])
    lens = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, -1.2, -2.2], [0, 0, -1, 0]])
    if np.ptp(scene.picture(ahead, lens, 32, 32)[1]) == 0:
        raise RuntimeError("the picture is empty")
