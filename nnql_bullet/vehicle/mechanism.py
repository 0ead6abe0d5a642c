"""Finds in a URDF how a vehicle drives: its two driven wheels, its casters, and the body that they carry.

What counts is where the joints put the parts, not how their frames lie: the drive axle is the line through two wheels
that turn freely about one axis. The vehicle's own frame has its origin in the middle of this axle, x ahead, y left, z
up. Joints that drive nothing, such as those of suspensions and arms, are held at the angle 0.
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from math import asin, atan2, cos, degrees, radians, sin, sqrt

import numpy as np

from nnql_bullet.geometry import Array
from nnql_bullet.vehicle.description import Description, Joint, Link, Solid, Unfit, refuse
from nnql_bullet.vehicle.shapes import Hull, Meshes, hull_of

NEAR = 1e-3
"""Tolerance of positions [m]: URDFs round them."""
PARALLEL = sin(radians(3.0))
"""Largest sine of the angle between axes that count as parallel."""
ROUNDED = 0.02
"""Tolerance of sizes and of the axle over the wheel radius."""
ALIKE = 2e-3
"""Relative difference up to which the drive wheels count as equally large."""
SET_DOWN = 0.15
"""Largest distance of a caster from the ground that the drive wheels stand on, over their radius; it is set down."""
LEAST_SET_DOWN = 3e-3
"""This distance for small wheels [m]."""
GRAZING = 0.05
"""Height over the wheel radius under which any small shape of the body is a support that slides."""
SMALL = 0.5
"""Largest size of such a shape over the track."""
WHEELS_AT_MOST = 2
"""Wheels on fixed axles that a vehicle may have."""
NAMED_SUPPORT = re.compile(r"cast(e|o)r|ball|skid|support", re.IGNORECASE)
NAMED_WHEEL = re.compile(r"wheel", re.IGNORECASE)
NAMED_LIDAR = re.compile(r"laser|lidar|scan|hokuyo|sick|velodyne|ydlidar|rplidar", re.IGNORECASE)
KIND = "a vehicle drives by two wheels on one axle, and all others are casters"


@dataclass(frozen=True, slots=True)
class Part:
    """A rigid body: links that nothing moves against each other."""

    name: str
    """Name of its link in the engines."""
    links: tuple[str, ...]
    """Names of its links in the URDF."""
    placed: dict[str, Array]
    """Transforms from the frames of these links to its own (4, 4)."""
    origin: Array
    """Origin of its own frame, which is parallel to the vehicle's, in the frame of the vehicle (3,) [m]."""


@dataclass(frozen=True, slots=True)
class Wheel:
    """A wheel that turns about an axis across the vehicle."""

    part: Part
    joint: str
    """Name of its joint."""
    radius: float
    """[m]"""
    half_width: float
    """[m]"""


@dataclass(frozen=True, slots=True)
class Caster:
    """A support besides the drive wheels: a wheel that trails its swivel, or a ball that slides."""

    wheel: Wheel
    """The wheel; the ball's joint is fixed."""
    fork: Part | None = None
    """What swivels; None for a ball."""
    swivel: str = ""
    """Name of the joint that swivels; empty for a ball."""
    friction: float | None = None
    """Friction coefficient of a ball, where the URDF tells it."""

    @property
    def trail(self) -> float:
        """Distance of the contact point behind the swivel [m]."""
        return 0.0 if self.fork is None else float(self.fork.origin[0] - self.wheel.part.origin[0])


@dataclass(frozen=True)
class Mechanism:
    """A vehicle, in its own frame."""

    urdf: Description
    frame: Array
    """Transform from the frame of the URDF's base link to the vehicle's (4, 4)."""
    body: Part
    left: Wheel
    right: Wheel
    casters: tuple[Caster, ...]
    low: Array
    """Smallest x, y, z that any part covers, casters at each angle (3,) [m]."""
    high: Array
    """Largest x, y, z that any part covers (3,) [m]."""
    box: tuple[Array, Array]
    """Middle and half edges of the body's collision box, which covers all of that (3,), (3,) [m]."""
    sensor: Array
    """Where its lidar is, or might be (3,) [m]."""
    notes: tuple[str, ...]
    """What was assumed, in sentences."""

    @property
    def wheels(self) -> tuple[Wheel, ...]:
        """All wheels: left, right, casters."""
        return (self.left, self.right, *(caster.wheel for caster in self.casters))

    @property
    def parts(self) -> tuple[Part, ...]:
        """All parts, in the order of the engines."""
        forks = ((caster.fork, caster.wheel.part) for caster in self.casters)
        return (self.body, self.left.part, self.right.part, *(part for pair in forks for part in pair if part))


