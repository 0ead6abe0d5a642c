"""Pictures of runs and recordings, drawn with Matplotlib's object interface: no display, no global figures."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Polygon
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.colours import (
    BOX,
    BOX_EDGE,
    COLLISION,
    GOAL,
    INK,
    LINES,
    MOVING,
    MOVING_EDGE,
    NON_SAFE,
    SAFE,
    TIMEOUT,
    VEHICLE,
)
from nnql_bullet.evaluation.statistics import mean_interval
from nnql_bullet.files import write_atomically
from nnql_bullet.geometry import Array, OrientedBox, Pose, as_rows, clearance_at, moved
from nnql_bullet.recording import Recording
from nnql_bullet.seeding import Stream, rng
from nnql_bullet.training.base import TrainingEpisode
from nnql_bullet.worlds.spec import WorldSpec

DPI = 150
"""Of pictures."""
OUTLINE_EVERY = 4.0
"""Distance along the path from one outline of the vehicle to the next [m]."""
BAND_PLACES = 400
"""Along a curve, where its interval is worked out."""


def draw_trajectory(recording: Recording, path: Path) -> None:
    """The world to scale as it was at the end, the path coloured by safe and non-safe, the vehicle at intervals."""
    world = recording.about["world"]
    figure = Figure(figsize=(11.0, 7.4), layout="constrained")
    grid = figure.add_gridspec(2, 2, width_ratios=(2.1, 1.0), height_ratios=(1.15, 1.0))
    whole, closer, clear = (figure.add_subplot(part) for part in (grid[:, 0], grid[0, 1], grid[1, 1]))
    draw_world(whole, recording, recording.state_time[-1])
    draw_path(whole, recording)
    whole.set(
        xlim=(-2, world["width"] + 2), ylim=(-2, world["depth"] + 2), aspect="equal", xlabel="x [m]", ylabel="y [m]"
    )
    _draw_tightest(closer, recording)
    whole.indicate_inset(bounds=_bounds(closer), inset_ax=None, edgecolor=INK, alpha=0.7)
    _draw_clearance(clear, recording)
    figure.suptitle(_caption(recording), fontsize=11, color=INK)
    handles = [
        Line2D([], [], color=SAFE, lw=2.4, label="in a safe state"),
        Line2D([], [], color=NON_SAFE, lw=2.4, label="in a non-safe state"),
        Patch(facecolor=BOX, edgecolor=BOX_EDGE, label="obstacle"),
        Line2D([], [], marker="o", ls="", mfc=INK, mec=INK, label="start"),
        Line2D([], [], marker="o", ls="", mfc="#ffe3e3", mec=COLLISION, ms=10, label="target"),
    ]
    if recording.patrols:
        handles.insert(3, Patch(facecolor=MOVING, edgecolor=MOVING_EDGE, label="moving, as at the end"))
    if recording.about["ending"] == "collision":
        handles.append(Line2D([], [], marker="X", ls="", mfc=COLLISION, mec="white", ms=11, label="collision"))
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False, fontsize=9)
    save_figure(figure, path)


def draw_learning_curve(episodes: Sequence[TrainingEpisode], path: Path, window: int = 50) -> None:
    """How episodes ended, what they returned and how long they lasted, as means over a trailing window.

    With several vehicles episodes stand where they finished, and the temperature where they began.
    """
    figure = Figure(figsize=(8.0, 7.2), layout="constrained")
    ends, returns, length = figure.subplots(3, 1, sharex=True, height_ratios=(2.2, 1.2, 1.2))
    number = np.arange(1, len(episodes) + 1)
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
        began = np.argsort([e.episode for e in episodes])
        right.plot(number, temperature[began], color="#7048e8", lw=1.2, ls="--")
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
    save_figure(figure, path)


def draw_success(recipes: Mapping[str, Mapping[str, Sequence[TrainingEpisode]]], path: Path, window: int = 50) -> None:
    """Success while training: a line for each run and, for a recipe with several, their mean as far as all have come.

    With three runs or more, a band is the bootstrap 95 % interval of that mean over training seeds.

    Args:
        recipes: Runs by name, by the name of what they share but for their training seed; none without an episode.
        path: Of the picture.
        window: Episodes of the trailing mean; fewer where runs are short.
    """
    window = max(1, min(window, min(len(run) for runs in recipes.values() for run in runs.values()) // 4))
    figure = Figure(figsize=(9.0, 4.4), layout="constrained")
    axes = figure.add_subplot()
    for number, (recipe, runs) in enumerate(recipes.items()):
        curves = {
            name: _trailing_mean(np.array([100.0 * (e.summary.ending == "goal") for e in episodes]), window)
            for name, episodes in runs.items()
        }
        colour = LINES[number % len(LINES)]
        alone = len(curves) == 1
        for name, curve in curves.items():
            style = {"lw": 1.8, "label": name} if alone else {"lw": 0.9, "alpha": 0.35}
            axes.plot(np.arange(1, len(curve) + 1), curve, color=colour, **style)
        if not alone:
            shortest = min(map(len, curves.values()))
            mean = np.mean([curve[:shortest] for curve in curves.values()], axis=0)
            axes.plot(np.arange(1, shortest + 1), mean, color=colour, lw=2.2, label=f"{recipe}: mean of {len(curves)}")
        if len(curves) > 2:
            places = np.arange(window // 4, shortest, max(1, shortest // BAND_PLACES))
            low, high = mean_interval(np.array([curve[places] for curve in curves.values()]), rng(0, Stream.BOOTSTRAP))
            axes.fill_between(places + 1, low, high, color=colour, alpha=0.25, lw=0)
    axes.set(ylabel="success [%]", ylim=(-2, 102), xlabel="episode", xlim=(0, None))
    axes.grid(color="#e9ecef", lw=0.8)
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_title(f"Training, mean over the last {window} episodes (exploring)", fontsize=11, color=INK)
    figure.legend(loc="outside right center", frameon=False, fontsize=9)
    save_figure(figure, path)


def draw_map(world: WorldSpec, path: Path) -> None:
    """Draws a world from above, with moving boxes where they start."""
    figure = Figure(figsize=(6.0, 6.0), layout="constrained")
    axes = figure.add_subplot()
    draw_world(axes, world, 0.0)
    axes.set(xlim=(-2, world.width + 2), ylim=(-2, world.depth + 2), aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.set_title(f"{world.name}, seed {world.seed}", fontsize=10, color=INK)
    save_figure(figure, path)


def draw_world(axes: Axes, drawn: Recording | WorldSpec, time: float) -> None:
    """Draws a world to scale, with moving boxes where they are at a time [s] and their tracks."""
    world = drawn if isinstance(drawn, WorldSpec) else drawn.world
    width, depth = world.width, world.depth
    axes.add_patch(Polygon([(0, 0), (width, 0), (width, depth), (0, depth)], fc="#f8f9fa", ec=BOX_EDGE, lw=2.5))
    for box in world.obstacles:
        axes.add_patch(Polygon(box.corners(), fc=BOX, ec=BOX_EDGE, lw=0.8))
    for patrol in world.patrols:
        (x, y), at_end = patrol.end, replace(patrol.box, x=patrol.end[0], y=patrol.end[1])
        axes.plot((patrol.box.x, x), (patrol.box.y, y), color=MOVING_EDGE, lw=0.6, ls="--", zorder=1.5)
        for box in (patrol.box, at_end):
            axes.add_patch(Polygon(box.corners(), fc="none", ec=MOVING_EDGE, lw=0.6, ls="--"))
        axes.add_patch(Polygon(patrol.at(time).corners(), fc=MOVING, ec=MOVING_EDGE, lw=0.8, zorder=2))
    axes.add_patch(Circle(world.target, world.target_radius, fc="#ffe3e3", ec=COLLISION, lw=1.6))
    axes.plot(*world.target, "+", color=COLLISION, ms=7)
    axes.plot(world.start.x, world.start.y, "o", color=INK, ms=5, zorder=5)


def draw_path(axes: Axes, recording: Recording, detail: float = 1.0, cross: bool = True) -> None:
    """The path coloured by safe and non-safe, with outlines of the vehicle, and where it ended.

    Args:
        axes: To draw on.
        recording: Of the drive.
        detail: How much thicker lines are and how much closer outlines.
        cross: Whether a collision is marked by a cross on the vehicle.
    """
    points = recording.sample_pose[:, :2]
    decision = np.searchsorted(recording.state_time, recording.sample_time - 1e-9, side="left") - 1
    non_safe = recording.state_property[np.clip(decision, 0, None)] == "NS"
    axes.add_collection(_segments(points, np.where(non_safe[1:], NON_SAFE, SAFE), 2.0 * detail))
    for pose in _outlines(recording, OUTLINE_EVERY / detail):
        axes.add_patch(Polygon(pose.corners(), fc="none", ec=INK, lw=0.6 * detail, zorder=3))
    last = moved(recording.footprint, Pose(*recording.state_pose[-1]))
    axes.add_patch(Polygon(last.corners(), fc=VEHICLE, ec=INK, lw=0.8 * detail, zorder=6))
    if cross and recording.about["ending"] == "collision":
        axes.plot(last.x, last.y, "X", color=COLLISION, mec="white", ms=11, zorder=7)


def _draw_tightest(axes: Axes, recording: Recording, half: float = 6.0) -> None:
    """The tightest moment, enlarged."""
    moment = _tightest(recording)
    vehicle = moved(recording.footprint, Pose(*recording.sample_pose[moment]))
    x, y = vehicle.x, vehicle.y
    draw_world(axes, recording, recording.sample_time[moment])
    draw_path(axes, recording, detail=2.0)
    axes.add_patch(Polygon(vehicle.corners(), fc=VEHICLE, ec=INK, lw=1.6, zorder=5))
    axes.set(xlim=(x - half, x + half), ylim=(y - half, y + half), aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.set_title(f"the tightest moment, at {recording.sample_time[moment]:.1f} s", fontsize=10)


def _tightest(recording: Recording) -> int:
    """The sample that was closest to a box, in the control period that was closest to anything."""
    step = int(np.argmin(recording.clearance))
    begin, end = recording.state_time[step : step + 2] + 1e-9
    within = np.flatnonzero((recording.sample_time > begin) & (recording.sample_time <= end))
    footprint = as_rows((recording.footprint,))[0]
    gaps = []
    for i in within.tolist():
        x, y, yaw = recording.sample_pose[i]
        gaps.append(clearance_at(x, y, yaw, footprint, as_rows(recording.boxes_at(recording.sample_time[i]))))
    return int(within[np.argmin(gaps)])


def _bounds(axes: Axes) -> tuple[float, float, float, float]:
    (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
    return left, low, right - left, high - low


def _draw_clearance(axes: Axes, recording: Recording) -> None:
    """Smallest clearance in each step over time, in the colours of the path."""
    time = recording.state_time
    points = np.column_stack([np.repeat(time, 2)[1:-1], np.repeat(recording.clearance, 2)])
    colours = np.repeat(np.where(recording.state_property[:-1] == "NS", NON_SAFE, SAFE), 2)[1:]
    axes.add_collection(_segments(points, colours, 1.8))
    axes.set(
        xlim=(0, time[-1]),
        ylim=(0, paper.SENSOR_RANGE),
        xlabel="time [s]",
        ylabel="clearance [m]",
    )
    axes.set_title(f"clearance, smallest {recording.clearance.min():.2f} m", fontsize=10)
    axes.grid(color="#e9ecef", lw=0.8)


def _segments(points: Array, colours: NDArray[np.str_], width: float) -> LineCollection:
    """A line through points (n, 2), each of its n - 1 pieces in its own colour."""
    pieces = [points[i : i + 2] for i in range(len(points) - 1)]
    return LineCollection(pieces, colors=colours.tolist(), linewidths=width, capstyle="round", zorder=4)


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
    mean = np.asarray((total[end] - total[begin]) / (end - begin))
    mean[: window // 4] = np.nan  # too few to mean anything
    return mean


def save_figure(figure: Figure, path: Path) -> None:
    """Writes a picture atomically, the same bytes for the same figure."""
    write_atomically(path, lambda temporary: figure.savefig(temporary, dpi=DPI, metadata={"Software": None}))
