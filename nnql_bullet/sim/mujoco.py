"""Contact physics in MuJoCo. The only module that imports mujoco.

Collision bits keep apart what must not meet: the wheels, which are spheres with one true contact point each, touch only
the ground; the chassis, a box over the whole footprint, touches only obstacles and walls; rays see only these.

The engine's constraints are soft by design. Here they are as hard as it lets them be, which takes three measures:

- Each constraint is to be met by the end of the step, and is given in to by a ten-thousandth (`IMPEDANCE`).
- A drive is no actuator, whose gain would have to be far too high for a free wheel, but a clutch: dry friction, as
  strong as the torque limit, between the wheel and a shaft that turns as commanded.
- The engine solves a convex relaxation of Coulomb's law in which whatever slides is lifted at once by the friction
  coefficient times the speed of sliding: a skidding vehicle would hop. That lift is made up for (`_let_slide`).
"""

from dataclasses import dataclass
from math import cos, hypot, sin, sqrt
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.constants import GRAVITY
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array, OrientedBox, Pose
from nnql_bullet.jit import njit
from nnql_bullet.sim.base import Sample
from nnql_bullet.sim.contact import ContactEngine
from nnql_bullet.sim.physics import ContactForce, LinkDynamics, Quaternion
from nnql_bullet.types import Vector
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.payload import urdf_text
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.spec import WorldSpec

WHEEL, CHASSIS = 1, 2
"""Collision bits: what the ground touches, and what obstacles and walls touch."""
OBSTACLE = 1
"""Group of the geoms that rays see; all others are in group 0."""

IMPEDANCE = 0.9999
"""Share of a constraint that is met; the engine takes no more. What is left has the vehicle sink in by a micrometre at
most, and creep by less than that in 10 s."""
CONSTRAINT_STEPS = 2.0
"""Time constant of a constraint, in steps: the engine takes no less. A wrong velocity is put right in one step."""
HIT_DAMPING = 5.0
"""Damping ratio of the chassis's contacts. With 1, critical damping, they throw the vehicle back at up to a quarter of
the speed of a hit; that share falls with the square of the ratio."""
SCRAPING = 0.25
"""Friction of the chassis on obstacles and walls; in PyBullet it is the product of two default values of 0.5."""
SHAFT = 1e4
"""Inertia of the shaft that a drive's clutch holds on to [kg m2]. A torque of 100 N m changes its speed by less than
1e-4 rad/s in a step, after which it turns as commanded again."""
LOCK = 1e4
"""What holds a locked joint [N m]."""
SINK = 1e-7
"""How deep the wheels stand in the ground at the start [m]: the engine sees contact only where things overlap."""
SLIDES = 0.999999
"""Share of its limit from which friction is taken to be sliding friction; the solver puts that on the limit exactly."""
AGREEMENT = 1e-5
"""Accelerations of sliding contacts agree with Coulomb's law if they are off by no more than this [m/s2]; what is given
in to (see `IMPEDANCE`), which keeps a wheel in contact, is a hundred times as much."""
GENTLEST = -0.1
"""Slope of the secant method, which takes it for at least that steep: it keeps steps within bounds."""
PASSES = 30
"""After which what is still off is left to the next step; most steps take 1 to 8."""


@dataclass(frozen=True, slots=True)
class Physics:
    """Settings of the engine."""

    time_step: float
    """[s]"""


PHYSICS = {
    "reference": Physics(time_step=1 / 240),
    "fast": Physics(time_step=1 / 120),
}