@dataclass(frozen=True, slots=True)
class _Candidate:
    """A joint that turns freely, and what it carries, in the frame of the base link."""

    joint: Joint
    links: tuple[str, ...]
    carrier: Joint | None
    """The nearest joint above it that turns freely; None if the body carries it."""
    axis: Array
    """(3,), of length 1."""
    at: Array
    """A point on the axis (3,) [m]."""
    hulls: tuple[Hull, ...]
    """What its links cover."""

    @property
    def upright(self) -> bool:
        """Whether the axis is vertical."""
        return bool(np.hypot(*self.axis[:2]) < PARALLEL)

    @property
    def level(self) -> bool:
        """Whether the axis is horizontal."""
        return bool(abs(self.axis[2]) < PARALLEL)

    @property
    def radius(self) -> float:
        """Largest distance of its shapes from the axis [m]."""
        return round(max(hull.radius_about(self.at, self.axis) for hull in self.hulls), 12)

    @property
    def is_ball(self) -> bool:
        """Whether it is a sphere."""
        return all(len(hull.points) == 1 for hull in self.hulls)

    @property
    def centre(self) -> Array:
        """The point of the axis in the middle of its shapes (3,) [m]."""
        ends = [(hull.points - self.at) @ self.axis for hull in self.hulls]
        low, high = min(end.min() for end in ends), max(end.max() for end in ends)
        return np.asarray(self.at + (low + high) / 2 * self.axis)

    @property
    def half_width(self) -> float:
        """Half the extent along its axis, 0 for a sphere, which stands for a wheel of no width [m]."""
        return max(float(np.ptp((hull.points - self.at) @ self.axis)) for hull in self.hulls) / 2


@dataclass(slots=True)
class _Search:
    """What is known so far."""

    urdf: Description
    meshes: Meshes
    problems: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    unknown: set[str] = field(default_factory=set)
    """Names of links with shapes of unknown extent."""


def find_mechanism(urdf: Description, meshes: Meshes, drives: tuple[str, str] | None = None) -> Mechanism:
    """Finds how a vehicle drives.

    Args:
        urdf: Its links and joints.
        meshes: Where its meshes are.
        drives: Names of the left and right drive joint, where they are told.

    Raises:
        Unfit: If it cannot drive, or not by two wheels; the text names all problems.
    """
    search = _Search(urdf, meshes)
    free = list(_candidates(search))
    steered = dict(_steered(search, free))
    search.problems += steered.values()
    pair, others = _drives(search, [its for its in free if its.joint.name not in steered], drives)
    if pair is None:
        refuse(search.problems)
        raise Unfit(f"no two wheels that turn freely are on one axle; {KIND}")
    left, right, frame = _axle(search, *pair)
    made = _Assembly(search, frame, left, right)
    before = len(search.problems)
    casters = [caster for its in _swivels(others) if (caster := made.swivelling(*its))]
    taken = {its.joint.name for pair in _swivels(others) for its in pair}
    held = [its for its in others if its.joint.name not in taken]
    casters += made.balls(held)
    if not casters and not steered and len(search.problems) == before:
        high = "".join(f"; '{name}' ends {above:.4g} m above the ground" for name, above in made.too_high.items())
        search.problems.append(f"it has no caster, and would fall over: only its drive wheels touch the ground{high}")
    body = made.body(casters)
    refuse(search.problems)
    return made.mechanism(body, casters)


