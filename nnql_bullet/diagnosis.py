"""Checks for `doctor`: this machine, and whether the engines and the encoder work here.

Each check imports what it needs: where a library does not load, the others still say what they find.
"""

import locale
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass
from importlib import import_module
from importlib.metadata import packages_distributions, version
from math import cos, hypot, sin
from pathlib import Path

from nnql_bullet.errors import UserError, failed_import
from nnql_bullet.machine import allowed_cores, pybullet_package

GIGABYTE = 1e9
"""[bytes]"""
PROGRAM_TIMEOUT = 60.0
"""Time limit for the answer of a program [s]."""


@dataclass(frozen=True, slots=True)
class Finding:
    """Result of a check, with advice if it failed."""

    ok: bool
    text: str
    needed: bool = True
    """Whether the package cannot work without it."""


def check_platform() -> Finding:
    """Checks that this is a platform on which the package is tested."""
    here = f"{platform.system()} {platform.machine()}"
    text = f"{platform.python_implementation()} {platform.python_version()}, {here}"
    well = here == "Linux x86_64"
    return Finding(well, text if well else f"{text}; tested on Linux x86_64 alone", needed=False)


def check_pybullet() -> Finding:
    """Checks that one package alone brings PyBullet, and that it loads."""
    packages, right = _packages("pybullet"), pybullet_package()
    found = f"{_listed(packages)}, numpy {version('numpy')}"
    if len(packages) > 1:
        remedy = f"pip uninstall {' '.join(packages)}, then pip install {right}"
        return Finding(False, f"{found}: they overwrite each other; {remedy}")
    try:
        from nnql_bullet.sim import bullet
    except UserError as error:
        return Finding(False, str(error), needed=right is not None)
    return Finding(True, found if bullet.has_numpy() else f"{found}; built without NumPy, so that pictures take longer")


def check_drive() -> Finding:
    """Drives four seconds straight ahead and compares the position with the expected one."""
    import numpy as np

    from nnql_bullet.experiment import Experiment
    from nnql_bullet.jit import announced
    from nnql_bullet.run_config import RunConfig

    experiment = Experiment(RunConfig(world="empty"))
    world, periods = experiment.world(0), 8
    with announced(), closing(experiment.simulator) as simulator:
        simulator.reset({0: world})
        for _ in range(periods):
            motion, _ = simulator.advance(np.zeros(1))
    expected = periods * experiment.config.drive.decision_period * experiment.config.drive.speed
    ahead = (world.start.x + expected * cos(world.start.yaw), world.start.y + expected * sin(world.start.yaw))
    off = hypot(*(motion.pose[0, :2] - ahead))
    text = f"{expected:g} m straight ahead in contact physics, {1000 * off:.1f} mm off"
    return Finding(off < 0.02, text if off < 0.02 else f"{text}: more than 20 mm; report this with your machine's name")


def check_rays() -> Finding:
    """Compares the rays with the analytic distances to the same boxes."""
    from nnql_bullet.experiment import Experiment
    from nnql_bullet.geometry import placed, ray_distances
    from nnql_bullet.run_config import RunConfig

    experiment = Experiment(RunConfig(world="cover_20"))
    world = experiment.world(0)
    with closing(experiment.simulator) as simulator:
        _, (found,) = simulator.reset({0: world})
    sensor = experiment.vehicle.sensor
    origin = placed(world.start, *sensor.position[:2])
    expected = ray_distances(origin, sensor.angles + world.start.yaw, world.solids, sensor.range)
    off = float(abs(found - expected).max())
    text = f"{sensor.rays} rays within {1000 * off:.2f} mm of the analytic distance"
    well = off < 0.002
    return Finding(well, text if well else f"{text}: more than 2 mm; report this with your machine's name")


def check_mujoco() -> Finding:
    """Checks that MuJoCo, the second engine of contact physics, loads, and that its packages are of one version."""
    advice = "pip install --force-reinstall 'nnql-bullet[mujoco]'"
    packages = _packages("mujoco")
    if not packages:
        return Finding(False, "the second engine is not installed: pip install 'nnql-bullet[mujoco]'", needed=False)
    if len(set(packages.values())) > 1:
        return Finding(False, f"{_listed(packages)}: packages of several versions; {advice}", needed=False)
    try:
        import_module("nnql_bullet.sim.mujoco")
    except (ImportError, OSError, AttributeError) as error:
        return Finding(False, f"{_listed(packages)}: does not load ({_line(error)}); {advice}", needed=False)
    return Finding(True, _listed(packages))


def check_caches() -> Finding:
    """Checks that compiled code and fonts can be kept on disk."""
    import matplotlib

    from nnql_bullet.geometry import wrap_angle

    compiled = wrap_angle.stats.cache_path  # type: ignore[attr-defined]  # a function that Numba has compiled
    if compiled is None:
        return Finding(False, "none can be written to, so each start compiles; set NUMBA_CACHE_DIR", needed=False)
    fonts = Path(matplotlib.get_cachedir())
    if not os.access(fonts, os.W_OK):
        return Finding(False, f"{fonts} cannot be written to; set MPLCONFIGDIR", needed=False)
    return Finding(True, f"{compiled}, {fonts}")


def check_locale() -> Finding:
    """Checks that paths with any characters can be named."""
    numbers, encoding = locale.setlocale(locale.LC_NUMERIC), sys.getfilesystemencoding()
    text = f"numbers {numbers}, file names {encoding}"
    well = encoding == "utf-8"
    return Finding(well, text if well else f"{text}; set PYTHONUTF8=1 for names beyond it", needed=False)


def check_cores() -> Finding:
    """Checks how many of the cores this process may use."""
    allowed, present = allowed_cores(), os.cpu_count() or 1  # noqa: TID251
    return Finding(True, f"{allowed} of {present} may be used; that many workers are the default")


def check_disk() -> Finding:
    """Checks the room in the working folder and in the folder for temporary files."""
    free = {place: shutil.disk_usage(place).free / GIGABYTE for place in (Path.cwd(), Path(tempfile.gettempdir()))}
    text = ", ".join(f"{room:.1f} GB free in {place}" for place, room in free.items())
    well = min(free.values()) > 1.0
    return Finding(well, text if well else f"{text}; a long training and its films want more than 1 GB", needed=False)


def check_ffmpeg() -> Finding:
    """Checks that ffmpeg, which encodes videos, starts and has what they need."""
    from nnql_bullet.render.video import check_encoder

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


def _packages(module: str) -> dict[str, str]:
    """The installed packages that bring a module, with their versions."""
    return {name: version(name) for name in sorted(set(packages_distributions().get(module, ())))}


def _listed(packages: Mapping[str, str]) -> str:
    return ", ".join(f"{name} {its}" for name, its in packages.items()) or "a build without a package"


def _line(error: BaseException) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())


def examined(check: Callable[[], Finding]) -> Finding:
    """Runs a check; one that raises has failed."""
    try:
        return check()
    except Exception as error:
        return Finding(False, failed_import(error) or f"the check itself failed: {_line(error)}")


CHECKS: dict[str, Callable[[], Finding]] = {
    "Python": check_platform,
    "cores": check_cores,
    "disk": check_disk,
    "caches": check_caches,
    "locale": check_locale,
    "PyBullet": check_pybullet,
    "MuJoCo": check_mujoco,
    "drive": check_drive,
    "rays": check_rays,
    "ffmpeg": check_ffmpeg,
    "Chromium": check_chromium,
}
