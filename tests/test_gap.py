"""The gap between two simulators: its numbers against the recordings and drives they come from."""

import csv
import json
import math
from collections.abc import Callable
from dataclasses import replace
from math import hypot
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from nnql_bullet.agents.base import Reflex
from nnql_bullet.cli import main
from nnql_bullet.env import REVERSE, STOP, TOWARD_TARGET, Navigation, Observation
from nnql_bullet.evaluation.causes import apart, explain, parting, period_errors
from nnql_bullet.evaluation.gap import (
    FaultTask,
    Pair,
    Side,
    differences,
    divergence,
    outcome_matrix,
    success_p_value,
    tasks,
)
from nnql_bullet.evaluation.policies import open_policies
from nnql_bullet.evaluation.statistics import mcnemar, proportion
from nnql_bullet.geometry import OrientedBox, Pose
from nnql_bullet.recording import Recorder, Recording, load_recording
from nnql_bullet.rollout import EpisodeSummary, run_episode
from nnql_bullet.run_config import Conditions
from nnql_bullet.setting import Setting
from nnql_bullet.sim.base import Simulator
from nnql_bullet.sim.engines import ContactSimulator, contact_simulator
from nnql_bullet.sim.kinematic import KinematicSimulator
from nnql_bullet.task import ENDINGS, TaskOptions
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.vehicle.urdf import load_vehicle
from nnql_bullet.worlds.spec import WorldSpec

RunCli = Callable[..., tuple[int, str, str]]


def recorded(simulator: Simulator, world: WorldSpec, actions: list[int]) -> Recording:
    """A drive that takes these decisions, then goes straight on."""
    vehicle = simulator.engines[0].vehicle if isinstance(simulator, ContactSimulator) else load_vehicle("tricycle")
    waiting = iter(actions)

    def policy(observations: Observation) -> np.ndarray[Any, Any]:
        return np.array([next(waiting, STRAIGHT)])

    recorder = Recorder(vehicle)
    run_episode(Navigation(simulator, TaskOptions(max_steps=len(actions))), world, Reflex(policy), watcher=recorder)
    simulator.close()
    return recorder.recording()


def contact(vehicle: VehicleSpec) -> ContactSimulator:
    return contact_simulator("bullet", "reference", vehicle, DriveOptions(), 1)


def slippery(vehicle: VehicleSpec, friction: float) -> VehicleSpec:
    return replace(vehicle, contact=replace(vehicle.contact, wheel_friction=friction))


STRAIGHT, LEFT_60, RIGHT_60 = 0, 2, 4
SWERVES = [LEFT_60, 1, RIGHT_60, RIGHT_60, STRAIGHT, LEFT_60, LEFT_60, 3, RIGHT_60, STRAIGHT]


class TestStatistics:
    def test_wilson_interval_of_the_formula(self) -> None:
        n, k, z = 50, 45, 1.959963984540054
        p = k / n
        centre = (p + z * z / (2 * n)) / (1 + z * z / n)
        half = z / (1 + z * z / n) * math.sqrt(p * (1 - p) / n + z * z / (4 * n * n))
        assert proportion(k, n) == pytest.approx((p, centre - half, centre + half))
        assert str(proportion(k, n)) == "90.0 (78.6-95.7)"

    def test_mcnemar_is_the_exact_binomial(self) -> None:
        # 1 against 7: twice the chance of at most one head in eight throws.
        assert mcnemar(1, 7) == pytest.approx(2 * (1 + 8) / 2**8)
        assert mcnemar(7, 1) == mcnemar(1, 7)
        assert mcnemar(0, 0) == 1.0