def _candidates(search: _Search) -> Iterator[_Candidate]:
    """Finds the joints that turn freely."""
    urdf = search.urdf
    free = {joint.child: joint for joint in urdf.joints.values() if joint.turns_freely}
    above = {joint.child: joint.parent for joint in urdf.joints.values()}

    def carrier(link: str) -> str | None:
        while link not in free and link in above:
            link = above[link]
        return link if link in free else None

    for child, joint in free.items():
        links = tuple(link for link in urdf.links if carrier(link) == child)
        upper = carrier(joint.parent)
        axis = urdf.frames[child][:3, :3] @ joint.axis
        length = float(np.linalg.norm(axis))
        if length < 1e-9:
            search.problems.append(f"joint '{joint.name}' has an axis of length 0; give it one")
            continue
        hulls = tuple(hull for link in links for hull in _hulls(search, urdf.links[link]))
        at = urdf.frames[child][:3, 3]
        yield _Candidate(joint, links, free[upper] if upper else None, axis / length, at, hulls)


def _hulls(search: _Search, link: Link) -> list[Hull]:
    """What a link covers, by its collision shapes, or by what is seen of it where these are not known."""
    frame, found = search.urdf.frames[link.name], []
    for solids in (link.solids, link.looks):
        found = [(solid, hull_of(solid, search.meshes)) for solid in solids]
        known = [hull.moved(frame) for _, hull in found if hull]
        if known:
            lost = [solid for solid, hull in found if hull is None]
            if lost and solids is link.solids:
                search.notes += [
                    f"{solid.title} of link '{link.name}' is not found or cannot be read; its extent is not known"
                    for solid in lost
                ]
            return known
    if link.solids or link.looks:
        search.unknown.add(link.name)
    return []


def _steered(search: _Search, free: list[_Candidate]) -> Iterator[tuple[str, str]]:
    """Finds wheels that are steered: a joint between the body and them turns about the vertical within limits.

    Yields:
        The name of the wheel's joint, and what is wrong with it.
    """
    urdf = search.urdf
    above = {joint.child: joint for joint in urdf.joints.values()}
    names = {its.joint.name for its in free}
    for its in free:
        if not its.level:
            continue
        link = its.joint.parent
        while link in above:
            joint = above[link]
            axis = urdf.frames[joint.child][:3, :3] @ joint.axis
            if joint.kind == "revolute" and joint.name not in names and np.hypot(*axis[:2]) < PARALLEL:
                yield (
                    its.joint.name,
                    f"wheel joint '{its.joint.name}' is steered by '{joint.name}', which turns within limits; steered "
                    f"wheels are not supported: {KIND}, which swivel freely (continuous)",
                )
            link = joint.parent


def _drives(
    search: _Search, free: list[_Candidate], told: tuple[str, str] | None
) -> tuple[tuple[_Candidate, _Candidate] | None, list[_Candidate]]:
    """Finds the two driven wheels among the joints that turn freely; returns the others too."""
    fixed = [its for its in free if its.carrier is None and its.level]
    for its in fixed:
        if not its.hulls and any(link in search.unknown for link in its.links):
            _guess(search, its)
    fixed = [its for its in free if its.carrier is None and its.level and its.hulls]
    if told:
        by_name = {its.joint.name: its for its in free}
        missing = [name for name in told if name not in by_name]
        for name in missing:
            there = ", ".join(search.urdf.joints)
            search.problems.append(f"has no joint '{name}' that turns freely; its joints are: {there}")
        if missing:
            return None, free
        pair = by_name[told[0]], by_name[told[1]]
        for its in pair:
            if not its.level or its.carrier is not None or not its.hulls:
                what = "has no shape" if its.level and its.carrier is None else "does not turn about a level axis"
                search.problems.append(f"drive joint '{its.joint.name}' {what}; {KIND}")
        if told[0] == told[1]:
            search.problems.append(f"[joints] in the TOML names joint '{told[0]}' twice")
            return None, free
        fixed = [its for its in fixed if its not in pair]
        extra = [its for its in fixed if not its.is_ball]
    else:
        pairs = [(a, b) for n, a in enumerate(fixed) for b in fixed[n + 1 :] if _on_one_axle(a, b)]
        rolling = [its for its in fixed if not its.is_ball]
        lowest = [its for its in fixed if _bottom(its) <= min(map(_bottom, fixed)) + SET_DOWN * its.radius]
        if len(rolling) > WHEELS_AT_MOST:
            touching = [its for its in rolling if its in lowest]
            extra = touching if len(touching) > WHEELS_AT_MOST else []
            pairs = [pair for pair in pairs if all(its in touching for its in pair)]
        else:
            extra = []
        if len(rolling) == WHEELS_AT_MOST:
            pairs = [pair for pair in pairs if all(its in rolling for its in pair)] or pairs[:0]
        if not pairs and not extra and len(fixed) >= WHEELS_AT_MOST:
            one, other = (rolling if len(rolling) >= WHEELS_AT_MOST else fixed)[:2]
            search.problems.append(
                f"the drive wheels are not on one axle: '{one.joint.name}' is at {rounded(one.centre)}, "
                f"'{other.joint.name}' at {rounded(other.centre)} in the frame of '{search.urdf.base}'"
            )
        found = max(pairs, key=lambda pair: min(its.radius for its in pair), default=None)
        if found is None and not extra and not search.problems:
            names = ", ".join([f"'{its.joint.name}'" for its in fixed] + list(_unlike_wheels(search, free))) or "none"
            lost = ", ".join(sorted(search.unknown))
            more = f"; the extent of {lost} is not known, as its meshes are not found" if lost else ""
            search.problems.append(f"it has no two wheels on fixed axles that turn freely, but: {names}{more}; {KIND}")
        if extra:
            names = ", ".join(f"'{its.joint.name}'" for its in extra)
            search.problems.append(f"it has {len(extra)} wheels on fixed axles ({names}), which must skid; {KIND}")
        return found, [its for its in free if not found or its not in found]
    if extra:
        names = ", ".join(f"'{its.joint.name}'" for its in extra)
        search.problems.append(f"besides its drive wheels it has wheels on fixed axles ({names}), which skid; {KIND}")
    return pair, [its for its in free if its not in pair]


