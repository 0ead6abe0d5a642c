"""Classes of input: a valid file of each, what may happen to it, and the reader that a user would reach with it."""

import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from random import Random

import mutators
import numpy as np
import trimesh
from PIL import Image

import nnql_bullet as nb
from nnql_bullet import assets
from nnql_bullet.config import to_values, write_toml
from nnql_bullet.env import Navigation
from nnql_bullet.evaluation.drives import draw_tiers
from nnql_bullet.evaluation.parts import Parts
from nnql_bullet.evaluation.policies import open_policies
from nnql_bullet.evaluation.replays import open_evaluation
from nnql_bullet.evaluation.splits import Draws, load_frozen
from nnql_bullet.experiment import Experiment
from nnql_bullet.presets import PRESETS, load_config
from nnql_bullet.recording import load_recording
from nnql_bullet.reports.html import open_results
from nnql_bullet.rollout import EpisodeSummary
from nnql_bullet.run_config import RunConfig, changed
from nnql_bullet.runs import load_policy, load_run
from nnql_bullet.session import check
from nnql_bullet.setting import Setting
from nnql_bullet.sources import changed_sources, located
from nnql_bullet.vehicle.urdf import load_vehicle
from nnql_bullet.worlds.importers.barn import path_file, reference_length, world_files
from nnql_bullet.worlds.waypoints import read_waypoints

Changed = Callable[[bytes, Random], bytes]


@dataclass(frozen=True)
class Target:
    """A class of input."""

    folder: Path
    """Holds valid files; a copy of it is read."""
    files: dict[str, Changed]
    """What may happen to each of its files."""
    read: Callable[[Path], object]
    """Reads a folder like it."""


def targets(home: Path) -> dict[str, Target]:
    """Makes the valid files of every class below a folder."""
    home.mkdir(parents=True, exist_ok=True)
    run = home / "trained"
    kinematic = {"simulator": "kinematic", "task": {"max_steps": 30}}
    few = {"vehicles": 2, "episodes": 4, **kinematic}
    nb.train("paper", out=run, **few)
    nb.train(
        "double_dqn",
        out=home / "double",
        vehicles=2,
        episodes=2,
        agent={"hidden": [8], "buffer_size": 100, "learning_starts": 4},
        training={"worlds": []},
        **kinematic,
    )
    nb.evaluate(["straight", str(run)], worlds=["empty"], n_worlds=2, simulator="kinematic", out=home / "evaluated")
    recording = nb.drive("straight", world="traps", simulator="kinematic")
    recording.save(_made(home / "recorded") / "trajectory.npz")
    robots = _made(home / "robot")
    for name in ("tricycle.toml", "tricycle.urdf"):
        (robots / name).write_bytes((assets.folder("robots") / name).read_bytes())
    worlds = _made(home / "worlds")
    for path in assets.folder("worlds").glob("*.toml"):
        (worlds / path.name).write_bytes(path.read_bytes())
    (worlds / "fixed.toml").write_text(_BOXES)
    (worlds / "based.toml").write_text('base = "fixed"\nwidth = 60\n')
    maps = _made(home / "maps")
    for name in ("fixed", "based", "rooms"):
        (maps / f"{name}.toml").write_bytes((worlds / f"{name}.toml").read_bytes())
    foreign = _foreign_files(_made(home / "foreign"))
    configs = _made(home / "configs")
    for name, config in PRESETS.items():
        (configs / f"{name}.toml").write_text(_config_text(config))
    (configs / "led.toml").write_text(_config_text(changed(PRESETS["paper"], **_LED)))
    splits = _made(home / "splits")
    (splits / "splits.json").write_bytes((assets.folder("worlds") / "splits.json").read_bytes())
    parts = _made(home / "parts")
    summaries = [path for path in (home / "evaluated" / "parts").glob("*.json") if "ending" in path.read_text()]
    (parts / "a.json").write_bytes(summaries[0].read_bytes())
    toml, json_, csv, st = (
        mutators.toml_changed,
        mutators.json_changed,
        mutators.csv_changed,
        mutators.safetensors_changed,
    )
    nb.train("paper", out=home / "sourced", world=worlds / "based.toml", robot=robots / "tricycle.toml", **few)
    policies = open_policies([str(run)])
    return {
        "configuration": Target(configs, {path.name: toml for path in configs.iterdir()}, _configure),
        "worlds": Target(worlds, {path.name: toml for path in worlds.iterdir()}, _draw),
        "folders of worlds": Target(
            maps, {"fixed.toml": mutators.bytes_changed, "based.toml": toml, "rooms.toml": toml}, _draw_folder
        ),
        "maps": Target(foreign, _FOREIGN, _import),
        "BARN": Target(_barn(home / "barn"), _BARN, _import_barn),
        "way points": Target(
            _waypoints(home / "waypoints"),
            {"bare.csv": csv, "named.csv": csv, "list.json": json_, "object.json": json_},
            lambda folder: read_waypoints(_changed_file(folder)),
        ),
        "descriptions": Target(_described(home / "described", robots / "tricycle.urdf"), _DESCRIBED, _describe),
        "robots": Target(robots, {"tricycle.toml": toml, "tricycle.urdf": mutators.bytes_changed}, _load_robot),
        "policies": Target(run, {"policy.safetensors": st}, lambda folder: load_policy(folder / "policy.safetensors")),
        "checkpoints": Target(
            home / "double", {"checkpoint.safetensors": st, "config.toml": toml, "episodes.csv": csv}, _resume
        ),
        "episodes.csv": Target(run, {"episodes.csv": csv, "selection.csv": csv}, load_run),
        "recordings": Target(home / "recorded", {"trajectory.npz": mutators.npz_changed}, _watch),
        "results.json": Target(
            home / "evaluated",
            {"results.json": json_, "episodes.csv": csv},
            lambda folder: (open_evaluation(folder), open_results("evaluate", folder, policies)),
        ),
        "splits": Target(splits, {"splits.json": json_}, lambda folder: load_frozen(folder / "splits.json")),
        "sources": Target(
            home / "sourced",
            {"sources.json": json_},
            lambda folder: (located(load_run(folder).config, folder), changed_sources(folder)),
        ),
        "parts": Target(parts, {"a.json": json_}, lambda folder: Parts(folder).load("a", EpisodeSummary)),
    }