class TestPeriodErrors:
    @pytest.mark.parametrize("actions", [SWERVES, [0, STOP + 1, REVERSE, REVERSE + 2, REVERSE + 3, STOP, 0, 2, 0]])
    def test_the_ideal_vehicle_neither_lags_nor_slips(
        self, vehicle: VehicleSpec, empty_world: WorldSpec, actions: list[int]
    ) -> None:
        drive = DriveOptions()
        ideal = recorded(KinematicSimulator(vehicle, drive, 1), empty_world, actions)
        parts = period_errors(ideal, vehicle, drive)
        assert parts.lag.max() < 1e-3
        assert parts.slip.max() < 1e-3
        assert parts.distance == pytest.approx(1.0)

    def test_contact_physics_keeps_within_two_hundredths(self, vehicle: VehicleSpec, empty_world: WorldSpec) -> None:
        parts = period_errors(recorded(contact(vehicle), empty_world, SWERVES), vehicle, DriveOptions())
        assert 1e-3 < parts.slip.max() < 0.02
        assert parts.lag.max() < 0.01

    def test_ice_shows_as_slip(self, vehicle: VehicleSpec, empty_world: WorldSpec) -> None:
        icy = slippery(vehicle, 0.25)
        parts = period_errors(recorded(contact(icy), empty_world, SWERVES), icy, DriveOptions())
        assert parts.slip.max() > 0.05
        assert parts.slip.max() > 3 * parts.lag.max()

    def test_weak_motors_show_as_lag(self, vehicle: VehicleSpec, empty_world: WorldSpec) -> None:
        weak = replace(vehicle, wheel_torque=8.0)
        parts = period_errors(recorded(contact(weak), empty_world, SWERVES), weak, DriveOptions())
        assert parts.lag.max() > 0.02
        assert parts.lag.max() > 3 * parts.slip.max()

    def test_a_step_that_contact_cuts_short_is_measured_as_far_as_it_went(
        self, vehicle: VehicleSpec, world_of: Callable[..., WorldSpec]
    ) -> None:
        recording = recorded(
            contact(vehicle), world_of(side=20.0, start=Pose(15.0, 10.0, 0.0), target=(2.0, 2.0)), [STRAIGHT] * 10
        )
        assert recording.contact[-1]
        parts = period_errors(recording, vehicle, DriveOptions())
        assert parts.distance[-1] < 1.0
        assert parts.distance.sum() == pytest.approx(20.0 - 15.0 - 0.90, abs=0.03)
        assert parts.lag.max() < 0.02


