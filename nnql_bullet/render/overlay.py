"""Writes text and marks over a picture: readings, action values, the action, the state and the ending."""

from collections.abc import Sequence
from functools import lru_cache
from importlib.util import find_spec
from math import degrees
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from nnql_bullet import colours, paper
from nnql_bullet.colours import INK, PANEL, TIMEOUT
from nnql_bullet.geometry import Pose, placed
from nnql_bullet.render.camera import Camera
from nnql_bullet.render.labels import MANOEUVRES, PROPERTIES
from nnql_bullet.render.timeline import Moment, Timeline
from nnql_bullet.types import Bytes

Box = tuple[float, float, float, float]

DESIGNED_FOR = 720
"""Height of a picture in which sizes have the stated pixels."""
FAR_OFF = 40.0
"""Distance beyond which the vehicle is hard to find in the picture [m]."""


class Overlay:
    """Writes over pictures of one recording."""

    def __init__(self, timeline: Timeline, height: int) -> None:
        """Prepares an overlay for pictures of a height in pixels."""
        self._timeline = timeline
        self._recording = timeline.recording
        self._size = height / DESIGNED_FOR
        self._safe = timeline.safe()

    def write(self, picture: Bytes, depths: NDArray[np.float32], moment: Moment, cameras: Sequence[Camera]) -> Bytes:
        """Returns the picture with all text and marks.

        Args:
            picture: Picture (h, w, 3).
            depths: Depths of solid bodies (h, w); 1 for ground or sky.
            moment: Moment of the picture.
            cameras: Cameras of its parts, from left to right.
        """
        image = Image.fromarray(picture)
        draw = ImageDraw.Draw(image, "RGBA")
        left = 0
        for camera in cameras:
            self._mark(draw, depths, moment, left, camera)
            left += camera.width
        self._title(draw)
        self._numbers(draw, moment, image.width)
        self._values(draw, moment, image.height)
        self._state(draw, moment, image.width, image.height)
        self._time_line(draw, moment, image.width, image.height)
        if moment.over:
            self._ending(draw, image.width)
        return np.asarray(image)

    def _px(self, pixels: float) -> float:
        return pixels * self._size

    def _font(self, size: float, bold: bool = False) -> ImageFont.FreeTypeFont:
        return text_font(max(round(self._px(size)), 7), bold)

    def _mark(
        self, draw: ImageDraw.ImageDraw, depths: NDArray[np.float32], moment: Moment, left: int, camera: Camera
    ) -> None:
        """Marks the path and the vehicle for a distant camera, and the sectors' readings for a near one."""
        pose = moment.pose
        if np.linalg.norm(np.subtract(camera.eye, (pose.x, pose.y, 0.0))) > FAR_OFF:
            self._mark_path(draw, moment, left, camera)
        else:
            self._mark_readings(draw, depths, moment, left, camera)

    def _mark_path(self, draw: ImageDraw.ImageDraw, moment: Moment, left: int, camera: Camera) -> None:
        """Draws the path so far and a ring around the vehicle."""
        places = self._timeline.path(moment.time)
        pixels, _ = camera.project(np.column_stack([places, np.zeros(len(places))]))
        safe = self._safe[: len(places) - 1]
        changes = np.flatnonzero(np.diff(safe)) + 1
        for part in np.split(np.arange(len(safe)), changes):
            if len(part):
                points = [(left + x, y) for x, y in pixels[part[0] : part[-1] + 2].tolist()]
                colour = colours.SAFE if safe[part[0]] else colours.NON_SAFE
                draw.line(points, fill=colour, width=round(self._px(2)) or 1)
        ((x, y),), _ = camera.project(np.array([[moment.pose.x, moment.pose.y, 0.3]]))
        r = self._px(13)
        ring = (left + x - r, y - r, left + x + r, y + r)
        draw.ellipse(ring, outline=INK, width=round(self._px(2)) or 1)

    def _mark_readings(
        self, draw: ImageDraw.ImageDraw, depths: NDArray[np.float32], moment: Moment, left: int, camera: Camera
    ) -> None:
        """Writes the reading of each sector at its rim, if the camera sees the ground there."""
        recording, font = self._recording, self._font(15)
        pose, readings = Pose(*recording.state_pose[moment.step].tolist()), recording.readings[moment.step]
        x, y = placed(pose, *recording.sensor.position[:2])
        angles = pose.yaw + np.arange(paper.SECTORS) * paper.SECTOR_ANGLE
        reach = readings - 0.45
        across, along = x + reach * np.cos(angles), y + reach * np.sin(angles)
        pixels, _ = camera.project(np.column_stack([across, along, np.zeros(len(angles))]))
        for (u, v), reading in zip(pixels, readings, strict=True):
            inside = 0 <= u < camera.width and 0 <= v < camera.height
            if inside and reading < recording.sensor.range - LEAST_SHOWN and depths[int(v), left + int(u)] == 1.0:
                draw.text((left + u, v), f"{reading:.1f} m", fill=INK, font=font, anchor="mm")

    def _title(self, draw: ImageDraw.ImageDraw) -> None:
        about, world = self._recording.about, self._recording.world
        lines = [
            (str(about.get("policy", "policy")), self._font(20, bold=True)),
            (f"world {world.name}, seed {world.seed}", self._font(17)),
            (_simulator(about), self._font(17)),
        ]
        lines = [(text, font) for text, font in lines if text]
        width = max(font.getlength(text) for text, font in lines)
        pad, line = self._px(12), self._px(25)
        self._panel(draw, (pad, pad, 3 * pad + width, 2.6 * pad + line * len(lines)))
        for row, (text, font) in enumerate(lines):
            draw.text((2 * pad, 1.8 * pad + row * line), text, fill=INK, font=font)

    def _numbers(self, draw: ImageDraw.ImageDraw, moment: Moment, width: int) -> None:
        clearance = self._recording.clearance[moment.step]
        time, speed = f"{moment.time:.1f} s", f"{moment.speed:.2f} m/s"
        rows = (("time", time), ("speed", speed), ("clearance", f"{clearance:.2f} m"))
        pad, line, across = self._px(12), self._px(25), self._px(190)
        left = width - pad - across
        self._panel(draw, (left, pad, width - pad, 2.6 * pad + line * len(rows)))
        for row, (name, value) in enumerate(rows):
            y = 1.8 * pad + row * line
            draw.text((left + pad, y), name, fill=TIMEOUT, font=self._font(17))
            draw.text((width - 2 * pad, y), value, fill=INK, font=self._font(17, bold=True), anchor="ra")

    def _values(self, draw: ImageDraw.ImageDraw, moment: Moment, height: int) -> None:
        """Names the chosen manoeuvre; draws the values of the five turns as bars, left turns to the left.

        The bar of the manoeuvre is marked, if it is one of them: some agents know more than these, at lower speeds.
        """
        values, action = self._recording.q_values[moment.step], int(self._recording.action[moment.step])
        pad, bar, tall, line = self._px(12), self._px(40), self._px(86), self._px(22)
        asked = bool(np.isfinite(values).all())
        text = f"shield: {MANOEUVRES[action]}" if self._recording.overridden[moment.step] else MANOEUVRES[action]
        font, small = self._font(16, bold=True), self._font(14)
        wide, high = 2 * pad + max(5 * bar if asked else 0, font.getlength(text)), self._px(34)
        if asked:
            high += line + tall + self._px(32)
        left, above = pad, height - self._px(30) - high
        self._panel(draw, (left, above, left + wide, above + high))
        draw.text((left + pad, above + self._px(7)), text, fill=INK, font=font)
        if not asked:
            return
        draw.text((left + pad, above + self._px(7) + line), "values of the five turns", fill=TIMEOUT, font=small)
        floor = above + line + self._px(36) + tall
        low, most = min(values.min(), 0.0), max(values.max(), 0.0)
        scale = (tall - self._px(16)) / max(most - low, 1e-9)
        zero = floor + low * scale
        order = sorted(range(len(paper.TURNS)), key=lambda k: -paper.TURNS[k])
        for place, k in enumerate(order):
            x, y, chosen = left + pad + place * bar, zero - float(values[k]) * scale, k == action
            box = (x + self._px(6), min(y, zero), x + bar - self._px(6), max(y, zero, min(y, zero) + 1))
            draw.rectangle(box, fill=colours.NON_SAFE if chosen else colours.TIMEOUT)
            middle, above_bar = x + bar / 2, box[1] - self._px(3)
            draw.text((middle, above_bar), f"{values[k]:.2f}", fill=INK, font=self._font(11), anchor="ms")
            ink, font = INK if chosen else TIMEOUT, self._font(14, bold=chosen)
            draw.text((middle, floor + self._px(14)), _turn(k), fill=ink, font=font, anchor="mm")
        draw.line((left + pad, zero, left + pad + 5 * bar, zero), fill=INK, width=1)

    def _state(self, draw: ImageDraw.ImageDraw, moment: Moment, width: int, height: int) -> None:
        step = len(self._recording.action) if moment.over else moment.step
        text, colour = PROPERTIES[str(self._recording.state_property[step])]
        font = self._font(20, bold=True)
        across, pad = font.getlength(text), self._px(12)
        right, below = width - pad, height - self._px(30)
        box = (right - across - 2 * pad, below - self._px(38), right, below)
        draw.rounded_rectangle(box, radius=self._px(8), fill=colour)
        draw.text(((box[0] + box[2]) / 2, (box[1] + box[3]) / 2), text, fill="white", font=font, anchor="mm")

    def _time_line(self, draw: ImageDraw.ImageDraw, moment: Moment, width: int, height: int) -> None:
        """Draws a bar of the whole episode with safe and non-safe states so far."""
        pad, tall = self._px(12), max(self._px(8), 2)
        left, across, below = pad, width - 2 * pad, height - pad
        draw.rectangle((left, below - tall, left + across, below), fill=PANEL)
        times = np.minimum(self._recording.state_time, moment.time) / self._timeline.duration
        for begin, end, state in zip(times[:-1], times[1:], self._recording.state_property[:-1], strict=True):
            if begin < end:
                box = (left + begin * across, below - tall, left + end * across, below)
                draw.rectangle(box, fill=PROPERTIES[str(state)][1])

    def _ending(self, draw: ImageDraw.ImageDraw, width: int) -> None:
        ending = self._recording.about["ending"]
        text = f"{ending} after {self._timeline.duration:.1f} s"
        font, pad = self._font(34, bold=True), self._px(16)
        across = font.getlength(text)
        box = ((width - across) / 2 - pad, self._px(90), (width + across) / 2 + pad, self._px(90) + self._px(60))
        draw.rounded_rectangle(box, radius=self._px(10), fill=colours.ENDINGS[ending])
        draw.text((width / 2, (box[1] + box[3]) / 2), text, fill="white", font=font, anchor="mm")

    def _panel(self, draw: ImageDraw.ImageDraw, box: Box) -> None:
        draw.rounded_rectangle(box, radius=self._px(8), fill=PANEL)


def _turn(action: int) -> str:
    """Writes one of the five turns in degrees as text."""
    turn = degrees(paper.TURNS[action])
    return f"{turn:+.0f}°" if turn else "0°"


LEAST_SHOWN = 0.05
"""How much nearer than the sensor's range an obstacle is whose distance is written [m]."""


def _simulator(about: dict[str, object]) -> str:
    """Returns the name of the simulator; empty if the recording does not contain it."""
    if about.get("simulator") == "kinematic":
        return "kinematic model"
    names = {"bullet": "PyBullet", "mujoco": "MuJoCo"}
    name = names.get(str(about.get("simulator")), "")
    return f"{name}, {about['physics']}" if name and "physics" in about else name


@lru_cache(maxsize=32)
def text_font(size: int, bold: bool) -> ImageFont.FreeTypeFont:
    """Returns the font that Matplotlib ships, the same on every machine."""
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    (matplotlib,) = find_spec("matplotlib").submodule_search_locations  # type: ignore[union-attr,misc]  # not imported
    return ImageFont.truetype(Path(matplotlib) / "mpl-data" / "fonts" / "ttf" / name, size)