class MujocoEngine(ContactEngine):
    """One vehicle in one world.

    Resistance to rolling and spinning acts on free wheels only. The engine has one limit for friction in all directions
    together, so that a wheel which rolls, and thereby uses up its limit, would slip by up to 4 % of its speed in turns.
    On driven wheels resistance only takes 1 N m of what the drives have.
    """

    _com = (0.0, 0.0, 0.0)

    def __init__(self, vehicle: VehicleSpec, drive: DriveOptions, physics: Physics) -> None:
        super().__init__(vehicle, drive, physics.time_step)
        self._urdf = urdf_text(vehicle)
        self._model: Any = None
        self._data: Any = None
        self._chassis = 0
        self._twisted = False
        self._seen = np.zeros(mujoco.mjNGROUP, np.uint8)
        self._seen[OBSTACLE] = 1

    def close(self) -> None:
        """Frees the model."""
        self._model = self._data = None
        self._position = self._velocity = self._shafts = np.empty(0)

    # What it is probed with

    def release_wheels(self) -> None:
        """Lets the drive wheels roll freely."""
        self._hold(drives=0.0, joints=0.0)

    def lock_joints(self) -> None:
        """Stops every joint and holds it where it is."""
        self._velocity[self._joint_rates] = 0.0
        self._hold(drives=0.0, joints=LOCK)

    def set_gravity(self, gravity: Vector) -> None:
        """[m/s2]; a placed vehicle has it pointing down."""
        self._model.opt.gravity[:] = gravity

    def set_velocity(self, x: float, y: float) -> None:
        """Sends the chassis along [m/s], without turning it; the joints go on as they were."""
        self._velocity[:6] = x, y, 0.0, 0.0, 0.0, 0.0

    def set_swivel(self, angle: float) -> None:
        """Turns the caster from trailing [rad], at rest."""
        self._position[self._joint_angles[2]] = angle
        self._velocity[self._joint_rates[2]] = 0.0

    def twist(self, torque: float) -> None:
        """Turns the chassis about the vertical during the next physics step [N m]."""
        self._data.xfrc_applied[self._chassis, 5] = torque
        self._twisted = True

    def touching(self) -> bool:
        """Whether the chassis touches anything now. The wheels touch nothing but the ground."""
        return len(self._contacts(self._chassis)) > 0

    def obstacle_force(self) -> float:
        """Normal force of obstacles and walls on the chassis, as a sum over all contacts [N]."""
        return self._contact_force(self._chassis).normal

    def wheel_forces(self) -> tuple[ContactForce, ContactForce, ContactForce]:
        """Of the ground on the left, right and caster wheel."""
        left, right, front = (self._contact_force(wheel) for wheel in self._wheels)
        return left, right, front

    def wheel_speeds(self) -> tuple[float, float]:
        """Left and right drive wheel [rad/s]."""
        left, right, *_ = self._velocity[self._joint_rates].tolist()
        return left, right

    def wheel_heights(self) -> Vector:
        """Of the left, right and caster wheel centre above the ground [m]."""
        mujoco.mj_kinematics(self._model, self._data)  # after a step these are still where it began
        left, right, front = self._data.xpos[self._wheels, 2].tolist()
        return left, right, front

    def sample(self) -> Sample:
        """The vehicle now."""
        left, right, swivel, roll = self._position[self._joint_angles].tolist()
        return Sample(self.time(), self.pose(), (left, right, swivel, roll), self.wheel_speeds())

    def link_dynamics(self) -> dict[str, LinkDynamics]:
        """What the engine holds of every link, by the link's name."""
        links = np.flatnonzero(self._model.body_rootid == self._chassis)
        return {self._model.body(link).name: self._dynamics(link) for link in links.tolist()}

    # How it is built

    def _build(self, world: WorldSpec, pose: Pose, speed: float, height: float, ground: bool) -> None:
        vehicle = self.vehicle
        model = self._model = self._compiled(world, ground)
        data = self._data = mujoco.MjData(model)
        self._position, self._velocity, self._shafts = data.qpos, data.qvel, data.qvel[-2:]
        self._commanded: list[float] = [0.0, 0.0]
        self._twisted = False
        names, links = vehicle.joints, vehicle.links
        joints = [model.joint(name) for name in (names.left_drive, names.right_drive, names.swivel, names.caster_roll)]
        self._joint_angles = [int(joint.qposadr[0]) for joint in joints]
        self._joint_rates = [int(joint.dofadr[0]) for joint in joints]
        self._chassis = int(model.body_rootid[model.body(links["left_drive"]).id])
        self._wheels = [model.body(links[field]).id for field in ("left_drive", "right_drive", "caster_roll")]
        self._drive_geoms = np.flatnonzero(np.isin(model.geom_bodyid, self._wheels[:2]))
        self._hold(drives=0.0, joints=0.0)
        half = pose.yaw / 2
        self._position[:7] = pose.x, pose.y, vehicle.wheel_radius + height - SINK, cos(half), 0.0, 0.0, sin(half)
        self.set_velocity(speed * cos(pose.yaw), speed * sin(pose.yaw))
        rolling, front = speed / vehicle.wheel_radius, speed / vehicle.caster_radius
        self._velocity[self._joint_rates] = rolling, rolling, 0.0, front
        mujoco.mj_kinematics(model, data)  # puts what rays see into its place

    def _compiled(self, world: WorldSpec, ground: bool) -> Any:
        """The world with the vehicle in it, as a model.

        Raises:
            UserError: If the engine cannot take the URDF.
        """
        try:
            spec = mujoco.MjSpec.from_string(self._urdf)
            spec.compiler.fusestatic = False
            spec.worldbody.first_body().add_freejoint()
            _set_solver(spec, self.time_step)
            _set_contacts(spec, self.vehicle)
            _add_clutches(spec, self.vehicle)
            if ground:
                plane = mujoco.mjtGeom.mjGEOM_PLANE
                spec.worldbody.add_geom(type=plane, size=[0.0, 0.0, 1.0], contype=0, conaffinity=WHEEL)
            _add_solids(spec, world)
            _add_patrols(spec, world)
            return spec.compile()
        except ValueError as error:
            reason = " ".join(str(error).split())
            raise UserError(f"{self.vehicle.urdf}: MuJoCo cannot take this URDF: {reason}") from None

    def _hold(self, drives: float, joints: float) -> None:
        """Has the clutches pass on a torque of up to `drives`, and every joint resist up to `joints` [N m]."""
        self._driven = drives > 0
        self._model.tendon_frictionloss[:] = drives
        self._model.dof_frictionloss[self._joint_rates] = joints
        contact = self.vehicle.contact
        resisting = 6 if contact.rolling_friction > 0 else 4 if contact.spinning_friction > 0 else 3
        self._model.geom_condim[self._drive_geoms] = 3 if self._driven else resisting

    def _engage_motors(self) -> None:
        if not self._driven:
            self._hold(drives=self.vehicle.wheel_torque, joints=0.0)

    def _command(self, speeds: list[float]) -> None:
        self._commanded = speeds

    def _step(self) -> None:
        model, data = self._model, self._data
        self._shafts[:] = self._commanded
        mujoco.mj_forward(model, data)
        contact = data.contact
        if _slides(contact.efc_address, contact.dim, contact.friction, data.efc_force):
            self._let_slide()
        mujoco.mj_Euler(model, data)
        self._steps += 1
        if self._twisted:
            data.xfrc_applied[self._chassis] = 0.0
            self._twisted = False

    def _place_patrols(self) -> None:
        self._data.mocap_pos[:, :2] = self._movers[:, :2]

    def _let_slide(self) -> None:
        """Solves the step anew, where contacts slide, for the accelerations that Coulomb's law has them end with.

        The solver exceeds the normal acceleration that it goes for, of a sliding contact, by its lift (see `_make_up`).
        Asking for one that is lower by just that makes up for it: the change of variables of de Saxcé and Feng, The
        bipotential method, Mathematical and Computer Modelling 28 (1998). The lift that comes out depends on the one
        made up for; the two are brought together.
        """
        model, data = self._model, self._data
        contact = data.contact
        rows, sizes, frictions = contact.efc_address, contact.dim, contact.friction
        references, reached = data.efc_aref.copy(), np.empty(data.nefc)
        lifts, last = np.zeros(len(rows)), np.zeros((len(rows), 2))
        for _ in range(PASSES):
            mujoco.mj_mulJacVec(model, data, reached, data.qacc)
            if _make_up(rows, sizes, frictions, references, reached, lifts, last, data.efc_aref):
                break
            mujoco.mj_fwdConstraint(model, data)

    def _frame(self) -> tuple[Vector, Quaternion]:
        x, y, z, qw, qx, qy, qz = self._position[:7].tolist()
        return (x, y, z), (qx, qy, qz, qw)

    def _velocities(self) -> tuple[Vector, Vector]:
        angular = np.empty(3)
        mujoco.mju_rotVecQuat(angular, self._velocity[3:6], self._position[3:7])  # it is held in the chassis's axes
        (vx, vy, vz), (wx, wy, wz) = self._velocity[:3].tolist(), angular.tolist()
        return (vx, vy, vz), (wx, wy, wz)

    def _cast(self, begins: Array, ends: Array) -> Array:
        if len(self._tracks):
            mujoco.mj_kinematics(self._model, self._data)  # else rays see patrols where the last step began
        count, furthest = len(begins), paper.SENSOR_RANGE
        directions = (ends - begins).ravel() / furthest
        distances, hits = np.empty(count), np.empty(count, np.int32)
        mujoco.mj_multiRay(
            self._model,
            self._data,
            pnt=begins[0],
            vec=directions,
            geomgroup=self._seen,
            flg_static=True,
            bodyexclude=-1,
            geomid=hits,
            dist=distances,
            normal=None,
            nray=count,
            cutoff=furthest,
        )
        return np.where((hits < 0) | (distances > furthest), furthest, distances)

    def _contacts(self, link: int) -> NDArray[np.intp]:
        """Which contacts of the last step were with a link; it had one wherever the two overlapped."""
        return np.flatnonzero((self._model.geom_bodyid[self._data.contact.geom] == link).any(axis=1))

    def _contact_force(self, link: int) -> ContactForce:
        normal, friction, wrench = 0.0, 0.0, np.empty(6)
        for contact in self._contacts(link):
            mujoco.mj_contactForce(self._model, self._data, contact, wrench)
            pressing, along, across, *_ = wrench.tolist()
            normal, friction = normal + pressing, friction + hypot(along, across)
        return ContactForce(normal, friction)

    def _dynamics(self, link: int) -> LinkDynamics:
        model, axes = self._model, np.empty(9)
        mujoco.mju_quat2Mat(axes, model.body_iquat[link])
        moments = np.empty(3)
        moments[np.argmax(np.abs(axes.reshape(3, 3)), axis=0)] = model.body_inertia[link]  # it sorts them
        ix, iy, iz = moments.tolist()
        friction = spinning = rolling = 0.0
        if model.body_geomnum[link]:
            friction, spinning, rolling = model.geom_friction[model.body_geomadr[link]].tolist()
        return LinkDynamics(float(model.body_mass[link]), (ix, iy, iz), friction, rolling, spinning)


