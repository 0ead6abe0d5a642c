"""The library as `import nnql_bullet` gives it: quick to import, silent, and open to objects of the caller."""

import ast
import doctest
import functools
import inspect
import re
import subprocess
import sys
import typing
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import nnql_bullet as nb
from nnql_bullet.agents.learning.nnql import Nnql
from nnql_bullet.agents.learning.options import NnqlOptions
from nnql_bullet.experiment import Experiment
from nnql_bullet.run_config import RunConfig
from nnql_bullet.task import REWARD_TERMS, RewardTerm, TaskOptions, paper_reward

EXAMPLES = [name for name in nb.__all__ if "Example:" in (getattr(nb, name).__doc__ or "")]
WITHOUT_EXAMPLE = {
    "RobotWarning",
    "Conditions",
    "Progress",
    "Recording",
    "UserError",
    "Vehicle",
    "WorkFailed",
    "envelope",
    "load_run",
}
SLOW = {"check_fidelity"}
TAKEN = {
    name: inspect.signature(getattr(nb, name)).parameters
    for name in nb.__all__
    if inspect.isfunction(getattr(nb, name))
}
"""Parameters of each function."""


def fresh(code: str) -> str:
    """What a new Python prints."""
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty folder to work in."""
    monkeypatch.chdir(tmp_path)
    yield tmp_path


class TestImport:
    def test_brings_nothing_heavy_along(self) -> None:
        heavy = "{'numpy', 'torch', 'gymnasium', 'numba', 'pydantic', 'matplotlib'}"
        assert fresh(f"import nnql_bullet, sys; print({heavy} & sys.modules.keys())") == "set()"

    def test_driving_a_rule_brings_along_what_it_needs_alone(self, here: Path) -> None:
        others = "torch gymnasium pybullet mujoco http.client optuna ray"
        ours = "nnql_bullet.api nnql_bullet.gym_env nnql_bullet.render nnql_bullet.session nnql_bullet.cli.worlds"
        drive = "main(['drive', 'straight', '--sim', 'kinematic', '--world', 'empty', '--out', '.', '--json'])"
        heavy = f"{{*'{others} {ours}'.split()}}"
        said = fresh(f"import sys; from nnql_bullet.cli import main; {drive}; print({heavy} & sys.modules.keys())")
        assert said.splitlines()[-1] == "set()"

    @pytest.mark.parametrize("order", ["nnql_bullet, gymnasium", "gymnasium, nnql_bullet"])
    def test_makes_the_environment_known_in_either_order(self, order: str) -> None:
        assert fresh(f"import {order}; print('nnql_bullet/Tricycle-v0' in gymnasium.registry)") == "True"

    def test_takes_paths_as_text(self) -> None:
        """Whatever takes a path takes its text too."""
        for name, parameters in TAKEN.items():
            hints = [its.annotation for its in parameters.values()]
            assert all(str in kinds for kinds in map(typing.get_args, hints) if Path in kinds), name
            assert Path not in hints, name

    def test_says_what_each_argument_is(self) -> None:
        for name, parameters in TAKEN.items():
            about = (inspect.getdoc(getattr(nb, name)) or "").partition("Args:\n")[2].partition("\n\n")[0]
            assert sorted(re.findall(r"^ {4}\*{0,2}(\w+): ", about, re.MULTILINE)) == sorted(parameters), name

    def test_help_shows_no_default_of_an_argument_of_a_group(self) -> None:
        assert "shield: bool = ..., " in str(inspect.signature(nb.drive))

    def test_every_name_is_there_typed_and_listed(self) -> None:
        (checked,) = [node for node in ast.parse(Path(nb.__file__).read_text()).body if isinstance(node, ast.If)]
        typed = {
            alias.asname or alias.name: f"{line.module}.{alias.name}"
            for line in checked.body
            if isinstance(line, ast.ImportFrom)
            for alias in line.names
        }
        assert sorted(typed) == sorted(nb.__all__)
        for name, full in typed.items():
            module, _, inside = full.rpartition(".")
            assert getattr(nb, name) is getattr(import_module(module), inside)
        assert set(nb.__all__) < set(dir(nb))
        with pytest.raises(AttributeError, match="no attribute 'nothing'"):
            nb.nothing  # noqa: B018


@pytest.mark.parametrize("name", [pytest.param(n, marks=[pytest.mark.slow] if n in SLOW else []) for n in EXAMPLES])
def test_the_example_of_a_docstring_runs(name: str, here: Path) -> None:
    (example, *_) = doctest.DocTestFinder(recurse=False).find(getattr(nb, name), name, globs={})
    assert example.examples
    result = doctest.DocTestRunner().run(example)
    assert result.failed == 0


def test_every_function_has_an_example() -> None:
    assert set(nb.__all__) - set(EXAMPLES) == WITHOUT_EXAMPLE


class TestArguments:
    @pytest.mark.parametrize(
        ("name", "arguments", "said"),
        [
            ("train", {"out": 1.5}, "'out' must be a path or text or None, not a value of type float"),
            ("train", {"workers": True}, "'workers' must be a whole number or None"),
            ("train", {"overwrite": "no"}, "'overwrite' must be True or False, not 'no'"),
            ("train", {"config": 10**5000}, "'config' is a number of too many digits"),
            ("train", {"on_progress": 3}, "'on_progress' must be a function or None"),
            ("train", {"reward": ["speed"]}, "'reward' must be a Sequence or a function or None"),
            ("train", {"agent": 0}, "a int cannot learn"),
            ("train", {"agent": "vfh"}, "a str cannot learn"),
            ("resume", {"folder": None}, "'folder' must be a path or text"),
            ("drive", {"policy": "vfh", "seed": "1"}, "'seed' must be a whole number, not '1'"),
            ("drive", {"policy": "vfh", "changes": [1]}, "'changes' must be a Mapping"),
            ("evaluate", {"policies": "vfh", "worlds": "traps"}, "'worlds' must be a Sequence, not 'traps'"),
            ("evaluate", {"policies": "vfh", "n_worlds": 2.0}, "'n_worlds' must be a whole number"),
            (
                "gap",
                {"policies": "vfh", "split": "tests"},
                "'split' must be 'validation' or 'test' or None, not 'tests'",
            ),
            ("ablate", {"only": "hysteresis"}, "'only' must be a Sequence or None"),
            ("make_env", {"n_envs": "2"}, "'n_envs' must be a whole number or None, not '2'"),
            ("train", {"out": "a\0b"}, "'out': no file can be named 'a\\x00b'"),
            ("resume", {"folder": "\ud800"}, "'folder': no file can be named '\\ud800'"),
            ("evaluate", {"policies": "vfh", "n_worlds": 10**5000}, "'n_worlds' is a number of too many digits"),
            ("ablate", {"seeds": 10**12}, "seeds must be from 1 to 1000, not 1000000000000"),
            ("drive", {"policy": "vfh", "changes": {1: 2}}, "'changes' must be a Mapping"),
            (
                "Conditions",
                {"payload": -1},
                "Conditions: 'payload': input should be greater than",
            ),
            ("Conditions", {"load": 1}, "Conditions: unknown key 'load'"),
            ("World", {}, "World: key 'layout' is missing"),
        ],
    )
    def test_of_a_wrong_type_are_refused_before_anything_is_done(
        self, here: Path, name: str, arguments: dict[str, Any], said: str
    ) -> None:
        with pytest.raises(nb.UserError) as caught:
            getattr(nb, name)(**arguments)
        assert str(caught.value).startswith(said)
        assert not list(here.iterdir())

    def test_may_be_numbers_of_numpy(self, here: Path) -> None:
        task = {"max_steps": np.int16(3), "hysteresis": np.float32(0.5)}
        few: dict[str, Any] = {"vehicles": np.int64(2), "seed": np.uint8(1), "episodes": np.int64(2), "task": task}
        run = nb.train(simulator="kinematic", workers=np.int64(1), out="run", **few)
        assert (run.config.seed, run.config.vehicles, run.config.task.hysteresis) == (1, 2, 0.5)
        assert nb.drive("vfh", simulator="kinematic", seed=np.int64(3)).world.seed == 3

    def test_of_methods_are_checked_too(self, here: Path) -> None:
        world = nb.World.load("cover_10")
        recording = nb.drive("vfh", simulator="kinematic", changes={"task": {"max_steps": 2}})
        for call, said in (
            (lambda: nb.World.from_boxes(None), "'boxes' must be"),  # type: ignore[arg-type]
            (lambda: world.draw("1"), "'seed' must be a whole number"),  # type: ignore[arg-type]
            (lambda: world.draw(-1), "a world seed must be from 0"),
            (lambda: recording.save(None), "'path' must be a path or text"),  # type: ignore[arg-type]
            (lambda: recording.plot("drive.xyz"), r"drive.xyz: pictures are .png"),
            (lambda: recording.render("a.gif", size="x"), "'size' must be"),
        ):
            with pytest.raises(nb.UserError, match=said):
                call()
        assert not list(here.iterdir())
        with pytest.raises(TypeError, match=r"drive\(\) got an unexpected keyword argument 'worlds'"):
            nb.drive("vfh", worlds="traps")  # type: ignore[call-arg]


class Constant:
    """Always does the same."""

    def __init__(self, action: int) -> None:
        self.action = action
        self.decisions = 0

    def act(self, observations: Any) -> Any:
        self.decisions += 1
        return np.full(len(observations.readings), self.action)


class TestOwnPolicy:
    def test_drives_as_the_rule_that_does_the_same(self, here: Path, capfd: pytest.CaptureFixture[str]) -> None:
        own = Constant(5)
        mine = nb.drive(own, world="cover_10", seed=3, simulator="kinematic")
        rule = nb.drive("straight", world="cover_10", seed=3, simulator="kinematic")
        assert mine.summary == rule.summary
        assert mine.about["policy"] == "Constant"
        assert not list(here.iterdir()), "a drive writes nothing by itself"
        assert capfd.readouterr().out == ""

    def test_is_evaluated_beside_others(self, here: Path, capfd: pytest.CaptureFixture[str]) -> None:
        arguments: dict[str, Any] = {"worlds": ["cover_10"], "n_worlds": 3, "simulator": "kinematic"}
        seen: list[nb.Progress] = []
        results = nb.evaluate([Constant(5), Constant(0), "straight"], **arguments, on_progress=seen.append)
        by_method = {row["method"]: row for row in results.rows}
        assert list(by_method) == ["Constant", "Constant 2", "straight"]
        assert by_method["Constant"]["goal"] == by_method["straight"]["goal"]
        assert seen[0].done == 0 and seen[-1].done == seen[-1].total == 9
        assert not list(here.iterdir()) and capfd.readouterr().out == ""

    def test_is_driven_anew_where_results_are_kept(self, here: Path) -> None:
        arguments: dict[str, Any] = {"worlds": ["cover_10"], "n_worlds": 2, "simulator": "kinematic", "out": "out"}
        own = Constant(5)
        nb.evaluate(own, **arguments)
        before = own.decisions
        nb.evaluate(own, **arguments)
        assert own.decisions > before

    def test_may_have_memory(self, here: Path) -> None:
        class Alternating:
            """Turns left and right by turns, in every world from the left."""

            def initial_state(self, size: int) -> Any:
                return np.zeros(size, int)

            def reset(self, state: Any, world_seeds: Any) -> Any:
                state = state.copy()
                state[list(world_seeds)] = 0
                return state

            def act(self, observations: Any, state: Any) -> Any:
                return np.where(state % 2, 3, 1), state + 1

            def action_values(self, observations: Any, state: Any) -> Any:
                return np.repeat(state[:, None], 5, axis=1).astype(float)

        own = nb.load_policy(Alternating())
        for seed in (3, 4):
            recording = nb.drive(own, world="cover_10", seed=seed, simulator="kinematic")
            assert recording.action[:4].tolist() == [1, 3, 1, 3]
            assert recording.q_values[:4, 0].tolist() == [0.0, 1.0, 2.0, 3.0]

    def test_has_to_be_whole(self) -> None:
        class Forgetful:
            def initial_state(self, size: int) -> None: ...
            def act(self, observations: Any, state: Any) -> Any: ...

        with pytest.raises(nb.UserError, match=r"Forgetful has a memory but lacks: action_values, reset"):
            nb.drive(Forgetful(), simulator="kinematic")  # type: ignore[arg-type]

    def test_cannot_leave_this_process(self) -> None:
        with pytest.raises(nb.UserError, match="'Constant' is an object of this process"):
            nb.evaluate(Constant(5), worlds=["cover_10"], n_worlds=1, simulator="kinematic", executor="processes")

    def test_has_to_act(self) -> None:
        with pytest.raises(nb.UserError, match=r"no policy: it has no method act\(observations\)"):
            nb.drive(object(), simulator="kinematic")  # type: ignore[arg-type]

    @pytest.mark.parametrize("given", [None, "x", [np.nan], [1.5], [-1], [24], [2**70], [0, 0], [[0]], 0, [True]])
    def test_has_to_give_actions(self, given: Any) -> None:
        class Wrong:
            def act(self, observations: Any) -> Any:
                return given

        with pytest.raises(nb.UserError, match="give 1 whole numbers from 0 to 23 as actions, not"):
            nb.drive(Wrong(), simulator="kinematic")


class TestOwnWorld:
    WALL = ((50.0, 50.0, 30.0, 4.0, 135.0),)

    def test_is_driven_in_trained_in_and_resumed(self, here: Path) -> None:
        world = nb.World.from_boxes(self.WALL, name="wall")
        assert nb.drive("straight", world=world, simulator="kinematic").summary.ending == "collision"
        few: dict[str, Any] = {"simulator": "kinematic", "vehicles": 2, "out": "run"}
        nb.train("paper", world=world, episodes=2, **few)
        run = nb.resume("run", 4)
        assert run.config.world == world
        assert nb.drive(run.policy, simulator="kinematic", physics="fast").world.name == "wall"

    def test_is_the_same_as_from_toml(self, here: Path) -> None:
        text = '[layout]\nkind = "boxes"\nboxes = [{ x = 50, y = 50, length = 30, width = 4, yaw_degrees = 135 }]\n'
        Path("wall.toml").write_text(text)
        world = nb.World.from_boxes(self.WALL, name="wall")
        assert nb.World.from_toml("wall.toml") == world == nb.World.load(world)
        world.plot("wall.png")
        assert Path("wall.png").read_bytes()[:4] == b"\x89PNG"

    def test_default_room_is_that_of_the_shipped_vehicle(self) -> None:
        world = nb.World.load("traps")
        assert world.draw(5).digest == Experiment(RunConfig(world="traps")).world(5).digest
        assert all(world.draw(seed) == world.draw(seed, Experiment(RunConfig()).vehicle.width) for seed in range(20))

    def test_mistakes_are_named(self) -> None:
        with pytest.raises(nb.UserError, match=r"'layout\.boxes\.0\.width'"):
            nb.World.from_boxes([(1.0, 1.0, 2.0, -1.0)])


class TestOwnReward:
    def test_is_what_the_environments_give(self) -> None:
        def twice(transition: Any) -> Any:
            return 2.0 + np.arange(len(transition.r_t))

        env = nb.make_env(simulator="kinematic", reward=twice)
        env.reset(seed=0)
        assert env.step(np.int64(0))[1] == 2.0
        env.close()
        several = nb.make_env(simulator="kinematic", n_envs=3, reward=twice)
        several.reset(seed=0)
        assert several.step(np.zeros(3, np.int64))[1].tolist() == [2.0, 3.0, 4.0]
        several.close()

    def test_changes_what_is_learned_but_not_what_is_logged(self, here: Path) -> None:
        few: dict[str, Any] = {"simulator": "kinematic", "vehicles": 4, "episodes": 8}
        plain = nb.train("paper", out="plain", **few)
        same = nb.train("paper", out="same", reward=lambda t: t.terms.sum(axis=1), **few)
        other = nb.train("paper", out="other", reward=lambda t: -t.terms.sum(axis=1), **few)
        weights = [run.policy.experiment.trainable.state_dict() for run in (plain, same, other)]
        assert all(np.array_equal(weights[0][key], weights[1][key]) for key in weights[0])
        assert not all(np.array_equal(weights[0][key], weights[2][key]) for key in weights[0])
        first = plain.episodes[0].summary, other.episodes[0].summary
        assert all(summary.episode_return == sum(summary.terms.values()) for summary in first)

    def test_names_its_terms_wherever_a_step_is_told(self, here: Path) -> None:
        terms = [*paper_reward(TaskOptions()), RewardTerm(turning, -0.1)]
        names = [*REWARD_TERMS, "turning"]
        env = nb.make_env(simulator="kinematic", reward=terms)
        env.reset(seed=0)
        _, reward, _, _, info = env.step(np.int64(1))
        env.close()
        assert [key for key in info if key.startswith("reward/")] == [f"reward/{name}" for name in names]
        assert info["reward/turning"] < 0
        assert reward == pytest.approx(sum(info[f"reward/{name}"] for name in names))

        few: dict[str, Any] = {"simulator": "kinematic", "vehicles": 4, "episodes": 8, "reward": terms}
        run = nb.train("paper", out="run", **few)
        assert Path("run/episodes.csv").read_text().splitlines()[0].split(",")[12:19] == [
            *REWARD_TERMS,
            "reward/turning",
        ]
        assert nb.load_run("run").episodes == run.episodes
        assert all(list(e.summary.terms) == names and e.summary.terms["turning"] < 0 for e in run.episodes)
        with pytest.raises(nb.UserError, match="give the same terms"):
            nb.resume("run", 12)
        assert len(nb.resume("run", 12, reward=terms).episodes) == 12

        nb.drive("straight", simulator="kinematic", reward=terms).save("drive.npz")
        recording = nb.Recording.load("drive.npz")
        assert recording.term_names == tuple(names)
        assert recording.reward_terms.shape == (len(recording.action), len(names))

    @pytest.mark.parametrize("given", [None, "x", [np.nan], [np.inf], [1j], [0.0, 0.0], 1.0])
    def test_has_to_give_numbers(self, given: Any) -> None:
        def wrong(*_: Any) -> Any:
            return np.array(given)

        for reward, said in ((wrong, "the reward must be 1 finite"), ([RewardTerm(wrong, 1.0)], "term 'wrong' of the")):
            with pytest.raises(nb.UserError, match=said):
                nb.drive("vfh", simulator="kinematic", reward=reward)

    def test_has_terms_with_a_name_and_a_scale(self) -> None:
        with pytest.raises(nb.UserError, match="a function with a name"):
            RewardTerm(functools.partial(turning, 1), 1.0)
        with pytest.raises(nb.UserError, match="its scale must be a finite number, not nan"):
            RewardTerm(turning, np.nan)

    def test_has_names_of_its_own(self) -> None:
        with pytest.raises(nb.UserError, match="a name of its own, not turning, turning"):
            nb.make_env(simulator="kinematic", reward=[RewardTerm(turning, -0.1), RewardTerm(turning, 1.0)])


def turning(s_tm1: Any, s_t: Any, task: TaskOptions) -> Any:
    """How fast vehicles turn (n,) [rad/s]."""
    return np.abs(s_t.yaw_rate)


def test_an_agent_of_ones_own_learns(here: Path) -> None:
    few: dict[str, Any] = {"simulator": "kinematic", "vehicles": 4, "episodes": 8, "seed": 3}
    own = Nnql(NnqlOptions(), 3)
    nb.train("paper", agent=own, out="own", **few)
    run = nb.train("paper", out="shipped", **few)
    shipped = run.policy.experiment.trainable.state_dict()
    assert all(np.array_equal(values, shipped[name]) for name, values in own.state_dict().items())


class TestVehicle:
    def test_stands_where_its_file_may(self) -> None:
        vehicle = nb.Vehicle.load("tricycle")
        by_name = nb.drive("straight", robot="tricycle", simulator="kinematic", world="empty")
        assert nb.drive("straight", robot=vehicle, simulator="kinematic", world="empty").summary == by_name.summary

    def test_changed_in_code_is_refused(self) -> None:
        slippery = nb.Vehicle.load("tricycle").gripping(0.1)
        with pytest.raises(nb.UserError, match="differs from its file"):
            nb.drive("straight", robot=slippery, simulator="kinematic")


def test_a_policy_that_learned_on_is_loaded_again(here: Path) -> None:
    few: dict[str, Any] = {"simulator": "kinematic", "vehicles": 4, "out": "run"}
    before = nb.train("paper", episodes=4, **few).policy
    nb.resume("run", 8)
    with pytest.raises(nb.UserError, match="run: is not what is saved there; load it again"):
        nb.evaluate(before, worlds=["cover_10"], n_worlds=1, simulator="kinematic")


def test_a_recording_is_saved_loaded_and_drawn(here: Path) -> None:
    recording = nb.drive("straight", world="empty", simulator="kinematic", conditions=nb.Conditions(sensor_noise=0.1))
    assert recording.about["conditions"]["sensor_noise"] == 0.1
    recording.save("drive.npz")
    assert nb.Recording.load("drive.npz").summary == recording.summary
    recording.plot("drive.png")
    recording.render("drive.gif", size=(160, 90), fps=5, end=1.0, renderer="raster")
    assert (Path("drive.png").read_bytes()[:4], Path("drive.gif").read_bytes()[:3]) == (b"\x89PNG", b"GIF")
    with pytest.raises(nb.UserError, match="fps: must be between 1 and 240"):
        recording.render("drive.mp4", fps=0)
