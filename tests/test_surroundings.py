"""Other people's surroundings: locales, closed streams, other PyBullet code in the process, threads."""

import ctypes
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from importlib.util import find_spec
from pathlib import Path
from threading import Thread

import matplotlib
import pytest

from nnql_bullet.reports.drawing import picture
from nnql_bullet.sim.bullet import PHYSICS, BulletEngine, bullet, silenced
from nnql_bullet.sim.contact import VehicleMotion
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.source import World
from nnql_bullet.worlds.spec import WorldSpec

ROOT = Path(__file__).resolve().parents[1]

C = ctypes.CDLL(None)
C.atof.restype, C.atof.argtypes = ctypes.c_double, (ctypes.c_char_p,)

COMMAS = "de_DE.UTF-8"
LOCALE = """
import locale, sys
from nnql_bullet.experiment import Experiment
from nnql_bullet.run_config import RunConfig
import ctypes
C = ctypes.CDLL(None)
C.atof.restype, C.atof.argtypes = ctypes.c_double, (ctypes.c_char_p,)
locale.setlocale(locale.LC_ALL, sys.argv[2])
for simulator in ("bullet", "mujoco", "kinematic"):
    if simulator == "mujoco" and sys.argv[1] == "without":
        continue
    experiment = Experiment(RunConfig(world="cover_10", simulator=simulator))
    _, rays = experiment.simulator.reset({0: experiment.world(0)})
    motion, _ = experiment.simulator.advance([0.3])
    print(simulator, rays.tobytes().hex()[:400], motion.pose.tobytes().hex())
    experiment.simulator.close()
print(locale.setlocale(locale.LC_NUMERIC), C.atof(b"0.125"), file=sys.stderr)
"""


