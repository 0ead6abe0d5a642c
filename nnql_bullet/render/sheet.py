"""Makes a contact sheet: the key moments of a recording side by side."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw

from nnql_bullet import colours
from nnql_bullet.render.overlay import text_font
from nnql_bullet.render.timeline import Timeline
from nnql_bullet.types import Bytes

COLUMNS = 3
WIDTH = 640
"""Largest width of a picture in the sheet [pixels]."""
GAP, CAPTION = 12, 30
"""Space between pictures, and below each picture for its caption [pixels]."""


@dataclass(frozen=True, slots=True)
class KeyMoment:
    """A moment with its caption."""

    time: float
    """[s]"""
    caption: str


def key_moments(timeline: Timeline, count: int = 6) -> list[KeyMoment]:
    """Finds the start, the end and the closest passes between them, spread over time.

    Args:
        timeline: Timeline of the recording.
        count: Largest number of moments.
    """
    recording, duration = timeline.recording, timeline.duration
    ending = recording.about["ending"]
    found = [KeyMoment(0.0, "0.0 s: start"), KeyMoment(duration, f"{duration:.1f} s: {ending}")]
    apart = duration / (2 * count)
    middles = (recording.state_time[:-1] + recording.state_time[1:]) / 2
    for step in np.argsort(recording.clearance, kind="stable").tolist():
        time = float(middles[step])
        if len(found) == count:
            break
        if all(abs(time - one.time) >= apart for one in found):
            found.append(KeyMoment(time, f"{time:.1f} s: {recording.clearance[step]:.2f} m to the nearest"))
    return sorted(found, key=lambda one: one.time)


def contact_sheet(moments: Sequence[KeyMoment], frames: Sequence[Bytes]) -> Bytes:
    """Returns frames (h, w, 3) with their captions as one picture; large frames are made smaller."""
    height, width, _ = frames[0].shape
    scale = min(WIDTH / width, 1.0)
    width, height = round(scale * width), round(scale * height)
    columns = min(COLUMNS, len(frames))
    rows = -(-len(frames) // columns)
    size = columns * (width + GAP) + GAP, rows * (height + CAPTION + GAP) + GAP
    sheet = Image.new("RGB", size, "white")
    draw, font = ImageDraw.Draw(sheet), text_font(17, bold=False)
    for number, (moment, frame) in enumerate(zip(moments, frames, strict=True)):
        row, column = divmod(number, columns)
        left, above = GAP + column * (width + GAP), GAP + row * (height + CAPTION + GAP)
        sheet.paste(Image.fromarray(frame).resize((width, height), Image.Resampling.LANCZOS), (left, above))
        draw.text((left, above + height + CAPTION / 2), moment.caption, fill=colours.INK, font=font, anchor="lm")
    return np.asarray(sheet)
