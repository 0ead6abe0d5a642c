"""Reads a URDF: what its links and joints are.

Links without a mass that are fixed to others are frames, as ROS files have them for sensors and for `base_footprint`:
they are folded into the link that carries them, because PyBullet would give each a mass of 1 kg.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Sequence
from copy import deepcopy
from dataclasses import dataclass
from math import atan2, cos, pi, sin
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np

from nnql_bullet.errors import UserError
from nnql_bullet.files import plain_file
from nnql_bullet.geometry import Array
from nnql_bullet.markup import parse_xml
from nnql_bullet.text import listed

NUMBERS = {"xyz": 3, "rpy": 3, "size": 3, "radius": 1, "length": 1, "effort": 1, "value": 1, "rgba": 4, "scale": 3}
NUMBERS |= dict.fromkeys(("lower", "upper", "velocity"), 1)
NUMBERS |= dict.fromkeys(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), 1)
"""Attributes that hold numbers, and how many."""
UNBOUNDED = ("effort", "value", "lower", "upper", "velocity")
"""Those that may be infinite or are checked elsewhere."""
LARGEST = 1e6
"""Largest number that a URDF may hold [m, kg, kg m2]."""
DRAWABLE = {"box": {"size"}, "cylinder": {"radius", "length"}, "sphere": {"radius"}}
"""Shapes that are drawn, and the attributes that they need."""
MOST_BYTES, MOST_LINKS, MOST_SHAPES = 10_000_000, 500, 5000
"""Size of the largest URDF that is read [bytes, links, collision and visual shapes of all links]."""
_ENCODING = re.compile(rb"\s*<\?xml[^>]*?encoding\s*=\s*[\"']([^\"']*)[\"'][^>]*\?>")
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?|[+-]?(nan|inf)", re.ASCII)


class Unfit(Exception):
    """The URDF does not describe a vehicle that this package can drive; the text names the changes needed."""

    def __init__(self, *problems: str) -> None:
        self.problems = problems
        super().__init__(listed(problems))


def refuse(problems: Sequence[str]) -> None:
    """Refuses a URDF with problems, and names all of them.

    Raises:
        Unfit: If there are any.
    """
    if problems:
        raise Unfit(*problems)


@dataclass(frozen=True, slots=True)
class Solid:
    """A shape that collides or is seen."""

    kind: str
    """The tag of its geometry: box, cylinder, sphere or mesh."""
    sizes: tuple[float, ...]
    """Edges of a box, radius of a sphere, radius and length of a cylinder [m], or scale of a mesh."""
    origin: Array
    """Transform from its own frame to its link's frame (4, 4)."""
    file: str = ""
    """Name of the file of a mesh, as the URDF has it."""
    of: str = ""
    """Name of the massless link that it was part of, if any."""

    @property
    def title(self) -> str:
        """The kind, and the file of a mesh."""
        return f"{self.kind} '{self.file}'" if self.file else self.kind or "a shape without geometry"


@dataclass(frozen=True, slots=True)
class Link:
    """A rigid body."""

    name: str
    mass: float | None
    """[kg]"""
    centre: Array
    """Transform from the frame of its inertia to its own frame (4, 4)."""
    inertia: Array | None
    """Moments of inertia in that frame (3, 3) [kg m2]."""
    solids: tuple[Solid, ...]
    """Collision shapes."""
    looks: tuple[Solid, ...] = ()
    """Visible shapes."""


@dataclass(frozen=True, slots=True)
class Joint:
    """A joint between two links."""

    name: str
    kind: str
    parent: str
    child: str
    origin: Array
    """Transform from its child's frame at the angle 0 to its parent's frame (4, 4)."""
    axis: Array
    """In the child's frame (3,)."""
    effort: float | None
    """Torque limit [N m]."""
    velocity: float | None = None
    """Limit on the speed [rad/s]."""
    turns_freely: bool = False
    """Whether it turns without end: a continuous joint, or a revolute one whose limits are a turn apart or more."""


@dataclass(frozen=True, slots=True)
class Description:
    """Links and joints of a URDF, which form a tree, with all joints at the angle 0."""

    base: str
    """Name of the root of the tree, whose frame is the chassis frame."""
    links: dict[str, Link]
    joints: dict[str, Joint]
    frames: dict[str, Array]
    """Transforms from each link's frame to the chassis frame (4, 4), by link, those of massless links among them."""
    frictions: dict[str, float]
    """Friction coefficients of links that Gazebo is told (mu1), by link."""

    def moving_joints_above(self, link: str) -> list[str]:
        """Names of the joints that are not fixed, from a link up to the base."""
        carried_by = {joint.child: joint for joint in self.joints.values()}
        above = []
        while link in carried_by:
            joint = carried_by[link]
            above += [] if joint.kind == "fixed" else [joint.name]
            link = joint.parent
        return above


