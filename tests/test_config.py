import os
from dataclasses import FrozenInstanceError
from functools import partial
from typing import Annotated, Literal

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import Field

from nnql_bullet.agents import NnqlOptions
from nnql_bullet.agents.learning.options import DoubleDqnOptions
from nnql_bullet.cli.flags import parse as parse_flags
from nnql_bullet.cli.train import train
from nnql_bullet.commands import train_arguments
from nnql_bullet.config import merged, options, parse, read_toml, to_values, write_toml
from nnql_bullet.errors import UserError
from nnql_bullet.presets import PRESETS, load_config
from nnql_bullet.run_config import Conditions, RunConfig, TrainingOptions, changed, conditions_of, migrated
from nnql_bullet.shield.shield import ShieldOptions
from nnql_bullet.sim.domain_randomization import DomainRandomization
from nnql_bullet.task import TaskOptions
from nnql_bullet.vehicle.controller import DriveOptions

numbers = st.floats(0.001, 1000, allow_subnormal=False)


@options
class Wheel:
    radius: Annotated[float, Field(gt=0)]
    colour: str = "black"


@options
class Engine:
    kind: Literal["engine"]
    power: float = 1.0


@options
class Pedals:
    kind: Literal["pedals"]
    length: int = 170
    wheel: Wheel | None = None


@options
class Cart:
    drive: Annotated[Engine | Pedals, Field(discriminator="kind")]
    front: Wheel = Wheel(radius=1.0)
    spares: tuple[Wheel, ...] = ()
    size: tuple[float, float] = (1.0, 2.0)
    seats: Annotated[int, Field(ge=1)] = 1
    covered: bool = False

    def __post_init__(self):
        if self.seats > 4 and self.covered:
            raise ValueError("no roof is that large")


ENGINE = {"kind": "engine"}


def refusal(cls, values):
    with pytest.raises(UserError) as error:
        parse(cls, values, "somewhere")
    message = str(error.value)
    assert message.startswith("somewhere: ")
    assert "\n" not in message
    return message.removeprefix("somewhere: ")


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"wheels": 3}, "unknown key 'wheels'; valid keys: covered, drive, front, seats, size, spares"),
        ({"front": {"radius": 1, "width": 2}}, "unknown key 'front.width'; valid keys: colour, radius"),
        (
            {"front": {"raduis": 1}},
            "unknown key 'front.raduis' (did you mean 'front.radius'?); valid keys: colour, radius",
        ),
        (
            {"drive": {"kind": "engine", "length": 2}},
            "unknown key 'drive.length' (it belongs to kind 'pedals'); valid keys: kind, power",
        ),
        (
            {"drive": {"kind": "pedals", "power": 2}},
            "unknown key 'drive.power' (it belongs to kind 'engine'); valid keys: kind, length, wheel",
        ),
        (
            {"drive": {"kind": "pedals", "wheel": {"radius": 1, "x": 1}}},
            "unknown key 'drive.wheel.x'; valid keys: colour, radius",
        ),
        (
            {"spares": [{"radius": 1}, {"radius": 1, "width": 2}]},
            "unknown key 'spares.1.width'; valid keys: colour, radius",
        ),
    ],
)
def test_unknown_key_lists_the_valid_ones_at_its_place(values, message):
    assert refusal(Cart, {"drive": ENGINE, **values}) == message


@pytest.mark.parametrize("drive", [{"kind": "sail"}, {}, {"power": 2.0}])
def test_unknown_or_missing_kind_lists_the_kinds(drive):
    assert refusal(Cart, {"drive": drive}) == "'drive.kind' must be one of: engine, pedals"


@pytest.mark.parametrize(
    ("values", "message"),
    [({}, "key 'drive' is missing"), ({"drive": ENGINE, "front": {}}, "key 'front.radius' is missing")],
)
def test_missing_key_is_named(values, message):
    assert refusal(Cart, values) == message