def _unlike_wheels(search: _Search, free: list[_Candidate]) -> Iterator[str]:
    """Says why joints that are named for wheels, or turn freely, are no wheels."""
    for its in free:
        if its.hulls and its.carrier is None and not its.level and not its.upright:
            tilt = degrees(asin(min(abs(float(its.axis[2])), 1.0)))
            yield f"'{its.joint.name}', whose axis is {tilt:.0f} degrees off the level"
    for joint in search.urdf.joints.values():
        if NAMED_WHEEL.search(f"{joint.name} {joint.child}") and not joint.turns_freely:
            yield f"'{joint.name}', which is {joint.kind}" + " within limits" * (joint.kind == "revolute")


def _guess(search: _Search, wheel: _Candidate) -> None:
    """Says that a wheel has no size."""
    search.problems.append(
        f"the radius of the wheel on joint '{wheel.joint.name}' is not known: its meshes are not found; put them where "
        "the URDF names them, or give its link a <collision> with a cylinder"
    )


def _bottom(its: _Candidate) -> float:
    return float(its.centre[2] - its.radius)


def _on_one_axle(one: _Candidate, other: _Candidate) -> bool:
    apart = other.centre - one.centre
    along = float(apart @ one.axis)
    off = float(np.linalg.norm(apart - along * one.axis))
    twisted = float(np.linalg.norm(np.cross(one.axis, other.axis)))
    tolerance = max(NEAR, ROUNDED * max(one.radius, other.radius))
    return abs(along) > one.radius / 10 and off <= tolerance and twisted < PARALLEL


