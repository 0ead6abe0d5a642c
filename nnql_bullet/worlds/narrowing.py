"""Makes worlds whose bottleneck is as wide as wanted: the layout becomes denser, then two obstacles grow a little.

Bottlenecks narrow as a layout becomes denser, in steps; at the last step above the wanted width, the obstacles beside
the narrowest place grow until it is that wide. They grow by a few centimetres at most, as a denser layout is found that
comes near enough.
"""

from collections.abc import Callable
from dataclasses import replace
from math import inf, sqrt

from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Circle, Shape, as_rows, squared_distance
from nnql_bullet.worlds.spec import WorldSpec

MOST_GROWTH = 0.2
"""How much wider than wanted a bottleneck may be before obstacles grow [m]."""
LITTLE_GROWTH = 0.03
"""Where it is this near no denser layout is looked for [m]."""
CLOSE = 0.01
"""How much wider than wanted it may be in the end [m]."""
FIRST_SHARE = 1 / 32
"""The first density that is tried; it doubles until the bottleneck is narrower than wanted."""
SMALLEST_STEP = 1 / 2048
"""Difference of densities at which the search ends."""
MOST_STEPS = 40
"""Largest number of times that obstacles grow."""


def as_narrow_as(wanted: float, draw: Callable[[float], WorldSpec]) -> WorldSpec | None:
    """Finds a world with a bottleneck of a width.

    Args:
        wanted: The width [m].
        draw: Draws a world of a density, from 0 (the layout as it is) to 1 (as dense as it can be).

    Returns:
        The world; None if the layout comes from wider to narrower in too large a step, or is too narrow as it is.

    Raises:
        UserError: If no density makes the layout so narrow, or the layout has no room as it is.
    """
    nearest: WorldSpec | None = None
    passed = False  # whether some density gave a narrower bottleneck
    below, above, share = 0.0, inf, 0.0  # densities that give a wider and a narrower bottleneck, and the next one
    while above - below > SMALLEST_STEP and share <= 1.0:
        try:
            world = draw(share)
            left = world.bottleneck.width - wanted
        except UserError:  # there is no room for so many obstacles
            if share == 0.0:
                raise
            left = -inf
        if left >= 0.0:
            below, nearest = share, world
            if left <= LITTLE_GROWTH:
                break
        elif share == 0.0:
            return None
        else:
            above, passed = share, passed or left > -inf
        share = (below + above) / 2 if above < inf else max(2 * below, FIRST_SHARE)
    left = inf if nearest is None else nearest.bottleneck.width - wanted
    if left <= MOST_GROWTH and nearest is not None:
        return _grown(nearest, wanted)
    if not passed:
        raise UserError(
            f"layout: as dense as it can be, its bottleneck is {wanted + left:.2f} m and not {wanted:.2f} m; let "
            "obstacles be larger or closer, or the arena smaller, or raise 'clearance'"
        )
    return None


def _grown(world: WorldSpec, wanted: float) -> WorldSpec | None:
    """Lets the obstacles beside the narrowest place grow until it is as wide as wanted; None if none stand there.

    The distance of two boxes that grow by 1 falls by 2 to 2.8, so it does not become less than wanted.
    """
    for _ in range(MOST_STEPS):
        found = world.bottleneck
        left = found.width - wanted
        if left <= CLOSE:
            return world
        rows = as_rows(world.obstacles)
        beside = [
            k for k, row in enumerate(rows) if squared_distance(found.x, found.y, row) <= (found.width / 2 + 1e-6) ** 2
        ]
        if not beside:
            return None
        growth = round(left / sqrt(8), 4)
        obstacles = list(world.obstacles)
        for k in beside:
            obstacles[k] = _larger(obstacles[k], growth)
        world = replace(world, obstacles=tuple(obstacles))
    return None


def _larger(shape: Shape, growth: float) -> Shape:
    """A shape whose sides are all farther out by `growth` [m]."""
    if isinstance(shape, Circle):
        return replace(shape, radius=round(shape.radius + growth, 4))
    half_length, half_width = (round(half + growth, 4) for half in (shape.half_length, shape.half_width))
    return replace(shape, half_length=half_length, half_width=half_width)