class TestCauses:
    @pytest.fixture
    def ideal(self, vehicle: VehicleSpec, empty_world: WorldSpec) -> Recording:
        return recorded(KinematicSimulator(vehicle, DriveOptions(), 1), empty_world, SWERVES)

    def test_slip(self, vehicle: VehicleSpec, empty_world: WorldSpec, ideal: Recording) -> None:
        icy = slippery(vehicle, 0.25)
        assert explain(ideal, recorded(contact(icy), empty_world, SWERVES), icy, DriveOptions()).cause == "slip"

    def test_tracking_lag(self, vehicle: VehicleSpec, empty_world: WorldSpec, ideal: Recording) -> None:
        weak = replace(vehicle, wheel_torque=8.0)
        assert (
            explain(ideal, recorded(contact(weak), empty_world, SWERVES), weak, DriveOptions()).cause == "tracking lag"
        )

    def test_what_slips_only_after_the_drives_have_parted_is_not_the_cause(
        self, vehicle: VehicleSpec, empty_world: WorldSpec
    ) -> None:
        icy = slippery(vehicle, 0.25)
        straight = recorded(KinematicSimulator(vehicle, DriveOptions(), 1), empty_world, [STRAIGHT] * 10)
        swerving = recorded(contact(icy), empty_world, [STRAIGHT, STRAIGHT, *SWERVES])
        found = explain(straight, swerving, icy, DriveOptions())
        assert found.slip < 0.03
        assert found.cause == "other"
        assert found.time == 1.0

    def test_slip_that_adds_up_little_by_little(
        self, vehicle: VehicleSpec, empty_world: WorldSpec, ideal: Recording
    ) -> None:
        # 1 cm of slip in each period of 1 m: no single one is notable, but in the end they are 10 cm apart.
        n = len(ideal.action)
        drift = np.outer(np.concatenate([[0.0], np.arange(1, n + 1)]), [0.013, 0.0, 0.0])
        step = np.minimum(np.searchsorted(ideal.state_time, ideal.sample_time - 1e-9), n)
        drifting = replace(
            ideal,
            state_pose=ideal.state_pose + drift,
            sample_pose=ideal.sample_pose + drift[step],
            action=np.array([*ideal.action[:-1], 3]),
        )
        found = explain(ideal, drifting, vehicle, DriveOptions())
        assert found.cause == "slip"
        assert found.slip < 0.03
        assert found.apart == pytest.approx(0.013 * (n - 1))
        barely = replace(drifting, state_pose=ideal.state_pose + 0.5 * drift)
        assert explain(ideal, barely, vehicle, DriveOptions()).cause == "other"

    def test_a_graze(self, vehicle: VehicleSpec, world_of: Callable[..., WorldSpec]) -> None:
        # The same straight drive beside a post: 1 cm into the flank on one side, 1 cm clear of it on the other.
        half_width = vehicle.footprint.half_width
        hit, missed = (
            recorded(
                KinematicSimulator(vehicle, DriveOptions(), 1),
                world_of(OrientedBox(104.0, 100.0 + half_width + 0.1 + off, 0.1, 0.1)),
                [STRAIGHT] * 8,
            )
            for off in (-0.01, 0.01)
        )
        assert hit.contact[-1]
        assert not missed.contact[-1]
        for found in (explain(hit, missed, vehicle, DriveOptions()), explain(missed, hit, vehicle, DriveOptions())):
            assert found.cause == "grazing contact"
            assert found.miss == pytest.approx(0.01, abs=2e-3)

    def test_a_close_call_of_the_network_is_measured(self, vehicle: VehicleSpec, empty_world: WorldSpec) -> None:
        first = recorded(KinematicSimulator(vehicle, DriveOptions(), 1), empty_world, [2, 2, 1])
        second = recorded(KinematicSimulator(vehicle, DriveOptions(), 1), empty_world, [2, 2, 3])
        q = np.zeros((3, 5))
        q[2] = [0.0, 0.5, 0.0, 0.2, 0.0]
        first, second = replace(first, q_values=q), replace(second, q_values=q[:, ::-1])
        found = explain(first, second, vehicle, DriveOptions())
        assert parting(first, second) == 2
        assert found.q_margin == pytest.approx(0.3)
        toward = replace(second, action=np.array([2, 2, TOWARD_TARGET]))
        assert math.isnan(explain(first, toward, vehicle, DriveOptions()).q_margin)
        assert math.isnan(
            explain(first, replace(toward, action=toward.action + STOP), vehicle, DriveOptions()).q_margin
        )

    def test_how_far_apart_two_arcs_get(self, vehicle: VehicleSpec, empty_world: WorldSpec) -> None:
        straight, turning = (
            recorded(KinematicSimulator(vehicle, DriveOptions(), 1), empty_world, [action] * 6)
            for action in (STRAIGHT, LEFT_60)
        )
        times, distances = apart(straight, turning)
        assert times == pytest.approx(0.5 * np.arange(6))
        expected = [hypot(*(straight.state_pose[k, :2] - turning.state_pose[k, :2])) for k in range(6)]
        assert distances == pytest.approx(expected)
        assert distances[-1] > 1.0


def summary(ending: str, duration: float = 10.0, clearance: float = 1.0) -> EpisodeSummary:
    return EpisodeSummary(0, ending, 20, duration, 2 * duration, clearance, 2.0, 1.0, 0.0, 3, 0.0, {})


def pair(first: str, second: str, apart: list[float], parted: float = math.inf, **second_with: float) -> Pair:
    times = 0.5 * np.arange(len(apart))
    return Pair("run", 0, summary(first), summary(second, **second_with), times, np.array(apart), parted, None)


