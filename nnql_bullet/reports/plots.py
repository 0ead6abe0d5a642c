"""Draws pictures of runs and recordings."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon

from nnql_bullet import colours, paper
from nnql_bullet.colours import BOX, INK, LINES, NON_SAFE, SAFE, TEMPERATURE, VEHICLE
from nnql_bullet.evaluation.statistics import least_seeds, mean_interval
from nnql_bullet.geometry import Array, Pose, as_rows, clearance_at, moved
from nnql_bullet.recording import Recording
from nnql_bullet.reports.drawing import (
    OPEN,
    coloured_line,
    draw_drive,
    draw_path,
    draw_world,
    finish_axes,
    legend_below,
    legend_entries,
    picture,
)
from nnql_bullet.run_config import DEFAULT_ROBOT
from nnql_bullet.seeding import Stream, rng
from nnql_bullet.training.base import TrainingEpisode
from nnql_bullet.training.evaluation import Evaluation
from nnql_bullet.worlds.spec import WorldSpec

BAND_PLACES = 400
"""Number of points along a curve at which its interval is computed."""


def draw_trajectory(recording: Recording, path: Path) -> None:
    """Draws the world at the end of a drive, the path coloured by safe and non-safe states, and the clearance."""
    with picture(path, 11.0, 7.4) as figure:
        grid = figure.add_gridspec(2, 2, width_ratios=(2.1, 1.0), height_ratios=(1.15, 1.0))
        whole, closer, clear = (figure.add_subplot(part) for part in (grid[:, 0], grid[0, 1], grid[1, 1]))
        draw_drive(whole, recording, 1.0, 2.0)
        whole.set(xlabel="x [m]", ylabel="y [m]")
        _draw_tightest(closer, recording)
        whole.indicate_inset(bounds=_bounds(closer), inset_ax=None, edgecolor=INK, alpha=0.7)
        _draw_clearance(clear, recording)
        figure.suptitle(_caption(recording), fontsize=11, color=INK)
        moving = {"moving": "moving, as at the end"} if recording.patrols else {}
        plan = {"plan": "plan and what was driven at"} if recording.plans else {}
        waypoint = {"waypoint": "way point"} if recording.world.waypoints else {}
        collision = {"collision": "collision"} if recording.about["ending"] == "collision" else {}
        handles = legend_entries(
            safe="in a safe state",
            non_safe="in a non-safe state",
            obstacle="obstacle",
            **moving,
            **plan,
            start="start",
            **waypoint,
            target="target",
            **collision,
        )
        legend_below(figure, len(handles), handles)


def draw_learning_curve(
    episodes: Sequence[TrainingEpisode], path: Path, window: int = 50, evaluations: Sequence[Evaluation] = ()
) -> None:
    """Draws endings, returns and path lengths of training episodes, as means over a trailing window, and evaluations.

    With several vehicles, episodes are ordered by their end, and temperatures by their beginning.
    """
    with picture(path, 8.0, 7.2) as figure:
        ends, returns, length = figure.subplots(3, 1, sharex=True, height_ratios=(2.2, 1.2, 1.2))
        number = np.arange(1, len(episodes) + 1)
        window = max(1, min(window, len(episodes) // 4))
        for name, colour in colours.ENDINGS.items():
            share = np.array([100.0 * (e.summary.ending == name) for e in episodes])
            ends.plot(number, _trailing_mean(share, window), color=colour, lw=1.8, label=name)
        if evaluations:
            rates = [100.0 * one.success for one in evaluations]
            label = "goal, validation"
            ends.plot([one.episodes for one in evaluations], rates, "o-", color=INK, ms=4, lw=1.0, label=label)
        ends.set(ylabel="episodes [%]", ylim=(-2, 102))
        ends.legend(loc="center left", frameon=False)
        temperature = np.array([e.diagnostics.get("temperature", np.nan) for e in episodes])
        if np.isfinite(temperature).any():
            right = ends.twinx()
            began = np.argsort([e.episode for e in episodes])
            right.plot(number, temperature[began], color=TEMPERATURE, lw=1.2, ls="--")
            right.set_ylabel("temperature T", color=TEMPERATURE)
            right.set_ylim(-0.02 * paper.TEMPERATURE_MAX, 1.02 * paper.TEMPERATURE_MAX)
        total = np.array([e.summary.episode_return for e in episodes])
        returns.plot(number, total, ".", color=BOX, ms=2.5)
        returns.plot(number, _trailing_mean(total, window), color=SAFE, lw=1.8)
        returns.set_ylabel("return")
        travelled = np.array([e.summary.path_length for e in episodes])
        length.plot(number, travelled, ".", color=BOX, ms=2.5)
        length.plot(number, _trailing_mean(travelled, window), color=NON_SAFE, lw=1.8)
        length.set(ylabel="path length [m]", xlabel="episode", xlim=(0, max(number[-1], 2)))
        titles = (f"Training, mean over the last {window} episodes (exploring)", "", "")
        for axes, title in zip((ends, returns, length), titles, strict=True):
            finish_axes(axes, title, 11, hidden=("top",))


def draw_success(recipes: Mapping[str, Mapping[str, Sequence[TrainingEpisode]]], path: Path, window: int = 50) -> None:
    """Draws success while training: a line for each run, and the mean over the runs of a recipe.

    With six runs or more, a band is the bootstrap 95 % interval of that mean over training seeds.

    Args:
        recipes: Episodes of runs that differ by their training seed only, by run name, by recipe name; not empty.
        path: Path of the picture.
        window: Episodes of the trailing mean; fewer if runs are short.
    """
    window = max(1, min(window, min(len(run) for runs in recipes.values() for run in runs.values()) // 4))
    with picture(path, 9.0, 4.4) as figure:
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
                axes.plot(
                    np.arange(1, shortest + 1), mean, color=colour, lw=2.2, label=f"{recipe}: mean of {len(curves)}"
                )
            if len(curves) >= least_seeds():
                places = np.arange(window // 4, shortest, max(1, shortest // BAND_PLACES))
                low, high = mean_interval(
                    np.array([curve[places] for curve in curves.values()]), rng(0, Stream.BOOTSTRAP)
                )
                axes.fill_between(places + 1, low, high, color=colour, alpha=0.25, lw=0)
        axes.set(ylabel="success [%]", ylim=(-2, 102), xlabel="episode", xlim=(0, None))
        finish_axes(axes, f"Training, mean over the last {window} episodes (exploring)", 11, hidden=OPEN)
        figure.legend(loc="outside right center", frameon=False, fontsize=9)


def draw_map(world: WorldSpec, path: Path) -> None:
    """Draws a world from above, with moving boxes at time 0."""
    with picture(path, 6.0, 6.0) as figure:
        axes = figure.add_subplot()
        draw_world(axes, world, 0.0)
        axes.set(xlim=(-2, world.width + 2), ylim=(-2, world.depth + 2), aspect="equal", xlabel="x [m]", ylabel="y [m]")
        axes.set_title(f"{world.name}, seed {world.seed}", fontsize=10, color=INK)


def _draw_tightest(axes: Axes, recording: Recording, half: float = 6.0) -> None:
    """Draws the moment with the smallest clearance enlarged."""
    moment = _tightest(recording)
    vehicle = moved(recording.footprint, Pose(*recording.sample_pose[moment]))
    x, y = vehicle.x, vehicle.y
    draw_world(axes, recording.world, recording.sample_time[moment])
    draw_path(axes, recording, detail=2.0)
    axes.add_patch(Polygon(vehicle.corners(), fc=VEHICLE, ec=INK, lw=1.6, zorder=5))
    axes.set(xlim=(x - half, x + half), ylim=(y - half, y + half), aspect="equal", xlabel="x [m]", ylabel="y [m]")
    finish_axes(axes, f"the tightest moment, at {recording.sample_time[moment]:.1f} s", grid="none")


def _tightest(recording: Recording) -> int:
    """Finds the sample closest to a box, in the control period with the smallest clearance."""
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
    """Draws the smallest clearance in each step over time, in the colours of the path."""
    time = recording.state_time
    points = np.column_stack([np.repeat(time, 2)[1:-1], np.repeat(recording.clearance, 2)])
    pieces = np.repeat(np.where(recording.state_property[:-1] == "NS", NON_SAFE, SAFE), 2)[1:]
    axes.add_collection(coloured_line(points, pieces, 1.8))
    axes.set(xlim=(0, time[-1]), ylim=(0, paper.SENSOR_RANGE), xlabel="time [s]", ylabel="clearance [m]")
    finish_axes(axes, f"clearance, smallest {recording.clearance.min():.2f} m")


def _caption(recording: Recording) -> str:
    about = recording.about
    world, vehicle = about["world"], about["vehicle"].get("name", DEFAULT_ROBOT)
    robot = "" if vehicle == DEFAULT_ROBOT else f" on '{vehicle}'"
    cover = sum(box.area for box in recording.obstacles) / (world["width"] * world["depth"])
    return (
        f"{about.get('policy', 'policy')}{robot} in world '{world['name']}', seed {world['seed']} ({cover:.1%} cover): "
        f"{about['ending']} after {recording.state_time[-1]:.1f} s"
    )


def _trailing_mean(values: Array, window: int) -> Array:
    total = np.cumsum(np.concatenate([[0.0], values]))
    end = np.arange(1, len(values) + 1)
    begin = np.maximum(end - window, 0)
    mean = np.asarray((total[end] - total[begin]) / (end - begin))
    mean[: window // 4] = np.nan  # too few episodes for a mean
    return mean
