"""Colours that mean something, the same in every picture."""

SAFE, NON_SAFE, COLLISION = "#1f77b4", "#e8590c", "#c92a2a"
GOAL, TIMEOUT = "#2b8a3e", "#868e96"
BOX, BOX_EDGE = "#adb5bd", "#495057"
MOVING, MOVING_EDGE = "#b197fc", "#5f3dc4"
VEHICLE = "#fab005"
INK = "#212529"
ENDINGS = {"goal": GOAL, "collision": COLLISION, "timeout": TIMEOUT}
"""Of what an episode came to."""
LINES = ("#1f77b4", "#e8590c", "#2b8a3e", "#7048e8", "#c2255c", "#0b7285", "#5c940d", "#862e9c", "#f08c00", "#495057")
"""Of things of one kind, in this order."""


def rgb(colour: str) -> tuple[float, float, float]:
    """Red, green, blue from 0 to 255 of "#rrggbb"."""
    red, green, blue = (float(int(colour[k : k + 2], 16)) for k in (1, 3, 5))
    return red, green, blue
