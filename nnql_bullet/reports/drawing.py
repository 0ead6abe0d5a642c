"""Draws parts of pictures with Matplotlib's object interface: no display, no global figures."""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from threading import RLock
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from matplotlib import rc_context, rcParamsDefault
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle as Disc
from matplotlib.patches import Patch, Polygon
from numpy.typing import NDArray

from nnql_bullet import colours
from nnql_bullet.colours import (
    ARENA,
    BOX,
    BOX_EDGE,
    COLLISION,
    GRID,
    INK,
    MOVING,
    MOVING_EDGE,
    NON_SAFE,
    PLAN,
    SAFE,
    TARGET,
    TEMPERATURE,
    VEHICLE,
)
from nnql_bullet.errors import UserError
from nnql_bullet.evaluation.statistics import Estimate
from nnql_bullet.files import write_atomically
from nnql_bullet.geometry import Array, Circle, OrientedBox, Pose, moved
from nnql_bullet.recording import Recording
from nnql_bullet.worlds.spec import WorldSpec

DPI = 150
"""Resolution of pictures [pixels per inch]."""
OUTLINE_EVERY = 4.0
"""Distance along the path between two outlines of the vehicle [m]."""
OPEN = ("top", "right")
"""Spines to hide in axes with only a left and a lower one."""
MARKS = "osD^vPX"
POWERS = {"text.parse_math": True}
"""Settings of a picture with a logarithmic axis, whose numbers are powers of ten."""

_one_at_a_time = RLock()

_ENTRIES: dict[str, dict[str, Any]] = {
    "safe": {"color": SAFE, "lw": 2.4},
    "non_safe": {"color": NON_SAFE, "lw": 2.4},
    "obstacle": {"facecolor": BOX, "edgecolor": BOX_EDGE},
    "moving": {"facecolor": MOVING, "edgecolor": MOVING_EDGE},
    "vehicle": {"facecolor": VEHICLE, "edgecolor": INK},
    "path": {"color": SAFE, "lw": 1.8},
    "bottleneck": {"marker": "o", "ls": "", "mfc": "none", "mec": TEMPERATURE, "mew": 1.8},
    "plan": {"color": PLAN, "lw": 1.4, "ls": "--", "marker": ".", "ms": 4},
    "waypoint": {"marker": "o", "ls": "", "mfc": "none", "mec": COLLISION, "ms": 8},
    "start": {"marker": "o", "ls": "", "mfc": INK, "mec": INK},
    "target": {"marker": "o", "ls": "", "mfc": TARGET, "mec": COLLISION, "ms": 10},
    "collision": {"marker": "X", "ls": "", "mfc": COLLISION, "mec": "white", "ms": 11},
    "touched": {"marker": "o", "ls": "", "mfc": COLLISION, "mec": "white", "ms": 7},
}


@contextmanager
def picture(
    path: Path, width: float, height: float, settings: Mapping[str, Any] = MappingProxyType({})
) -> Iterator[Figure]:
    """Yields an empty figure, and writes it atomically; the same figure gives the same bytes.

    It is drawn with Matplotlib's default settings, whatever the user's matplotlibrc or program has set. They are those
    of the whole process for that time, so one picture is drawn at a time.

    Args:
        path: File of the picture.
        width: Width [inches].
        height: Height [inches].
        settings: Settings of Matplotlib (rcParams) beside its defaults.

    Raises:
        UserError: If the file is no .png.
    """
    if path.suffix.lower() != ".png":
        raise UserError(f"{path}: pictures are .png; give such a name")
    its: dict[Any, Any] = {name: value for name, value in rcParamsDefault.items() if name != "backend"}
    its |= {"text.parse_math": False, **settings}  # a dollar in a name is a dollar
    with _one_at_a_time, rc_context(its):
        figure = Figure(figsize=(width, height), dpi=DPI, layout="constrained")
        canvas: Any = FigureCanvasAgg(figure)  # `savefig` would draw it twice
        yield figure
        write_atomically(path, lambda temporary: canvas.print_png(temporary, metadata={"Software": None}))