@pytest.fixture(scope="module")
def commas(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """An environment with a locale of decimal commas."""
    if shutil.which("localedef") is None:
        pytest.skip("localedef is not installed (Debian: libc-bin)")
    folder = tmp_path_factory.mktemp("locales")
    command = ["localedef", "-i", "de_DE", "-f", "UTF-8", str(folder / COMMAS)]
    if subprocess.run(command, capture_output=True).returncode > 1 or not (folder / COMMAS).exists():
        pytest.skip("the sources of locales are not installed (Debian: locales)")
    return os.environ | {"LOCPATH": str(folder), "PYTHONPATH": str(ROOT)}


def test_every_locale_gives_the_same_numbers(commas: dict[str, str]) -> None:
    with_mujoco = "with" if find_spec("mujoco") else "without"

    def told(name: str) -> tuple[str, str]:
        command = [sys.executable, "-c", LOCALE, with_mujoco, name]
        done = subprocess.run(command, env=commas, capture_output=True, text=True, timeout=120, check=True)
        return done.stdout, done.stderr.splitlines()[-1]

    (points, as_set), (with_commas, as_set_then) = told("C"), told(COMMAS)
    assert as_set == "C 0.125"
    assert as_set_then == f"{COMMAS} 0.0"  # what the program set is there still
    assert with_commas == points != ""


STREAMS = """
import os, sys
if len(sys.argv) > 2:
    for stream in map(int, sys.argv[2].split(",")):
        os.close(stream)
before = {fd: os.path.exists(f"/proc/self/fd/{fd}") for fd in range(3)}
from nnql_bullet.sim.bullet import silenced, bullet
with silenced():
    bullet.disconnect(bullet.connect(bullet.DIRECT))
    os.system("echo lost")
after = {fd: os.path.exists(f"/proc/self/fd/{fd}") for fd in range(3)}
open(sys.argv[1], "w").write(f"{before == after}")
"""


@pytest.mark.skipif(not Path("/proc/self/fd").exists(), reason="no /proc")
@pytest.mark.parametrize("closed", ["1", "2", "0,1", "1,2", "0,1,2"])
def test_the_engine_can_be_silenced_where_streams_are_closed(tmp_path: Path, closed: str) -> None:
    """Streams that were closed are closed again, and those that were open are the same."""
    command = [sys.executable, "-c", STREAMS, str(tmp_path / "answer"), closed]
    done = subprocess.run(command, env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True, timeout=120)
    assert (done.returncode, done.stdout, done.stderr) == (0, b"", b"")
    assert (tmp_path / "answer").read_text() == "True"


def test_silence_keeps_what_c_printed_before(capfd: pytest.CaptureFixture[str]) -> None:
    C.printf(b"before ")
    with silenced():
        C.printf(b"meanwhile ")
    C.printf(b"after")
    C.fflush(None)
    assert capfd.readouterr().out == "before after"


@pytest.fixture
def engine(engine_of: Callable[..., BulletEngine]) -> BulletEngine:
    return engine_of("fast")


@pytest.fixture
def bystander() -> Iterator[Callable[[], int]]:
    """Other code's sphere 15 mm above its ground: PyBullet sees a contact by default, not with the package's value."""
    clients = []

    def contacts() -> int:
        client = bullet.connect(bullet.DIRECT)
        clients.append(client)
        ground = bullet.createCollisionShape(bullet.GEOM_PLANE, physicsClientId=client)
        bullet.createMultiBody(0.0, ground, physicsClientId=client)
        sphere = bullet.createCollisionShape(bullet.GEOM_SPHERE, radius=0.5, physicsClientId=client)
        body = bullet.createMultiBody(1.0, sphere, basePosition=[0.0, 0.0, 0.515], physicsClientId=client)
        bullet.stepSimulation(client)
        return len(bullet.getContactPoints(body, physicsClientId=client))

    yield contacts
    for client in clients:
        bullet.disconnect(client)


class TestOtherPyBulletCode:
    @pytest.mark.parametrize("use", ["advance", "run", "step"])
    def test_its_bodies_touch_as_by_default(
        self, engine: BulletEngine, empty_world: WorldSpec, bystander: Callable[[], int], use: str
    ) -> None:
        assert bystander() == 1
        engine.reset(empty_world)
        {"advance": lambda: engine.advance(0.1), "run": lambda: engine.run(0.1), "step": engine.step}[use]()
        assert bystander() == 1
        with engine.own_threshold():
            assert bystander() == 0

    def test_its_threshold_does_not_change_a_drive(self, engine: BulletEngine, empty_world: WorldSpec) -> None:
        def driven() -> list[float]:
            engine.reset(empty_world)
            return [value for _ in range(3) for value in vars_of(engine.advance(0.2))]

        def vars_of(motion: VehicleMotion) -> tuple[float, ...]:
            return motion.pose.x, motion.pose.y, motion.pose.yaw, motion.path_length

        before = driven()
        other = bullet.connect(bullet.DIRECT)
        bullet.setPhysicsEngineParameter(contactBreakingThreshold=0.2, physicsClientId=other)
        try:
            assert driven() == before
        finally:
            bullet.disconnect(other)

    def test_it_is_put_back_only_when_no_engine_steps(
        self, engine: BulletEngine, empty_world: WorldSpec, bystander: Callable[[], int]
    ) -> None:
        """Another thread may drive another engine at the same time."""
        engine.reset(empty_world)
        with engine.own_threshold():
            thread = Thread(target=drive_another, args=(engine.vehicle, empty_world))
            thread.start()
            thread.join()
            assert bystander() == 0
        assert bystander() == 1


def drive_another(vehicle: VehicleSpec, world: WorldSpec) -> None:
    with closing(BulletEngine(vehicle, DriveOptions(), PHYSICS["fast"])) as another:
        another.reset(world)
        another.advance(0.1)


class TestPictures:
    """They have the package's own settings, and leave the program's as they are."""

    @pytest.fixture
    def world(self) -> World:
        return World.load("cover_10")

    def test_the_users_settings_change_nothing(self, world: World, tmp_path: Path) -> None:
        world.plot(tmp_path / "plain.png")
        theirs = {"text.usetex": True, "font.size": 30.0, "savefig.transparent": True, "lines.linewidth": 9.0}
        with matplotlib.rc_context(theirs):
            before = dict(matplotlib.rcParams)
            world.plot(tmp_path / "theirs.png")
            assert dict(matplotlib.rcParams) == before
        assert (tmp_path / "theirs.png").read_bytes() == (tmp_path / "plain.png").read_bytes()

    def test_threads_draw_one_after_another_and_put_the_settings_back(self, world: World, tmp_path: Path) -> None:
        before = dict(matplotlib.rcParams)
        with ThreadPoolExecutor(4) as pool:
            list(pool.map(lambda number: world.plot(tmp_path / f"{number}.png"), range(8)))
        assert dict(matplotlib.rcParams) == before
        assert len({path.read_bytes() for path in tmp_path.glob("*.png")}) == 1

    def test_a_dollar_in_a_name_is_no_formula(self, tmp_path: Path) -> None:
        with picture(tmp_path / "dollars.png", 2.0, 2.0) as figure:
            figure.suptitle("runs/$x_{$")
        assert (tmp_path / "dollars.png").exists()
