"""Recordings on a time line: the file is read back, and holds what the recording holds, when it happened."""

import builtins
import sys
from collections.abc import Callable
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from nnql_bullet.geometry import OrientedBox, Pose, as_rows, ray_distances
from nnql_bullet.recording import Recording
from nnql_bullet.sensing import ray_angles
from nnql_bullet.worlds.spec import Patrol

NEEDS_RERUN = pytest.mark.skipif(find_spec("rerun") is None, reason="needs the extra: pip install 'nnql-bullet[viz]'")

STEPS, SAMPLES = 6, 15
ROBOTS = Path(__file__).resolve().parents[1] / "robots"
Cli = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def drive() -> Recording:
    """Six decisions of half a second along a quarter of a circle past one box, made up; it ends at a wall."""
    rng = np.random.default_rng(3)
    state_time = 0.5 * np.arange(STEPS + 1)
    sample_time = np.arange(1, STEPS * SAMPLES + 1) / (2 * SAMPLES)

    def poses(times: NDArray[np.float64]) -> NDArray[np.float64]:
        angle = times / state_time[-1] * np.pi / 2
        return np.column_stack([5.0 + 4.0 * np.sin(angle), 9.0 - 4.0 * np.cos(angle), angle])

    box = OrientedBox(12.0, 6.0, 1.0, 2.0, 0.3)
    row = as_rows([box])
    state_pose = poses(state_time)
    rays = np.array(
        [
            ray_distances((x + 0.35 * np.cos(yaw), y + 0.35 * np.sin(yaw)), ray_angles() + yaw, row, 10.0)
            for x, y, yaw in state_pose
        ]
    )
    asked = np.array([False, True, True, False, True, False])
    return Recording(
        about={
            "policy": "script",
            "ending": "collision",
            "vehicle": {
                "name": "tricycle",
                "footprint": {"x": 0.35, "y": 0.0, "half_length": 0.55, "half_width": 0.325, "yaw": 0.0},
                "sensor": [0.35, 0.0, 0.475],
            },
            "world": {
                "name": "test",
                "seed": 7,
                "width": 20.0,
                "depth": 18.0,
                "obstacles": [{"x": 12.0, "y": 6.0, "half_length": 1.0, "half_width": 2.0, "yaw": 0.3}],
                "start": {"x": 5.0, "y": 5.0, "yaw": 0.0},
                "target": [17.0, 16.0],
                "target_radius": 2.0,
                "obstacle_height": 1.5,
                "patrols": [
                    {
                        "box": {"x": 2.0, "y": 10.0, "half_length": 0.8, "half_width": 0.5, "yaw": 0.4},
                        "end": [2.0, 14.0],
                        "speed": 0.8,
                        "phase": 0.25,
                    }
                ],
            },
        },
        state_time=state_time,
        state_pose=state_pose,
        readings=rays.reshape(STEPS + 1, 8, 9).min(axis=2),
        ray_distances=rays,
        state_property=np.array(["SS", "NS", "NS", "SS", "NS", "SS", "FS"]),
        q_values=np.where(asked[:, None], rng.normal(size=(STEPS, 5)), np.nan),
        overridden=np.array([False, True, False, False, True, True]),
        action=np.array([5, 1, 0, 5, 8, 11]),
        heading_command=rng.normal(size=STEPS),
        heading_error=rng.normal(size=STEPS),
        clearance=rng.uniform(size=STEPS),
        contact=np.array([False] * (STEPS - 1) + [True]),
        reward_terms=rng.normal(size=(STEPS, 6)),
        sample_time=sample_time,
        sample_pose=poses(sample_time),
        joint_angles=np.zeros((STEPS * SAMPLES, 4)),
        wheel_speeds=rng.normal(size=(STEPS * SAMPLES, 2)),
    )