def read(path: Path) -> Element:
    """Reads the links and joints of a URDF, without its massless frames.

    Raises:
        UserError: If the file cannot be read, is not XML, or its links and joints are not a tree with proper numbers.
    """
    try:
        size = plain_file(path).stat().st_size
        if size > MOST_BYTES:
            raise Unfit(f"has {size} bytes; a URDF is read up to {MOST_BYTES} bytes")
        return parse(path.read_bytes())
    except OSError as error:
        raise UserError(f"{path}: cannot be read: {error.strerror}") from None
    except Unfit as error:
        raise UserError(f"{path}: {error}") from None


def parse(source: str | bytes) -> Element:
    """Reads the links and joints of a URDF from its text, in the encoding that it declares.

    Raises:
        Unfit: See `read`.
    """
    try:
        robot = parse_xml(_decoded(source))
        if robot.tag != "robot":
            raise Unfit(f"its root is <{robot.tag}>, not <robot>")
        refuse(list(_check_numbers(robot)))
        _check_tree(robot)
    except (Unfit, ValueError) as error:
        raise Unfit(f"cannot be read as a URDF: {error}") from None
    _fold_frames(robot)
    return robot


def _decoded(source: str | bytes) -> str | bytes:
    """Returns text that declares no encoding or UTF-8 and is not UTF-8 as the Latin-1 that it then is."""
    if isinstance(source, str) or ((encoding := _ENCODING.match(source)) and encoding[1].lower() != b"utf-8"):
        return source
    try:
        source.decode()
    except UnicodeDecodeError:
        if not source.startswith((b"\xff\xfe", b"\xfe\xff")):  # UTF-16, which the parser knows by these
            return _ENCODING.sub(b"", source).decode("latin-1")
    return source


def describe(robot: Element) -> Description:
    """Makes records of the links and joints that `read` gives."""
    links = {link.attrib["name"]: _link(link) for link in robot.findall("link")}
    joints = {joint.attrib["name"]: _joint(joint) for joint in robot.findall("joint")}
    base = root_of(robot)
    frames = {base: np.eye(4)}
    while len(frames) < len(links):
        for joint in joints.values():
            if joint.parent in frames:
                frames[joint.child] = frames[joint.parent] @ joint.origin
    for frame in robot.findall("frame"):
        frames[frame.attrib["name"]] = frames[frame.attrib["link"]] @ _transform(frame)
    frictions = {its.get("reference", ""): mu for its in robot.findall("gazebo") if (mu := _friction(its)) is not None}
    return Description(base, links, joints, frames, frictions)


def root_of(robot: Element) -> str:
    """Returns the name of the link that is no joint's child."""
    children = {_end(joint, "child") for joint in robot.findall("joint")}
    return next(link.attrib["name"] for link in robot.findall("link") if link.attrib["name"] not in children)


def for_physics(robot: Element) -> str:
    """Returns the text that engines load: what moves and collides, without looks and extensions of other programs."""
    bare = Element("robot", name=robot.get("name", ""))
    for link in robot.findall("link"):
        kept = ElementTree.SubElement(bare, "link", name=link.attrib["name"])
        kept.extend(_inertial(link))
        kept.extend(_shape("collision", solid) for solid in link.findall("collision"))
    bare.extend(_bare_joint(joint, "limit", "dynamics") for joint in robot.findall("joint"))
    return text_of(bare)


def for_drawing(robot: Element, mesh: Callable[[Element], Path | None] = lambda _: None) -> str:
    """Returns the text that renderers load, which names no other files than those of `mesh`.

    A link that looks like meshes alone gets the looks of its collision shapes; of other links, meshes are left out.

    Args:
        robot: The URDF.
        mesh: Returns the file to draw for a <mesh>, in metres and its own scale; None if there is none.
    """
    bare = Element("robot", name=robot.get("name", ""))
    bare.extend(map(_paint, robot.findall("material")))
    for link in robot.findall("link"):
        kept = ElementTree.SubElement(bare, "link", name=link.attrib["name"])
        kept.extend(_inertial(link))
        looks, solids = link.findall("visual"), link.findall("collision")
        drawn = [_look(look, look) for look in looks if _is_drawable(look)]
        for look in looks:
            found = look.find("geometry/mesh")
            if found is not None and (file := mesh(found)):
                drawn.append(shown := _look(look, look))
                for its in shown.findall("geometry/mesh"):
                    its.attrib.clear()
                    its.set("filename", str(file))
        kept.extend(drawn or [_look(solid, looks[0]) for solid in solids if looks and _is_drawable(solid)])
    bare.extend(map(_bare_joint, robot.findall("joint")))
    return text_of(bare)


