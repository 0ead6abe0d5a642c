"""The colours of pictures, films and pages, as "#rrggbb": each has one meaning everywhere."""

Colour = tuple[float, float, float]
"""Red, green, blue, from 0 to 1."""

SAFE, NON_SAFE, COLLISION = "#1f77b4", "#e8590c", "#c92a2a"
GOAL, TIMEOUT, STUCK, OVERTURNED = "#2b8a3e", "#868e96", "#0b7285", "#862e9c"
BOX, BOX_EDGE = "#adb5bd", "#495057"
MOVING, MOVING_EDGE = "#b197fc", "#5f3dc4"
VEHICLE = "#fab005"
PLAN = "#0ca678"
ARENA, TARGET = "#f8f9fa", "#ffe3e3"
INK = "#212529"
GRID, SHADE, REFERENCE = "#e9ecef", "#f1f3f5", "#ced4da"
"""Grid lines, the background of one row among many, and lines that others are compared with."""
TEMPERATURE = "#7048e8"
ENDINGS = {"goal": GOAL, "collision": COLLISION, "timeout": TIMEOUT, "stuck": STUCK, "overturned": OVERTURNED}
"""The endings of an episode."""
LINES = ("#1f77b4", "#e8590c", "#2b8a3e", "#7048e8", "#c2255c", "#0b7285", "#5c940d", "#862e9c", "#f08c00", "#495057")
"""Things of one kind, in this order."""
DISTINCT = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00")
"""Six colours that colour-blind readers tell apart (Okabe and Ito)."""
ACTIONS = ("#212529", "#74c0fc", "#1864ab", "#ffa94d", "#d9480f")
"""The five turns of the paper, in its order."""
HATCH_DARK, HATCH_LIGHT = "#00000099", "#ffffff99"

PANEL = "#ffffffcd"
"""The background of text in a film."""
FLOOR, OUTSIDE, HORIZON = "#e9eae8", "#cdcfd0", "#d6e0e9"
"""The ground of a film inside and outside the arena, and its sky at the horizon."""
NEAR, MIDDLE, FAR = "#d62728", "#f5aa1e", "#2ea043"
"""A sensor sector that reads nothing, half of the range and the whole range."""
SOLID_BOX, SOLID_WALL, SOLID_MOVING = "#8594a8", "#bdbfc4", "#9970ed"
"""Solid things of a film."""

PAGE_LIGHT = {
    **{"paper": "#ffffff", "ink": INK, "soft": "#5c636a", "line": "#dee2e6", "shade": "#f4f5f7", "link": "#1864ab"},
    **{"mark": "#fff3bf", "mark-ink": "#6b4700", "warn": NON_SAFE, "box": BOX, "moving": MOVING, "vehicle": VEHICLE},
    **{"target": COLLISION, "safe": SAFE, "non-safe": NON_SAFE},
}
"""The colours of an HTML page on a light screen, by the names of its style sheet."""
PAGE_DARK = PAGE_LIGHT | {
    **{"paper": "#16181b", "ink": "#e6e8ea", "soft": "#a3abb2", "line": "#363b40", "shade": "#212428"},
    **{"link": "#74c0fc", "mark": "#4a3a0a", "mark-ink": "#ffe08a", "warn": "#ff922b", "box": "#5c636a"},
    **{"moving": "#7048e8", "target": "#ff8787", "safe": "#4dabf7", "non-safe": "#ff922b"},
}
"""The same on a dark screen."""
PAGE_PRINT = PAGE_LIGHT | {
    **{"ink": "#000000", "soft": "#444444", "line": "#bbbbbb", "shade": "#f2f2f2", "link": "#000000"},
    **{"mark": "#eeeeee", "mark-ink": "#000000"},
}
"""The same on paper."""


def rgb(colour: str) -> tuple[float, float, float]:
    """Returns red, green and blue of "#rrggbb", each from 0 to 255."""
    red, green, blue = (float(int(colour[k : k + 2], 16)) for k in (1, 3, 5))
    return red, green, blue


def unit_rgb(colour: str) -> Colour:
    """Returns the same, each from 0 to 1."""
    red, green, blue = rgb(colour)
    return red / 255, green / 255, blue / 255