def finish_axes(
    axes: Axes,
    title: str = "",
    size: float = 10.0,
    grid: Literal["both", "x", "none"] = "both",
    hidden: Sequence[str] = (),
) -> None:
    """Gives axes a title, a grid and spines in the style of all pictures.

    Args:
        axes: Axes that hold their data.
        title: Text above the axes.
        size: Font size of the title [points].
        grid: Grid lines across both axes, across the x axis, or none.
        hidden: Spines to hide.
    """
    axes.set_title(title, fontsize=size, color=INK)
    if grid != "none":
        axes.grid(axis=grid, color=GRID, lw=0.8)
    for name in hidden:
        axes.spines[name].set_visible(False)


def legend_entries(**labels: str) -> list[Line2D | Patch]:
    """Returns legend entries for parts of `draw_world` and `draw_path`; arguments are labels by part."""
    return [
        Patch(label=label, **_ENTRIES[name])
        if "facecolor" in _ENTRIES[name]
        else Line2D([], [], label=label, **_ENTRIES[name])
        for name, label in labels.items()
    ]


def legend_below(figure: Figure, columns: int, handles: Sequence[Line2D | Patch] | None = None) -> None:
    """Draws a legend under all axes; by default with the labels of the first axes."""
    shown = figure.axes[0].get_legend_handles_labels()[0] if handles is None else handles
    figure.legend(handles=shown, loc="outside lower center", ncols=columns, frameon=False, fontsize=9)


def draw_world(axes: Axes, world: WorldSpec, time: float, outline: float = 0.8) -> None:
    """Draws arena, boxes, start and target to scale, and moving boxes with their tracks.

    Args:
        axes: Axes to draw on.
        world: The world.
        time: Instant at which moving boxes are shown [s].
        outline: Width of the lines around obstacles; with 0 they are filled in the colour of lines.
    """
    width, depth = world.width, world.depth
    axes.add_patch(Polygon([(0, 0), (width, 0), (width, depth), (0, depth)], fc=ARENA, ec=BOX_EDGE, lw=2.5))
    outlines = [_rim(its) if isinstance(its, Circle) else its.corners() for its in world.obstacles]
    fill = BOX if outline else BOX_EDGE
    axes.add_collection(PolyCollection(outlines, facecolor=fill, edgecolor=BOX_EDGE, linewidth=outline or 0.1))
    for patrol in world.patrols:
        (x, y), at_end = patrol.end, replace(patrol.box, x=patrol.end[0], y=patrol.end[1])
        axes.plot((patrol.box.x, x), (patrol.box.y, y), color=MOVING_EDGE, lw=0.6, ls="--", zorder=1.5)
        for box in (patrol.box, at_end):
            axes.add_patch(Polygon(box.corners(), fc="none", ec=MOVING_EDGE, lw=0.6, ls="--"))
        axes.add_patch(Polygon(patrol.at(time).corners(), fc=MOVING, ec=MOVING_EDGE, lw=0.8, zorder=2))
    for number, place in enumerate(world.waypoints, 1):
        axes.add_patch(Disc(place, world.target_radius, fc="none", ec=COLLISION, lw=1.0, zorder=3))
        axes.text(*place, str(number), color=COLLISION, size=8, ha="center", va="center", clip_on=True, zorder=7)
    axes.add_patch(Disc(world.target, world.target_radius, fc=TARGET, ec=COLLISION, lw=1.6))
    axes.plot(*world.target, "+", color=COLLISION, ms=7)
    axes.plot(world.start.x, world.start.y, "o", color=INK, ms=5, zorder=5)


def _rim(circle: Circle) -> Array:
    """Points around a circle, as its corners (48, 2) [m]."""
    angles = np.linspace(0.0, 2 * np.pi, 48, endpoint=False)
    return circle.radius * np.column_stack([np.cos(angles), np.sin(angles)]) + (circle.x, circle.y)


