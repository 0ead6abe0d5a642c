"""Xacros are expanded as ROS does it, and cannot reach beyond that."""

import sys
from collections.abc import Callable
from pathlib import Path

import pytest

from nnql_bullet.errors import UserError
from nnql_bullet.vehicle.translation import read_robot

pytest.importorskip("xacrodoc")

HEAD = '<robot name="mine" xmlns:xacro="http://www.ros.org/wiki/xacro">'
MACROS = f"""{HEAD}
<xacro:property name="half" value="${{0.3 / 2}}"/>
<xacro:macro name="inertial" params="mass:=1 *more">
  <inertial><mass value="${{mass}}"/><inertia ixx="${{mass / 100}}" ixy="0" ixz="0" iyy="${{mass / 100}}" iyz="0"
  izz="${{mass / 100}}"/><xacro:insert_block name="more"/></inertial>
</xacro:macro>
<xacro:macro name="wheel" params="name side radius">
  <link name="${{name}}"><xacro:inertial mass="0.5"><origin/></xacro:inertial>
    <collision><geometry><cylinder radius="${{radius}}" length="0.04"/></geometry></collision></link>
  <joint name="${{name}}_joint" type="continuous"><parent link="base"/><child link="${{name}}"/>
    <origin xyz="0 ${{side * half}} ${{radius}}" rpy="${{-pi / 2}} 0 0"/><axis xyz="0 0 1"/></joint>
</xacro:macro>
</robot>"""
ROBOT = f"""{HEAD}
<xacro:arg name="radius" default="0.1"/>
<xacro:arg name="mast" default="false"/>
<xacro:include filename="$(find mine_description)/urdf/macros.xacro"/>
<link name="base"><xacro:inertial mass="10"><origin xyz="0.1 0 0.2"/></xacro:inertial>
  <collision><origin xyz="0.1 0 0.2"/><geometry><box size="0.5 0.3 0.1"/></geometry></collision></link>
<xacro:wheel name="left" side="1" radius="$(arg radius)"/>
<xacro:wheel name="right" side="-1" radius="$(arg radius)"/>
<link name="caster"><xacro:inertial mass="0.1"><origin/></xacro:inertial>
  <collision><geometry><sphere radius="0.05"/></geometry></collision></link>
<joint name="c" type="fixed"><parent link="base"/><child link="caster"/><origin xyz="0.25 0 0.05"/></joint>
<xacro:if value="$(arg mast)"><link name="mast"><xacro:inertial mass="2"><origin/></xacro:inertial></link>
<joint name="m" type="fixed"><parent link="base"/><child link="mast"/><origin xyz="0.1 0 0.5"/></joint></xacro:if>
</robot>"""


@pytest.fixture
def described(tmp_path: Path) -> Callable[..., Path]:
    """Writes a package with a robot as ROS packages have it; returns the robot's file."""

    def write(robot: str = ROBOT, macros: str = MACROS) -> Path:
        folder = tmp_path / "mine_description" / "urdf"
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "macros.xacro").write_text(macros)
        (folder / "mine.urdf.xacro").write_text(robot)
        return folder / "mine.urdf.xacro"

    return write


def test_macros_includes_packages_and_arguments(described: Callable[..., Path]) -> None:
    vehicle = read_robot(described()).vehicle
    assert (vehicle.track, vehicle.wheel_radius, vehicle.mass) == pytest.approx((0.3, 0.1, 11.1))
    assert vehicle.casters[0].x == pytest.approx(0.25)
    other = read_robot(described(), {"radius": "0.11", "mast": "true"}).vehicle
    assert (other.wheel_radius, other.mass) == pytest.approx((0.11, 13.1))


def test_relative_includes_begin_in_the_folder_of_the_file_that_has_them(described: Callable[..., Path]) -> None:
    robot = described(ROBOT.replace("$(find mine_description)/urdf/macros.xacro", "parts/all.xacro"))
    (robot.parent / "parts").mkdir()
    (robot.parent / "parts" / "all.xacro").write_text(f'{HEAD}<xacro:include filename="../macros.xacro"/></robot>')
    assert read_robot(robot).vehicle.track == pytest.approx(0.3)


def test_a_package_beside_its_own_is_found(described: Callable[..., Path], tmp_path: Path) -> None:
    robot = described(ROBOT.replace("mine_description)/urdf", "mine_macros)"))
    (tmp_path / "mine_macros").mkdir()
    (tmp_path / "mine_macros" / "macros.xacro").write_text(MACROS)
    assert read_robot(robot).vehicle.track == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("find mine_description", "find nowhere", "package 'nowhere' is not found; put its folder beside"),
        ("urdf/macros.xacro", "urdf/other.xacro", r"other\.xacro"),
        ("xacro:wheel name", "xacro:whel name", "whel"),
        ('<xacro:arg name="radius" default="0.1"/>', "", "radius"),
        ("$(arg radius)", "${radius * 2}", "radius"),
        ("0.1 0 0.5", "${1 / 0}", ""),
        ("</robot>", "", ""),
        ('side="1"', 'side="${[x for x in [().__class__]]}"', "uses __class__"),
        ('side="1"', 'side="${(lambda: ().__class__)()}"', "uses __class__"),
        ('side="1"', "side=\"${python['va' + 'rs'](1)}\"", "uses python"),
        ('side="1"', 'side="${python.type(1)}"', "uses type"),
        ('side="1"', 'side="${(x for x in []).gi_frame}"', "uses gi_frame"),
    ],
)
def test_what_cannot_be_expanded_is_refused_in_one_line(
    described: Callable[..., Path], old: str, new: str, message: str, capfd: pytest.CaptureFixture[str]
) -> None:
    path = described(ROBOT.replace(old, new))
    with pytest.raises(UserError, match=rf"^{path}: xacro cannot expand it: .*{message}") as told:
        read_robot(path, {"mast": "true"})
    assert "\n" not in str(told.value)
    assert capfd.readouterr() == ("", "")


def test_nothing_of_xacro_stays_changed(described: Callable[..., Path]) -> None:
    import xacro
    from xacrodoc import packages

    before = packages._finder, xacro.safe_eval, sys.stderr
    read_robot(described())
    with pytest.raises(UserError):
        read_robot(described(ROBOT.replace("whe", "hwe")))
    assert (packages._finder, xacro.safe_eval, sys.stderr) == before


def test_what_xacro_warns_of_is_noted(described: Callable[..., Path]) -> None:
    warned = ROBOT.replace('<link name="base">', '${xacro.warning("old file")}<link name="base">')
    assert any("old file" in note for note in read_robot(described(warned)).notes)


def test_the_verb_takes_arguments(described: Callable[..., Path], run_cli: Callable[..., tuple[int, str, str]]) -> None:
    path = described()
    code, out, _ = run_cli("robot", path, "--arg", "radius:=0.11", "mast:=true")
    assert code == 0 and "0.11 m" in out
    assert run_cli("robot", path, "--arg", "radius=0.11")[::2] == (
        2,
        "nnql-bullet: --arg: give NAME:=VALUE, not 'radius=0.11'\n",
    )
    path.with_suffix("").write_text("<robot/>")
    assert run_cli("robot", path.with_suffix(""), "--arg", "a:=1")[0] == 2


def test_without_xacrodoc_the_extra_is_named(described: Callable[..., Path], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "xacrodoc", None)
    with pytest.raises(UserError, match=r"pip install 'nnql-bullet\[robots\]'"):
        read_robot(described())
