"""Films by the whole command, against PyBullet's bare `getCameraImage` of about the same scene in one process.

The bare loop draws a floor, 40 boxes and the vehicle, from the same cameras; the film has its ground, light and overlay
besides, and is encoded. Starting the processes that draw counts.
"""

import os
import time
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from nnql_bullet.executors import ProcessExecutor
from nnql_bullet.experiment import Experiment
from nnql_bullet.machine import allowed_cores
from nnql_bullet.recording import Recorder, load_recording
from nnql_bullet.render.camera import chase
from nnql_bullet.render.film import frame_times
from nnql_bullet.render.filming import render
from nnql_bullet.render.renderers import RendererName
from nnql_bullet.render.solids import BulletRenderer
from nnql_bullet.render.timeline import Timeline
from nnql_bullet.rollout import run_episode
from nnql_bullet.run_config import RunConfig
from nnql_bullet.sim.bullet import bullet as pybullet
from nnql_bullet.sim.bullet import silenced

SIZE = 640, 360
BARE_FRAMES, WARM = 60, 5


@dataclass(frozen=True)
class BareTask:
    """The bare loop."""

    recording: Path
    renderer: RendererName
    seed: int = 0


def film_over_bare(renderer: RendererName, seconds: float) -> float:
    """A film's frames a second over the bare loop's.

    Args:
        renderer: Of both.
        seconds: Length of the film [s].
    """
    with TemporaryDirectory() as folder:
        path = Path(folder) / "drive.npz"
        _record(path)
        before = _bare(path, renderer)
        times = frame_times(0.0, seconds, 30.0, 1.0, hold=0.0)
        begin = time.perf_counter()
        render(path, Path(folder) / "film.mp4", size=SIZE, renderer=renderer, end=seconds, hold=0.0, workers=None)
        film = len(times) / (time.perf_counter() - begin)
        return film / ((before + _bare(path, renderer)) / 2)


def _record(path: Path) -> None:
    experiment = Experiment(RunConfig(simulator="kinematic", world="cover_10"))
    recorder = Recorder(experiment.vehicle)
    world = max((experiment.world(seed) for seed in range(6)), key=lambda world: len(world.obstacles))
    run_episode(experiment.navigation, world, experiment.agent, watcher=recorder)
    recorder.recording(policy="untrained", simulator="kinematic").save(path)


def _bare(path: Path, renderer: RendererName) -> float:
    """Frames a second."""
    (outcome,) = ProcessExecutor(1).map(_draw_bare, [BareTask(path, renderer)])
    if outcome.value is None:
        raise RuntimeError(outcome.error)
    return outcome.value


def _draw_bare(task: BareTask) -> float:
    os.environ["LP_NUM_THREADS"] = str(allowed_cores())  # Mesa's renderer may have all cores here, if it can use them
    recording = load_recording(task.recording)
    scene, timeline = BulletRenderer(recording, task.renderer), Timeline(recording)
    client, world = scene.scene.client, recording.world
    floor = scene.scene.add_box((world.width / 2, world.depth / 2, 0.05), (0.9, 0.9, 0.9))
    scene.scene.place(floor, world.width / 2, world.depth / 2, -0.05, 0.0)
    follow = chase(timeline, *SIZE)
    egl = task.renderer == "egl"
    flag = pybullet.ER_BULLET_HARDWARE_OPENGL if egl else pybullet.ER_TINY_RENDERER
    begin = 0.0
    for frame in range(BARE_FRAMES + WARM):
        if frame == WARM:
            begin = time.perf_counter()
        moment = timeline.at(frame / 30)
        camera = follow(moment)
        scene.show(moment)
        view, lens = camera.view.T.ravel().tolist(), camera.projection.T.ravel().tolist()
        with silenced():
            pybullet.getCameraImage(*SIZE, view, lens, shadow=0, renderer=flag, physicsClientId=client)
    return BARE_FRAMES / (time.perf_counter() - begin)