@pytest.mark.parametrize(
    ("values", "name"),
    [
        ({"seats": 1.5}, "seats"),
        ({"seats": "1"}, "seats"),
        ({"seats": True}, "seats"),
        ({"seats": 0}, "seats"),
        ({"covered": 1}, "covered"),
        ({"covered": "yes"}, "covered"),
        ({"front": 3}, "front"),
        ({"front": []}, "front"),
        ({"front": {"radius": "1"}}, "front.radius"),
        ({"front": {"radius": True}}, "front.radius"),
        ({"front": {"radius": 0.0}}, "front.radius"),
        ({"front": {"radius": -1}}, "front.radius"),
        ({"front": {"radius": float("nan")}}, "front.radius"),
        ({"front": {"radius": float("inf")}}, "front.radius"),
        ({"front": {"radius": 1.0, "colour": 3}}, "front.colour"),
        ({"spares": [{"radius": 1}, {"radius": 0}]}, "spares.1.radius"),
        ({"spares": {"radius": 1}}, "spares"),
        ({"size": [1.0]}, "size.1"),
        ({"size": [1.0, 2.0, 3.0]}, "size"),
        ({"size": [1.0, "2"]}, "size.1"),
        ({"drive": {"kind": "engine", "power": None}}, "drive.power"),
    ],
)
def test_value_of_the_wrong_type_or_range_is_named(values, name):
    message = refusal(Cart, {"drive": ENGINE, **values})
    assert f"'{name}'" in message


def test_value_is_shown_with_what_is_wrong_about_it():
    message = refusal(Cart, {"drive": ENGINE, "front": {"radius": -1}})
    assert message == "'front.radius': input should be greater than 0, not -1"


def test_rule_between_keys_is_explained():
    assert refusal(Cart, {"drive": ENGINE, "seats": 5, "covered": True}) == "no roof is that large"


def test_integers_are_numbers_and_arrays_are_tuples():
    cart = parse(Cart, {"drive": {"kind": "engine", "power": 3}, "size": [3, 4], "spares": [{"radius": 2}]}, "x")
    assert (cart.drive.power, cart.size, cart.spares) == (3.0, (3.0, 4.0), (Wheel(radius=2.0),))
    assert isinstance(cart.drive.power, float)
    assert isinstance(cart.size[0], float)


def test_options_are_frozen_checked_and_by_keyword_only():
    wheel = Wheel(radius=1.0)
    with pytest.raises(FrozenInstanceError):
        wheel.radius = 2.0
    with pytest.raises(UserError):
        Wheel(radius=-1.0)
    with pytest.raises(UserError):
        Wheel(1.0)


carts = st.builds(
    Cart,
    drive=st.builds(Engine, kind=st.just("engine"), power=st.floats(-1e300, 1e300)),
    front=st.builds(Wheel, radius=numbers, colour=st.text(st.characters(codec="utf-8"), max_size=20)),
    spares=st.lists(st.builds(Wheel, radius=numbers), max_size=3).map(tuple),
    size=st.tuples(numbers, numbers),
    seats=st.integers(1, 4),
    covered=st.booleans(),
)


@given(carts)
@settings(max_examples=60, deadline=None)
def test_options_come_back_from_toml_as_they_were(tmp_path_factory, cart):
    path = tmp_path_factory.mktemp("toml") / "cart.toml"
    path.write_text(write_toml(to_values(cart)), encoding="utf-8", newline="\n")
    assert parse(Cart, read_toml(path), str(path)) == cart


run_configs = st.builds(
    RunConfig,
    seed=st.integers(0, 2**63 - 1),
    episodes=st.integers(1, 10**6),
    physics=st.sampled_from(["fast", "reference"]),
    drive=st.builds(DriveOptions, decision_period=st.floats(1e-3, 60), speed=st.floats(1e-3, 50), heading_gain=numbers),
    task=st.builds(TaskOptions, front_distance=st.floats(0, 10), reward_non_safe_to_safe=st.floats(-2, 2)),
    agent=st.builds(NnqlOptions, gradient_step=numbers, encoding=st.sampled_from(["proximity", "distance"])),
)


@given(run_configs)
@settings(max_examples=40, deadline=None)
def test_run_config_comes_back_from_toml_as_it_was(tmp_path_factory, config):
    path = tmp_path_factory.mktemp("toml") / "config.toml"
    path.write_text(write_toml(to_values(config)), encoding="utf-8")
    assert parse(RunConfig, read_toml(path), str(path)) == config


