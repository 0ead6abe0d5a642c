"""`nnql-bullet fidelity`: its exit code, and that its tables, JSON and pictures say what the probes measured."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from math import degrees
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nnql_bullet.cli import main
from nnql_bullet.fidelity.actions import tightest, watch_actions
from nnql_bullet.fidelity.probe import Bench, Measurement, at_most, close_to
from nnql_bullet.fidelity.probes import PROBES
from nnql_bullet.reports.fidelity import number, share_used, tolerance
from nnql_bullet.sim import bullet
from nnql_bullet.sim.bullet import BulletEngine
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.spec import WorldSpec

RunCli = Callable[..., tuple[int, str, str]]


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of the shipped vehicle in `fast` physics."""
    folder = tmp_path_factory.mktemp("fidelity")
    assert main(["fidelity", "--physics", "fast", "--out", str(folder)]) == 0
    return folder


@pytest.fixture(scope="module")
def values(report: Path) -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads((report / "fidelity.json").read_text())
    return loaded


class TestReport:
    def test_it_holds_every_probe_with_its_source(self, report: Path, values: dict[str, Any]) -> None:
        assert [probe["name"] for probe in values["probes"]] == list(PROBES)
        text = (report / "fidelity.md").read_text()
        for probe in PROBES.values():
            assert f"| {probe.title} | {probe.closed_form} | {probe.source} |".replace("<", "&lt;") in text
        assert {path.name for path in report.iterdir()} == {
            "fidelity.md", "fidelity.json", "tolerances.png", "actions.png", "grip.png"
        }  # fmt: skip

    def test_its_numbers_are_measured_anew_the_same(self, vehicle: VehicleSpec, values: dict[str, Any]) -> None:
        for name, refinement, key in (("settle", 1, "measurements"), ("settle", 2, "at_half_the_step")):
            again = PROBES[name].measure(Bench(vehicle, "bullet", "fast", refinement))
            (probe,) = [probe for probe in values["probes"] if probe["name"] == name]
            assert [m["measured"] for m in probe[key]] == [m.measured for m in again]

    def test_the_table_says_what_the_json_says(self, report: Path, values: dict[str, Any]) -> None:
        rows = [line for line in (report / "fidelity.md").read_text().splitlines() if line.endswith(" |")]
        for probe in values["probes"]:
            for m in probe["measurements"]:
                name = f"{m['quantity']} [{m['unit']}]" if m["unit"] else m["quantity"]
                (row,) = [row for row in rows if row.startswith(f"| {probe['title']} | {name} |")]
                cells = [cell.strip() for cell in row.strip("|").split("|")]
                resolution = 0.02 * (m["high"] - m["low"])
                assert float(cells[3]) == pytest.approx(m["measured"], rel=0.05, abs=max(resolution, 1e-9))
                assert cells[5] == "ok"

    def test_the_five_actions_come_closer_to_the_ideal_with_the_step(self, values: dict[str, Any]) -> None:
        steps = [entry["time_step"] for entry in values["actions"]]
        assert steps == pytest.approx([1 / 120, 1 / 240, 1 / 480])
        gaps = np.array([[turn["gap"] for turn in entry["turns"]] for entry in values["actions"]])
        assert [turn["heading_change_degrees"] for turn in values["actions"][0]["turns"]] == pytest.approx(
            [0, 30, 60, -30, -60]
        )
        assert (gaps[0, 1:] > gaps[1, 1:]).all()
        assert (gaps[1, 1:] > gaps[2, 1:]).all()
        assert (gaps[0] < 0.012).all()


def test_physics_that_is_wrong_exits_1_and_says_where(
    run_cli: RunCli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    coarse = replace(bullet.PHYSICS["fast"], iterations=4)
    monkeypatch.setitem(bullet.PHYSICS, "fast", coarse)
    code, out, _ = run_cli("fidelity", "--physics", "fast", "--out", tmp_path)
    values = json.loads((tmp_path / "fidelity.json").read_text())
    wrong = [m for probe in values["probes"] for m in probe["measurements"] if not m["ok"]]
    assert code == 1
    assert wrong
    assert values["ok"] is False
    assert out.count("OUT") == len(wrong)
    assert (tmp_path / "fidelity.md").read_text().count("**out**") == len(wrong)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [(("--robot", "nothing"), "nothing"), (("--physics", "slow"), "slow"), (("--sim", "kinematic"), "kinematic")],
)
def test_bad_input_is_one_line_and_leaves_nothing(
    run_cli: RunCli, tmp_path: Path, arguments: tuple[str, ...], message: str
) -> None:
    out = tmp_path / "report"
    code, _, err = run_cli("fidelity", *arguments, "--out", out)
    assert code == 2
    assert message in err
    assert len(err.strip().splitlines()) == 1
    assert not out.exists()


