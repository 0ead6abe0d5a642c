"""Mesh files: their triangles in metres, and nothing else that they name."""

import os
import struct
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
import trimesh

from nnql_bullet.errors import UserError
from nnql_bullet.vehicle.description import MOST_SHAPES, read
from nnql_bullet.vehicle.shapes import MOST_MESH_BYTES, read_mesh

BOX = trimesh.creation.box((0.5, 0.3, 0.1))
STL: bytes = BOX.export(file_type="stl")
OBJ = BOX.export(file_type="obj").encode()
BOMB = "".join(f'<!ENTITY a{i} "{f"&a{i - 1};" * 10}">' for i in range(1, 10))
GLTF = b"""{"asset": {"version": "2.0"}, "buffers": [{"uri": "pipe", "byteLength": 36}], "scene": 0,
"bufferViews": [{"buffer": 0, "byteLength": 36}], "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
"accessors": [{"bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3"}],
"meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}]}"""


def collada(unit: str = "", before: str = "") -> bytes:
    pytest.importorskip("collada")
    exported: bytes = BOX.export(file_type="dae")
    text = exported.decode().partition("<COLLADA")[2].replace("<asset>", f"<asset>{unit}", 1)
    return f"{before}<COLLADA{text}".encode()


@pytest.mark.parametrize(
    ("name", "content", "factor"),
    [
        ("box.stl", lambda: STL, 1),
        ("BOX.STL", lambda: STL, 1),
        ("box.obj", lambda: OBJ, 1),
        ("names_a_pipe_as_material.obj", lambda: b"mtllib pipe\nmtllib /dev/zero\nusemtl a\n" + OBJ, 1),
        ("inches.dae", lambda: collada('<unit name="inch" meter="0.0254"/>'), 0.0254),
    ],
)
def test_the_triangles_are_read_and_no_other_file(
    tmp_path: Path, name: str, content: Callable[[], bytes], factor: float
) -> None:
    os.mkfifo(tmp_path / "pipe")  # to open it would wait for ever
    (tmp_path / name).write_bytes(content())
    mesh = read_mesh(tmp_path / name)
    assert mesh.extents == pytest.approx([0.5 * factor, 0.3 * factor, 0.1 * factor])
    assert mesh.volume == pytest.approx(0.015 * factor**3)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("more_than_there_is.stl", lambda: STL[:80] + struct.pack("<I", 0xFFFFFFFF) + STL[84:]),
        ("not_a_number.stl", lambda: STL.replace(STL[96:100], struct.pack("<f", float("nan")))),
        ("empty.stl", lambda: b""),
        ("far_faces.obj", lambda: b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 99999999999\n"),
        ("entities.dae", lambda: collada(before=f'<!DOCTYPE x [<!ENTITY a0 "aaaaaaaaaa">{BOMB}]>')),
        ("names_a_pipe.dae", lambda: collada(before='<!DOCTYPE x SYSTEM "pipe">')),
        *((f"unit_{k}.dae", lambda k=k: collada(f'<unit meter="{k}"/>')) for k in ("0", "-1", "nan", "1e999", "...")),
        ("names_a_pipe.gltf", lambda: GLTF),
        ("no_mesh.txt", lambda: STL),
    ],
)
def test_what_is_no_mesh_is_not_read(tmp_path: Path, name: str, content: Callable[[], bytes]) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / name).write_bytes(content())
    assert read_mesh(tmp_path / name) is None


def test_archives_are_not_unpacked(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "box.zip", "w") as archive:
        archive.writestr("box.stl", STL)
    assert read_mesh(tmp_path / "box.zip") is None


def test_huge_ones_are_not_read(tmp_path: Path) -> None:
    with (tmp_path / "huge.stl").open("wb") as file:
        file.write(STL)
        file.truncate(MOST_MESH_BYTES + 1)
    assert read_mesh(tmp_path / "huge.stl") is None


def test_more_shapes_than_a_robot_has_are_refused(tmp_path: Path) -> None:
    shape = '<collision><geometry><sphere radius="1"/></geometry></collision>'
    (tmp_path / "many.urdf").write_text(f'<robot><link name="a">{shape * (MOST_SHAPES + 1)}</link></robot>')
    with pytest.raises(UserError, match=f"it has {MOST_SHAPES + 1} shapes; up to {MOST_SHAPES} are taken"):
        read(tmp_path / "many.urdf")