@pytest.mark.parametrize("preset", PRESETS)
def test_presets_are_valid_and_come_back_from_their_values(preset):
    config = load_config(preset, {})
    assert parse(RunConfig, to_values(config), "values") == config


def test_preset_paper_is_the_defaults():
    assert load_config("paper", {}) == RunConfig()


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (
            {"episode": 3},
            "unknown key 'episode' (did you mean 'episodes'?); valid keys: agent, allow_impassable, conditions, drive,",
        ),
        ({"task": {"front": 3}}, "unknown key 'task.front'; valid keys: closer, front_distance, front_side_distance,"),
        (
            {"agent": {"kind": "nnql", "gamma": 0.1}},
            "unknown key 'agent.gamma'; valid keys: discount, encoding, gradient_step,",
        ),
        (
            {"agent": {"kind": "nnql", "sectors": [0]}},
            "unknown key 'agent.sectors' (it belongs to kind 'q_table'); valid keys: discount, encoding,",
        ),
        ({"seed": -1}, "'seed': input should be greater than or equal to 0, not -1"),
        (
            {"agent": {"kind": "nnql", "discount": 1.5}},
            "'agent.discount': input should be less than or equal to 1, not 1.5",
        ),
    ],
)
def test_mistakes_in_a_run_config_are_named(values, message):
    assert refusal(RunConfig, values).startswith(message)


def test_file_is_laid_over_its_preset_and_changes_over_the_file(tmp_path):
    path = tmp_path / "run.toml"
    path.write_text('preset = "literal"\nseed = 3\nepisodes = 7\n[task]\nother_distance = 1.0\n')
    config = load_config(str(path), {"seed": 4, "world": None})
    assert (config.seed, config.episodes, config.world) == (4, 7, "paper")
    assert (config.task.front_distance, config.task.other_distance) == (4.0, 1.0)
    assert config.agent.encoding == "distance"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('preset = "mine"\n', "'preset' must be one of: paper, literal"),
        ("sed = 3\n", "unknown key 'sed' (did you mean 'seed'?); valid keys: agent"),
        ("seed = \n", "cannot be read as TOML"),
        ("seed = 1\nseed = 2\n", "cannot be read as TOML"),
        ("\udcff", "is not UTF-8 (byte 0)"),
        ("seed = " + "9" * 5000, "cannot be read as TOML"),
        ("preset = ['paper']\n", "'preset' must be one of"),
        ("[preset]\nname = 'paper'\n", "'preset' must be one of"),
        ("simulator = []\n", "'simulator'"),
        ("conditions = 3\n", "'conditions'"),
        ("seed = " + "[" * 2000 + "]" * 2000, ""),
        ("vehicles = 1000000000\n", "'vehicles': input should be less than or equal to 4096"),
        ("[task]\nmax_steps = 1000000000\n", "'task.max_steps': input should be less than or equal to 100000"),
        ("[drive]\ndecision_period = 1e300\n", "'drive.decision_period': input should be less than or equal to 60"),
        ("[agent]\nhidden_units = 10000000\n", "'agent.hidden_units': input should be less than or equal to 4096"),
        ("[drive]\nspeed = nan\n", "'drive.speed': input should be a finite number"),
    ],
)
def test_mistake_in_a_file_is_one_line_that_names_the_file(tmp_path, text, message):
    path = tmp_path / "run.toml"
    path.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(UserError) as refusal:
        load_config(str(path), {})
    assert str(refusal.value).startswith(f"{path}: {message}")
    assert "\n" not in str(refusal.value)


def test_a_name_that_is_not_utf_8_is_refused_as_such():
    with pytest.raises(UserError, match="mine: the name of a file is not UTF-8; rename it"):
        parse(RunConfig, {"world": os.fsdecode(b"latin-\xe9.toml")}, "mine")


def test_file_with_a_byte_order_mark_is_read(tmp_path):
    path = tmp_path / "run.toml"
    path.write_bytes(b"\xef\xbb\xbfseed = 7\n")
    assert load_config(str(path), {}).seed == 7


