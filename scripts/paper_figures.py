"""Redraws the paper's Figs. 5, 6 and 7 on one page, from drives of this program in contact physics.

Fig. 5 shows every 200th episode of one training as the paper does it, with one vehicle. What the vehicle was told is
noted while it learns, and driven again to be recorded: a simulator repeats itself bit for bit, which is checked.
Figs. 6 and 7 show what was learned, in worlds that are new to it. Training and recordings are kept and not repeated.

    python scripts/paper_figures.py                    # docs/paper_figures.png
    python scripts/paper_figures.py --seed 1 --out other.png
"""

import argparse
from contextlib import closing
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch, Polygon, Wedge
from numpy.typing import NDArray
from rich.progress import track

import nnql_bullet as nb
from nnql_bullet import __version__, paper
from nnql_bullet.agents.base import Reflex
from nnql_bullet.colours import INK, NON_SAFE, SAFE, VEHICLE
from nnql_bullet.env import Navigation, Transition
from nnql_bullet.experiment import Experiment
from nnql_bullet.geometry import Array, Pose, moved, placed
from nnql_bullet.presets import load_config
from nnql_bullet.recording import Recorder, Recording, load_recording
from nnql_bullet.reports.drawing import (
    draw_drive,
    draw_path,
    draw_world,
    legend_below,
    legend_entries,
    picture,
    without_ticks,
)
from nnql_bullet.rollout import EpisodeSummary, run_episode
from nnql_bullet.runs import CHECKPOINT, Run, load_run
from nnql_bullet.sensing import FRONT
from nnql_bullet.sim.base import Motion, Simulator, Traces
from nnql_bullet.task import TaskOptions
from nnql_bullet.worlds.spec import WorldSpec

TRAINING = (1, 200, 400, 600, 800, paper.EPISODES)
"""Episodes of Fig. 5, counted from 1."""
NEW = (("paper", 0), ("cover_7.5", 1), ("cover_10", 2))
"""World file and seed of Figs. 6 and 7."""


class Noting(Navigation):
    """Episodes of one vehicle, with a note of every decision and of the heading change that was commanded."""

    def __init__(self, simulator: Simulator, task: TaskOptions) -> None:
        super().__init__(simulator, task)
        self.decisions: list[tuple[int, float]] = []

    def step(
        self, actions: NDArray[np.int64], active: NDArray[np.bool_] | None = None, traces: Traces | None = None
    ) -> Transition:
        """Carries out one decision."""
        transition = super().step(actions, active, traces)
        self.decisions.append((int(actions[0]), float(transition.heading_command[0])))
        return transition


class Told:
    """A simulator of one vehicle that commands the noted heading changes, to the last bit."""

    def __init__(self, simulator: Simulator, decisions: list[tuple[int, float]]) -> None:
        self.size, self.vehicle, self.drive = simulator.size, simulator.vehicle, simulator.drive
        self.reset, self.close = simulator.reset, simulator.close
        self._simulator = simulator
        self._waiting = iter(decisions)

    def advance(
        self,
        heading_changes: Array,
        active: NDArray[np.bool_] | None = None,
        speed_scales: Array | None = None,
        traces: Traces | None = None,
    ) -> tuple[Motion, Array]:
        """Drives one control period."""
        return self._simulator.advance(np.array([next(self._waiting)[1]]), active, speed_scales, traces)


def train(folder: Path, seed: int) -> None:
    """Trains, or goes on from the last recorded episode, and records the episodes of Fig. 5."""
    if (folder / CHECKPOINT).exists():
        run = load_run(folder)
    else:
        run = Run(folder, load_config("paper", {"seed": seed}))
        run.create(overwrite=True)
    config = run.config
    with closing(Experiment(config).new_simulator(workers=1)) as simulator:
        experiment = Experiment(config)
        navigation = Noting(simulator, config.task)
        learner, training = experiment.trainable, experiment.trainer(navigation)
        if run.state:
            learner.load_state_dict(run.state.learned)
            training.load_state_dict(run.state.under_way)
        episodes = zip(range(len(run.episodes), config.episodes), training.episodes(), strict=False)
        for _, episode in track(episodes, "training", total=config.episodes, completed=len(run.episodes)):
            run.episodes.append(episode)
            if episode.episode + 1 in TRAINING:
                world = experiment.training_world(episode.episode)
                record(experiment, world, navigation.decisions, episode.summary).save(film(folder, episode.episode + 1))
                run.save(learner, training)
            navigation.decisions.clear()


def film(folder: Path, name: object) -> Path:
    """Where a recording is kept."""
    return folder / f"{name}.npz"


def record(
    experiment: Experiment, world: WorldSpec, decisions: list[tuple[int, float]], summary: EpisodeSummary
) -> Recording:
    """Drives the same again.

    Raises:
        RuntimeError: If that is another drive.
    """
    waiting = iter(decisions)
    policy = Reflex(lambda observations: np.array([next(waiting)[0]]))
    navigation = Navigation(Told(experiment.simulator, decisions), experiment.config.task)
    recorder = Recorder(experiment.vehicle)  # what the network thought of the turns changed at every step
    if run_episode(navigation, world, policy, watcher=recorder) != summary:
        raise RuntimeError(f"world {world.seed}: the drive is not repeated; report this with your machine's name")
    return recorder.recording(version=__version__)


