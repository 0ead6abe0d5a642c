"""Contact physics in MuJoCo. The only module that imports mujoco.

Collision bits separate the contacts: the wheels, which are spheres with one contact point each, touch only the ground;
the chassis, a box over the whole footprint, touches only obstacles and walls; rays meet only these.

The engine's constraints are soft by design. Three measures make them as hard as the engine allows:

- A constraint is met at the end of the step, up to a small share (`IMPEDANCE`).
- A drive is a clutch: dry friction, as strong as the torque limit, between the wheel and a shaft that turns as
  commanded. An actuator would need a gain that is too high for a free wheel.
- The engine solves a convex relaxation of Coulomb's law, in which a sliding contact separates with the friction
  coefficient times the sliding speed: a skidding vehicle would hop. `_let_slide` compensates this lift.
"""

from dataclasses import dataclass
from math import cos, hypot, sin, sqrt
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from nnql_bullet.constants import GRAVITY
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Array, Circle, Pose, Shape
from nnql_bullet.jit import njit
from nnql_bullet.sim.base import Sample
from nnql_bullet.sim.contact import ContactEngine
from nnql_bullet.sim.physics import ContactForce, LinkDynamics, Quaternion
from nnql_bullet.types import Vector
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.payload import physics_text
from nnql_bullet.vehicle.scale import length_scale
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.spec import WorldSpec

WHEEL, CHASSIS = 1, 2
"""Collision bits: the ground touches wheels; obstacles and walls touch the chassis."""
OBSTACLE = 1
"""Group of the geoms that rays meet; all others are in group 0."""

