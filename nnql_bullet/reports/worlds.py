"""Describes a world, and draws it with the shortest path through it and its narrowest place."""

from dataclasses import dataclass
from functools import cached_property
from math import degrees, inf
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Circle as Disc
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator

from nnql_bullet.colours import BOX_EDGE, SAFE, TEMPERATURE
from nnql_bullet.geometry import Array, Circle, Pose, placed
from nnql_bullet.reports.drawing import draw_world, finish_axes, legend_below, legend_entries, picture
from nnql_bullet.reports.tables import finite
from nnql_bullet.worlds.paths import path_length, shortest_path
from nnql_bullet.worlds.spec import WorldSpec

LONGER, SHORTER = 9.0, 3.4
"""Length of the longer side of a picture, and least length of the other [inches]."""


@dataclass(frozen=True)
class WorldView:
    """A world as a vehicle finds it."""

    world: WorldSpec
    frame: Pose
    """The arena's lower left corner in the frame of its map, in which places are given."""
    vehicle: str
    vehicle_width: float
    """[m]"""
    needed: float
    """Width of the narrowest passage that the world asks for: that of the vehicle and its clearance [m]."""

    @cached_property
    def path(self) -> Array:
        """Corners of the shortest path of a disc of the vehicle's width, or of the bottleneck's if that is less."""
        return shortest_path(self.world, min(self.vehicle_width, self.world.bottleneck.width) / 2)[0]

    @property
    def values(self) -> dict[str, Any]:
        """What `show` prints, for JSON; places are in the frame of the map, null stands for what there is not."""
        w, found = self.world, self.world.bottleneck
        circles = sum(isinstance(its, Circle) for its in w.obstacles)
        x, y = placed(self.frame, found.x, found.y)
        return finite(
            {
                "name": w.name,
                "seed": w.seed,
                "width": w.width,
                "depth": w.depth,
                "origin": [self.frame.x, self.frame.y, self.frame.yaw],
                "boxes": len(w.obstacles) - circles,
                "circles": circles,
                "moving": len(w.patrols),
                "cover": w.cover,
                "start": [*placed(self.frame, w.start.x, w.start.y), w.start.yaw + self.frame.yaw],
                "target": list(placed(self.frame, *w.target)),
                "target_radius": w.target_radius,
                "bottleneck": found.width,
                "bottleneck_at": [x, y],
                "needed": self.needed,
                "passable": found.admits(self.needed),
                "path_length": path_length(self.path) if len(self.path) else inf,
                "digest": w.digest,
            }
        )

    def text(self) -> str:
        """The values in words."""
        v = self.values
        moving = f", {v['moving']} moving" if v["moving"] else ""
        (x, y, yaw), (u, w), (p, q) = v["start"], v["target"], v["bottleneck_at"]
        path = "no path" if v["path_length"] is None else f"{v['path_length']:.1f} m by the shortest path"
        fits = "passes" if v["passable"] else f"does not pass: it needs {v['needed']:.2f} m"
        return "\n".join(
            [
                f"world '{v['name']}', seed {v['seed']}: {v['width']:g} m x {v['depth']:g} m, {v['boxes']} boxes, "
                f"{v['circles']} circles{moving}, cover {100 * v['cover']:.1f} %",
                f"start ({x:.2f}, {y:.2f}), yaw {degrees(yaw):.0f} degrees; target ({u:.2f}, {w:.2f}), reached within "
                f"{v['target_radius']:g} m; {path}",
                f"bottleneck {v['bottleneck']:.2f} m at ({p:.2f}, {q:.2f}); {self.vehicle}, {self.vehicle_width:g} m "
                f"wide, {fits}",
            ]
        )

    def draw(self, path: Path) -> None:
        """Draws the world to scale with the shortest path and the bottleneck."""
        world = self.world
        longer = max(world.width, world.depth)
        sides = [max(LONGER * side / longer, SHORTER) for side in (world.width, world.depth)]
        with picture(path, sides[0] + 0.8, sides[1] + 1.4) as figure:
            axes = figure.add_subplot()
            fine = len(world.obstacles) > 200
            draw_world(axes, world, 0.0, outline=0.0 if fine else 0.8)
            if len(self.path):
                axes.plot(*self.path.T, color=SAFE, lw=1.8, zorder=4, solid_joinstyle="round")
            narrow = world.bottleneck
            radius = max(narrow.width / 2, 0.012 * longer)
            axes.add_patch(Disc((narrow.x, narrow.y), radius, fc="none", ec=TEMPERATURE, lw=1.8, zorder=6))
            margin = 0.02 * longer
            axes.set(xlim=(-margin, world.width + margin), ylim=(-margin, world.depth + margin), aspect="equal")
            self._scale(axes)
            finish_axes(axes, self._title(), 10, grid="none")
            way = f"shortest path, {path_length(self.path):.1f} m" if len(self.path) else "no path"
            handles = [
                Patch(fc=BOX_EDGE, label="obstacle") if fine else legend_entries(obstacle="obstacle")[0],
                *legend_entries(**({"moving": "moving"} if world.patrols else {}), start="start", target="target"),
                *legend_entries(path=way, bottleneck=f"bottleneck, {narrow.width:.2f} m"),
            ]
            legend_below(figure, 3 if sides[0] < 7 else len(handles), handles)

    def _title(self) -> str:
        w = self.world
        return f"{w.name}: {w.width:g} m x {w.depth:g} m, {len(w.obstacles)} shapes, cover {100 * w.cover:.1f} %"

    def _scale(self, axes: Axes) -> None:
        """Writes coordinates of the map on the axes; of the arena, if that is turned in its map."""
        if self.frame.yaw:
            axes.set(xlabel="x in the arena [m]", ylabel="y in the arena [m]")
            return
        for axis, begin, length in (
            (axes.xaxis, self.frame.x, self.world.width),
            (axes.yaxis, self.frame.y, self.world.depth),
        ):
            ticks = np.asarray(MaxNLocator(8).tick_values(begin, begin + length))
            ticks = np.round(ticks[(begin <= ticks) & (ticks <= begin + length)], 9)
            axis.set_ticks(ticks - begin, [f"{tick:g}" for tick in ticks])
        axes.set(xlabel="x [m]", ylabel="y [m]")
