"""Faulty sensors and other conditions that a policy was not trained for."""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from math import exp, hypot
from pathlib import Path
from typing import get_args
from xml.etree import ElementTree

import numpy as np
import pytest
from helpers import Alone

from nnql_bullet.env import Navigation
from nnql_bullet.errors import UserError
from nnql_bullet.experiment import Experiment
from nnql_bullet.geometry import Pose
from nnql_bullet.rollout import run_episode, run_episodes
from nnql_bullet.run_config import Conditions, RunConfig, changed
from nnql_bullet.sim.base import Simulator
from nnql_bullet.sim.bullet import PHYSICS, BulletEngine
from nnql_bullet.sim.contact import ContactEngine
from nnql_bullet.sim.engines import EngineName, contact_engine
from nnql_bullet.sim.faults import FaultySimulator, SensorFaults, degraded
from nnql_bullet.sim.kinematic import KinematicSimulator
from nnql_bullet.vehicle.controller import (
    COMMAND_RATE,
    DriveOptions,
    Goal,
    command_times,
    plan_late,
    plan_period,
)
from nnql_bullet.vehicle.payload import loaded, urdf_text
from nnql_bullet.vehicle.spec import Payload, VehicleSpec
from nnql_bullet.worlds.spec import WorldSpec

ENGINES = get_args(EngineName)
RANGE = 10.0
G = 9.81


def generator(seed: int = 1) -> np.random.Generator:
    return np.random.default_rng(seed)


class TestDegraded:
    def test_noise_has_the_stated_spread_and_no_bias(self) -> None:
        distances = np.full(72, 5.0)
        off = np.concatenate([degraded(distances, SensorFaults(noise=0.1), generator(k)) - 5.0 for k in range(200)])
        assert abs(off.mean()) < 4 * 0.1 / np.sqrt(off.size)
        assert off.std() == pytest.approx(0.1, rel=0.03)

    def test_a_ray_that_meets_nothing_still_meets_nothing(self) -> None:
        assert (degraded(np.full(72, RANGE), SensorFaults(noise=0.5), generator()) == RANGE).all()

    def test_readings_stay_within_the_sensor(self) -> None:
        for distance in (0.05, 9.95):
            seen = degraded(np.full(72, distance), SensorFaults(noise=0.5), generator())
            assert seen.min() >= 0.0
            assert seen.max() <= RANGE
            assert np.ptp(seen) > 0.1

    @pytest.mark.parametrize("sector", [0, 3, 7])
    def test_a_dead_sector_sees_nothing_and_the_others_all(self, sector: int) -> None:
        distances = np.linspace(1.0, 8.0, 72)
        seen = degraded(distances, SensorFaults(dead_sector=sector), generator())
        dead = np.arange(72) // 9 == sector
        assert (seen[dead] == RANGE).all()
        assert (seen[~dead] == distances[~dead]).all()
        assert distances.max() == 8.0  # what was handed in is untouched


@pytest.mark.parametrize("faults", [SensorFaults(noise=0.05), SensorFaults(dead_sector=0)], ids=["noise", "dead"])
class TestSimulatorsSeenThroughFaults:
    def test_one_and_several_vehicles_see_the_same(
        self, vehicle: VehicleSpec, small_world: Path, faults: SensorFaults
    ) -> None:
        config = RunConfig(
            world=str(small_world),
            simulator="kinematic",
            conditions=Conditions(sensor_noise=faults.noise, dead_sector=faults.dead_sector),
            vehicles=3,
        )
        experiment = Experiment(config)
        worlds = [experiment.world(seed) for seed in range(4)]
        many = run_episodes(Navigation(experiment.new_simulator(), config.task), worlds, experiment.agent)
        alone = [run_episode(experiment.navigation, world, experiment.agent) for world in worlds]
        assert many == alone

    def test_the_vehicle_itself_moves_as_before(
        self, vehicle: VehicleSpec, empty_world: WorldSpec, faults: SensorFaults
    ) -> None:
        motions = []
        for faulty in (False, True):
            simulator: Simulator = KinematicSimulator(vehicle, DriveOptions(), 1)
            with Alone(FaultySimulator(simulator, faults) if faulty else simulator) as alone:
                alone.reset(empty_world)
                motions.append(alone.advance(0.4))
        assert motions[0] == motions[1]

    def test_every_world_has_noise_of_its_own(
        self, vehicle: VehicleSpec, world_of: Callable[..., WorldSpec], faults: SensorFaults
    ) -> None:
        inner = KinematicSimulator(vehicle, DriveOptions(), 2)
        simulator = FaultySimulator(inner, faults)
        world = world_of(side=20.0, start=Pose(10.0, 10.0, 0.0), target=(15.0, 15.0))
        _, seen = simulator.reset({0: world, 1: replace(world, seed=1)})
        _, true = inner.reset({0: world, 1: replace(world, seed=1)})
        assert (seen != true).any()
        if faults.noise:
            assert (seen[0] != seen[1]).any()
        simulator.close()


