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
from multiprocessing import get_context
from pathlib import Path
from threading import Event, Thread

import matplotlib
import numpy as np
import pytest
import torch

import nnql_bullet
from nnql_bullet.errors import UserError
from nnql_bullet.recording import Recording
from nnql_bullet.render.video import write_video
from nnql_bullet.reports.drawing import picture
from nnql_bullet.sim.bullet import PHYSICS, BulletEngine, bullet
from nnql_bullet.sim.c_library import silenced
from nnql_bullet.sim.contact import VehicleMotion
from nnql_bullet.types import Bytes
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.work import Progress
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


BROKEN = {"numba": "NUMBA_NUM_THREADS=0", "numpy": "NUMPY_MADVISE_HUGEPAGE=abc", "matplotlib": "MPLBACKEND=none"}
"""Libraries, and settings with which they do not load."""


class TestEnvironmentVariables:
    @staticmethod
    def ran(setting: str, *words: str) -> tuple[int, str, str]:
        name, _, value = setting.partition("=")
        command = [sys.executable, "-m", "nnql_bullet", *words]
        env = os.environ | {"PYTHONPATH": str(ROOT), name: value}
        done = subprocess.run(command, env=env, capture_output=True, text=True, timeout=120)
        return done.returncode, done.stdout, done.stderr

    @pytest.mark.parametrize("word", ["--version", "--help"])
    def test_version_and_help_need_no_library(self, word: str) -> None:
        names = '("numba", "numpy", "torch", "pydantic", "matplotlib")'
        code = f"import sys; sys.modules |= dict.fromkeys({names}); from nnql_bullet.cli import main; main(['{word}'])"
        done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=120, check=True)
        assert (done.stdout[:1] != "", done.stderr) == (True, "")

    @pytest.mark.parametrize("setting", [*BROKEN.values(), "SOURCE_DATE_EPOCH=abc"])
    def test_a_library_that_does_not_load_is_one_line_that_names_the_variable(
        self, setting: str, tmp_path: Path
    ) -> None:
        out = tmp_path / "out"
        code, printed, err = self.ran(setting, "drive", "straight", "--sim", "kinematic", "--out", str(out))
        assert (code, printed, err.count("\n"), out.exists()) == (2, "", 1, False)
        assert setting.partition("=")[0] in err

    @pytest.mark.slow
    @pytest.mark.parametrize("library", BROKEN)
    def test_doctor_says_which_library_does_not_load_and_goes_on(self, library: str) -> None:
        code, printed, err = self.ran(BROKEN[library], "doctor")
        assert (code, err) == (1, "")
        assert f"FAIL  caches      {library} does not load" in printed
        assert printed.count("mend or unset " + BROKEN[library]) == printed.count("FAIL")
        assert "ok    locale" in printed

    def test_a_warning_of_a_library_is_one_line(self) -> None:
        code, printed, err = self.ran("NUMBA_OPT=9", "policies")
        assert (code, printed != "", err.count("\n"), "NUMBA_OPT" in err) == (0, True, 1, True)

    @pytest.mark.slow
    def test_a_warning_of_a_library_is_not_said_again_by_workers(self, tmp_path: Path) -> None:
        words = ("--vehicles", "2", "--workers", "2", "--episodes", "2", "--task.max-steps", "5")
        code, _, err = self.ran("NUMBA_NUM_THREADS=abc", "train", *words, "--out", str(tmp_path / "run"))
        assert (code, err.count("NUMBA_NUM_THREADS"), "Traceback" in err) == (0, 1, False)