def _hard(damping: float, time_step: float) -> list[float]:
    """The engine's `solref` of a constraint with this damping ratio."""
    return [CONSTRAINT_STEPS * time_step, damping]


def _set_solver(spec: Any, time_step: float) -> None:
    spec.option.timestep = time_step
    spec.option.gravity = [0.0, 0.0, -GRAVITY]
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC  # friction is the same in all directions
    spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_ISLAND  # there is only one, and `_let_slide` works without


def _set_contacts(spec: Any, vehicle: VehicleSpec) -> None:
    """What the vehicle's geoms touch, and how; their values hold against anything."""
    time_step, contact = spec.option.timestep, vehicle.contact
    for geom in spec.geoms:
        geom.contype = geom.conaffinity = 0
        geom.priority = 1
        geom.condim = 3
        geom.solimp[:2] = IMPEDANCE
        geom.solref = _hard(1.0, time_step)
    for geom in spec.worldbody.first_body().geoms:
        geom.contype = CHASSIS
        geom.solref = _hard(HIT_DAMPING, time_step)
        geom.friction = [SCRAPING, 0.0, 0.0]
    for field in ("left_drive", "right_drive", "caster_roll"):
        resistance = [contact.spinning_friction, contact.rolling_friction] if field != "caster_roll" else [0.0, 0.0]
        for geom in spec.body(vehicle.links[field]).geoms:
            geom.contype = WHEEL
            geom.friction = [contact.wheel_friction, *resistance]