def draw_path(axes: Axes, recording: Recording, detail: float = 1.0, cross: bool = True) -> None:
    """Draws the path coloured by safe and non-safe states, outlines of the vehicle, and the vehicle at the end.

    Args:
        axes: Axes to draw on.
        recording: Recording of the drive.
        detail: Factor on the width of lines and on the density of outlines.
        cross: Whether a cross on the vehicle marks a collision.
    """
    for _, corners in recording.plans:
        axes.plot(*corners.T, color=PLAN, lw=1.4 * detail, ls="--", zorder=2.5)
    if recording.plans:
        axes.plot(*recording.aims.T, ".", color=PLAN, ms=2.0 * detail, zorder=3)
    points = recording.sample_pose[:, :2]
    decision = np.searchsorted(recording.state_time, recording.sample_time - 1e-9, side="left") - 1
    non_safe = recording.state_property[np.clip(decision, 0, None)] == "NS"
    axes.add_collection(coloured_line(points, np.where(non_safe[1:], NON_SAFE, SAFE), 2.0 * detail))
    outlines = [its.corners() for its in _outlines(recording, OUTLINE_EVERY / detail)]
    axes.add_collection(PolyCollection(outlines, facecolor="none", edgecolor=INK, linewidth=0.6 * detail, zorder=3))
    last = moved(recording.footprint, Pose(*recording.state_pose[-1]))
    axes.add_patch(Polygon(last.corners(), fc=VEHICLE, ec=INK, lw=0.8 * detail, zorder=6))
    if cross and recording.about["ending"] == "collision":
        axes.plot(last.x, last.y, "X", color=COLLISION, mec="white", ms=11, zorder=7)


def draw_drive(
    axes: Axes, recording: Recording, detail: float, margin: float, title: str = "", size: float = 8
) -> None:
    """Draws the whole world at the end of a drive with the path through it.

    Args:
        axes: Axes to draw on.
        recording: Recording of the drive.
        detail: See `draw_path`.
        margin: Width of the frame around the arena [m].
        title: Text above the axes.
        size: Font size of the title [points].
    """
    draw_world(axes, recording.world, recording.state_time[-1])
    draw_path(axes, recording, detail)
    frame_world(axes, recording, margin)
    finish_axes(axes, title, size, grid="none")


def frame_world(axes: Axes, recording: Recording, margin: float) -> None:
    """Sets the limits of axes to the arena and a margin around it [m], to scale."""
    world = recording.about["world"]
    axes.set(xlim=(-margin, world["width"] + margin), ylim=(-margin, world["depth"] + margin), aspect="equal")


def without_ticks(axes: Axes) -> None:
    """Removes the ticks of axes whose scale does not matter."""
    axes.set_xticks([])
    axes.set_yticks([])


def draw_endings(
    axes: Axes,
    names: Sequence[str],
    shares: Sequence[Mapping[str, Estimate]],
    success: Sequence[Estimate],
    digits: int = 0,
) -> None:
    """Draws stacked bars of the endings of drives, with success and its interval.

    Args:
        axes: Axes to draw on.
        names: Names of the bars, from above.
        shares: Shares of the endings for each bar.
        success: Success with its interval for each bar.
        digits: Number of decimals.
    """
    places, left = np.arange(len(names))[::-1], np.zeros(len(names))
    for ending, colour in colours.ENDINGS.items():
        widths = np.array([100 * share[ending].value for share in shares])
        axes.barh(places, widths, left=left, color=colour, height=0.7, label=ending)
        left += widths
    for place, shown in zip(places.tolist(), success, strict=True):
        axes.plot([100 * shown.low, 100 * shown.high], [place] * 2, color=INK, lw=1.4, solid_capstyle="butt")
        axes.text(102, place, f"{100 * shown.value:.{digits}f}", va="center", fontsize=8, color=INK)
    axes.set_yticks(places, names)


def coloured_line(points: Array, piece_colours: NDArray[np.str_], width: float) -> LineCollection:
    """Returns a line through points (n, 2) whose n - 1 pieces have their own colours."""
    turns = [0, *(np.flatnonzero(piece_colours[1:] != piece_colours[:-1]) + 1), len(piece_colours)]
    runs = [points[a : b + 1] for a, b in pairwise(turns) if a < b]  # a piece at a time takes long to draw
    shown = piece_colours[turns[: len(runs)]].tolist()
    return LineCollection(runs, colors=shown, linewidths=width, capstyle="round", joinstyle="round", zorder=4)


def _outlines(recording: Recording, every: float) -> list[OrientedBox]:
    poses = recording.sample_pose
    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])
    chosen = np.unique(np.searchsorted(along, np.arange(0.0, along[-1], every)))
    return [moved(recording.footprint, Pose(*poses[i])) for i in chosen]