IMPEDANCE = 0.9999
"""Share to which a constraint is met, the largest that the engine takes; the vehicle hardly sinks in or creeps."""
SLIDING_IMPEDANCE = 0.99
"""The same for balls of a vehicle with more than three supports: where its weight could rest on any of them, the wheels
take it. Otherwise the load would jump, because `_let_slide` finds one of many solutions."""
CONSTRAINT_STEPS = 2.0
"""Time constant of a constraint, in steps, the smallest that the engine takes; it corrects a velocity in one step."""
HIT_DAMPING = 5.0
"""Damping ratio of the chassis's contacts; the rebound from a hit falls with its square. 1 is critical damping."""
SCRAPING = 0.25
"""Friction of the chassis on obstacles and walls; in PyBullet it is the product of two default values."""
SHAFT = 1e4
"""Inertia of the shaft of a drive's clutch [kg m2]; it is so large that the clutch hardly changes the shaft's speed."""
LOCK = 1e4
"""Torque that holds a locked joint [N m]."""
SINK = 1e-7
"""Depth of the wheels in the ground at the start [m]; the engine finds contacts only where shapes overlap."""
SLIDES = 0.999999
"""Share of the friction limit from which a contact slides; the solver puts sliding friction exactly on the limit."""
AGREEMENT = 1e-5
"""Tolerance of a sliding contact's acceleration [m/s2]; the error that `IMPEDANCE` leaves is much larger."""
LARGEST_SLOPE = -0.1
"""Upper bound on the slope in the secant method; it limits the steps of the method."""
PASSES = 30
"""Largest number of solutions of one step; the next step corrects the remaining error."""


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

    Resistance to rolling and spinning acts on free wheels only. The engine has one friction limit for all directions
    together, so a wheel with rolling resistance would slip in turns. On driven wheels the resistance would only reduce
    the available torque.
    """

    _com = (0.0, 0.0, 0.0)

    def __init__(self, vehicle: VehicleSpec, drive: DriveOptions, physics: Physics) -> None:
        super().__init__(vehicle, drive, physics.time_step)
        self._urdf = physics_text(vehicle)
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

    # Quantities for probes

    def release_wheels(self) -> None:
        """Lets the drive wheels roll freely."""
        self._hold(drives=0.0, joints=0.0)

    def lock_joints(self) -> None:
        """Stops every joint and holds its angle."""
        self._velocity[self._joint_rates] = 0.0
        self._hold(drives=0.0, joints=LOCK)

    def set_gravity(self, gravity: Vector) -> None:
        """Sets the acceleration of gravity [m/s2]; `place` sets it pointing down."""
        self._model.opt.gravity[:] = gravity

    def set_velocity(self, x: float, y: float) -> None:
        """Sets the velocity of the chassis [m/s] and a yaw rate of zero; the joints keep their speeds."""
        self._velocity[:6] = x, y, 0.0, 0.0, 0.0, 0.0

    def set_swivel(self, angle: float, rate: float = 0.0) -> None:
        """See `VehiclePhysics.set_swivel`."""
        self._position[self._joint_angles[2::2]] = angle
        self._velocity[self._joint_rates[2::2]] = rate

    def twist(self, torque: float) -> None:
        """Applies a torque about the vertical to the chassis during the next physics step [N m]."""
        self._data.xfrc_applied[self._chassis, 5] = torque
        self._twisted = True

    def touching(self) -> bool:
        """Whether the chassis touches an obstacle or wall; it cannot touch anything else."""
        return len(self._contacts(self._chassis)) > 0

    def obstacle_force(self) -> float:
        """Normal force of obstacles and walls on the chassis, summed over all contacts [N]."""
        return self._contact_force(self._chassis).normal

    def wheel_forces(self) -> tuple[ContactForce, ...]:
        """Forces of the ground on the left and right wheel and on each caster."""
        return tuple(self._contact_force(wheel) for wheel in self._wheels)

    def wheel_speeds(self) -> tuple[float, float]:
        """Speeds of the left and right drive wheel [rad/s]."""
        left, right, *_ = self._velocity[self._joint_rates].tolist()
        return left, right

    def wheel_heights(self) -> tuple[float, ...]:
        """Heights of the centres of the left and right wheel and of each caster above the ground [m]."""
        mujoco.mj_kinematics(self._model, self._data)  # a step leaves the heights of its beginning
        return tuple(self._data.xpos[self._wheels, 2].tolist())

    def sample(self) -> Sample:
        """The vehicle at the present time."""
        angles = tuple(self._position[self._joint_angles].tolist())
        return Sample(self.time(), self.pose(), angles, self.wheel_speeds(), self.tilt())

    def link_dynamics(self) -> dict[str, LinkDynamics]:
        """Properties of every link in the engine, by the link's name."""
        links = np.flatnonzero(self._model.body_rootid == self._chassis)
        return {self._model.body(link).name: self._dynamics(link) for link in links.tolist()}

    # Construction

    def _build(self, world: WorldSpec, pose: Pose, speed: float, height: float, ground: bool) -> None:
        self._ground, self._twisted = ground, False
        self._commanded: list[float] = [0.0, 0.0]
        self._compile()
        self._hold(drives=0.0, joints=0.0)
        half, vehicle = pose.yaw / 2, self.vehicle
        self._position[:7] = pose.x, pose.y, vehicle.wheel_radius + height - SINK, cos(half), 0.0, 0.0, sin(half)
        self.set_velocity(speed * cos(pose.yaw), speed * sin(pose.yaw))
        rolling = speed / vehicle.wheel_radius
        casters = [rate for its in vehicle.casters if its.swivels for rate in (0.0, speed / its.radius)]
        self._velocity[self._joint_rates] = rolling, rolling, *casters
        mujoco.mj_kinematics(self._model, self._data)  # sets the positions of the geoms that rays meet

    def _load(self) -> None:
        """Compiles a model of what is near, and goes on in it with all of the state and what probes may have set."""
        model, data, drive_geoms = self._model, self._data, self._drive_geoms
        state = np.empty(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_INTEGRATION))
        mujoco.mj_getState(model, data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
        self._compile()
        mujoco.mj_setState(self._model, self._data, state, mujoco.mjtState.mjSTATE_INTEGRATION)
        self._model.opt.gravity[:] = model.opt.gravity
        self._model.tendon_frictionloss[:] = model.tendon_frictionloss
        self._model.dof_frictionloss[:] = model.dof_frictionloss
        self._model.geom_condim[self._drive_geoms] = model.geom_condim[drive_geoms]

    def _compile(self) -> None:
        """Makes a model of what is near with the vehicle in it, and finds the vehicle's parts in the model."""
        vehicle = self.vehicle
        model = self._model = self._compiled(self._shapes_in(self._near))
        data = self._data = mujoco.MjData(model)
        self._position, self._velocity, self._shafts = data.qpos, data.qvel, data.qvel[-2:]
        links = vehicle.links
        joints = [model.joint(name) for name in vehicle.joints.values()]
        self._joint_angles = [int(joint.qposadr[0]) for joint in joints]
        self._joint_rates = [int(joint.dofadr[0]) for joint in joints]
        self._chassis = int(model.body_rootid[model.body(links["left_drive"]).id])
        supports = links["left_drive"], links["right_drive"], *(its.link for its in vehicle.casters)
        self._wheels = [model.body(name).id for name in supports]
        self._drive_geoms = np.flatnonzero(np.isin(model.geom_bodyid, self._wheels[:2]))

    def _compiled(self, shapes: tuple[Shape, ...]) -> Any:
        """Compiles a model of obstacles and walls with the vehicle, ground and patrols.

        Raises:
            UserError: If the engine cannot take the URDF.
        """
        try:
            spec = mujoco.MjSpec.from_string(self._urdf)
            spec.compiler.fusestatic = False
            spec.worldbody.first_body().add_freejoint()
            _set_solver(spec, self.vehicle, self.time_step)
            _set_contacts(spec, self.vehicle)
            _add_clutches(spec, self.vehicle)
            if self._ground:
                plane = mujoco.mjtGeom.mjGEOM_PLANE
                spec.worldbody.add_geom(type=plane, size=[0.0, 0.0, 1.0], contype=0, conaffinity=WHEEL)
            _add_solids(spec, shapes, self._world.obstacle_height)
            _add_patrols(spec, self._world)
            return spec.compile()
        except ValueError as error:
            reason = " ".join(str(error).split())
            raise UserError(f"{self.vehicle.urdf}: MuJoCo cannot take this URDF: {reason}") from None

    def _hold(self, drives: float, joints: float) -> None:
        """Limits the torque of the clutches to `drives`, and the friction of every joint to `joints` [N m]."""
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
        """Solves the step again so that sliding contacts satisfy Coulomb's law.

        The normal acceleration of a sliding contact exceeds its reference by a lift (see `_compensate_lifts`). A
        reference that is lower by the lift compensates it: the change of variables of de Saxcé and Feng, The
        bipotential method, Mathematical and Computer Modelling 28 (1998). The lift depends on the compensation, so this
        iterates until both are equal.
        """
        model, data = self._model, self._data
        contact = data.contact
        rows, sizes, frictions = contact.efc_address, contact.dim, contact.friction
        references, reached = data.efc_aref.copy(), np.empty(data.nefc)
        lifts, last = np.zeros(len(rows)), np.zeros((len(rows), 2))
        for _ in range(PASSES):
            mujoco.mj_mulJacVec(model, data, reached, data.qacc)
            if _compensate_lifts(rows, sizes, frictions, references, reached, lifts, last, data.efc_aref):
                break
            mujoco.mj_fwdConstraint(model, data)

    def _frame(self) -> tuple[Vector, Quaternion]:
        x, y, z, qw, qx, qy, qz = self._position[:7].tolist()
        return (x, y, z), (qx, qy, qz, qw)

    def _velocities(self) -> tuple[Vector, Vector]:
        angular = np.empty(3)
        mujoco.mju_rotVecQuat(angular, self._velocity[3:6], self._position[3:7])  # given in the chassis's axes
        (vx, vy, vz), (wx, wy, wz) = self._velocity[:3].tolist(), angular.tolist()
        return (vx, vy, vz), (wx, wy, wz)

    def _cast(self, begins: Array, ends: Array) -> Array:
        if len(self._tracks):
            mujoco.mj_kinematics(self._model, self._data)  # a step leaves the patrols of its beginning
        count, furthest = len(begins), self.vehicle.sensor.range
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
        """Finds the contacts of the last step with a link."""
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
        moments[np.argmax(np.abs(axes.reshape(3, 3)), axis=0)] = model.body_inertia[link]  # the engine sorts them
        ix, iy, iz = moments.tolist()
        friction = spinning = rolling = 0.0
        if model.body_geomnum[link]:
            friction, spinning, rolling = model.geom_friction[model.body_geomadr[link]].tolist()
        return LinkDynamics(float(model.body_mass[link]), (ix, iy, iz), friction, rolling, spinning)


def _hard(damping: float, time_step: float) -> list[float]:
    """Returns the engine's `solref` for a constraint with a damping ratio."""
    return [CONSTRAINT_STEPS * time_step, damping]


def _set_solver(spec: Any, vehicle: VehicleSpec, time_step: float) -> None:
    spec.option.timestep = time_step
    spec.option.gravity = [0.0, 0.0, -GRAVITY]
    # The solver stops when a round gains less energy than this; that of a small vehicle goes with its lengths as k^5.
    spec.option.tolerance *= min(length_scale(vehicle.footprint), 1.0) ** 5
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC  # friction is the same in all directions
    spec.option.disableflags = mujoco.mjtDisableBit.mjDSBL_ISLAND  # `_let_slide` works without; there is only one


def _set_contacts(spec: Any, vehicle: VehicleSpec) -> None:
    """Sets the contacts of the vehicle's geoms; their values take priority over those of other geoms."""
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
    resistance = [contact.spinning_friction, contact.rolling_friction]
    frictions = {vehicle.links[field]: [contact.wheel_friction, *resistance] for field in ("left_drive", "right_drive")}
    for its in vehicle.casters:
        frictions[its.link] = [contact.wheel_friction if its.swivels else contact.ball_friction, 0.0, 0.0]
    for link, friction in frictions.items():
        for geom in spec.body(link).geoms:
            geom.contype = WHEEL
            geom.friction = friction
    for its in vehicle.casters if len(vehicle.casters) > 1 else ():
        for geom in [] if its.swivels else spec.body(its.link).geoms:
            geom.solimp[:2] = SLIDING_IMPEDANCE


def _add_clutches(spec: Any, vehicle: VehicleSpec) -> None:
    """Adds a shaft for each drive wheel, as the last joints, and the friction between them; sets friction of joints."""
    friction = {"solref_friction": _hard(1.0, spec.option.timestep)}
    for wheel in (vehicle.joints["left_drive"], vehicle.joints["right_drive"]):
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


def _add_solids(spec: Any, solids: tuple[Shape, ...], height: float) -> None:
    for solid in solids:
        _add_solid(spec.worldbody, solid, height / 2, pos=[solid.x, solid.y, height / 2])


def _add_patrols(spec: Any, world: WorldSpec) -> None:
    """Adds bodies that are moved from outside. The engine ignores their velocity; only their depth affects a hit."""
    half_height = world.obstacle_height / 2
    for patrol in world.patrols:
        body = spec.worldbody.add_body(mocap=True, pos=[patrol.box.x, patrol.box.y, half_height])
        _add_solid(body, patrol.box, half_height, pos=[0.0, 0.0, 0.0])


def _add_solid(body: Any, solid: Shape, half_height: float, pos: list[float]) -> None:
    """Adds a box or an upright cylinder to a body, with the contacts of an obstacle."""
    if isinstance(solid, Circle):
        kind, size, yaw = mujoco.mjtGeom.mjGEOM_CYLINDER, [solid.radius, half_height, 0.0], 0.0
    else:
        kind, size, yaw = mujoco.mjtGeom.mjGEOM_BOX, [solid.half_length, solid.half_width, half_height], solid.yaw
    body.add_geom(
        type=kind,
        size=size,
        pos=pos,
        quat=[cos(yaw / 2), 0.0, 0.0, sin(yaw / 2)],
        contype=0,
        conaffinity=CHASSIS,
        group=OBSTACLE,
    )


@njit()
def _slides(rows: NDArray[np.int32], sizes: NDArray[np.int32], frictions: Array, forces: Array) -> bool:
    """Whether any contact uses all available friction, in all its directions together.

    Args:
        rows: First row of each contact in the solver: its normal; its rows of friction follow (n,).
        sizes: Number of rows of each contact (n,).
        frictions: Coefficients of the rows after the first (n, 5) [1, m].
        forces: Forces of all rows [N, N m].
    """
    for contact in range(len(rows)):
        row, used = rows[contact], 0.0
        for k in range(1, sizes[contact]):
            used += (forces[row + k] / frictions[contact, k - 1]) ** 2
        if row >= 0 and used > 0.0 and sqrt(used) >= SLIDES * forces[row]:
            return True
    return False


@njit()
def _compensate_lifts(
    rows: NDArray[np.int32],
    sizes: NDArray[np.int32],
    frictions: Array,
    references: Array,
    reached: Array,
    lifts: Array,
    last: Array,
    asked: Array,
) -> bool:
    """Compensates the lifts of contacts by one step of the secant method for each contact.

    The lift of a contact is the norm, over its rows of friction, of coefficient times missing acceleration: that which
    would end the sliding within the step. The lift grows with its compensation, but more slowly; the method finds where
    both are equal.

    Args:
        rows: See `_slides`.
        sizes: See `_slides`.
        frictions: See `_slides`.
        references: Wanted accelerations of all rows [m/s2, rad/s2].
        reached: Accelerations that the solver reached [m/s2, rad/s2].
        lifts: Lifts compensated so far (n,) [m/s2]; updated.
        last: Lifts compensated before that, and by how much the resulting ones exceeded them (n, 2) [m/s2]; updated.
        asked: `references` less the lifts; updated.

    Returns:
        Whether the resulting lifts equal the compensated ones.
    """
    agreed = True
    for contact in range(len(rows)):
        row, lift = rows[contact], 0.0
        if row < 0:  # the solver excludes this contact
            continue
        for k in range(1, sizes[contact]):
            lift += (frictions[contact, k - 1] * (reached[row + k] - references[row + k])) ** 2
        lift = sqrt(lift)
        more, before, more_before = lift - lifts[contact], last[contact, 0], last[contact, 1]
        agreed = agreed and abs(more) <= AGREEMENT
        slope = -1.0
        if lifts[contact] != before:
            slope = min(max((more - more_before) / (lifts[contact] - before), -1.0), LARGEST_SLOPE)
        last[contact, 0], last[contact, 1] = lifts[contact], more
        lifts[contact] = max(lifts[contact] - more / slope, 0.0)
        asked[row] = references[row] - lifts[contact]
    return agreed