def _add_clutches(spec: Any, vehicle: VehicleSpec) -> None:
    """Two shafts, which become the last joints, and the friction between each and its wheel; also what locks joints."""
    friction = {"solref_friction": _hard(1.0, spec.option.timestep)}
    for wheel in (vehicle.joints.left_drive, vehicle.joints.right_drive):
        shaft = f"shaft of {wheel}"
        body = spec.worldbody.add_body(name=shaft, mass=1.0, inertia=[SHAFT] * 3, explicitinertial=True)
        body.add_joint(name=shaft, type=mujoco.mjtJoint.mjJNT_HINGE, axis=[0.0, 1.0, 0.0])
        clutch = spec.add_tendon(name=wheel, **friction)
        clutch.solimp_friction[:2] = IMPEDANCE
        clutch.wrap_joint(wheel, 1.0)
        clutch.wrap_joint(shaft, -1.0)
    for joint in spec.joints:
        joint.solref_friction = friction["solref_friction"]
        joint.solimp_friction[:2] = IMPEDANCE


def _add_solids(spec: Any, world: WorldSpec) -> None:
    for box in world.obstacles + world.walls:
        _add_box(spec.worldbody, box, world.obstacle_height / 2, pos=[box.x, box.y, world.obstacle_height / 2])


def _add_patrols(spec: Any, world: WorldSpec) -> None:
    """Bodies that are told where they are. The engine takes them to stand: it feels how deep they hit, not how fast."""
    half_height = world.obstacle_height / 2
    for patrol in world.patrols:
        body = spec.worldbody.add_body(mocap=True, pos=[patrol.box.x, patrol.box.y, half_height])
        _add_box(body, patrol.box, half_height, pos=[0.0, 0.0, 0.0])