def draw(training: list[Recording], new: list[Recording], path: Path) -> None:
    """The page."""
    with picture(path, 12.0, 13.6) as figure:
        upper, lower = figure.subfigures(2, 1, height_ratios=(2.0, 1.06))
        left, right = lower.subfigures(1, 2, width_ratios=(1.0, 2.0))
        upper.suptitle("Fig. 5: some training episodes, one vehicle learning online", fontsize=13, color=INK)
        left.suptitle("Fig. 6: a new world", fontsize=13, color=INK)
        right.suptitle("Fig. 7: two other worlds, same weights", fontsize=13, color=INK)
        captions = [f"episode {number}" for number in TRAINING]
        for axes, recording, caption in zip(upper.subplots(2, 3).flat, training, captions, strict=True):
            draw_panel(axes, recording, caption)
        (whole,) = left.subplots(1, 1, squeeze=False).flat
        for axes, recording in zip((whole, *right.subplots(1, 2)), new, strict=True):
            draw_panel(axes, recording, f"{cover(recording):.1f} % cover, seed {recording.about['world']['seed']}")
        draw_moment(whole, new[0])
        handles = legend_entries(
            safe="safe: toward the target",
            non_safe="non-safe: the network decides",
            obstacle="obstacle",
            start="start",
            target="target",
            collision="collision",
        )
        handles.append(Patch(facecolor=NON_SAFE, alpha=0.3, label="sensor that sees something"))
        handles.append(Patch(facecolor=SAFE, alpha=0.3, label="sensor that sees nothing"))
        legend_below(figure, 4, handles)


def draw_panel(axes: Axes, recording: Recording, caption: str) -> None:
    """One drive."""
    ending = f"{recording.about['ending']} after {recording.state_time[-1]:.0f} s"
    draw_drive(axes, recording, 0.7, 2.0, f"{caption}: {ending}", 10)
    axes.set_xticks(range(0, 101, 20))
    axes.set_yticks(range(0, 101, 20))
    axes.tick_params(labelsize=8)
    axes.set_xlabel("x [m]", fontsize=8, labelpad=1)
    axes.set_ylabel("y [m]", fontsize=8, labelpad=1)


def cover(recording: Recording) -> float:
    """Of the arena, under boxes [%]."""
    world = recording.about["world"]
    return 100 * sum(box.area for box in recording.obstacles) / (world["width"] * world["depth"])


def draw_moment(axes: Axes, recording: Recording) -> None:
    """What the eight sensors see when the way ahead is shortest, enlarged in a corner."""
    ahead = np.where(recording.state_property == "NS", recording.readings[:, FRONT], np.inf)
    step = int(np.argmin(ahead))
    x, y, yaw = recording.state_pose[step]
    eye = placed(Pose(x, y, yaw), *recording.sensor.position[:2])
    half = 1.15 * paper.SENSOR_RANGE
    inset = axes.inset_axes((0.54, 0.02, 0.44, 0.44))
    without_ticks(inset)
    draw_world(inset, recording.world, recording.state_time[step])
    draw_path(inset, recording)
    for sector, reading in enumerate(recording.readings[step]):
        middle = np.degrees(yaw + sector * paper.SECTOR_ANGLE)
        reach = np.degrees(paper.SECTOR_ANGLE / 2)
        colour = NON_SAFE if reading < paper.SENSOR_RANGE else SAFE
        inset.add_patch(Wedge(eye, reading, middle - reach, middle + reach, fc=colour, ec=INK, lw=0.5, alpha=0.3))
    vehicle = moved(recording.footprint, Pose(x, y, yaw))
    inset.add_patch(Polygon(vehicle.corners(), fc=VEHICLE, ec=INK, lw=0.8, zorder=6))
    inset.set(xlim=(eye[0] - half, eye[0] + half), ylim=(eye[1] - half, eye[1] + half), aspect="equal")
    axes.indicate_inset_zoom(inset, edgecolor=INK, alpha=0.7)


def main() -> None:
    """Makes what is missing, then draws."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, default=0, help="of the training")
    parser.add_argument("--keep", type=Path, default=Path("runs/paper_figures"), help="where training and drives go")
    parser.add_argument("--out", type=Path, default=Path("docs/paper_figures.png"), help="the picture")
    a = parser.parse_args()
    folder = a.keep / f"seed-{a.seed}"
    if not all(film(folder, number).exists() for number in TRAINING):
        train(folder, a.seed)
    for file, seed in NEW:
        if not film(folder, f"{file}-{seed}").exists():
            nb.drive(folder, world=file, seed=seed).save(film(folder, f"{file}-{seed}"))
    training = [load_recording(film(folder, number)) for number in TRAINING]
    draw(training, [load_recording(film(folder, f"{file}-{seed}")) for file, seed in NEW], a.out)
    print(a.out)


if __name__ == "__main__":
    main()
