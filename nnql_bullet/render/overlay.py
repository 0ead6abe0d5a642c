"""What is written over a picture: what the vehicle sees, holds best and does, and what came of it."""

from functools import lru_cache
from math import degrees
from pathlib import Path

import matplotlib
import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from nnql_bullet import colours, paper
from nnql_bullet.render.camera import Camera
from nnql_bullet.render.timeline import Moment, Timeline

Bytes = NDArray[np.uint8]
Box = tuple[float, float, float, float]

PAPER, FAINT, INK = (255, 255, 255, 205), (134, 142, 150, 255), (33, 37, 41, 255)
STATES = {
    "SS": ("safe", colours.SAFE),
    "NS": ("non-safe", colours.NON_SAFE),
    "WS": ("at the target", colours.GOAL),
    "FS": ("collision", colours.COLLISION),
}
DESIGNED_FOR = 720
"""Height of the picture in which sizes below are pixels."""
FAR_OFF = 40.0
"""From here on, the vehicle is too small to be found in the picture [m]."""


class Overlay:
    """Writes over pictures of one recording."""

    def __init__(self, timeline: Timeline, height: int) -> None:
        """Prepares for pictures of a height in pixels."""
        self._timeline = timeline
        self._recording = timeline.recording
        self._size = height / DESIGNED_FOR

    def write(self, picture: Bytes, moment: Moment, cameras: tuple[tuple[int, Camera], ...]) -> Bytes:
        """The picture with everything written over it.

        Args:
            picture: (h, w, 3)
            moment: What it shows.
            cameras: Where the picture of each camera begins, from the left [pixels].
        """
        image = Image.fromarray(picture)
        draw = ImageDraw.Draw(image, "RGBA")
        for left, camera in cameras:
            self._mark(draw, moment, left, camera)
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

    def _mark(self, draw: ImageDraw.ImageDraw, moment: Moment, left: int, camera: Camera) -> None:
        """What each sector reads, at its rim; from afar, a ring around the vehicle."""
        recording, pose = self._recording, moment.pose
        (at,), (away,) = camera.project(np.array([[pose.x, pose.y, 0.3]]))
        if away > FAR_OFF:
            x, y, r = left + at[0], at[1], self._px(13)
            draw.ellipse((x - r, y - r, x + r, y + r), outline=colours.INK, width=max(round(self._px(2)), 1))
            return
        x, y, yaw = recording.state_pose[moment.step].tolist()
        readings, ahead = recording.readings[moment.step], recording.about["vehicle"]["sensor"][0]
        angles = yaw + np.arange(paper.SECTORS) * 2 * np.pi / paper.SECTORS
        reach = np.minimum(readings, paper.SENSOR_RANGE) - 0.45
        origin = np.array([x + ahead * np.cos(yaw), y + ahead * np.sin(yaw)])
        points = np.column_stack(
            [origin[0] + reach * np.cos(angles), origin[1] + reach * np.sin(angles), np.zeros(len(angles))]
        )
        pixels, distances = camera.project(points)
        for (u, v), distance, reading in zip(pixels, distances, readings, strict=True):
            if 0 < u < camera.width and 0 < v < camera.height and distance > camera.near and reading < RANGE_SHOWN:
                text = f"{reading:.1f} m"
                draw.text((left + u, v), text, fill=INK, font=self._font(15), anchor="mm")

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
            draw.text((left + pad, y), name, fill=FAINT, font=self._font(17))
            draw.text((width - 2 * pad, y), value, fill=INK, font=self._font(17, bold=True), anchor="ra")

    def _values(self, draw: ImageDraw.ImageDraw, moment: Moment, height: int) -> None:
        """The Q-values of the five turns as bars, left turns to the left, and the action that was chosen."""
        values, action = self._recording.q_values[moment.step], int(self._recording.action[moment.step])
        pad, bar, tall = self._px(12), self._px(40), self._px(86)
        wide, high = 5 * bar + 2 * pad, tall + self._px(66)
        left, above = pad, height - self._px(30) - high
        self._panel(draw, (left, above, left + wide, above + high))
        asked = bool(np.isfinite(values).all())
        title = "Q of the five turns" if asked else "toward the target" if action == len(paper.TURNS) else "by rule"
        draw.text((left + pad, above + self._px(7)), title, fill=INK, font=self._font(16, bold=not asked))
        floor = above + self._px(36) + tall
        low, most = (min(values.min(), 0.0), max(values.max(), 0.0)) if asked else (0.0, 0.0)
        scale = (tall - self._px(16)) / max(most - low, 1e-9)
        zero = floor + low * scale
        order = sorted(range(len(paper.TURNS)), key=lambda k: -paper.TURNS[k])
        for place, k in enumerate(order):
            x = left + pad + place * bar
            chosen = k == action
            ink = colours.NON_SAFE if chosen else colours.TIMEOUT
            if asked:
                y = zero - float(values[k]) * scale
                box = (x + self._px(6), min(y, zero), x + bar - self._px(6), max(y, zero, min(y, zero) + 1))
                draw.rectangle(box, fill=ink)
                text, font = f"{values[k]:.2f}", self._font(11)
                draw.text((x + bar / 2, box[1] - self._px(3)), text, fill=INK, font=font, anchor="ms")
            turn = f"{degrees(paper.TURNS[k]):+.0f}°" if paper.TURNS[k] else "0°"
            font = self._font(14, bold=chosen)
            draw.text((x + bar / 2, floor + self._px(14)), turn, fill=INK if chosen else FAINT, font=font, anchor="mm")
        if asked:
            draw.line((left + pad, zero, left + pad + 5 * bar, zero), fill=INK, width=1)

    def _state(self, draw: ImageDraw.ImageDraw, moment: Moment, width: int, height: int) -> None:
        step = len(self._recording.action) if moment.over else moment.step
        text, colour = STATES[str(self._recording.state_property[step])]
        font = self._font(20, bold=True)
        across, pad = font.getlength(text), self._px(12)
        right, below = width - pad, height - self._px(30)
        box = (right - across - 2 * pad, below - self._px(38), right, below)
        draw.rounded_rectangle(box, radius=self._px(8), fill=colour)
        draw.text(((box[0] + box[2]) / 2, (box[1] + box[3]) / 2), text, fill="white", font=font, anchor="mm")

    def _time_line(self, draw: ImageDraw.ImageDraw, moment: Moment, width: int, height: int) -> None:
        """All of the episode: safe and non-safe states so far, and how much is left."""
        pad, tall = self._px(12), max(self._px(8), 2)
        left, across, below = pad, width - 2 * pad, height - pad
        draw.rectangle((left, below - tall, left + across, below), fill=PAPER)
        times = np.minimum(self._recording.state_time, moment.time) / self._timeline.duration
        for begin, end, state in zip(times[:-1], times[1:], self._recording.state_property[:-1], strict=True):
            if begin < end:
                box = (left + begin * across, below - tall, left + end * across, below)
                draw.rectangle(box, fill=STATES[str(state)][1])

    def _ending(self, draw: ImageDraw.ImageDraw, width: int) -> None:
        ending = self._recording.about["ending"]
        text = f"{ending} after {self._timeline.duration:.1f} s"
        font, pad = self._font(34, bold=True), self._px(16)
        across = font.getlength(text)
        box = ((width - across) / 2 - pad, self._px(90), (width + across) / 2 + pad, self._px(90) + self._px(60))
        draw.rounded_rectangle(box, radius=self._px(10), fill=colours.ENDINGS[ending])
        draw.text((width / 2, (box[1] + box[3]) / 2), text, fill="white", font=font, anchor="mm")

    def _panel(self, draw: ImageDraw.ImageDraw, box: Box) -> None:
        draw.rounded_rectangle(box, radius=self._px(8), fill=PAPER)


RANGE_SHOWN = paper.SENSOR_RANGE - 0.05
"""A sector that reads more sees nothing [m]."""


def _simulator(about: dict[str, object]) -> str:
    """Where it was driven, as far as the recording says."""
    if about.get("simulator") == "twin":
        return "ideal twin"
    names = {"bullet": "PyBullet", "mujoco": "MuJoCo"}
    name = names.get(str(about.get("simulator")), "")
    return f"{name}, {about['physics']}" if name and "physics" in about else name


@lru_cache(maxsize=32)
def text_font(size: int, bold: bool) -> ImageFont.FreeTypeFont:
    """The one that Matplotlib brings along, the same on every machine."""
    name = "DejaVuSans-Bold.ttf" if bold else "DejaVuSans.ttf"
    return ImageFont.truetype(Path(matplotlib.get_data_path()) / "fonts" / "ttf" / name, size)