class TestActions:
    def test_they_are_the_drives_of_the_simulator(
        self, vehicle: VehicleSpec, empty_world: WorldSpec, engine_of: Callable[..., BulletEngine]
    ) -> None:
        turns = watch_actions(Bench(vehicle, "bullet", "fast"))
        engine = engine_of("fast", decision_period=1.0)
        for turn in turns:
            engine.reset(empty_world)
            end = engine.advance(turn.heading_change).pose
            assert turn.times[-1] == pytest.approx(1.0)
            assert (end.x - 100.0, end.y - 100.0) == tuple(turn.path[-1])
        assert degrees(tightest(turns).heading_change) == pytest.approx(60.0)

    def test_the_ideal_ends_where_geometry_says(self, vehicle: VehicleSpec) -> None:
        # Symmetric ramps: the chord of the whole turn points along half the heading change. Straight: v t.
        turns = {round(degrees(t.heading_change)): t for t in watch_actions(Bench(vehicle, "bullet", "fast"))}
        assert turns[0].ideal[-1] == pytest.approx((2.0, 0.0))
        for angle in (30, 60):
            turn = turns[angle]
            during = turn.times <= turn.turn.duration + 1e-9
            x, y = turn.ideal[during][-1]
            left_over = turn.turn.duration - turn.times[during][-1]
            x += 2.0 * left_over * math.cos(math.radians(angle))
            y += 2.0 * left_over * math.sin(math.radians(angle))
            assert degrees(math.atan2(y, x)) == pytest.approx(angle / 2, abs=0.02)
            assert turns[-angle].ideal[:, 1] == pytest.approx(-turn.ideal[:, 1])

    def test_the_loads_add_up_to_the_weight(self, vehicle: VehicleSpec) -> None:
        turn = tightest(watch_actions(Bench(vehicle)))
        assert turn.forces.normal.sum(axis=1) == pytest.approx(120 * 9.81, rel=0.03)


class TestNumbers:
    @pytest.mark.parametrize(
        ("measurement", "text", "accepted"),
        [
            (close_to("x", "m", 40.0, 39.9993, relative=2e-4), "39.9993", "±0.008"),
            (close_to("x", "N", 483.35, 483.38, relative=5e-3), "483.38", "±2.4"),
            (at_most("x", "mm", 6.0, 3.618), "3.62", "at most 6.00"),
            (close_to("x", "deg", 0.0, 2.7e-5, absolute=0.1), "2.7e-05", "±0.1"),
            (Measurement("x", "", math.nan, math.nan, math.nan, math.nan), "nan", "±nan"),
        ],
    )
    def test_they_have_the_digits_that_the_tolerance_makes_sense_of(
        self, measurement: Measurement, text: str, accepted: str
    ) -> None:
        assert number(measurement.measured, measurement) == text
        assert tolerance(measurement) == accepted

    @pytest.mark.parametrize(
        ("measurement", "share"),
        [
            (close_to("x", "", 10.0, 10.5, absolute=1.0), 0.5),
            (close_to("x", "", 10.0, 9.0, absolute=1.0), 1.0),
            (at_most("x", "", 4.0, 1.0), 0.25),
            (close_to("x", "", 0.0, 0.0), 0.0),
        ],
    )
    def test_how_much_of_a_tolerance_is_used(self, measurement: Measurement, share: float) -> None:
        assert share_used(measurement) == pytest.approx(share)
        assert measurement.ok is (share <= 1.0)

    def test_what_is_not_a_number_is_never_accepted(self) -> None:
        broken = close_to("x", "", 1.0, math.nan, absolute=1e9)
        assert not broken.ok
        assert share_used(broken) > 1
