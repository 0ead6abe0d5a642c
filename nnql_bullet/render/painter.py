"""Paints moments of a recording: solid bodies, ground and light."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from nnql_bullet import colours
from nnql_bullet.geometry import Array, Pose, as_rows, moved, placed
from nnql_bullet.render.camera import Camera
from nnql_bullet.render.shading import (
    NON_SAFE_PATH,
    SAFE_PATH,
    SHADOW,
    Ground,
    Inks,
    blocks_of,
    eye_of,
    paint_line,
    paint_shadow,
    shade,
    shadow_reach,
    smooth_edges,
)
from nnql_bullet.render.solids import Renderer
from nnql_bullet.render.timeline import Moment, Timeline
from nnql_bullet.types import Bytes

MOST_CELLS = 2200
"""Largest number of cells in the map of the ground along the longer side of the arena."""
FINEST = 0.03
"""Smallest side of a cell [m]."""
PATH_WIDTH = 0.16
"""Width of the line of the path [m]."""
VEHICLE_HEIGHT = 0.4
"""Height of the vehicle for its shadow [m]."""
INKS = Inks(
    floor=colours.rgb(colours.FLOOR),
    outside=colours.rgb(colours.OUTSIDE),
    target=colours.rgb(colours.COLLISION),
    safe=colours.rgb(colours.SAFE),
    non_safe=colours.rgb(colours.NON_SAFE),
    horizon=colours.rgb(colours.HORIZON),
)


def tint(reading: Array, sensor_range: float) -> Array:
    """Returns colours (..., 3) of sensor readings (...) [m], from red over yellow to green at the range [m]."""
    share = np.clip(np.asarray(reading) / sensor_range, 0.0, 1.0)[..., None]
    low, middle, high = (np.array(colours.rgb(colour)) for colour in (colours.NEAR, colours.MIDDLE, colours.FAR))
    rising, falling = low + 2 * share * (middle - low), middle + (2 * share - 1) * (high - middle)
    return np.asarray(np.where(share < 0.5, rising, falling))


class Painter:
    """Paints the moments of one recording."""

    def __init__(self, timeline: Timeline, renderer: Renderer) -> None:
        self._renderer = renderer
        world = timeline.recording.world
        self._cell = max(max(world.width, world.depth) / MOST_CELLS, FINEST)
        rows, columns = (int(np.ceil(side / self._cell)) for side in (world.depth, world.width))
        self._cells = np.zeros((rows, columns), "<u4")
        self._layers = self._cells.view(np.uint8).reshape(rows, columns, 4)
        self._busy = blocks_of(self._cells)
        for box in as_rows(() if renderer.lights else world.obstacles + world.walls):
            paint_shadow(self._layers[..., SHADOW], self._busy, self._cell, box, world.obstacle_height)
        self._painted = 1
        """Number of positions of the path in the map."""
        self.follow(timeline)
        self._heights = np.array([VEHICLE_HEIGHT, *[world.obstacle_height] * len(world.patrols)])

    def follow(self, timeline: Timeline) -> None:
        """Takes up a later timeline of the episode, as it has gone on."""
        self._timeline, self._safe = timeline, timeline.safe()

    def paint(self, moment: Moment, camera: Camera) -> tuple[Bytes, NDArray[np.float32]]:
        """Paints a camera's picture at a moment (height, width, 3); returns it with the `Solids.depths`."""
        self._paint_path(moment)
        samples, recording = self._renderer.samples, self._timeline.recording
        camera = replace(camera, width=samples * camera.width, height=samples * camera.height)
        solids = self._renderer.draw(moment, camera)
        readings = recording.readings[moment.step]
        boxes = as_rows((moved(recording.footprint, moment.pose), *moment.movers))
        reaches = [shadow_reach(box, height) for box, height in zip(boxes, self._heights, strict=True)]
        picture = shade(
            solids.colours,
            solids.depths,
            solids.light,
            eye_of(camera),
            self._ground(moment),
            INKS,
            self._cells,
            self._busy,
            np.column_stack([boxes, self._heights, reaches])[: 0 if self._renderer.lights else None],
            np.column_stack([readings, tint(readings, self._timeline.recording.sensor.range)]),
        )
        return _averaged(smooth_edges(picture, solids.depths), samples), solids.depths[::samples, ::samples]

    def _paint_path(self, moment: Moment) -> None:
        """Paints the path up to a moment into the map."""
        places = self._timeline.path(moment.time)
        if len(places) < self._painted:
            self._layers[..., SAFE_PATH:] = 0
            self._painted = 1
        for k in range(self._painted, len(places)):
            layer = self._layers[..., SAFE_PATH if self._safe[k - 1] else NON_SAFE_PATH]
            paint_line(layer, self._busy, self._cell, places[k - 1], places[k], PATH_WIDTH / 2)
        self._painted = max(len(places), 1)

    def _ground(self, moment: Moment) -> Ground:
        recording = self._timeline.recording
        world = recording.world
        pose = Pose(*recording.state_pose[moment.step].tolist())
        return Ground(
            cell=self._cell,
            width=world.width,
            depth=world.depth,
            target=(*world.target, world.target_radius),
            scan=(*placed(pose, *recording.sensor.position[:2]), pose.yaw),
            sensor_range=recording.sensor.range,
        )


def _averaged(picture: Bytes, samples: int) -> Bytes:
    """Averages a picture over squares of pixels."""
    if samples == 1:
        return picture
    height, width, _ = picture.shape
    squares = picture.reshape(height // samples, samples, width // samples, samples, 3)
    return np.asarray(np.round(squares.mean(axis=(1, 3), dtype=np.float32)).astype(np.uint8))
