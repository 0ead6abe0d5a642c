"""What a vehicle looks like, against what PyBullet makes of the same URDF."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pybullet
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Pose
from nnql_bullet.vehicle.payload import urdf_text
from nnql_bullet.vehicle.spec import Payload, VehicleSpec
from nnql_bullet.vehicle.visuals import UNPAINTED, Visuals, recorded_urdf, upright

ANGLES = (0.7, -1.9, 2.5, 0.4)  # left and right drive, swivel, caster roll
KINDS = {pybullet.GEOM_BOX: "box", pybullet.GEOM_CYLINDER: "cylinder", pybullet.GEOM_SPHERE: "sphere"}


def said_of(vehicle: VehicleSpec) -> dict[str, Any]:
    """What recordings say."""
    return {"urdf": urdf_text(vehicle), "joints": vehicle.joints, "wheel_radius": vehicle.wheel_radius}


@pytest.fixture(scope="module")
def visuals(vehicle: VehicleSpec) -> Visuals:
    return Visuals(said_of(vehicle))


def test_links_are_where_pybullet_has_them(vehicle: VehicleSpec, visuals: Visuals) -> None:
    client = pybullet.connect(pybullet.DIRECT)
    body = pybullet.loadURDF(str(vehicle.urdf), useFixedBase=True, physicsClientId=client)
    infos = [pybullet.getJointInfo(body, joint, client) for joint in range(pybullet.getNumJoints(body, client))]
    angles = dict(zip(said_of(vehicle)["joints"].values(), ANGLES, strict=True))
    for info in infos:
        pybullet.resetJointState(body, info[0], angles[info[1].decode()], physicsClientId=client)
    frames = visuals.link_frames(ANGLES)
    assert len(infos) == 4
    for info in infos:
        state = pybullet.getLinkState(body, info[0], computeForwardKinematics=True, physicsClientId=client)
        frame = frames[info[12].decode()]
        assert frame[:3, 3] == pytest.approx(state[4], abs=1e-6)
        assert frame[:3, :3] == pytest.approx(Rotation.from_quat(state[5]).as_matrix(), abs=1e-6)
    pybullet.disconnect(client)


def test_shapes_are_those_that_pybullet_draws(vehicle: VehicleSpec, visuals: Visuals) -> None:
    client = pybullet.connect(pybullet.DIRECT)
    body = pybullet.loadURDF(str(vehicle.urdf), useFixedBase=True, physicsClientId=client)
    drawn = pybullet.getVisualShapeData(body, physicsClientId=client)
    pybullet.disconnect(client)
    assert len(drawn) == len(visuals.shapes) == 20
    theirs = sorted((KINDS[shape[2]], *np.round(shape[7][:3], 3)) for shape in drawn)
    assert sorted((shape.kind, *np.round(shape.colour, 3)) for shape in visuals.shapes) == theirs
    deck = max((shape for shape in visuals.shapes if shape.kind == "box"), key=lambda shape: shape.half_sizes[0])
    assert deck.half_sizes == pytest.approx((0.53, 0.30, 0.015))
    assert deck.origin[:3, 3] == pytest.approx((0.35, 0.0, 0.245))
    tyre = next(shape for shape in visuals.shapes if shape.link == "left_wheel")
    assert (tyre.kind, tyre.half_sizes) == ("cylinder", pytest.approx((0.125, 0.125, 0.025)))


def test_on_the_ground_each_shape_stands_in_its_link(visuals: Visuals) -> None:
    pose = Pose(3.0, -2.0, 0.8)
    links, chassis = visuals.link_frames(ANGLES), upright(3.0, -2.0, 0.125, 0.8)
    for shape, frame in zip(visuals.shapes, visuals.frames(pose, ANGLES), strict=True):
        assert np.linalg.inv(chassis) @ frame == pytest.approx(links[shape.link] @ shape.origin)
    assert upright(3.0, -2.0, 0.125, 0.8) @ (1.0, 0.0, 0.0, 1.0) == pytest.approx(
        (3.0 + np.cos(0.8), -2.0 + np.sin(0.8), 0.125, 1.0)
    )


def test_a_payload_is_seen(vehicle: VehicleSpec, visuals: Visuals) -> None:
    loaded = Visuals(said_of(replace(vehicle, payload=Payload(mass=40.0, ahead=0.35, height=0.6))))
    (cube,) = [shape for shape in loaded.shapes if shape.link not in {other.link for other in visuals.shapes}]
    assert (cube.kind, cube.half_sizes) == ("box", pytest.approx((0.2, 0.2, 0.2)))
    (place,) = [
        frame[:3, 3]
        for shape, frame in zip(loaded.shapes, loaded.frames(Pose(0.0, 0.0, 0.0), (0.0,) * 4), strict=True)
        if shape is cube
    ]
    assert place == pytest.approx((0.35, 0.0, 0.6))


def test_what_has_no_colour_is_grey(vehicle: VehicleSpec) -> None:
    said = said_of(vehicle)
    bare = Visuals({**said, "urdf": said["urdf"].replace('<material name="light" />', "")})
    assert sum(shape.colour == UNPAINTED for shape in bare.shapes) == 2


def test_a_recording_that_does_not_say_is_refused() -> None:
    with pytest.raises(UserError, match="record it again"):
        Visuals({"name": "tricycle"})


def with_mesh(file: object) -> dict[str, Any]:
    """A recording's vehicle: a body with the look of a mesh and the collision shape of a box."""
    body = (
        '<link name="body"><inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" izz="1"/>'
        f'</inertial><visual><geometry><mesh filename="{file}" scale="2 1 1"/></geometry></visual>'
        '<collision><geometry><box size="1 1 1"/></geometry></collision></link>'
    )
    return {"urdf": f'<robot name="m">{body}</robot>'}


def test_a_mesh_that_is_found_is_drawn_scaled_and_anything_else_is_not_opened(tmp_path: Path) -> None:
    drawn = tmp_path / "drawn"
    drawn.mkdir()
    trimesh.creation.box([0.2, 0.4, 0.6]).export(tmp_path / "body.stl")
    (tmp_path / "text.stl").write_text("solid")
    assert "obj" in (shown := recorded_urdf(with_mesh(tmp_path / "body.stl"), drawn))
    (file,) = drawn.iterdir()
    assert str(file) in shown and "scale" not in shown
    assert trimesh.load(file, force="mesh").extents == pytest.approx([0.4, 0.4, 0.6])
    for name in ("body.stl", tmp_path / "lost.stl", tmp_path / "text.stl", "/etc/passwd", tmp_path):
        shown = recorded_urdf(with_mesh(name), drawn)
        assert 'box size="1 1 1"' in shown and "mesh" not in shown
    assert "mesh" not in recorded_urdf(with_mesh(tmp_path / "body.stl"))