class File:
    """What an .rrd file holds, by entity and component."""

    def __init__(self, path: Path) -> None:
        from rerun.chunk import RrdReader

        reader = RrdReader(path)
        self.recordings, self.blueprints = reader.recordings(), reader.blueprints()
        self._chunks = [(chunk.entity_path, chunk.to_record_batch()) for chunk in reader.stream().to_chunks()]

    @property
    def columns(self) -> dict[tuple[str, str], list[Any]]:
        """Every column but the row numbers, which are drawn by chance; how rows are packed is left to chance too."""
        found: dict[tuple[str, str], list[Any]] = {}
        for entity, batch in self._chunks:
            for name in batch.schema.names:
                if name != "rerun.controls.RowId":
                    values = batch.column(name)  # times are nanoseconds, which Python's durations are too coarse for
                    values = values.cast("int64") if str(values.type).startswith("duration") else values
                    found.setdefault((entity, name), []).extend(values.to_pylist())
        return {key: sorted(rows, key=repr) for key, rows in sorted(found.items())}

    def rows(self, entity: str, component: str, timeline: str = "time") -> tuple[NDArray[np.float64], list[Any]]:
        """When, in seconds or decisions and in order, an entity has which batches of a component."""
        pairs: list[tuple[float, Any]] = []
        for at, batch in self._chunks:
            if at == entity and {component, timeline} <= set(batch.schema.names):
                times = batch.column(timeline).cast("int64").to_numpy()
                pairs += zip(times.tolist(), batch.column(component).to_pylist(), strict=True)
        pairs.sort(key=lambda pair: pair[0])
        times = np.array([time for time, _ in pairs], dtype=np.float64)
        return times / (1e9 if timeline == "time" else 1), [value for _, value in pairs]

    def static(self, entity: str, component: str) -> Any:
        """What an entity has all the time."""
        (found,) = (
            batch.column(component).to_pylist()[0]
            for at, batch in self._chunks
            if at == entity and component in batch.schema.names and "time" not in batch.schema.names
        )
        return found

    def check(
        self, entity: str, times: NDArray[np.float64], values: NDArray[np.float64], component: str = "Scalars:scalars"
    ) -> None:
        """An entity has these values at these times, to the nanosecond, NaN for NaN."""
        there, found = self.rows(entity, component)
        np.testing.assert_allclose(there, times, rtol=0, atol=0.6e-9)
        np.testing.assert_array_equal(np.array(found, dtype=np.float64).reshape(values.shape), values)


