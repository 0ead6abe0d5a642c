"""What is foreseen of manoeuvres and searched among them: against what the simulator then does, and brute force."""

from dataclasses import replace

import numpy as np
import pytest

from nnql_bullet.agents.base import Reflex
from nnql_bullet.agents.foresight import Foresight, SearchOptions
from nnql_bullet.env import ACTIONS, MANOEUVRES, STOP, Navigation
from nnql_bullet.experiment import Experiment
from nnql_bullet.mapping.foresight import LASTS, MOST_ROOM, ROOM
from nnql_bullet.presets import load_config
from nnql_bullet.shield.prediction import clear_by_margin
from nnql_bullet.shield.shield import Shield, ShieldOptions
from nnql_bullet.sim.kinematic import KinematicSimulator
from nnql_bullet.task import TaskOptions
from nnql_bullet.vehicle.controller import DriveOptions
from nnql_bullet.vehicle.spec import VehicleSpec
from nnql_bullet.worlds.source import World


@pytest.fixture(scope="module")
def vehicle():
    its = VehicleSpec.load("tricycle")
    return replace(its, sensor=replace(its.sensor, rays=720))


def set_out(vehicle, boxes):
    """24 vehicles at one start among boxes, and what they foresee."""
    drive = DriveOptions()
    world = World.from_boxes(boxes, name="boxes").draw(seed=0)
    navigation = Navigation(KinematicSimulator(vehicle, drive, MANOEUVRES, 1), TaskOptions())
    navigation.reset(dict.fromkeys(range(MANOEUVRES), world))
    foresight = Foresight(vehicle, drive)
    o = navigation.observation
    look = foresight.ahead(foresight.look(foresight.nothing(MANOEUVRES), o), o)
    return navigation, foresight, look


def test_every_manoeuvre_comes_as_near_as_foreseen(vehicle):
    x, y = World.load("paper").start
    boxes = [(x + 1.2, y - 0.6, 0.8, 0.8), (x - 0.7, y + 1.1, 1.0, 0.6), (x + 0.9, y + 2.1, 0.6, 0.6)]
    navigation, foresight, look = set_out(vehicle, boxes)
    actions = np.arange(MANOEUVRES)
    foreseen = look.foreseen[actions, actions]
    t = navigation.step(actions)
    room = np.minimum(t.motion.clearance, MOST_ROOM)
    assert (room < MOST_ROOM).sum() > MANOEUVRES / 2
    assert np.abs(foreseen[:, ROOM] - room)[~t.motion.touching].max() < 0.03
    assert (foreseen[t.motion.touching, ROOM] < 0.03).all()
    assert (foreseen[~t.motion.touching & (foreseen[:, ROOM] > 0.03), LASTS] > 0.25).all()
    after = foresight.after(look, navigation.observation, actions)
    assert np.array_equal(after.age, np.ones(MANOEUVRES))


def test_a_deeper_search_does_not_choose_what_leads_to_a_contact(vehicle):
    """One step ahead it may turn toward the wall; it never chooses what cannot be followed by a stop."""
    x, y = World.load("paper").start
    navigation, foresight, look = set_out(vehicle, [(x + 2.5, y + 2.5, 0.5, 8.0), (x, y + 4.5, 8.0, 0.5)])
    for depth in (1, 3):
        scores, then = foresight.searched(look, navigation.observation, SearchOptions(depth=depth))
        assert scores.shape == (MANOEUVRES, MANOEUVRES)
        assert (scores == scores[0]).all()
        best = int(scores[0].argmax())
        assert look.foreseen[0, best, LASTS] == 1.0
        assert (then[0] >= 0) == (depth > 1)


def test_a_pose_costs_with_every_visit_until_another_is_better(vehicle):
    """To stay is worth less by the same for each time; what leads away keeps its worth."""
    x, y = World.load("paper").start
    navigation, foresight, look = set_out(vehicle, [(x + 9.0, y + 9.0, 0.5, 0.5)])
    stay, leave = STOP, 0
    scores = []
    standing = replace(navigation.observation, speed=np.zeros(MANOEUVRES), yaw_rate=np.zeros(MANOEUVRES))
    for visits in (1, 2, 3):
        trails = np.full_like(look.memory.trails, np.inf)
        trails[:, :visits] = look.memory.poses[:, None]
        there = replace(look, memory=replace(look.memory, trails=trails))
        scores.append(foresight.searched(there, standing, SearchOptions(depth=1, room_weight=0.0))[0][0])
    worth = np.array(scores)
    assert np.diff(worth[:, stay]) == pytest.approx([worth[1, stay] - worth[0, stay]] * 2)
    assert worth[1, stay] < worth[0, stay] - 0.1
    assert worth[:, leave] == pytest.approx([worth[0, leave]] * 3)