class TestPayload:
    LOAD = Payload(80.0, 0.35, 0.55, 0.4)

    def test_mass_centre_and_inertia_are_those_of_two_bodies(self, vehicle: VehicleSpec) -> None:
        v, w = vehicle, loaded(vehicle, self.LOAD)
        assert w.mass == pytest.approx(200.0)
        assert w.com_ahead == pytest.approx((120 * v.com_ahead + 80 * 0.35) / 200)
        assert w.com_height == pytest.approx((120 * v.com_height + 80 * 0.55) / 200)
        # Each body about the common centre, by Steiner.
        cube = 80 * 0.4**2 / 6 + 80 * (0.35 - w.com_ahead) ** 2
        assert w.yaw_inertia == pytest.approx(v.yaw_inertia + 120 * (v.com_ahead - w.com_ahead) ** 2 + cube)

    def test_the_urdf_gains_one_link_at_its_place(self, vehicle: VehicleSpec) -> None:
        before = ElementTree.parse(vehicle.urdf).getroot()
        after = ElementTree.fromstring(urdf_text(loaded(vehicle, self.LOAD)))
        assert len(after.findall("link")) == len(before.findall("link")) + 1
        (joint,) = after.findall("joint[@type='fixed']")
        place = [float(part) for part in joint.find("origin").attrib["xyz"].split()]  # type: ignore[union-attr]
        assert place == pytest.approx([0.35, 0.0, 0.55 - vehicle.wheel_radius])

    def test_without_one_the_urdf_is_the_file(self, vehicle: VehicleSpec) -> None:
        canonical = partial(ElementTree.canonicalize, strip_text=True)
        assert canonical(urdf_text(vehicle)) == canonical(vehicle.urdf.read_text())
        assert loaded(vehicle, Payload(0.0, 0.3, 0.5)) is vehicle

    def test_a_second_one_is_refused(self, vehicle: VehicleSpec) -> None:
        with pytest.raises(UserError, match="carries a payload"):
            loaded(loaded(vehicle, self.LOAD), self.LOAD)

    def test_the_wheels_carry_it_by_the_lever_rule(
        self, engine_of: Callable[..., BulletEngine], vehicle: VehicleSpec, empty_world: WorldSpec
    ) -> None:
        simulator = engine_of("reference", loaded(vehicle, self.LOAD))
        simulator.place(empty_world, empty_world.start, 0.0)
        simulator.command_wheels(0.0, 0.0)
        simulator.run(2.0)
        left, right, front = simulator.wheel_loads()
        moment = (120 * vehicle.com_ahead + 80 * 0.35) * G  # about the rear axle
        assert front == pytest.approx(moment / vehicle.wheelbase, rel=0.01)
        assert left + right == pytest.approx(200 * G - moment / vehicle.wheelbase, rel=0.01)

    def test_no_file_of_it_stays(self, vehicle: VehicleSpec, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
        simulator = BulletEngine(loaded(vehicle, self.LOAD), DriveOptions(), PHYSICS["reference"])
        assert not list(tmp_path.iterdir())
        simulator.close()


class TestDelays:
    def turn(self, engine: ContactEngine, world: WorldSpec, change: float) -> tuple[np.ndarray, np.ndarray]:
        """Times [s] and headings [rad] along one control period from a start at speed."""
        engine.reset(world)
        yaws = [0.0]
        engine.advance(change, look=lambda: yaws.append(engine.pose().yaw))
        return np.arange(len(yaws)) * engine.time_step, np.array(yaws)

    @pytest.mark.parametrize("name", ENGINES)
    def test_a_late_decision_is_the_same_turn_later(
        self, name: EngineName, vehicle: VehicleSpec, empty_world: WorldSpec
    ) -> None:
        prompt, late = (
            contact_engine(
                name, "reference", Conditions(decision_latency=s).applied_to(vehicle), DriveOptions(decision_period=2.0)
            )
            for s in (0.0, 0.25)
        )
        times, at_once = self.turn(prompt, empty_world, 0.6)
        _, after = self.turn(late, empty_world, 0.6)
        assert after == pytest.approx(np.interp(times - 0.25, times, at_once), abs=0.02)
        assert np.ptp(at_once) == pytest.approx(0.6, abs=0.02)

    def test_until_then_the_former_decision_is_carried_out(self, vehicle: VehicleSpec) -> None:
        times, limits = command_times(DriveOptions(decision_period=2.0)), vehicle.limits
        left, right = Goal(0.5, 2.0), Goal(-0.4, 1.0)
        plan = plan_late(0.0, 2.0, (left, right), 24, limits, times)
        former = plan_period(0.0, 2.0, *left, limits, times)
        assert (plan.headings[:25] == former.headings[:25]).all()
        assert plan.headings[-1] == pytest.approx(right.heading_change)
        assert plan.speeds[-1] == right.speed
        assert np.abs(np.diff(plan.yaw_rates)).max() < 1.01 * limits.yaw_acceleration / COMMAND_RATE

    @pytest.mark.parametrize("name", ENGINES)
    def test_wheels_lag_behind_as_a_first_order_system_does(
        self, name: EngineName, vehicle: VehicleSpec, empty_world: WorldSpec
    ) -> None:
        lag, period, a = 0.2, 0.5, vehicle.limits.acceleration
        engine = contact_engine(
            name, "reference", Conditions(wheel_lag=lag).applied_to(vehicle), DriveOptions(decision_period=period)
        )
        engine.reset(replace(empty_world, at_rest=True))
        engine.advance(0.0)
        assert engine.speed() == pytest.approx(a * (period - lag * (1 - exp(-period / lag))), rel=0.03)  # of a ramp

    @pytest.mark.parametrize("conditions", [Conditions(wheel_lag=0.1), Conditions(decision_latency=0.1)])
    def test_the_kinematic_model_refuses_them(self, conditions: Conditions) -> None:
        with pytest.raises(UserError, match="contact physics"):
            Experiment(RunConfig(simulator="kinematic", conditions=conditions)).new_simulator()

    def test_a_decision_takes_effect_before_the_next(self, vehicle: VehicleSpec) -> None:
        with pytest.raises(UserError, match="shorter latency"):
            contact_engine(
                "bullet",
                "fast",
                Conditions(decision_latency=0.5).applied_to(vehicle),
                DriveOptions(decision_period=0.5),
            )


class TestConditions:
    def test_defaults_leave_the_vehicle_as_its_files_say(self, vehicle: VehicleSpec) -> None:
        assert Conditions().applied_to(vehicle) == vehicle

    def test_they_reach_the_vehicle(self) -> None:
        config = changed(RunConfig(), conditions={"wheel_friction": 0.5, "payload": 40.0})
        experiment = Experiment(config)
        assert experiment.vehicle.contact.wheel_friction == 0.5
        assert experiment.vehicle.mass == pytest.approx(160.0)
        assert experiment.vehicle.payload == Payload(40.0, experiment.vehicle.footprint.x, 0.55)

    def test_a_slippery_floor_lets_the_vehicle_drift_wide(
        self, vehicle: VehicleSpec, empty_world: WorldSpec, engine_of: Callable[..., BulletEngine]
    ) -> None:
        ends = []
        for friction in (0.8, 0.3):
            slippery = Conditions(wheel_friction=friction).applied_to(vehicle)
            simulator = engine_of("reference", slippery, decision_period=1.0)
            simulator.reset(empty_world)
            ends.append(simulator.advance(1.0).pose)
        assert hypot(ends[0].x - ends[1].x, ends[0].y - ends[1].y) > 0.1

    @pytest.mark.parametrize(
        ("conditions", "message"),
        [
            ({"wheel_friction": 0.0}, "conditions.wheel_friction"),
            ({"payload": -1.0}, "conditions.payload"),
            ({"dead_sector": 8}, "conditions.dead_sector"),
            ({"sensor_noise": -0.1}, "conditions.sensor_noise"),
            ({"friction": 0.5}, "unknown key 'conditions.friction'"),
        ],
    )
    def test_nonsense_is_refused_by_name(self, conditions: dict[str, object], message: str) -> None:
        with pytest.raises(UserError, match=message):
            changed(RunConfig(), conditions=conditions)
