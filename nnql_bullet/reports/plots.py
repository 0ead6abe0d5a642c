"""Pictures of runs and recordings, drawn with Matplotlib's object interface: no display, no global figures."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Polygon

from nnql_bullet import paper
from nnql_bullet.files import write_atomically
from nnql_bullet.geometry import Array, OrientedBox, Pose, moved
from nnql_bullet.recording import Recording
from nnql_bullet.training.loop import TrainingEpisode

SAFE, NON_SAFE, COLLISION = "#1f77b4", "#e8590c", "#c92a2a"
GOAL, TIMEOUT = "#2b8a3e", "#868e96"
BOX, BOX_EDGE = "#adb5bd", "#495057"
INK = "#212529"
OUTLINE_EVERY = 4.0
"""Distance along the path from one outline of the vehicle to the next [m]."""


def draw_trajectory(recording: Recording, path: Path) -> None:
    """The world to scale, the path coloured by safe and non-safe, the vehicle at intervals."""
    world = recording.about["world"]
    figure = Figure(figsize=(8.0, 8.6), layout="constrained")
    axes = figure.subplots()
    _draw_world(axes, recording)
    _draw_path(axes, recording)
    axes.set(
        xlim=(-2, world["width"] + 2),
        ylim=(-2, world["depth"] + 2),
        aspect="equal",
        xlabel="x [m]",
        ylabel="y [m]",
    )
    axes.set_title(_caption(recording), fontsize=11, color=INK)
    _inset_of_the_end(axes, recording)
    handles = [
        Line2D([], [], color=SAFE, lw=2.4, label="safe: toward the target"),
        Line2D([], [], color=NON_SAFE, lw=2.4, label="non-safe: the network decides"),
        Patch(facecolor=BOX, edgecolor=BOX_EDGE, label="obstacle"),
        Line2D([], [], marker="o", ls="", mfc=INK, mec=INK, label="start"),
        Line2D([], [], marker="o", ls="", mfc="#ffe3e3", mec=COLLISION, ms=10, label="target"),
    ]
    if recording.about["ending"] == "collision":
        handles.append(Line2D([], [], marker="X", ls="", mfc=COLLISION, mec="white", ms=11, label="collision"))
    axes.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, -0.07), ncols=3, frameon=False, fontsize=9)
    _save(figure, path)


def draw_learning_curve(episodes: Sequence[TrainingEpisode], path: Path, window: int = 50) -> None:
    """How episodes ended, what they returned and how long they lasted, as means over a trailing window."""
    figure = Figure(figsize=(8.0, 7.2), layout="constrained")
    ends, returns, length = figure.subplots(3, 1, sharex=True, height_ratios=(2.2, 1.2, 1.2))
    number = np.array([e.episode + 1 for e in episodes])
    window = max(1, min(window, len(episodes) // 4))
    for name, colour in (("goal", GOAL), ("collision", COLLISION), ("timeout", TIMEOUT)):
        share = np.array([100.0 * (e.summary.ending == name) for e in episodes])
        ends.plot(number, _trailing_mean(share, window), color=colour, lw=1.8, label=name)
    ends.set(ylabel="episodes [%]", ylim=(-2, 102))
    ends.legend(loc="center left", frameon=False)
    ends.set_title(f"Training, mean over the last {window} episodes (exploring)", fontsize=11, color=INK)
    temperature = np.array([e.diagnostics.get("temperature", np.nan) for e in episodes])
    if np.isfinite(temperature).any():
        right = ends.twinx()
        right.plot(number, temperature, color="#7048e8", lw=1.2, ls="--")
        right.set_ylabel("temperature T", color="#7048e8")
        right.set_ylim(-0.02 * paper.TEMPERATURE_MAX, 1.02 * paper.TEMPERATURE_MAX)
    total = np.array([e.summary.episode_return for e in episodes])
    returns.plot(number, total, ".", color=BOX, ms=2.5)
    returns.plot(number, _trailing_mean(total, window), color=SAFE, lw=1.8)
    returns.set_ylabel("return")
    travelled = np.array([e.summary.path_length for e in episodes])
    length.plot(number, travelled, ".", color=BOX, ms=2.5)
    length.plot(number, _trailing_mean(travelled, window), color=NON_SAFE, lw=1.8)
    length.set(ylabel="path length [m]", xlabel="episode", xlim=(0, max(number[-1], 2)))
    for axes in (ends, returns, length):
        axes.grid(color="#e9ecef", lw=0.8)
        axes.spines[["top"]].set_visible(False)
    _save(figure, path)


def _draw_world(axes: Axes, recording: Recording) -> None:
    world = recording.about["world"]
    width, depth = world["width"], world["depth"]
    axes.add_patch(Polygon([(0, 0), (width, 0), (width, depth), (0, depth)], fc="#f8f9fa", ec=BOX_EDGE, lw=2.5))
    for box in recording.obstacles:
        axes.add_patch(Polygon(box.corners(), fc=BOX, ec=BOX_EDGE, lw=0.8))
    axes.add_patch(Circle(world["target"], world["target_radius"], fc="#ffe3e3", ec=COLLISION, lw=1.6))
    axes.plot(*world["target"], "+", color=COLLISION, ms=7)
    axes.plot(world["start"]["x"], world["start"]["y"], "o", color=INK, ms=5, zorder=5)


def _draw_path(axes: Axes, recording: Recording, detail: float = 1.0) -> None:
    points = recording.sample_pose[:, :2]
    decision = np.searchsorted(recording.state_time, recording.sample_time - 1e-9, side="left") - 1
    non_safe = recording.state_property[np.clip(decision, 0, None)] == "NS"
    segments = np.stack([points[:-1], points[1:]], axis=1)
    colours = np.where(non_safe[1:], NON_SAFE, SAFE)
    axes.add_collection(LineCollection(segments, colors=colours, lw=2.0 * detail, capstyle="round", zorder=4))
    for pose in _outlines(recording, OUTLINE_EVERY / detail):
        axes.add_patch(Polygon(pose.corners(), fc="none", ec=INK, lw=0.6 * detail, zorder=3))
    last = moved(recording.footprint, Pose(*recording.state_pose[-1]))
    axes.add_patch(Polygon(last.corners(), fc="#fab005", ec=INK, lw=0.8 * detail, zorder=6))
    if recording.about["ending"] == "collision":
        axes.plot(last.x, last.y, "X", color=COLLISION, mec="white", ms=11, zorder=7)


def _inset_of_the_end(axes: Axes, recording: Recording) -> None:
    """The tightest moment, enlarged, in the corner that the path from (20, 20) to (90, 90) leaves empty."""
    tightest = int(np.argmin(recording.clearance)) + 1
    x, y, _ = recording.state_pose[min(tightest, len(recording.state_pose) - 1)]
    world = recording.about["world"]
    half = 6.0
    inset = axes.inset_axes((0.62, 0.03, 0.35, 0.35)) if y > x - 25 else axes.inset_axes((0.03, 0.62, 0.35, 0.35))
    _draw_world(inset, recording)
    _draw_path(inset, recording, detail=2.0)
    inset.set(
        xlim=(min(max(x, half), world["width"] - half) - half, min(max(x, half), world["width"] - half) + half),
        ylim=(min(max(y, half), world["depth"] - half) - half, min(max(y, half), world["depth"] - half) + half),
        aspect="equal",
        xticks=[],
        yticks=[],
    )
    inset.set_title(f"tightest: {recording.clearance.min():.2f} m clear", fontsize=8, pad=3)
    axes.indicate_inset_zoom(inset, edgecolor=INK, alpha=0.6)


def _outlines(recording: Recording, every: float) -> list[OrientedBox]:
    poses = recording.sample_pose
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    chosen = np.unique(np.searchsorted(along, np.arange(0.0, along[-1], every)))
    return [moved(recording.footprint, Pose(*poses[i])) for i in chosen]


def _caption(recording: Recording) -> str:
    about = recording.about
    world = about["world"]
    cover = sum(box.area for box in recording.obstacles) / (world["width"] * world["depth"])
    return (
        f"{about.get('policy', 'policy')} in world '{world['name']}', seed {world['seed']} ({cover:.1%} cover): "
        f"{about['ending']} after {recording.state_time[-1]:.1f} s"
    )


def _trailing_mean(values: Array, window: int) -> Array:
    total = np.cumsum(np.concatenate([[0.0], values]))
    end = np.arange(1, len(values) + 1)
    begin = np.maximum(end - window, 0)
    return np.asarray((total[end] - total[begin]) / (end - begin))


def _save(figure: Figure, path: Path) -> None:
    write_atomically(path, lambda temporary: figure.savefig(temporary, dpi=150, metadata={"Software": None}))