@pytest.fixture(scope="module")
def written(drive: Recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    from nnql_bullet.reports.rrd import write_rrd

    path = tmp_path_factory.mktemp("rerun") / "drive.rrd"
    write_rrd(drive, path)
    return path


@pytest.fixture(scope="module")
def file(written: Path) -> File:
    return File(written)


@NEEDS_RERUN
class TestFile:
    def test_numbers_are_those_of_the_recording_when_they_happened(self, file: File, drive: Recording) -> None:
        begins, ends = drive.state_time[:-1], drive.state_time[1:]
        file.check("/readings", drive.state_time, drive.readings)
        file.check("/heading_command", begins, drive.heading_command)
        file.check("/heading_error", ends, drive.heading_error)
        file.check("/clearance", ends, drive.clearance)
        file.check("/reward", ends, drive.reward_terms)
        file.check("/wheel_speeds", drive.sample_time, drive.wheel_speeds)

    def test_action_values_have_gaps_where_the_agent_did_not_ask(self, file: File, drive: Recording) -> None:
        file.check("/q_values", drive.state_time[:-1], drive.q_values)
        assert np.isnan(drive.q_values).all(axis=1).tolist() == [True, False, False, True, False, True]
        assert file.static("/q_values", "SeriesPoints:names") == [
            "straight on",
            "left 30°",
            "left 60°",
            "right 30°",
            "right 60°",
        ]

    def test_what_belongs_to_states_also_has_the_number_of_the_decision(self, file: File) -> None:
        for entity, component, numbers in (
            ("/readings", "Scalars:scalars", range(STEPS + 1)),
            ("/q_values", "Scalars:scalars", range(STEPS)),
            ("/clearance", "Scalars:scalars", range(1, STEPS + 1)),
            ("/world/vehicle", "Transform3D:translation", range(STEPS + 1)),
            ("/world/rays", "LineStrips3D:strips", range(STEPS + 1)),
        ):
            assert file.rows(entity, component, "decision")[0].tolist() == list(numbers), entity

    def test_the_vehicle_is_where_it_was(self, file: File, drive: Recording) -> None:
        for timeline, poses in (
            ("decision", drive.state_pose),
            ("time", np.concatenate([drive.state_pose, drive.sample_pose])),
        ):
            when, places = file.rows("/world/vehicle", "Transform3D:translation", timeline)
            _, turns = file.rows("/world/vehicle", "Transform3D:quaternion", timeline)
            if timeline == "time":
                order = np.argsort(np.concatenate([drive.state_time, drive.sample_time]), kind="stable")
                poses = poses[order]
                assert len(when) == STEPS + 1 + STEPS * SAMPLES
            found = np.array(places).reshape(-1, 3)
            assert found == pytest.approx(np.column_stack([poses[:, :2], np.zeros(len(poses))]), abs=1e-5)
            x, y, z, w = np.array(turns).reshape(-1, 4).T
            assert (x == 0).all()
            assert (y == 0).all()
            assert 2 * np.arctan2(z, w) == pytest.approx(poses[:, 2], abs=1e-6)

    def test_rays_end_on_the_box_and_are_coloured_by_whether_they_meet_it(self, file: File, drive: Recording) -> None:
        when, strips = file.rows("/world/rays", "LineStrips3D:strips")
        _, colours = file.rows("/world/rays", "LineStrips3D:colors")
        assert when == pytest.approx(drive.state_time)
        ends = np.array(strips)[:, :, 1]
        met = drive.ray_distances < 10.0
        assert met.any(axis=1).all()
        box = drive.obstacles[0]
        c, s = np.cos(box.yaw), np.sin(box.yaw)
        local = (ends[met][:, :2] - (box.x, box.y)) @ np.array([[c, -s], [s, c]])
        outside = np.max(np.abs(local) - (box.half_length, box.half_width), axis=1)
        assert outside == pytest.approx(0.0, abs=1e-5)
        assert ends[..., 2] == pytest.approx(0.475)
        hit, none = set(np.array(colours)[met].tolist()), set(np.array(colours)[~met].tolist())
        assert (len(hit), len(none), hit & none) == (1, 1, set())

    def test_sectors_reach_as_far_as_they_read(self, file: File, drive: Recording) -> None:
        _, strips = file.rows("/world/sectors", "LineStrips3D:strips")
        arcs = np.array(strips)[..., :2]
        yaw = drive.state_pose[:, 2]
        sensor = drive.state_pose[:, :2] + 0.35 * np.column_stack([np.cos(yaw), np.sin(yaw)])
        along = arcs - sensor[:, None, None]
        assert np.hypot(along[..., 0], along[..., 1]).mean(axis=2) == pytest.approx(drive.readings, abs=1e-5)
        middle = along.mean(axis=2)
        ahead = np.arctan2(middle[..., 1], middle[..., 0]) - yaw[:, None]
        off = ahead - np.radians(45.0 * np.arange(8))
        assert np.cos(off) == pytest.approx(1.0, abs=1e-9)

    def test_the_world_is_there_and_what_moves_moves(self, file: File, drive: Recording) -> None:
        assert file.static("/world/boxes", "Boxes3D:centers") == [pytest.approx([12.0, 6.0, 0.75])]
        assert file.static("/world/boxes", "Boxes3D:half_sizes") == [pytest.approx([1.0, 2.0, 0.75])]
        assert np.array(file.static("/world/walls", "Boxes3D:centers"))[:, :2] == pytest.approx(
            np.array([(10.0, -0.5), (10.0, 18.5), (-0.5, 9.0), (20.5, 9.0)])
        )
        assert file.static("/world/target", "Cylinders3D:centers") == [[17.0, 16.0, 0.0]]
        assert file.static("/world/patrols/0", "Boxes3D:half_sizes") == [pytest.approx([0.8, 0.5, 0.75])]
        when, places = file.rows("/world/patrols/0", "Transform3D:translation")
        assert when == pytest.approx(np.append(0.0, drive.sample_time))
        # By hand: half-way at first, at the far end after 2.5 s, on the way back at 3 s.
        found = np.array(places).reshape(-1, 3)
        assert found[[0, 75, 90]] == pytest.approx(np.array([(2.0, 12.0, 0.0), (2.0, 14.0, 0.0), (2.0, 13.6, 0.0)]))

    def test_properties_and_actions_in_words(self, file: File, drive: Recording) -> None:
        when, states = file.rows("/property", "StateChange:state")
        assert when == pytest.approx(drive.state_time)
        assert [state for (state,) in states] == drive.state_property.tolist()
        _, actions = file.rows("/action", "StateChange:state")
        toward = "toward the target"
        done = [toward, "left 30°", "straight on", toward, "stop, left 60°", f"stop, {toward}"]
        assert [action for (action,) in actions] == [*done, ""]
        assert set(done) <= set(file.static("/action", "StateConfiguration:values"))

    def test_what_a_shield_does_is_shown_and_told(self, file: File, drive: Recording) -> None:
        when, deciders = file.rows("/decided_by", "StateChange:state")
        assert when == pytest.approx(drive.state_time)
        assert [who for (who,) in deciders] == ["agent", "shield", "agent", "agent", "shield", "shield", ""]
        when, texts = file.rows("/events", "TextLog:text")
        told = [(time, text) for time, (text,) in zip(when.tolist(), texts, strict=True) if "shield" in text]
        assert sorted(told) == [
            (0.5, "shield: left 30°"),
            (2.0, "shield: stop, left 60°"),
            (2.5, "shield: stop, toward the target"),
        ]

    def test_the_contact_and_the_ending_are_told(self, file: File, drive: Recording) -> None:
        when, texts = file.rows("/events", "TextLog:text")
        _, levels = file.rows("/events", "TextLog:level")
        told = [(time, text, level) for time, (text,), (level,) in zip(when.tolist(), texts, levels, strict=True)]
        assert (3.0, "contact with an obstacle or a wall", "ERROR") in told
        assert (3.0, "collision after 3.0 s", "INFO") in told
        assert (0.5, f"non-safe: nearest reading {drive.readings[1].min():.2f} m", "INFO") in told
        assert len(told) == 11  # beside them six changes of property and three acts of a shield
        when, places = file.rows("/world/contacts", "Points3D:positions")
        assert when.tolist() == [3.0]
        assert places[0][0] == pytest.approx([9.0, 9.0, 0.0], abs=1e-5)

    def test_the_same_recording_gives_the_same_content_and_another_one_another_identity(
        self, file: File, drive: Recording, tmp_path: Path
    ) -> None:
        from nnql_bullet.reports.rrd import write_rrd

        write_rrd(drive, tmp_path / "again.rrd")
        again = File(tmp_path / "again.rrd")
        assert repr(again.columns) == repr(file.columns)
        assert again.recordings[0].recording_id == file.recordings[0].recording_id
        write_rrd(replace(drive, clearance=drive.clearance + 1e-9), tmp_path / "other.rrd")
        assert File(tmp_path / "other.rrd").recordings[0].recording_id != file.recordings[0].recording_id

    def test_a_vehicle_of_known_looks_is_drawn_so_and_its_wheels_turn(self, drive: Recording, tmp_path: Path) -> None:
        from nnql_bullet.reports.rrd import write_rrd

        names = {"left_drive": "left_drive", "right_drive": "right_drive", "swivel": "swivel"}
        known = {
            **drive.about["vehicle"],
            "urdf": (ROBOTS / "tricycle.urdf").read_text(encoding="utf-8"),
            "joints": {**names, "caster_roll": "caster_roll"},
            "wheel_radius": 0.125,
        }
        angles = np.column_stack([np.linspace(0.1, 4.0, STEPS * SAMPLES), *np.zeros((3, STEPS * SAMPLES))])
        write_rrd(replace(drive, about={**drive.about, "vehicle": known}, joint_angles=angles), tmp_path / "known.rrd")
        file = File(tmp_path / "known.rrd")
        when, wheels = file.rows("/world/vehicle/left_wheel", "Transform3D:quaternion")
        assert when == pytest.approx(np.append(0.0, drive.sample_time))
        half, zero = np.append(0.1, angles[:, 0]) / 2, np.zeros(len(when))
        expected = np.column_stack([zero, np.sin(half), zero, np.cos(half)])  # about the axle, which is y
        found = np.array(wheels).reshape(-1, 4)
        assert found * np.sign(np.sum(found * expected, axis=1))[:, None] == pytest.approx(expected, abs=1e-6)
        _, places = file.rows("/world/vehicle/left_wheel", "Transform3D:translation")
        assert np.array(places).reshape(-1, 3) == pytest.approx(np.tile((0.0, 0.3, 0.0), (len(places), 1)), abs=1e-6)
        assert file.static("/world/vehicle/left_wheel/0", "Cylinders3D:radii") == [pytest.approx(0.125)]
        _, frames = file.rows("/world/vehicle", "Transform3D:translation")
        assert np.array(frames).reshape(-1, 3)[:, 2] == pytest.approx(0.125)
        _, strips = file.rows("/world/rays", "LineStrips3D:strips")
        assert np.array(strips)[..., 2] == pytest.approx(0.6)

    def test_there_is_a_layout_for_the_viewer(self, file: File) -> None:
        assert (len(file.recordings), len(file.blueprints)) == (1, 1)

    def test_a_drive_without_a_contact_or_what_moves(self, drive: Recording, tmp_path: Path) -> None:
        from nnql_bullet.reports.rrd import write_rrd

        world = {**drive.about["world"], "patrols": [], "obstacles": []}
        quiet = replace(drive, about={**drive.about, "world": world, "ending": "goal"}, contact=drive.contact & False)
        write_rrd(quiet, tmp_path / "quiet.rrd")
        entities = {entity for entity, _ in File(tmp_path / "quiet.rrd").columns}
        assert not [entity for entity in entities if "contacts" in entity or "patrols" in entity]

    def test_an_older_file_survives_a_failure(
        self, drive: Recording, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        from nnql_bullet.reports import rrd

        path = tmp_path / "old.rrd"
        path.write_text("precious")
        monkeypatch.setattr(rrd, "_log_events", lambda stream, recording: 1 / 0)
        with pytest.raises(ZeroDivisionError):
            rrd.write_rrd(drive, path)
        assert path.read_text() == "precious"
        assert [found.name for found in tmp_path.iterdir()] == ["old.rrd"]


@pytest.fixture
def recorded(drive: Recording, tmp_path: Path) -> Path:
    path = tmp_path / "trajectory.npz"
    drive.save(path)
    return path


def test_a_recording_knows_its_world(drive: Recording) -> None:
    world = drive.world
    assert (world.name, world.seed, world.width, world.depth) == ("test", 7, 20.0, 18.0)
    assert world.obstacles == (OrientedBox(12.0, 6.0, 1.0, 2.0, 0.3),)
    assert world.patrols == (Patrol(OrientedBox(2.0, 10.0, 0.8, 0.5, 0.4), (2.0, 14.0), 0.8, 0.25),)
    assert world.start == Pose(5.0, 5.0, 0.0)
    assert (world.target, world.target_radius, world.obstacle_height) == ((17.0, 16.0), 2.0, 1.5)


class TestVerb:
    @NEEDS_RERUN
    def test_it_writes_beside_the_recording_and_says_how_to_open_it(
        self, run_cli: Cli, recorded: Path, written: Path
    ) -> None:
        code, out, err = run_cli("view", recorded)
        assert (code, err) == (0, "")
        path = recorded.with_suffix(".rrd")
        assert out.splitlines() == [f"time line: {path}", f"open it: rerun {path}"]
        assert repr(File(path).columns) == repr(File(written).columns)

    @NEEDS_RERUN
    def test_it_writes_where_it_is_told(self, run_cli: Cli, recorded: Path, tmp_path: Path) -> None:
        assert run_cli("view", recorded, "--out", tmp_path / "new" / "one.rrd")[0] == 0
        assert [path.name for path in (tmp_path / "new").iterdir()] == ["one.rrd"]
        assert not recorded.with_suffix(".rrd").exists()

    def test_a_truncated_recording_is_one_line_and_nothing_written(
        self, run_cli: Cli, recorded: Path, snapshot: Callable[[Path], dict[str, bytes]]
    ) -> None:
        recorded.write_bytes(recorded.read_bytes()[:1000])
        before = snapshot(recorded.parent)
        for path in (recorded, recorded.parent, recorded.parent / "none.npz", Path(".")):
            code, out, err = run_cli("view", path)
            assert (code, out, err.count("\n")) == (2, "", 1)
            assert ("not a whole recording" if path == recorded else "there is no such recording") in err
        assert snapshot(recorded.parent) == before

    def test_another_ending_is_refused(self, run_cli: Cli, recorded: Path, tmp_path: Path) -> None:
        code, _, err = run_cli("view", recorded, "--out", tmp_path / "one.npz")
        assert (code, err.count("\n")) == (2, 1)
        assert ".rrd" in err
        assert [path.name for path in tmp_path.iterdir()] == ["trajectory.npz"]

    def test_without_the_extra_it_names_it(
        self, run_cli: Cli, recorded: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        for name in [name for name in sys.modules if name.split(".")[0] == "rerun"]:
            monkeypatch.delitem(sys.modules, name)
        monkeypatch.delitem(sys.modules, "nnql_bullet.reports.rrd", raising=False)
        monkeypatch.delattr("nnql_bullet.reports.rrd", raising=False)
        imported = builtins.__import__

        def without_rerun(name: str, *rest: Any) -> Any:
            if name.split(".")[0] == "rerun":
                raise ImportError(name)
            return imported(name, *rest)

        monkeypatch.setattr(builtins, "__import__", without_rerun)
        code, out, err = run_cli("view", recorded)
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert "nnql-bullet[viz]" in err
        assert [path.name for path in tmp_path.iterdir()] == ["trajectory.npz"]