STREAMS = """
import os, sys
if len(sys.argv) > 2:
    for stream in map(int, sys.argv[2].split(",")):
        os.close(stream)
before = {fd: os.path.exists(f"/proc/self/fd/{fd}") for fd in range(3)}
from nnql_bullet.sim.bullet import bullet
from nnql_bullet.sim.c_library import silenced
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


def frames() -> list[Bytes]:
    return [np.full((36, 64, 3), grey, np.uint8) for grey in range(0, 200, 20)]


class TestFfmpeg:
    @pytest.mark.parametrize("folder", ["a, b", 'it\'s "so"', "a:b", "-x", "100%d", "ü"])
    def test_films_are_written_wherever_they_are_wanted(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: str
    ) -> None:
        monkeypatch.chdir(tmp_path)
        Path(folder).mkdir()
        write_video(Path(folder) / "a.mp4", frames(), (64, 36), 24.0, "mp4")
        assert [path.name for path in Path(folder).iterdir()] == ["a.mp4"]

    @pytest.mark.parametrize(
        ("program", "said"),
        [
            (None, "No such file"),
            ("#!/bin/sh\nexit 3\n", "exit code 3"),
            ("#!/bin/sh\necho ' V..... mpeg4 '\n", "libx264"),
        ],
    )
    def test_one_that_does_not_work_is_named_before_the_drive(
        self,
        run_cli: Callable[..., tuple[int, str, str]],
        tmp_path: Path,
        monkeypatch: pytest.MonkeyPatch,
        program: str | None,
        said: str,
    ) -> None:
        ffmpeg = tmp_path / "ffmpeg"
        if program:
            ffmpeg.write_text(program)
            ffmpeg.chmod(0o755)
        monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(ffmpeg))
        for words in (("drive", "straight"), ("render", "straight"), ("evaluate", "straight", "--clips", 1)):
            film = ("--video",) if words[0] == "drive" else ()
            out = tmp_path / "out.mp4" if words[0] == "render" else tmp_path / "out"
            code, printed, err = run_cli(*words, *film, "--out", out)
            assert (code, printed, err.count("\n")) == (2, "", 1)
            assert str(ffmpeg) in err
            assert said in err
            assert not out.exists()

    def test_one_that_fails_at_the_end_leaves_the_old_film(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        """Such as on a full disk, when the film's index is written."""
        film, ffmpeg = tmp_path / "a.mp4", tmp_path / "ffmpeg"
        film.write_bytes(b"old")
        ffmpeg.write_text("#!/bin/sh\ncat > /dev/null\necho No space left on device >&2\nexit 1\n")
        ffmpeg.chmod(0o755)
        monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(ffmpeg))
        with pytest.raises(UserError, match=r"a.mp4: .*No space left on device"):
            write_video(film, frames(), (64, 36), 24.0, "mp4")
        assert film.read_bytes() == b"old"


class TestFilmsOfAnotherDrive:
    @pytest.fixture
    def recordings(self) -> list[Recording]:
        return [nnql_bullet.drive("straight", world="cover_10", seed=k, simulator="kinematic") for k in (3, 5)]

    def test_they_go_when_another_recording_takes_the_place(self, recordings: list[Recording], tmp_path: Path) -> None:
        old, new = recordings
        film, mine = tmp_path / "trajectory.mp4", tmp_path / "mine.mp4"
        for path in (film, mine):
            path.write_bytes(b"a film")
        old.save(tmp_path / "trajectory.npz")
        assert film.exists()  # there was no recording that it could be a film of
        old.save(tmp_path / "trajectory.npz")
        assert film.exists()  # the same drive
        new.save(tmp_path / "trajectory.npz")
        assert not film.exists()
        assert mine.exists()


def test_trainings_in_threads_put_the_threads_of_torch_back(tmp_path: Path) -> None:
    """Also when the first one to begin is the first to end."""
    before = torch.get_num_threads()
    torch.set_num_threads(3)
    try:
        first, second = Event(), Event()

        def train(name: str, seen: Event, awaited: Event) -> None:
            def wait(_: Progress) -> None:
                seen.set()
                awaited.wait(60.0)

            nnql_bullet.train(simulator="kinematic", episodes=2, out=tmp_path / name, on_progress=wait)

        one = Thread(target=train, args=("one", first, second))
        another = Thread(target=train, args=("another", second, first))
        one.start()
        first.wait(60.0)
        another.start()
        one.join()
        another.join()
        assert torch.get_num_threads() == 3
    finally:
        torch.set_num_threads(before)


def in_a_daemon(folder: Path) -> list[str]:
    run = nnql_bullet.train(vehicles=2, episodes=2, workers=2, out=folder)
    results = nnql_bullet.evaluate(
        run.policy, worlds=["cover_20"], n_worlds=2, simulator="kinematic", executor="processes", workers=2
    )
    return [episode["ending"] for episode in results.episodes]


@pytest.mark.slow
def test_a_daemonic_process_which_may_have_no_children_does_all_itself(tmp_path: Path) -> None:
    with get_context("spawn").Pool(1) as pool:  # its workers are daemonic
        endings = pool.apply(in_a_daemon, (tmp_path / "daemon",))
    assert endings == in_a_daemon(tmp_path / "here")
    first, second = ((tmp_path / name / "episodes.csv").read_bytes() for name in ("daemon", "here"))
    assert first == second


WITHOUT = """
import sys
for name in ("torch", "pybullet"):
    sys.modules[name] = None  # importing it raises an ImportError
import nnql_bullet as nb
assert nb.drive("straight", world="empty", simulator="kinematic").summary.ending == "goal"
for policy, simulator, named in (("paper", "kinematic", "PyTorch"), ("straight", "bullet", "PyBullet")):
    try:
        nb.drive(policy, world="empty", simulator=simulator)
    except nb.UserError as error:
        assert named in str(error), error
    else:
        raise SystemExit(f"{policy} drove in {simulator}")
"""


def test_a_rule_in_the_kinematic_model_needs_neither_torch_nor_pybullet() -> None:
    done = subprocess.run([sys.executable, "-c", WITHOUT], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
