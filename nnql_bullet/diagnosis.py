"""Checks of the installation for `doctor`: whether the engines, the encoder and the renderers work here."""

import shutil
import subprocess
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from math import cos, hypot, sin

import numpy as np

from nnql_bullet import paper
from nnql_bullet.errors import UserError
from nnql_bullet.experiment import Experiment
from nnql_bullet.geometry import placed, ray_distances
from nnql_bullet.render.video import check_encoder
from nnql_bullet.run_config import RunConfig
from nnql_bullet.sensing import ray_angles
from nnql_bullet.sim import bullet
from nnql_bullet.sim.bullet_scene import works

PROGRAM_TIMEOUT = 60.0
"""Time limit for the answer of a program or renderer [s]."""


@dataclass(frozen=True, slots=True)
class Finding:
    """Result of a check, with advice if it failed."""

    ok: bool
    text: str
    needed: bool = True
    """Whether the package cannot work without it."""


def check_pybullet() -> Finding:
    """Checks that PyBullet supports NumPy, which fast images need."""
    found = f"pybullet {version('pybullet')}, numpy {version('numpy')}"
    if not bullet.has_numpy():
        return Finding(False, f"{found}: built without NumPy; reinstall it from its wheel: pip install pybullet")
    return Finding(True, found)


def check_drive() -> Finding:
    """Drives four seconds straight ahead and compares the position with the expected one."""
    experiment = Experiment(RunConfig(world="empty"))
    world, periods = experiment.world(0), 8
    with closing(experiment.simulator) as simulator:
        simulator.reset({0: world})
        for _ in range(periods):
            motion, _ = simulator.advance(np.zeros(1))
    expected = periods * experiment.config.drive.decision_period * experiment.config.drive.speed
    ahead = (world.start.x + expected * cos(world.start.yaw), world.start.y + expected * sin(world.start.yaw))
    off = hypot(*(motion.pose[0, :2] - ahead))
    text = f"{expected:g} m straight ahead in contact physics, {1000 * off:.1f} mm off"
    return Finding(off < 0.02, text if off < 0.02 else f"{text}: more than 20 mm; report this with your machine's name")


def check_rays() -> Finding:
    """Compares the 72 rays with the analytic distances to the same boxes."""
    experiment = Experiment(RunConfig(world="cover_20"))
    world = experiment.world(0)
    with closing(experiment.simulator) as simulator:
        _, (found,) = simulator.reset({0: world})
    origin = placed(world.start, *experiment.vehicle.sensor[:2])
    expected = ray_distances(origin, ray_angles() + world.start.yaw, world.solids, paper.SENSOR_RANGE)
    off = float(np.abs(found - expected).max())
    text = f"72 rays within {1000 * off:.2f} mm of the analytic distance"
    well = off < 0.002
    return Finding(well, text if well else f"{text}: more than 2 mm; report this with your machine's name")


def check_mujoco() -> Finding:
    """Checks that MuJoCo, the second engine of contact physics, is installed."""
    try:
        return Finding(True, f"mujoco {version('mujoco')}")
    except PackageNotFoundError:
        return Finding(False, "the second engine is not installed: pip install 'nnql-bullet[mujoco]'", needed=False)


def check_ffmpeg() -> Finding:
    """Checks that ffmpeg starts; it encodes videos."""
    try:
        return Finding(True, check_encoder())
    except UserError as error:
        return Finding(False, str(error), needed=False)


def check_chromium() -> Finding:
    """Checks that Chromium starts; a test opens the HTML report in it."""
    program = shutil.which("chromium")
    if program is None:
        return Finding(False, "not found; only a test of the HTML report needs it (Debian: chromium)", needed=False)
    try:
        answer = subprocess.run(
            [program, "--version"], capture_output=True, text=True, timeout=PROGRAM_TIMEOUT, check=True
        )
    except (OSError, subprocess.SubprocessError):
        return Finding(False, "does not start; only a test of the HTML report needs it", needed=False)
    return Finding(True, answer.stdout.strip().split(" built on")[0])


def check_renderer() -> Finding:
    """Checks that EGL or TinyRenderer draws a picture."""
    if works("egl", PROGRAM_TIMEOUT):
        return Finding(True, "EGL (hardware or Mesa)")
    if works("tiny", PROGRAM_TIMEOUT):
        return Finding(True, "TinyRenderer; for smoother and faster pictures install EGL (Debian: libegl1)")
    return Finding(False, "neither EGL nor TinyRenderer draws a picture; reinstall pybullet", needed=False)


CHECKS: dict[str, Callable[[], Finding]] = {
    "PyBullet": check_pybullet,
    "MuJoCo": check_mujoco,
    "drive": check_drive,
    "rays": check_rays,
    "ffmpeg": check_ffmpeg,
    "renderer": check_renderer,
    "Chromium": check_chromium,
}