class TestAggregates:
    PAIRS: ClassVar = [
        pair("goal", "goal", [0.0, 0.1, 0.3], parted=1.0, duration=11.0, clearance=0.5),
        pair("goal", "goal", [0.0, 0.2], duration=13.0),
        pair("goal", "collision", [0.0, 0.4, 0.5, 9.0], parted=0.5),
        pair("timeout", "goal", [0.0, 0.0, 0.1]),
        pair("collision", "collision", [0.0]),
        pair("goal", "timeout", [0.0, 0.3, 0.7]),
    ]

    def test_every_pair_stands_where_it_ended(self) -> None:
        ended = {("goal", "goal"): 2, ("goal", "collision"): 1, ("goal", "timeout"): 1, ("timeout", "goal"): 1}
        ended |= {("collision", "collision"): 1}
        wanted = [[ended.get((first, second), 0) for second in ENDINGS] for first in ENDINGS]
        assert outcome_matrix(self.PAIRS).tolist() == wanted

    def test_mcnemar_counts_successes_on_one_side_alone(self) -> None:
        assert success_p_value(self.PAIRS) == pytest.approx(mcnemar(2, 1))

    def test_divergence_is_over_the_pairs_that_still_drive(self) -> None:
        d = divergence(self.PAIRS)
        assert d.time.tolist() == [0.0, 0.5, 1.0]  # at 1.5 s one of six drives
        assert d.driving.tolist() == [6, 5, 4]
        assert d.median == pytest.approx([0.0, 0.2, 0.4])
        assert d.parted == pytest.approx([0.0, 1 / 6, 2 / 6])

    def test_differences_are_over_the_pairs_that_both_arrive(self) -> None:
        time, path, clearance = differences(self.PAIRS)
        assert time.mean == pytest.approx(2.0)
        assert path.mean == pytest.approx(4.0)
        assert clearance.mean == pytest.approx(-0.25)
        assert not differences(self.PAIRS[2:])