def _add_box(body: Any, box: OrientedBox, half_height: float, pos: list[float]) -> None:
    """A box as obstacles are, somewhere in a body."""
    body.add_geom(
        type=mujoco.mjtGeom.mjGEOM_BOX,
        size=[box.half_length, box.half_width, half_height],
        pos=pos,
        quat=[cos(box.yaw / 2), 0.0, 0.0, sin(box.yaw / 2)],
        contype=0,
        conaffinity=CHASSIS,
        group=OBSTACLE,
    )


@njit()
def _slides(rows: NDArray[np.int32], sizes: NDArray[np.int32], frictions: Array, forces: Array) -> bool:
    """Whether any contact uses all the friction there is, in all its directions together.

    Args:
        rows: The first row of each contact among the solver's, its normal; those of friction follow (n,).
        sizes: How many rows it has (n,).
        frictions: Coefficients of the rows after the first (n, 5) [1, m].
        forces: Of all rows [N, N m].
    """
    for contact in range(len(rows)):
        row, used = rows[contact], 0.0
        for k in range(1, sizes[contact]):
            used += (forces[row + k] / frictions[contact, k - 1]) ** 2
        if row >= 0 and used > 0.0 and sqrt(used) >= SLIDES * forces[row]:
            return True
    return False


@njit()
def _make_up(
    rows: NDArray[np.int32],
    sizes: NDArray[np.int32],
    frictions: Array,
    references: Array,
    reached: Array,
    lifts: Array,
    last: Array,
    asked: Array,
) -> bool:
    """Makes up for the lift of contacts: the norm of friction coefficient times what is missing of an acceleration.

    What is missing in the directions of friction is what would end the sliding within the step. The lift that comes out
    grows with the one made up for, by less than that grows. The secant method finds where they are the same, for each
    contact on its own.

    Args:
        rows: See `_slides`.
        sizes: See `_slides`.
        frictions: See `_slides`.
        references: Accelerations that are gone for, in all rows [m/s2, rad/s2].
        reached: Those that came out [m/s2, rad/s2].
        lifts: Made up for so far (n,) [m/s2]; brought up to date.
        last: What was made up for before that, and how much more came out (n, 2) [m/s2]; brought up to date.
        asked: `references` less the lifts; brought up to date.

    Returns:
        Whether what came out is what was made up for.
    """
    agreed = True
    for contact in range(len(rows)):
        row, lift = rows[contact], 0.0
        if row < 0:  # it is left out
            continue
        for k in range(1, sizes[contact]):
            lift += (frictions[contact, k - 1] * (reached[row + k] - references[row + k])) ** 2
        lift = sqrt(lift)
        more, before, more_before = lift - lifts[contact], last[contact, 0], last[contact, 1]
        agreed = agreed and abs(more) <= AGREEMENT
        slope = -1.0
        if lifts[contact] != before:
            slope = min(max((more - more_before) / (lifts[contact] - before), -1.0), GENTLEST)
        last[contact, 0], last[contact, 1] = lifts[contact], more
        lifts[contact] = max(lifts[contact] - more / slope, 0.0)
        asked[row] = references[row] - lifts[contact]
    return agreed