def test_a_network_takes_what_meets_nothing_and_at_the_worst_what_meets_it_last(vehicle):
    x, y = World.load("paper").start
    _, foresight, look = set_out(vehicle, [(x + 2.5, y + 2.5, 0.5, 8.0), (x, y + 4.5, 8.0, 0.5)])
    free = look.foreseen[0, :, LASTS] == 1.0
    assert free.any() and not free.all()
    worst_first = np.broadcast_to(np.where(free, 0.0, 5.0), (MANOEUVRES, MANOEUVRES))
    assert free[foresight.chosen(look, worst_first, 0.0)].all()
    all_meet = look.foreseen.copy()
    all_meet[..., LASTS] = np.minimum(np.linspace(0.1, 0.9, MANOEUVRES), 0.8)
    chosen = foresight.chosen(replace(look, foreseen=all_meet), np.tile(-np.arange(24.0), (MANOEUVRES, 1)), 0.0)
    assert (all_meet[0, chosen, LASTS] == 0.8).all()


@pytest.mark.parametrize(("side", "slower"), [(0.04, True), (0.6, False)])
def test_near_something_thin_it_drives_slowly(vehicle, side, slower):
    """Where rays meet one thin thing, they may miss another."""
    x, y = World.load("paper").start
    navigation, foresight, look = set_out(vehicle, [(x + 0.2, y + 2.2, side, side)])
    for caution, expected in ((0.0, False), (SearchOptions().caution, slower)):
        scores, _ = foresight.searched(look, navigation.observation, SearchOptions(caution=caution))
        assert (scores[0].argmax() >= STOP) == expected


def test_it_is_too_fast_where_a_shield_admits_no_full_speed(vehicle):
    """Against the shield's own kernels, which know the scan alone."""
    drive, task = DriveOptions(), TaskOptions()
    foresight = Foresight(vehicle, drive)
    shield = Shield(ShieldOptions(), Reflex(lambda o: np.zeros(len(o.speed), np.int64)), vehicle, drive, task)
    navigation = Navigation(KinematicSimulator(vehicle, drive, 24, 1), task)
    x, y = World.load("paper").start
    beside = np.linspace(-1.5, 3.0, 24)
    walls = [[(x + 1.0 + its, y + 2.5, 1.0, 0.4), (x - 2.0, y + 4.0 + its, 0.6, 3.0)] for its in beside]
    navigation.reset({i: World.from_boxes(its, name="boxes").draw(seed=0) for i, its in enumerate(walls)})
    o = navigation.observation
    look = foresight.look(foresight.nothing(24), o, paced=True)
    _, memories = shield.perceived(o, shield.initial_state(24).memories)
    admitted = np.empty((24, ACTIONS), np.bool_)
    for i in range(24):
        motion = float(o.yaw_rate[i]), float(o.speed[i])
        clear_by_margin(shield._setting, memories[i].known, look.turns[i, :ACTIONS].copy(), *motion, admitted[i])
    assert 0.1 < admitted.mean() < 0.9
    assert (look.too_fast[:, :ACTIONS] != admitted).mean() > 0.97
    assert not look.too_fast[:, ACTIONS:].any()


@pytest.mark.parametrize("kind", ["guided_search", "distilled"])
def test_it_asks_for_room_by_itself_in_a_shield(kind):
    def paced(shield, **given):
        agent = given if kind == "guided_search" else {"search": given}
        changes = {"agent": {"kind": kind, **agent}, **({"shield": {}} if shield else {})}
        options = Experiment(load_config("paper", changes)).agent.options
        return (options if kind == "guided_search" else options.search).paced

    assert paced(True) and not paced(False)
    assert not paced(True, paced=False) and paced(False, paced=True)