@pytest.fixture(scope="module")
def report(tiny_run: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of seven worlds, faults included."""
    folder = tmp_path_factory.mktemp("gap")
    arguments = ["gap", tiny_run, "--worlds", 7, "--physics", "fast", "--workers", 2, "--out", folder]
    assert main([str(argument) for argument in arguments]) == 0
    return folder


class TestCommand:
    def test_it_leaves_the_whole_report(self, report: Path) -> None:
        there = {path.name for path in report.iterdir()}
        assert {"gap.md", "gap.json", "episodes.csv", "gap.png", "faults.png", "flips"} <= there
        values = json.loads((report / "gap.json").read_text())
        assert ("flips.png" in there) is bool(values["flips"])

    def test_its_numbers_are_those_of_the_drives(self, report: Path) -> None:
        values = json.loads((report / "gap.json").read_text())
        with (report / "episodes.csv").open(newline="") as file:
            rows = list(csv.DictReader(file))
        sound = {side: {r["world_seed"]: r["ending"] for r in rows if r["simulator"] == side and not r["fault"]}
                 for side in ("kinematic", "bullet, fast")}  # fmt: skip
        for i, first in enumerate(values["endings"]):
            for j, second in enumerate(values["endings"]):
                both = sum(
                    sound["kinematic"][s] == first and sound["bullet, fast"][s] == second for s in map(str, range(7))
                )
                assert values["outcomes"][i][j] == both
        assert len(values["faults"]) == 13
        for row in values["faults"]:
            name = "" if row["fault"] == "none" else row["fault"]
            endings = [r["ending"] for r in rows if r["fault"] == name and r["simulator"] != "kinematic"]
            in_kinematic = [r["ending"] for r in rows if r["fault"] == name and r["simulator"] == "kinematic"]
            assert len(endings) == 7
            assert row["goal"][0] == pytest.approx(endings.count("goal") / 7)
            assert bool(in_kinematic) is not name.startswith(("friction", "payload"))
            assert row["goal_first"] is None or row["goal_first"][0] == pytest.approx(in_kinematic.count("goal") / 7)
            assert bool(row["goal_first"]) is bool(in_kinematic)
        text = (report / "gap.md").read_text()
        assert all(f"| {row['fault']} |" in text for row in values["faults"])

    @pytest.mark.parametrize(("fault", "flags"), [("", ()), ("payload 40 kg", ("--conditions.payload", 40))])
    def test_drive_drives_the_same_again(
        self, report: Path, tiny_run: Path, run_cli: RunCli, tmp_path: Path, fault: str, flags: tuple[object, ...]
    ) -> None:
        with (report / "episodes.csv").open(newline="") as file:
            rows = [r for r in csv.DictReader(file) if r["simulator"] == "bullet, fast" and r["fault"] == fault]
        for row in rows[:2]:
            seed = row["world_seed"]
            arguments = (tiny_run, "--seed", seed, "--physics", "fast", *flags, "--out", tmp_path, "--json")
            code, out, _ = run_cli("drive", *arguments)
            again = json.loads(out)
            assert code == 0
            assert (again["ending"], again["time"]) == (row["ending"], float(row["duration"]))

    def test_the_report_does_not_depend_on_the_workers(
        self, report: Path, tiny_run: Path, run_cli: RunCli, tmp_path: Path
    ) -> None:
        arguments = ("--worlds", 7, "--physics", "fast", "--no-faults", "--workers", 1, "--out", tmp_path)
        assert run_cli("gap", tiny_run, *arguments)[0] == 0
        one, two = (json.loads((folder / "gap.json").read_text()) for folder in (tmp_path, report))
        assert one["outcomes"] == two["outcomes"]
        assert one["divergence"] == two["divergence"]
        assert not (tmp_path / "faults.png").exists()

    def test_conditions_hold_in_every_drive(
        self, report: Path, tiny_run: Path, run_cli: RunCli, tmp_path: Path
    ) -> None:
        given = ("--conditions.payload", 40)
        arguments = ("--worlds", 5, "--physics", "fast", "--no-faults", "--workers", 1, "--out", tmp_path)
        code, out, _ = run_cli("gap", tiny_run, *arguments, *given)
        assert code == 0
        texts = [(folder / "episodes.csv").read_text() for folder in (tmp_path, report)]
        loaded, faulty = (list(csv.DictReader(text.splitlines())) for text in texts)
        wanted = [{**row, "fault": ""} for row in faulty if row["fault"] == "payload 40 kg"]
        assert [row for row in loaded if row["simulator"] == "bullet, fast"] == wanted[:5]
        values = json.loads((tmp_path / "gap.json").read_text())
        assert values["conditions"]["payload"] == 40
        commands = [values["command"], *(replay for flip in values["flips"] for replay in flip["replay"])]
        assert all(command.endswith("--conditions.payload 40") for command in commands)
        assert "payload 40" in out
        assert "payload 40" in (tmp_path / "gap.md").read_text()

    def test_a_fault_takes_the_place_of_the_same_condition_only(self) -> None:
        sides = Side("kinematic", "fast"), Side("bullet", "fast")
        setting = Setting("bullet", "fast", Conditions(payload=10.0, dead_sector=3))
        work = tasks(open_policies("straight"), None, [range(1)], *sides, setting, True)
        under = {task.fault: task.setting.conditions for task in work if isinstance(task, FaultTask)}
        assert under["friction 0.5"] == Conditions(payload=10.0, dead_sector=3, wheel_friction=0.5)
        assert under["payload 80 kg"] == Conditions(payload=80.0, dead_sector=3)
        assert under["front sector dead"] == Conditions(payload=10.0, dead_sector=0)

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            (("--conditions.payload", -1), "'conditions.payload'"),
            (("--worlds", 0), "the number of worlds must be from 1 to 1000"),
            (("--sim", "bullet", "--against", "bullet"), "is the simulator itself"),
            (("--world", "nowhere"), "nowhere"),
        ],
    )
    def test_bad_input_is_one_line_and_leaves_nothing(
        self, tiny_run: Path, run_cli: RunCli, tmp_path: Path, arguments: tuple[object, ...], message: str
    ) -> None:
        out = tmp_path / "gap"
        code, _, err = run_cli("gap", tiny_run, *arguments, "--out", out)
        assert code == 2
        assert message in err
        assert len(err.strip().splitlines()) == 1
        assert not out.exists()

    def test_flips_keep_both_recordings(self, report: Path) -> None:
        values = json.loads((report / "gap.json").read_text())
        files = list((report / "flips").glob("*.npz"))
        assert len(files) == 2 * len(values["flips"])
        for file in files:
            assert load_recording(file).about["simulator"] in ("kinematic", "bullet")