def _axle(search: _Search, one: _Candidate, other: _Candidate) -> tuple[_Candidate, _Candidate, Array]:
    """Finds the vehicle's frame: tells the left from the right wheel, and returns the transform to this frame."""
    apart = one.centre - other.centre
    if float(np.linalg.norm(apart[:2])) < NEAR:
        raise Unfit("the drive wheels are in one place")
    if not _on_one_axle(one, other):
        search.problems.append(
            f"the drive wheels are not on one axle, but at {rounded(one.centre)} and {rounded(other.centre)} in the "
            f"frame of '{search.urdf.base}'"
        )
    axis = one.axis if one.axis @ apart > 0 else -one.axis
    if abs(axis[2]) < NEAR:
        axis = np.array([axis[0], axis[1], 0.0])
    left = axis / np.linalg.norm(axis)
    left[np.abs(left) < NEAR] = 0.0  # rpy of 1.57 for a quarter turn
    left = left / np.linalg.norm(left)
    ahead = np.array([left[1], -left[0], 0.0])
    if ahead[0] < -PARALLEL or (abs(ahead[0]) <= PARALLEL and ahead[1] < 0):
        one, other, left, ahead = other, one, -left, -ahead
    if ahead[0] < PARALLEL:
        search.notes.append(f"ahead is along y of '{search.urdf.base}', across the drive axle")
    frame = np.eye(4)
    frame[:3, :3] = np.array([ahead, left, (0.0, 0.0, 1.0)]) + 0.0
    middle = (one.centre + other.centre) / 2
    frame[:3, 3] = -frame[:3, :3] @ middle + 0.0
    a, b = one.radius, other.radius
    if abs(a - b) > ALIKE * max(a, b):
        search.problems.append(f"the drive wheels differ in radius: {a:.4g} and {b:.4g} m")
    for its in (one, other):
        off = (
            max(float(np.linalg.norm(_middle_off_axis(hull, its))) for hull in its.hulls if len(hull.points) == 1)
            if (its.is_ball)
            else 0.0
        )
        if off > max(NEAR, ROUNDED * its.radius):
            search.problems.append(
                f"the sphere of the wheel on joint '{its.joint.name}' is {off:.4g} m off its axle, and its radius is "
                f"{its.radius - off:.4g} m; put it at the axle"
            )
    return one, other, frame


def _middle_off_axis(hull: Hull, its: _Candidate) -> Array:
    away = hull.points[0] - its.at
    return np.asarray(away - (away @ its.axis) * its.axis)


def _swivels(others: list[_Candidate]) -> list[tuple[_Candidate, _Candidate]]:
    """Pairs swivels with the wheels that they carry."""
    return [
        (swivel, wheel)
        for swivel in others
        if swivel.carrier is None and swivel.upright
        for wheel in others
        if wheel.carrier is swivel.joint and wheel.level
    ]