_BOXES = """\
width = 40
depth = 40
start = [5, 5]
target = [35, 35]

[layout]
kind = "boxes"

[[layout.boxes]]
x = 20
y = 20
length = 3
width = 2
yaw_degrees = 30

[patrols]
count = 2
"""

_FOREIGN: dict[str, Changed] = {
    "map.yaml": mutators.numbers_changed,
    "map.pgm": mutators.numbers_changed,
    "other.yaml": mutators.numbers_changed,
    "other.png": mutators.bytes_changed,
    "hall.world": mutators.numbers_changed,
    "world_3.world": mutators.numbers_changed,
    "path_3.npy": mutators.bytes_changed,
    "cells.map": mutators.numbers_changed,
    "plan.geojson": mutators.json_changed,
}


def _foreign_files(folder: Path) -> Path:
    """Maps and worlds of other programs."""
    for name in ("map.yaml", "hall.world"):
        nb.export_world("rooms", folder / name, seed=1, cell=0.2)
    with Image.open(folder / "map.pgm") as image:
        image.save(folder / "other.png")
    (folder / "other.yaml").write_text((folder / "map.yaml").read_text().replace("map.pgm", "other.png"))
    nb.export_world("cells", folder / "world_3.world", seed=1)
    np.save(folder / "path_3.npy", np.array([[1, 2], [3, 4]]))
    rows = ["." * 30] * 10 + ["." * 12 + "@@TTWW" + "." * 12] * 4 + ["." * 30] * 10
    (folder / "cells.map").write_text("\n".join(["type octile", "height 24", "width 30", "map", *rows, ""]))
    ring, hole = [[0, 0], [9, 1], [5, 8], [0, 0]], [[4, 3], [5, 3], [5, 4], [4, 3]]
    square = [[20, 0], [24, 0], [24, 3], [20, 3], [20, 0]]
    shapes = [{"type": "Polygon", "coordinates": [ring, hole]}, {"type": "MultiPolygon", "coordinates": [[square]]}]
    shapes.append({"type": "Point", "coordinates": [1, 2]})
    features = [{"type": "Feature", "properties": {"name": "a"}, "geometry": shape} for shape in shapes]
    (folder / "plan.geojson").write_text(json.dumps({"type": "FeatureCollection", "features": features}))
    return folder


_LED = {
    "start": [2.0, 2.0, 0.5],
    "waypoints": [[5.0, 5.0], [40.0, 40.0]],
    "plan": {"look_ahead": 3.0, "room": 1.0},
    "shield": {"margin": 0.1},
    "conditions": {"payload": 10.0},
}
_BARN = {f"worlds/world_{n}.world": mutators.numbers_changed for n in (0, 7)} | {
    f"path_files/path_{n}.npy": mutators.bytes_changed for n in (0, 7)
}
_DESCRIBED: dict[str, Changed] = {
    "mine.urdf": mutators.numbers_changed,
    "mine.xacro": mutators.numbers_changed,
    "body.stl": mutators.bytes_changed,
    "body.obj": mutators.numbers_changed,
    "body.dae": mutators.numbers_changed,
}