def looks_of(link: Element, find: Callable[[str], Path | None]) -> list[Element]:
    """Makes the visuals of a link anew: its own, with meshes that are found; those of its collision shapes otherwise.

    Args:
        link: The link.
        find: Finds the file of a mesh by the name that the URDF has for it.
    """
    own = []
    for visual in link.findall("visual"):
        mesh = visual.find("geometry/mesh")
        file = None if mesh is None else find(mesh.get("filename", ""))
        if file or _is_drawable(visual):
            own.append(look := _look(visual, visual))
            for its in look.findall("geometry/mesh"):
                its.set("filename", str(file))
    painted = link.find("visual")
    if own or painted is None:
        return own
    return [_look(solid, painted) for solid in link.findall("collision") if _is_drawable(solid)]


def without_looks(text: str) -> str:
    """Returns a URDF without what is only seen."""
    robot = parse(text)
    for link in robot.findall("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
    for material in robot.findall("material"):
        robot.remove(material)
    return text_of(robot)


def text_of(robot: Element) -> str:
    """Writes a URDF as text."""
    return ElementTree.tostring(robot, encoding="unicode")


def _check_numbers(robot: Element) -> Iterator[str]:
    """Checks the form of all numbers of links and joints, and writes one space between them, as PyBullet needs it."""
    for part in [*robot.findall("link"), *robot.findall("joint"), *robot.findall("material")]:
        for element in part.iter():
            for key in sorted(element.attrib.keys() & NUMBERS.keys()):
                if key == "value" and element.tag != "mass":
                    continue
                words, count = element.attrib[key].split(), NUMBERS[key]
                given = f'<{element.tag} {key}="{element.attrib[key]}"> of {part.tag} {part.get("name")!r}'
                if len(words) != count or not all(map(_NUMBER.fullmatch, words)):
                    yield f"{given} must be {count} number{'s' * (count > 1)}"
                    continue
                numbers = [float(word) for word in words]
                if key not in UNBOUNDED and not all(abs(number) <= LARGEST for number in numbers):
                    yield f"{given} must be finite, and at most {LARGEST:g} in size"
                elif key in ("size", "length") and min(numbers) <= 0:
                    yield f"{given} must be positive"
                element.set(key, " ".join(words))


def _check_tree(robot: Element) -> None:
    shapes = sum(len(robot.findall(f"link/{tag}")) for tag in ("collision", "visual"))
    if shapes > MOST_SHAPES:
        raise Unfit(f"it has {shapes} shapes; up to {MOST_SHAPES} are taken")
    for tag in ("link", "joint"):
        names = [part.get("name", "") for part in robot.findall(tag)]
        if len(names) > MOST_LINKS:
            raise Unfit(f"it has {len(names)} {tag}s; up to {MOST_LINKS} are taken")
        for number, name in enumerate(names):
            if not name or name in names[:number]:
                raise Unfit(f"two {tag}s are named {name!r}" if name else f"a <{tag}> has no name")
    above = {}
    links = [link.attrib["name"] for link in robot.findall("link")]
    for joint in robot.findall("joint"):
        for end in ("parent", "child"):
            if _end(joint, end) not in links:
                raise Unfit(f"the {end} {_end(joint, end)!r} of joint {joint.get('name')!r} is not a link of it")
        if _end(joint, "child") in above:
            raise Unfit(f"link {_end(joint, 'child')!r} is the child of two joints")
        above[_end(joint, "child")] = _end(joint, "parent")
    roots = [link for link in links if link not in above]
    if len(roots) != 1:
        raise Unfit(
            f"one link must carry all others; no joint carries: {', '.join(roots) or 'none, they go in circles'}"
        )
    held = set(roots)
    while more := {link for link, carrier in above.items() if carrier in held} - held:
        held |= more
    if astray := [link for link in links if link not in held]:
        raise Unfit(f"joints go in a circle, and nothing carries: {', '.join(astray)}")


def _fold_frames(robot: Element) -> None:
    """Moves what massless links carry to the links that they are fixed to, and removes them."""
    links = {link.attrib["name"]: link for link in robot.findall("link")}
    for joint in robot.findall("joint"):
        if joint.get("type") == "fixed" and _massless(links[_end(joint, "child")]):
            _fold(robot, joint, links[_end(joint, "child")], links[_end(joint, "parent")], _transform(joint))
    root = links[root_of(robot)]
    fixed = [joint for joint in robot.findall("joint") if joint.get("type") == "fixed" and _carries(joint, root)]
    if fixed and _massless(root):
        _fold(robot, fixed[0], root, links[_end(fixed[0], "child")], np.asarray(np.linalg.inv(_transform(fixed[0]))))


def _fold(robot: Element, joint: Element, frame: Element, carrier: Element, transform: Array) -> None:
    """Moves all that a frame carries to another link, whose frame it lies in by a transform (4, 4)."""
    robot.remove(joint)
    robot.remove(frame)
    name = frame.attrib["name"]
    for element in [*frame.findall("visual"), *frame.findall("collision")]:
        carrier.append(element)
        element.attrib.setdefault("of", name)
        _set_origin(element, transform @ _transform(element))
    ElementTree.SubElement(robot, "frame", name=name, link=name)
    for element in robot.findall("frame"):
        if element.attrib["link"] == name:
            element.set("link", carrier.attrib["name"])
            _set_origin(element, transform @ _transform(element))
    for other in robot.findall("joint"):
        if _carries(other, frame):
            _set_origin(other, transform @ _transform(other))
            for parent in other.findall("parent"):
                parent.set("link", carrier.attrib["name"])


def _massless(link: Element) -> bool:
    mass = link.find("inertial/mass")
    return mass is None or float(mass.get("value", "nan")) == 0


def _carries(joint: Element, link: Element) -> bool:
    return _end(joint, "parent") == link.attrib["name"]


def _end(joint: Element, end: str) -> str:
    """Returns the name of a joint's parent or child."""
    found = joint.find(end)
    return "" if found is None else found.get("link", "")


def _is_drawable(element: Element) -> bool:
    shape = element.find("geometry/*")
    return shape is not None and shape.attrib.keys() >= DRAWABLE.get(shape.tag, {"no such attribute"})


def _firsts(part: Element, *tags: str) -> list[Element]:
    """Finds the first element of each tag; engines differ in which of several they take."""
    return [found for tag in tags if (found := part.find(tag)) is not None]


def _bare_joint(joint: Element, *more: str) -> Element:
    bare = Element("joint", name=joint.attrib["name"], type=joint.get("type", ""))
    bare.extend(_firsts(joint, "parent", "child", "origin", "axis", *more))
    return bare


def _inertial(link: Element) -> list[Element]:
    found = link.find("inertial")
    if found is None:
        return []
    bare = Element("inertial")
    bare.extend(_firsts(found, "origin", "mass", "inertia"))
    return [bare]


def _shape(tag: str, element: Element) -> Element:
    """Makes a visual or collision of the shape of another element."""
    shape = Element(tag)
    shape.extend(map(deepcopy, _firsts(element, "origin")))
    ElementTree.SubElement(shape, "geometry").extend(map(deepcopy, _firsts(element, "geometry/*")))
    return shape


def _look(element: Element, painted: Element) -> Element:
    look = _shape("visual", element)
    look.extend(map(_paint, _firsts(painted, "material")))
    return look


def _paint(material: Element) -> Element:
    """Copies a material, without its texture and with its colour between 0 and 1."""
    paint = Element("material", name=material.get("name", ""))
    colour = material.find("color")
    if colour is not None and "rgba" in colour.attrib:
        rgba = words(min(max(value, 0.0), 1.0) for value in _floats(colour.attrib["rgba"]))
        ElementTree.SubElement(paint, "color", rgba=rgba)
    return paint


def _floats(text: str) -> list[float]:
    return [float(word) for word in text.split()]


def _transform(element: Element) -> Array:
    """Computes the transform (4, 4) of the <origin> of an element, whose rpy turns about x, then y, then z."""
    origin = element.find("origin")
    transform = np.eye(4)
    if origin is not None:
        transform[:3, :3] = rotation(*_floats(origin.get("rpy", "0 0 0")))
        transform[:3, 3] = _floats(origin.get("xyz", "0 0 0"))
    return transform


def rotation(roll: float, pitch: float, yaw: float) -> Array:
    """Makes the matrix (3, 3) that turns about x, then y, then z [rad]."""
    about_x = np.array([[1.0, 0, 0], [0, cos(roll), -sin(roll)], [0, sin(roll), cos(roll)]])
    about_y = np.array([[cos(pitch), 0, sin(pitch)], [0, 1.0, 0], [-sin(pitch), 0, cos(pitch)]])
    about_z = np.array([[cos(yaw), -sin(yaw), 0], [sin(yaw), cos(yaw), 0], [0, 0, 1.0]])
    return np.asarray(about_z @ about_y @ about_x)


def place(element: Element, transform: Array) -> None:
    """Moves an element by a transform (4, 4)."""
    if not np.array_equal(transform, np.eye(4)):
        _set_origin(element, transform @ _transform(element))


def _set_origin(element: Element, transform: Array) -> None:
    """Gives an element the <origin> of a transform (4, 4)."""
    origin = element.find("origin")
    if origin is None:
        origin = ElementTree.SubElement(element, "origin")
    r = transform[:3, :3]
    across = float(np.hypot(r[0, 0], r[1, 0]))
    pitch = atan2(-r[2, 0], across)
    if across > 1e-9:
        roll, yaw = atan2(r[2, 1], r[2, 2]), atan2(r[1, 0], r[0, 0])
    else:  # it points up or down: roll and yaw turn about one axis
        roll, yaw = atan2(-r[1, 2], r[1, 1]), 0.0
    origin.set("xyz", words(transform[:3, 3].tolist()))
    origin.set("rpy", words((roll, pitch, yaw)))


def words(numbers: Iterable[float]) -> str:
    """Writes numbers as the text of an attribute, exactly."""
    return " ".join(map(repr, numbers))


def _link(link: Element) -> Link:
    inertial, mass = link.find("inertial"), link.find("inertial/mass")
    return Link(
        name=link.attrib["name"],
        mass=None if mass is None or "value" not in mass.attrib else float(mass.attrib["value"]),
        centre=np.eye(4) if inertial is None else _transform(inertial),
        inertia=_inertia(link.find("inertial/inertia")),
        solids=tuple(map(_solid, link.findall("collision"))),
        looks=tuple(map(_solid, link.findall("visual"))),
    )


def _inertia(moments: Element | None) -> Array | None:
    if moments is None or not {"ixx", "iyy", "izz"} <= moments.attrib.keys():
        return None
    rows = (("ixx", "ixy", "ixz"), ("ixy", "iyy", "iyz"), ("ixz", "iyz", "izz"))
    return np.array([[float(moments.get(key, "0")) for key in row] for row in rows])


def _solid(element: Element) -> Solid:
    shape = element.find("geometry/*")
    kind = "" if shape is None else shape.tag
    sizes = {} if shape is None else shape.attrib
    round_ones = dict.fromkeys(("cylinder", "capsule"), ("radius", "length"))
    keys = (round_ones | {"box": ("size",), "sphere": ("radius",), "mesh": ("scale",)}).get(kind, ())
    numbers = tuple(number for key in keys for number in _floats(sizes.get(key, "")))
    return Solid(kind, numbers, _transform(element), sizes.get("filename", ""), element.get("of", ""))


def _friction(gazebo: Element) -> float | None:
    """Reads the friction that Gazebo is told, as text or as an attribute."""
    mu = gazebo.find("mu1")
    text = "" if mu is None else (mu.text or "").strip() or mu.get("value", "").strip()
    return abs(float(text)) if _NUMBER.fullmatch(text) else None


def _joint(joint: Element) -> Joint:
    axis, limit = joint.find("axis"), joint.find("limit")
    return Joint(
        name=joint.attrib["name"],
        kind=joint.get("type", "of no type"),
        parent=_end(joint, "parent"),
        child=_end(joint, "child"),
        origin=_transform(joint),
        axis=np.array(_floats("1 0 0" if axis is None else axis.get("xyz", "1 0 0"))),
        effort=_limit(limit, "effort"),
        velocity=_limit(limit, "velocity"),
        turns_freely=_turns_freely(joint.get("type", ""), limit),
    )


def _limit(limit: Element | None, key: str) -> float | None:
    return None if limit is None or key not in limit.attrib else float(limit.attrib[key])


def _turns_freely(kind: str, limit: Element | None) -> bool:
    turn = (_limit(limit, "upper") or 0.0) - (_limit(limit, "lower") or 0.0)
    return kind == "continuous" or (kind == "revolute" and turn >= 2 * pi)