class _Assembly:
    """Puts the parts together in the vehicle's frame."""

    def __init__(self, search: _Search, frame: Array, left: _Candidate, right: _Candidate) -> None:
        self._search, self._frame = search, frame
        self._left, self._right = self._wheel(left, np.eye(4)), self._wheel(right, np.eye(4))
        self._ground = -self._left.radius
        self.track = float(self._left.part.origin[1] - self._right.part.origin[1])
        self._moved = {*left.links, *right.links}
        self._supporting: set[tuple[str, int]] = set()
        self.too_high: dict[str, float] = {}
        """Heights above the ground of what is named for a caster and is none [m]."""

    def _wheel(self, its: _Candidate, turned: Array) -> Wheel:
        """Makes a wheel, of the shapes of a candidate moved in the vehicle's frame."""
        origin = _moved(turned @ self._frame, its.centre)
        origin[np.abs(origin) < 1e-12] = 0.0
        self._check_mass(its)
        part = self._part(its.joint.child, its.links, turned, origin)
        return Wheel(part, its.joint.name, its.radius, its.half_width)

    def _check_mass(self, its: _Candidate) -> None:
        """Checks that what a joint moves has a mass."""
        if not any(self._search.urdf.links[link].mass for link in its.links):
            self._search.problems.append(
                f"link '{its.joint.child}', which joint '{its.joint.name}' moves, has no mass and inertia; give it an "
                "<inertial>"
            )

    def _part(self, name: str, links: tuple[str, ...], turned: Array, origin: Array) -> Part:
        back = np.eye(4)
        back[:3, 3] = -origin
        frames = self._search.urdf.frames
        return Part(name, links, {link: back @ turned @ self._frame @ frames[link] for link in links}, origin)

    def swivelling(self, swivel: _Candidate, wheel: _Candidate) -> Caster | None:
        """Makes a caster that swivels, turned to where it trails; None if it cannot be one."""
        name, problems, notes = swivel.joint.name, self._search.problems, self._search.notes
        self._moved |= {*swivel.links, *wheel.links}
        if not wheel.hulls:
            problems.append(f"the caster wheel on joint '{wheel.joint.name}' has no shape that is found; give it one")
            return None
        pivot, centre = _moved(self._frame, swivel.at), _moved(self._frame, wheel.centre)
        axis = self._frame[:3, :3] @ wheel.axis
        away = centre[:2] - pivot[:2]
        aside, trail = float(away @ axis[:2]), float(np.linalg.norm(away))
        radius = wheel.radius
        if abs(aside) > max(NEAR, 0.1 * radius) or trail > 3 * radius:
            problems.append(
                f"the caster wheel of joint '{wheel.joint.name}' is not under its swivel '{name}': the swivel is at "
                f"{rounded(pivot)}, the wheel at {rounded(centre)}"
            )
            return None
        if trail < NEAR:
            if not wheel.is_ball:
                problems.append(
                    f"the wheel of joint '{wheel.joint.name}' has no trail behind its swivel '{name}' ({trail:.4g} m): "
                    f"it is steered, or could not turn to where the vehicle drives; {KIND}"
                )
                return None
            return self._ball(wheel.joint.child, (*swivel.links, *wheel.links), centre, radius, 0.0)
        turn = atan2(0.0, -1.0) - atan2(away[1], away[0])
        if abs(away[1]) <= 1e-9 and away[0] < 0:
            turned = np.eye(4)
        else:
            notes.append(f"caster '{name}' starts turned to where it trails, by {degrees(turn) % 360:.0f} degrees")
            turned = _turn_about(pivot, turn)
        rolling = self._set_down(self._wheel(wheel, turned))
        if rolling is None:
            return None
        origin = np.array([pivot[0], pivot[1], rolling.part.origin[2]])
        self._check_mass(swivel)
        fork = self._part(swivel.joint.child, swivel.links, turned, origin)
        return Caster(rolling, fork, name)

    def _set_down(self, wheel: Wheel) -> Wheel | None:
        """Puts a support on the ground that the drive wheels stand on; None if it is far from it."""
        part = wheel.part
        above = float(part.origin[2]) - wheel.radius - self._ground
        if abs(above) > max(SET_DOWN * -self._ground, LEAST_SET_DOWN):
            way = "above" if above > 0 else "below"
            self._search.problems.append(
                f"caster '{part.name}' ends {abs(above):.4g} m {way} the ground that the drive wheels of radius "
                f"{-self._ground:.4g} m stand on"
            )
            return None
        if abs(above) > NEAR / 2:
            way = "above" if above > 0 else "below"
            self._search.notes.append(
                f"caster '{part.name}' ends {1000 * abs(above):.2g} mm {way} the ground; it is put on it"
            )
        shift = np.array([0.0, 0.0, above])
        if abs(above) < 1e-12:
            return wheel
        return replace(wheel, part=replace(part, origin=part.origin - shift))

    def balls(self, held: list[_Candidate]) -> list[Caster]:
        """Makes casters of what stands on the ground without a swivel: balls, rollers and skids, which slide."""
        search, urdf, found = self._search, self._search.urdf, []
        moved = {link for its in held for link in its.links}
        for its in held:
            if its.joint.kind != "fixed" and not its.hulls:
                search.notes.append(f"joint '{its.joint.name}' is held at 0")
        links = [link for link in urdf.links.values() if link.name not in self._moved]
        shapes: dict[str, list[Hull]] = {}
        for link in links:
            known = any(hull_of(solid, search.meshes) for solid in link.solids)
            looks = link.looks if NAMED_SUPPORT.search(link.name) else ()
            for number, solid in enumerate(link.solids if known else looks):
                hull = hull_of(solid, search.meshes)
                if hull is None:
                    continue
                hull = hull.moved(self._frame @ urdf.frames[link.name])
                owner = solid.of or link.name
                named = NAMED_SUPPORT.search(owner) or link.name in moved
                above = float(hull.low[2]) - self._ground
                small = float(np.max(hull.high[:2] - hull.low[:2])) < SMALL * self.track
                grazes = known and small and abs(above) <= max(GRAZING * -self._ground, NEAR)
                if (named and self._is_low(hull)) or grazes:
                    shapes.setdefault(owner, []).append(hull)
                    self._supporting |= {(link.name, number)} if known else set()
                elif NAMED_SUPPORT.search(owner):
                    self.too_high[owner] = min(above, self.too_high.get(owner, above))
        for owner, hulls in shapes.items():
            low, high = np.min([h.low for h in hulls], axis=0), np.max([h.high for h in hulls], axis=0)
            flat = [hull for hull in hulls if len(hull.points) == 1]
            radius = flat[0].inflation if flat else float(high[2] - low[2]) / 2
            centre = flat[0].points[0] if flat else (low + high) / 2
            joint = next((j for j in urdf.joints.values() if j.child == owner), None)
            friction = 0.0 if joint is not None and joint.turns_freely else urdf.frictions.get(owner)
            inside = (owner,) if owner in urdf.links and owner != urdf.base and urdf.links[owner].mass else ()
            ball = self._ball(owner, inside, centre, radius, friction)
            found += [ball] if ball else []
        return found

    def _is_low(self, hull: Hull) -> bool:
        """Whether it is nearer to the ground than to the axle."""
        return float(hull.low[2]) < self._ground + 0.6 * -self._ground

    def _ball(
        self, name: str, links: tuple[str, ...], centre: Array, radius: float, friction: float | None
    ) -> Caster | None:
        own = f"{name}_support" if name == self._search.urdf.base else name
        part = self._part(own, links, np.eye(4), np.array(centre, dtype=float))
        self._moved |= {*links}
        wheel = self._set_down(Wheel(part, f"{own}_mount", radius, 0.0))
        return None if wheel is None else Caster(wheel, friction=friction)

    def body(self, casters: list[Caster]) -> Part:
        """Makes the body of all links that no wheel and no swivel takes along."""
        taken = {link for caster in casters for part in (caster.fork, caster.wheel.part) if part for link in part.links}
        taken |= {*self._left.part.links, *self._right.part.links}
        urdf = self._search.urdf
        links = tuple(link for link in urdf.links if link not in taken)
        if not any(urdf.links[link].mass for link in links):
            self._search.problems.append(f"link '{urdf.base}' has no mass and inertia; give it an <inertial>")
        for joint in urdf.joints.values():
            if joint.kind not in ("fixed", "continuous") and joint.child in links and not joint.turns_freely:
                self._search.notes.append(f"joint '{joint.name}' ({joint.kind}) is held at 0")
        return self._part(urdf.base, links, np.eye(4), np.zeros(3))

    def mechanism(self, body: Part, casters: list[Caster]) -> Mechanism:
        """Makes the record, with what all parts cover."""
        search, wheels = self._search, (self._left, self._right)
        boxes = list(self._covered(body))
        tall = list(boxes) or [(np.zeros(3), np.full(3, self._left.radius))]
        for wheel in wheels:
            boxes.append((wheel.part.origin, np.array([wheel.radius, wheel.half_width, wheel.radius])))
        for caster in casters:
            pivot = caster.fork.origin if caster.fork else caster.wheel.part.origin
            sweep = caster.trail + caster.wheel.radius if caster.fork else 0.0
            boxes.append((pivot, np.array([sweep, sweep, 0.0])))
        low = np.min([middle - half for middle, half in boxes], axis=0)
        high = np.max([middle + half for middle, half in boxes], axis=0)
        box = next(
            ((m, h) for m, h in tall if (m - h <= low + NEAR)[:2].all() and (m + h >= high - NEAR)[:2].all()), None
        )
        if box is None:
            bottom, top = min(m[2] - h[2] for m, h in tall), max(m[2] + h[2] for m, h in tall)
            corner, other = np.array([low[0], low[1], bottom]), np.array([high[0], high[1], top])
            box = (corner + other) / 2, (other - corner) / 2
        return Mechanism(
            search.urdf,
            self._frame,
            body,
            *wheels,
            tuple(casters),
            low,
            high,
            box,
            self._lidar(box),
            tuple(search.notes),
        )

    def _covered(self, body: Part) -> Iterator[tuple[Array, Array]]:
        """Finds the boxes, as middles and half edges, that the shapes of the body cover.

        Of links whose collision shapes are not found it takes what is seen of them, and if nothing of the body is
        known, the box of its inertia.
        """
        search, urdf, lost, found = self._search, self._search.urdf, [], False
        for name in body.links:
            link, frame = urdf.links[name], body.placed[name]
            own = [solid for number, solid in enumerate(link.solids) if (name, number) not in self._supporting]
            boxes = [box for solid in own if (box := self._box(solid, frame))]
            missing = [solid for solid in own if self._box(solid, frame) is None]
            if missing and not boxes:
                boxes = [box for solid in link.looks if (box := self._box(solid, frame))]
                what = "it covers what is seen of it" if boxes else "what it covers is not known"
                search.notes.append(f"{missing[0].title} of '{name}' is not found or cannot be read: {what}")
                lost += [] if boxes else [name]
            found = found or bool(boxes)
            yield from boxes
        for name in [] if found or lost else body.links:
            seen = [box for solid in urdf.links[name].looks if (box := self._box(solid, body.placed[name]))]
            if seen:
                search.notes.append(f"nothing of the body collides: '{name}' covers what is seen of it")
            yield from seen
            lost += [] if seen or name != urdf.base else [name]
        for name in [] if found else lost:
            centre, half = body.placed[name] @ urdf.links[name].centre, _inertia_box(urdf.links[name])
            if half is not None:
                search.notes.append(f"'{name}' covers the box of its inertia")
                yield centre[:3, 3], np.abs(centre[:3, :3]) @ half

    def _box(self, solid: Solid, frame: Array) -> tuple[Array, Array] | None:
        """Computes the upright box around a shape: its middle and half edges."""
        if solid.kind == "box" and len(solid.sizes) == 3:  # exactly, so that a box around everything stays as it is
            placed = frame @ solid.origin
            return placed[:3, 3], np.abs(placed[:3, :3]) @ (np.array(solid.sizes) / 2)
        hull = hull_of(solid, self._search.meshes)
        if hull is None:
            return None
        hull = hull.moved(frame)
        return (hull.low + hull.high) / 2, (hull.high - hull.low) / 2

    def _lidar(self, box: tuple[Array, Array]) -> Array:
        """Finds the place of the lidar, or one for it."""
        search, (middle, half) = self._search, box
        named = [name for name in search.urdf.frames if NAMED_LIDAR.search(name)]
        places = [_moved(self._frame, search.urdf.frames[name][:3, 3]) for name in named]
        centred = [(name, at) for name, at in zip(named, places, strict=True) if abs(at[1]) <= 0.1 * half[1]]
        if len(centred) == 1 or (centred and all(np.allclose(at, centred[0][1], atol=0.05) for _, at in centred)):
            search.notes.append(f"its rays are those of '{centred[0][0]}'")
            return centred[0][1]
        height = float(np.mean([at[2] for at in places])) if places else float(middle[2] + half[2])
        what = f"of its {len(places)} sensors ({', '.join(named)})" if places else "of its top, as it names no lidar"
        search.notes.append(f"its rays begin in the middle of the footprint, at the height {what}")
        return np.array([middle[0], 0.0, height])


def rounded(vector: Array) -> tuple[float, ...]:
    """Rounds a position for a message."""
    return tuple(round(value, 4) + 0.0 for value in np.asarray(vector).tolist())


def _moved(transform: Array, point: Array) -> Array:
    return np.asarray(transform[:3, :3] @ point + transform[:3, 3])


def _turn_about(pivot: Array, angle: float) -> Array:
    """Makes the transform (4, 4) that turns about a vertical axis through a point."""
    transform = np.eye(4)
    transform[:2, :2] = [[cos(angle), -sin(angle)], [sin(angle), cos(angle)]]
    transform[:2, 3] = pivot[:2] - transform[:2, :2] @ pivot[:2]
    return transform


def _inertia_box(link: Link) -> Array | None:
    """Computes half the edges of the solid box of a link's mass and inertia, in the frame of the inertia (3,) [m]."""
    if link.mass is None or link.mass <= 0 or link.inertia is None:
        return None
    xx, yy, zz = np.diag(link.inertia).tolist()
    squares = [yy + zz - xx, xx + zz - yy, xx + yy - zz]
    if min(squares) < 0 or max(squares) == 0:
        return None
    return np.array([sqrt(6 * square / link.mass) / 2 for square in squares])