def _barn(folder: Path) -> Path:
    """A folder as that of BARN, of two worlds."""
    for name in ("worlds", "path_files"):
        _made(folder / name)
    for number in (0, 7):
        nb.export_world("cells", folder / "worlds" / f"world_{number}.world", seed=number)
        np.save(folder / "path_files" / f"path_{number}.npy", np.array([[1, 2], [3, 4], [5, 9]]))
    return folder


def _waypoints(folder: Path) -> Path:
    places = [[1.5, 2.0], [-3.0, 4e1], [5.0, 6.0]]
    _made(folder)
    (folder / "bare.csv").write_text("# places\n" + "".join(f"{x},{y}\n" for x, y in places))
    (folder / "named.csv").write_text("name,x,y\n" + "".join(f"a,{x},{y}\n" for x, y in places))
    (folder / "list.json").write_text(json.dumps(places))
    (folder / "object.json").write_text(json.dumps({"waypoints": [{"x": x, "y": y} for x, y in places]}))
    return folder


def _described(folder: Path, shipped: Path) -> Path:
    """A robot whose body is meshes, as a URDF and a xacro."""
    _made(folder)
    text, kinds = shipped.read_text(), ("stl", "obj", "dae")
    for kind in kinds:
        trimesh.creation.box((1.1, 0.65, 0.28)).export(folder / f"body.{kind}")
    own = re.findall(r"<collision>.*?</collision>", text, re.DOTALL)[0]
    text = text.replace(own, "".join(re.sub(r"<box [^>]*>", f'<mesh filename="body.{kind}"/>', own) for kind in kinds))
    (folder / "mine.urdf").write_text(text)
    macro = '<xacro:property name="r" value="${0.5 * 0.25}"/><xacro:arg name="a" default="1"/>'
    head = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="tricycle">'
    text = re.sub("<robot [^>]*>", head + macro, text).replace('radius="0.125"', 'radius="${r * $(arg a)}"')
    (folder / "mine.xacro").write_text(text)
    return folder


def _made(folder: Path) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def _config_text(config: RunConfig) -> str:
    return write_toml(to_values(config) | {"world": "empty"})


def _changed_file(folder: Path) -> Path:
    """The file that was changed last."""
    return max(folder.iterdir(), key=lambda path: path.stat().st_mtime_ns)


def _configure(folder: Path) -> None:
    config = load_config(str(_changed_file(folder)), {})
    check(config)
    experiment = Experiment(config)
    experiment.agent  # noqa: B018 (makes it)
    experiment.training_world(0)


def _draw(folder: Path) -> None:
    world = nb.World.load(_changed_file(folder))
    world.draw(0).digest  # noqa: B018 (hashes it)


def _draw_folder(folder: Path) -> None:
    kinematic, draws = Setting("kinematic", "reference"), Draws(range(700_000, 700_002), None)
    (tier,), refused = draw_tiers([folder], draws, kinematic, open_policies("straight"))
    if {its.file for its in (*tier.worlds, *refused)} != {str(path) for path in folder.iterdir()}:
        raise RuntimeError(f"{folder}: a file is neither drawn nor refused")


def _import(folder: Path) -> None:
    changed = _changed_file(folder)
    if changed.suffix == ".npy":
        reference_length(changed)
        return
    path = changed.with_suffix(".yaml") if changed.suffix in (".pgm", ".png") else changed
    nb.import_world(path).world.draw(0, allow_impassable=True).digest  # noqa: B018 (hashes it)


def _import_barn(folder: Path) -> None:
    for world in world_files(folder).values():
        nb.import_world(world).world.draw(0, allow_impassable=True).digest  # noqa: B018 (hashes it)
        if (path := path_file(world)) is not None:
            reference_length(path)


def _describe(folder: Path) -> None:
    changed = _changed_file(folder)
    nb.read_robot(changed if changed.suffix == ".xacro" else folder / "mine.urdf")


def _load_robot(folder: Path) -> None:
    load_vehicle(folder / "tricycle.toml")


def _resume(folder: Path) -> None:
    run = load_run(folder)
    check(run.config)
    experiment = Experiment(run.config)
    experiment.training_world(0)
    if run.state:
        experiment.trainable.load_state_dict(run.state.learned)
        trainer = experiment.trainer(Navigation(experiment.new_training_simulator(1), run.config.task))
        trainer.load_state_dict(run.state.under_way)


def _watch(folder: Path) -> None:
    recording = load_recording(folder / "trajectory.npz")
    (recording.world, recording.footprint, recording.term_names, recording.boxes_at(1.0))
    if "summary" in recording.about:
        recording.summary  # noqa: B018 (makes it)