@pytest.mark.parametrize("name", ["x" * 5000, "a\0b", "folder"])
def test_name_that_no_file_can_have_is_refused(tmp_path, monkeypatch, name):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "folder").mkdir()
    with pytest.raises(UserError, match="there is no preset or file") as refusal:
        load_config(name, {})
    assert str(refusal.value).isprintable()


def test_number_of_thousands_of_digits_is_refused():
    with pytest.raises(UserError, match="too many digits"):
        changed(RunConfig(), vehicles=10**5000)


def test_unknown_preset_lists_the_presets():
    with pytest.raises(UserError, match="no preset or file 'mine'; give a TOML file or one of: paper, literal"):
        load_config("mine", {})


def test_missing_file_is_an_error(tmp_path):
    with pytest.raises(UserError, match="there is no such file"):
        read_toml(tmp_path / "nowhere.toml")


def test_changed_replaces_what_is_given():
    config = RunConfig(seed=5)
    assert changed(config, seed=None, episodes=3) == RunConfig(seed=5, episodes=3)
    assert config == RunConfig(seed=5)
    with pytest.raises(UserError, match="configuration: unknown key 'sed'"):
        changed(config, sed=1)


def test_a_table_of_another_kind_replaces_the_one_below():
    base = {"layout": {"kind": "random_boxes", "cover": 0.1}, "width": 10.0}
    assert merged(base, {"layout": {"kind": "boxes", "boxes": []}}) == {
        "layout": {"kind": "boxes", "boxes": []},
        "width": 10.0,
    }
    assert merged(base, {"layout": {"kind": "random_boxes", "cover": 0.2}})["layout"]["cover"] == 0.2


def test_merged_lays_tables_over_tables_and_changes_neither():
    base, changes = {"a": {"b": 1, "c": {"d": 2}}, "e": 3}, {"a": {"c": {"d": 4}}, "e": {"f": 5}}
    assert merged(base, changes) == {"a": {"b": 1, "c": {"d": 4}}, "e": {"f": 5}}
    assert base == {"a": {"b": 1, "c": {"d": 2}}, "e": 3}
    assert changes == {"a": {"c": {"d": 4}}, "e": {"f": 5}}


OLD = """
seed = 3
simulator = "twin"
[conditions]
payload = 40.0
[conditions.sensors]
noise = 0.1
dead_sector = 2
[training.disturbances]
noise = 0.05
[agent]
kind = "double_dqn"
seen_map = false
[shield]
leads = false
"""
"""As version 0.1 wrote it."""


def test_a_configuration_of_version_0_1_is_read_under_the_names_of_now(tmp_path):
    path = tmp_path / "config.toml"
    path.write_text(OLD)
    old = read_toml(path)
    config = parse(RunConfig, migrated(old), "old")
    assert config == RunConfig(
        seed=3,
        simulator="kinematic",
        conditions=Conditions(payload=40.0, sensor_noise=0.1, dead_sector=2),
        training=TrainingOptions(domain_randomization=DomainRandomization(noise=0.05)),
        agent=DoubleDqnOptions(grid_map=False),
        shield=ShieldOptions(recovers=False),
    )
    assert old == read_toml(path)
    assert migrated(to_values(config)) == to_values(config)


@pytest.mark.parametrize("preset", PRESETS)
def test_flags_of_a_training_give_its_configuration_again(preset):
    changes = {"seed": 2, "task": {"front_distance": 6.5}, "conditions": {"dead_sector": 0}, "simulator": "mujoco"}
    config = load_config(preset, changes)
    base, flags = train_arguments(config)
    assert base == preset
    call = parse_flags(train, "train", flags)
    assert isinstance(call, partial)
    assert load_config(base, call.keywords["keys"]) == config


def test_conditions_that_are_given_replace_the_others():
    config = RunConfig(conditions=Conditions(wheel_friction=0.5, payload=40.0))
    assert changed(config, conditions=Conditions(payload=80.0)).conditions == Conditions(payload=80.0)
    assert changed(config, conditions=None) == config
    assert conditions_of({}) is None
    assert Conditions(payload=80.0, dead_sector=0).title == "payload 80, dead sector 0"
