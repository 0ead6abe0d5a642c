"""Names of states and actions for videos, pages and viewers."""

from math import degrees

from nnql_bullet import paper
from nnql_bullet.colours import COLLISION, GOAL, NON_SAFE, SAFE

PROPERTIES = {
    "SS": ("safe", SAFE),
    "NS": ("non-safe", NON_SAFE),
    "WS": ("at the target", GOAL),
    "FS": ("failure", COLLISION),
}
"""Name and colour of each state property, by the paper's two letters."""
TURNS = tuple(
    f"{'left' if turn > 0 else 'right'} {abs(degrees(turn)):.0f}°" if turn else "straight on" for turn in paper.TURNS
)
_ACTIONS = (*TURNS, "toward the target")
MANOEUVRES = tuple(f"{way}{action}" for way in ("", "stop, ", "reverse, ", "slowly, ") for action in _ACTIONS)
"""Names of the manoeuvres, in the order of `env`: the actions, then the same with a stop, then in reverse."""
