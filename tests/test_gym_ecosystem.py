"""The environments among the tools of others: checkers, wrappers, vectors, copies, films, learners."""

import copy
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import closing
from functools import partial
from importlib.util import find_spec
from types import ModuleType
from typing import Any

import gymnasium
import numpy as np
import pytest
from gymnasium import wrappers
from gymnasium.utils.env_checker import check_env
from gymnasium.utils.env_match import check_environments_match
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray

import nnql_bullet as nb
from nnql_bullet.errors import UserError
from nnql_bullet.gym_env.vector import TricycleVectorEnv
from nnql_bullet.registration import VARIANTS
from nnql_bullet.render.film import Film, studio_of
from nnql_bullet.render.live import SIZE, modes_here
from nnql_bullet.render.timeline import Timeline

NAME, RAYS, GOAL, FRAMES, CONTINUOUS = VARIANTS
KINEMATIC: dict[str, Any] = {"simulator": "kinematic", "world": "cover_20"}
SMALL = (64, 64)
TOWARD = 5
SIMULATORS = ["kinematic", "bullet", *(["mujoco"] if find_spec("mujoco") else [])]


def make(name: str = NAME, **more: Any) -> Any:
    return gymnasium.make(name, **KINEMATIC | more)


def equal(one: Any, other: Any) -> bool:
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(equal(one[key], other[key]) for key in one)
    return type(one) is type(other) and np.array_equal(one, other)


class TestCheckers:
    @pytest.mark.parametrize("name", VARIANTS)
    def test_gymnasiums(self, name: str) -> None:
        with closing(make(name, size=SMALL)) as env:
            check_env(env.unwrapped)  # a warning is an error here

    @pytest.mark.parametrize("name", VARIANTS)
    def test_stable_baselines3s(self, name: str) -> None:
        checker = pytest.importorskip("stable_baselines3.common.env_checker", reason="needs the extra [sb3]")
        with closing(make(name)) as env:
            checker.check_env(env.unwrapped)

    @pytest.mark.parametrize("name", VARIANTS)
    def test_the_seed_decides_on_everything(self, name: str) -> None:
        def drive(seed: int) -> list[Any]:
            with closing(make(name)) as env:
                env.action_space.seed(3)
                seen = [env.reset(seed=seed)]
                while len(seen) < 30 and not (len(seen) > 1 and (seen[-1][2] or seen[-1][3])):
                    seen.append(env.step(env.action_space.sample()))
            return seen

        first, again, other = drive(1), drive(1), drive(2)
        assert all(equal(a, b) for one, two in zip(first, again, strict=True) for a, b in zip(one, two, strict=True))
        assert not equal(first[-1][0], other[-1][0])

    @pytest.mark.parametrize("simulator", SIMULATORS)
    def test_two_that_are_made_alike_match(self, simulator: str) -> None:
        with closing(make(simulator=simulator)) as one, closing(make(simulator=simulator)) as other:
            check_environments_match(one, other, num_steps=20, seed=1, info_comparison="equivalence")


def _doubled(observation: Any) -> Any:
    return 2 * observation


def _box(env: Any) -> Any:
    return gymnasium.spaces.Box(2 * env.observation_space.low, 2 * env.observation_space.high, dtype=np.float32)


def _scaled(env: Any) -> Any:
    return wrappers.RescaleObservation(env, np.float32(-1.0), np.float32(1.0))


APPLY: dict[str, tuple[Any, str]] = {
    "DelayObservation": (partial(wrappers.DelayObservation, delay=2), NAME),
    "DtypeObservation": (partial(wrappers.DtypeObservation, dtype=np.float32), NAME),
    "DiscretizeObservation": (partial(wrappers.DiscretizeObservation, bins=2), NAME),
    "FilterObservation": (partial(wrappers.FilterObservation, filter_keys=["observation"]), GOAL),
    "FlattenObservation": (wrappers.FlattenObservation, GOAL),
    "FrameStackObservation": (partial(wrappers.FrameStackObservation, stack_size=3), NAME),
    "TransformObservation": (lambda e: wrappers.TransformObservation(e, _doubled, _box(e)), NAME),
    "MaxAndSkipObservation": (partial(wrappers.MaxAndSkipObservation, skip=2), NAME),
    "NormalizeObservation": (wrappers.NormalizeObservation, NAME),
    "AddRenderObservation": (partial(wrappers.AddRenderObservation, render_only=True), NAME),
    "ReshapeObservation": (partial(wrappers.ReshapeObservation, shape=(1, 11)), NAME),
    "RescaleObservation": (_scaled, NAME),
    "TimeAwareObservation": (wrappers.TimeAwareObservation, NAME),
    "ClipAction": (wrappers.ClipAction, CONTINUOUS),
    "DiscretizeAction": (partial(wrappers.DiscretizeAction, bins=3), CONTINUOUS),
    "TransformAction": (
        lambda e: wrappers.TransformAction(e, lambda a: a / 2, gymnasium.spaces.Box(-2.0, 2.0, (2,), np.float32)),
        CONTINUOUS,
    ),
    "RescaleAction": (partial(wrappers.RescaleAction, min_action=np.float32(0), max_action=np.float32(1)), CONTINUOUS),
    "StickyAction": (partial(wrappers.StickyAction, repeat_action_probability=0.5), NAME),
    "RepeatAction": (partial(wrappers.RepeatAction, num_repeats=2), NAME),
    "ClipReward": (partial(wrappers.ClipReward, min_reward=-0.1, max_reward=0.1), NAME),
    "TransformReward": (partial(wrappers.TransformReward, func=lambda r: 2 * r), NAME),
    "NormalizeReward": (wrappers.NormalizeReward, NAME),
    "TimeLimit": (partial(wrappers.TimeLimit, max_episode_steps=3), NAME),
    "Autoreset": (wrappers.Autoreset, NAME),
    "PassiveEnvChecker": (wrappers.PassiveEnvChecker, NAME),
    "OrderEnforcing": (wrappers.OrderEnforcing, NAME),
    "RecordEpisodeStatistics": (wrappers.RecordEpisodeStatistics, NAME),
    "AddWhiteNoise": (partial(wrappers.AddWhiteNoise, probability_of_noise_per_pixel=0.5), NAME),
    "ObstructView": (
        partial(wrappers.ObstructView, obstructed_pixels_ratio=0.1, obstruction_width=8, is_noise_grayscale=False),
        NAME,
    ),
    "RenderCollection": (wrappers.RenderCollection, NAME),
    "GrayscaleObservation": (lambda e: wrappers.GrayscaleObservation(wrappers.AddRenderObservation(e)), NAME),
}
"""How each wrapper is put around an environment, and around which."""
DO_NOT_APPLY = {
    "vector": "a module",
    "AtariPreprocessing": "of the Arcade Learning Environment",
    "ResizeObservation": "needs OpenCV",
    "RecordVideo": "see TestFilms",
    "HumanRendering": "needs pygame; the environment has a window of its own",
    "ArrayConversion": "needs array-api-compat",
    "NumpyToTorch": "needs array-api-compat",
    "JaxToNumpy": "of environments in JAX",
    "JaxToTorch": "of environments in JAX",
}
"""Wrappers that do not apply, and why."""


class TestWrappers:
    def test_each_of_gymnasiums_is_looked_at(self) -> None:
        assert set(wrappers.__all__) == APPLY.keys() | DO_NOT_APPLY.keys()

    @pytest.mark.parametrize("wrapper", APPLY)
    def test_applies(self, wrapper: str) -> None:
        put_around, name = APPLY[wrapper]
        with closing(put_around(make(name, render_mode="rgb_array", size=SMALL))) as env:
            seen, _ = env.reset(seed=1)
            over = False
            while not over:
                assert seen in env.observation_space
                seen, _, terminated, truncated, info = env.step(env.action_space.sample())
                over = terminated or truncated
            assert wrapper != "TimeLimit" or truncated
            assert wrapper != "RecordEpisodeStatistics" or info["episode"]["l"] > 1
            env.render()

    def test_statistics_of_many_are_where_they_are_looked_for(self) -> None:
        with closing(wrappers.vector.RecordEpisodeStatistics(gymnasium.make_vec(NAME, 3, **KINEMATIC))) as env:
            env.reset(seed=0)
            infos: dict[str, Any] = {}
            while "episode" not in infos:
                *_, infos = env.step(np.full(3, TOWARD))
            assert infos["episode"]["l"][infos["_episode"]].min() > 1

    @pytest.mark.parametrize(
        "put_around",
        [
            partial(wrappers.vector.DtypeObservation, dtype=np.float32),
            wrappers.vector.NormalizeObservation,
            wrappers.vector.NormalizeReward,
            wrappers.vector.DictInfoToList,
            partial(wrappers.vector.ClipReward, min_reward=-0.1, max_reward=0.1),
            partial(wrappers.vector.ReshapeObservation, shape=(1, 11)),
        ],
    )
    def test_those_of_vectors_apply(self, put_around: Any) -> None:
        with closing(put_around(gymnasium.make_vec(NAME, 3, **KINEMATIC))) as env:
            env.reset(seed=1)
            for _ in range(20):
                env.step(env.action_space.sample())


MODES = [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP, AutoresetMode.DISABLED]


class TestVectors:
    @pytest.mark.parametrize("name", [NAME, GOAL, CONTINUOUS])
    @pytest.mark.parametrize("mode", MODES)
    def test_ours_does_what_gymnasiums_does(self, name: str, mode: AutoresetMode) -> None:
        ours = gymnasium.make_vec(name, 3, **KINEMATIC, autoreset_mode=mode)
        theirs = gymnasium.make_vec(
            name, 3, vectorization_mode="sync", vector_kwargs={"autoreset_mode": mode}, **KINEMATIC
        )
        with closing(ours), closing(theirs):
            assert isinstance(ours, TricycleVectorEnv)
            assert ours.metadata["autoreset_mode"] == theirs.metadata["autoreset_mode"] == mode
            ours.action_space.seed(0)
            found, expected = ours.reset(seed=5), theirs.reset(seed=5)
            assert alike(found[0], expected[0]) and alike(found[1], expected[1])
            ended = 0
            for _ in range(80):
                actions = ours.action_space.sample()
                found, expected = ours.step(actions), theirs.step(actions)
                for one, other in zip(found, expected, strict=True):
                    assert alike(one, other)
                over = found[2] | found[3]
                ended += over.sum()
                if mode == AutoresetMode.DISABLED and over.any():
                    with pytest.raises(UserError, match="the episode is over"):
                        ours.step(actions)
                    found = ours.reset(options={"reset_mask": over})
                    expected = theirs.reset(options={"reset_mask": over.copy()})
                    assert alike(found[0], expected[0]) and alike(found[1], expected[1])
            assert ended >= 3

    @pytest.mark.parametrize("name", [NAME, GOAL])
    def test_vectors_of_processes(self, name: str) -> None:
        with (
            closing(gymnasium.make_vec(name, 2, vectorization_mode="async", **KINEMATIC)) as processes,
            closing(gymnasium.make_vec(name, 2, **KINEMATIC)) as ours,
        ):
            assert alike(processes.reset(seed=1)[0], ours.reset(seed=1)[0])
            for action in (TOWARD, 0, 1):
                found, expected = processes.step(np.full(2, action)), ours.step(np.full(2, action))
                assert alike(found[0], expected[0]) and alike(found[1], expected[1])

    @pytest.mark.slow
    def test_vectors_of_processes_in_contact_physics(self) -> None:
        context = {"vector_kwargs": {"context": "spawn"}, "vectorization_mode": "async"}
        contact = {**KINEMATIC, "simulator": "bullet"}
        with (
            closing(gymnasium.make_vec(NAME, 2, **context, **contact)) as processes,
            closing(gymnasium.make_vec(NAME, 2, workers=1, **contact)) as ours,
        ):
            assert alike(processes.reset(seed=1)[0], ours.reset(seed=1)[0])
            assert alike(processes.step(np.full(2, TOWARD))[0], ours.step(np.full(2, TOWARD))[0])

    def test_autoreset_modes_have_names(self) -> None:
        with closing(nb.make_env(n_envs=1, simulator="kinematic", autoreset_mode="SameStep")) as env:
            assert env.metadata["autoreset_mode"] == AutoresetMode.SAME_STEP
        with pytest.raises(UserError, match="'autoreset_mode' must be"):
            nb.make_env(n_envs=1, simulator="kinematic", autoreset_mode="never")


def alike(one: Any, other: Any) -> bool:
    """Whether they are the same, numbers but for rounding."""
    if isinstance(one, dict):
        return one.keys() == other.keys() and all(alike(one[key], other[key]) for key in one)
    one, other = np.asarray(one), np.asarray(other)
    if one.dtype != other.dtype or one.shape != other.shape:
        return False
    if one.dtype == object:
        pairs = zip(one.ravel().tolist(), other.ravel().tolist(), strict=True)
        return all(a is b or (a is not None and alike(a, b)) for a, b in pairs)
    return bool((one == other).all()) if one.dtype.kind == "U" else bool(np.allclose(one, other, atol=1e-5))


def pickled(env: Any) -> Any:
    return pickle.loads(pickle.dumps(env))


class TestCopies:
    @pytest.mark.parametrize("simulator", SIMULATORS)
    @pytest.mark.parametrize("again", [copy.deepcopy, pickled])
    def test_a_copy_goes_on_alike_and_moves_nothing_else(self, simulator: str, again: Callable[[Any], Any]) -> None:
        values = {"simulator": simulator, "conditions": {"sensor_noise": 0.1}, "reward": "progress"}
        with closing(make(**values)) as env, closing(make(**values)) as alone:
            for one in (env, alone):
                one.reset(seed=3)
                for _ in range(3):
                    one.step(TOWARD)
            with closing(again(env)) as other, closing(again(env)) as astray:
                for _ in range(3):
                    astray.step(2)
                for action in (1, 0, 3):
                    expected = alone.step(action)
                    for one in (env, other):
                        assert all(equal(a, b) for a, b in zip(one.step(action), expected, strict=True))
                assert all(equal(a, b) for a, b in zip(other.reset(), alone.reset(), strict=True))

    def test_of_many_vehicles_too(self) -> None:
        with closing(gymnasium.make_vec(NAME, 3, **KINEMATIC)) as env:
            env.reset(seed=1)
            for _ in range(25):  # some are in their second world
                env.step(np.array([TOWARD, 0, 1]))
            with closing(copy.deepcopy(env)) as other:
                for action in (1, 0):
                    pairs = zip(env.step([action] * 3), other.step([action] * 3), strict=True)
                    assert all(alike(a, b) for a, b in pairs)

    def test_before_reset_and_after_close(self) -> None:
        with closing(make(simulator="bullet")) as env, closing(copy.deepcopy(env)) as other:
            assert equal(env.reset(seed=1)[0], other.reset(seed=1)[0])
            env.close()
            with pytest.raises(UserError, match="closed"):
                copy.deepcopy(env).reset()


class TestPictures:
    @pytest.mark.parametrize("camera", ["chase", "top", "orbit", "split"])
    def test_each_camera_shows_what_moves(self, camera: Any) -> None:
        with closing(make(render_mode="rgb_array", camera=camera, size=(96, 64))) as env:
            env.reset(seed=0)
            first = env.render()
            assert (first.shape, first.dtype) == ((64, 96, 3), np.uint8)
            assert np.array_equal(first, env.render())
            env.step(1)
            assert not np.array_equal(first, env.render())

    def test_a_list_holds_each_state_once(self) -> None:
        with (
            closing(make(render_mode="rgb_array_list", size=SMALL)) as env,
            closing(make(render_mode="rgb_array", size=SMALL)) as other,
        ):
            env.reset(seed=0), other.reset(seed=0)
            for action in (0, 1, 0):
                env.step(action), other.step(action)
            frames = env.render()
            assert len({frame.tobytes() for frame in frames}) == len(frames) == 4
            assert np.array_equal(frames[-1], other.render())
            assert env.render() == []
            env.step(0)
            env.reset()
            assert len(env.render()) == 1
            assert env.metadata["render_fps"] == 2.0

    def test_pictures_are_those_of_the_film(self, tmp_path: Any) -> None:
        """The same drive, recorded and then drawn."""
        with closing(make(render_mode="rgb_array", size=SIZE, camera="top")) as env:
            seed = env.reset(seed=4)[1]["world_seed"]
            while not env.step(TOWARD)[2]:
                pass
            shown = env.render().astype(int)
        nb.drive("straight", world="cover_20", seed=seed, simulator="kinematic").save(tmp_path / "drive.npz")
        film = studio_of(Film(tmp_path / "drive.npz", "top", *SIZE, "raster"))
        drawn = film.frame(Timeline(nb.Recording.load(tmp_path / "drive.npz")).duration).astype(int)
        title = (slice(0, 60), slice(0, 160))  # says another policy
        shown[title] = drawn[title] = 0
        assert np.abs(shown - drawn).max() == 0

    def test_of_many_vehicles(self) -> None:
        with closing(gymnasium.make_vec(NAME, 3, render_mode="rgb_array", size=SMALL, **KINEMATIC)) as env:
            env.reset(seed=0)
            env.step(np.array([0, 1, 2]))
            frames = env.render()
            assert [frame.shape for frame in frames] == [(64, 64, 3)] * 3
            assert not np.array_equal(frames[0], frames[1])
            with closing(make(render_mode="rgb_array", size=SMALL)) as one:
                one.reset(seed=1)
                one.step(1)
                assert np.array_equal(one.render(), frames[1])

    def test_without_a_mode_nothing_is_kept(self) -> None:
        with closing(make()) as env:
            env.reset(seed=0)
            assert env.render() is None if env.spec is None else env.unwrapped.render() is None
            assert env.unwrapped._fleet._lives == []

    def test_mistakes_are_named(self, monkeypatch: pytest.MonkeyPatch) -> None:
        with (
            closing(nb.make_env(render_mode="rgb_array", simulator="kinematic")) as env,
            pytest.raises(UserError, match="no episode has begun; call reset first"),
        ):
            env.render()
        with pytest.raises(UserError, match="size: give width and height"):
            make(render_mode="rgb_array", size=(3, 3))
        with pytest.raises(UserError, match="'render_mode' must be"):
            make(render_mode="ansi")
        monkeypatch.setattr("nnql_bullet.render.window.a_window_opens", lambda: False)
        with pytest.raises(UserError, match="no window can be opened here; take render_mode='rgb_array'"):
            make(render_mode="human")
        monkeypatch.delenv("DISPLAY", raising=False)
        assert modes_here() == ["rgb_array", "rgb_array_list"]


@pytest.fixture
def clips(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[tuple[list[NDArray[np.uint8]], float]]]:
    """Frames and rate of the films that moviepy would have been given."""
    made: list[tuple[list[NDArray[np.uint8]], float]] = []

    class Clip:
        def __init__(self, frames: list[NDArray[np.uint8]], fps: float) -> None:
            made.append((list(frames), fps))

        def write_videofile(self, *args: Any, **kwargs: Any) -> None:
            pass

    for name in ("moviepy", "moviepy.video", "moviepy.video.io", "moviepy.video.io.ImageSequenceClip"):
        monkeypatch.setitem(sys.modules, name, ModuleType(name))
    sys.modules["moviepy.video.io.ImageSequenceClip"].ImageSequenceClip = Clip  # type: ignore[attr-defined]
    yield made


ALWAYS: dict[str, Any] = {"episode_trigger": lambda _: True, "disable_logger": True}


class TestFilms:
    @pytest.mark.parametrize("mode", ["rgb_array", "rgb_array_list"])
    def test_record_video(self, clips: list[Any], tmp_path: Any, mode: str) -> None:
        env = make(render_mode=mode, size=SMALL)
        recorded = wrappers.RecordVideo(
            env, str(tmp_path / "films"), episode_trigger=lambda _: True, disable_logger=True
        )
        with closing(recorded):
            recorded.reset(seed=0)
            for _ in range(4):
                recorded.step(0)
            recorded.stop_recording()
        ((frames, rate),) = clips
        assert (len(frames), rate) == (5, 2.0)
        assert not np.array_equal(frames[0], frames[-1])

    def test_record_video_of_many(self, clips: list[Any], tmp_path: Any) -> None:
        env = gymnasium.make_vec(NAME, 2, render_mode="rgb_array", size=SMALL, **KINEMATIC)
        recorded = wrappers.vector.RecordVideo(
            env, str(tmp_path / "films"), episode_trigger=lambda _: True, disable_logger=True
        )
        with closing(recorded):
            recorded.reset(seed=0)
            for _ in range(3):
                recorded.step(np.array([0, 1]))
            recorded.stop_recording()
        assert len(clips[0][0]) >= 3


class TestNames:
    def test_a_process_that_imports_nothing_names_the_package(self) -> None:
        program = f"import gymnasium; print(gymnasium.make('nnql_bullet:{NAME}', simulator='kinematic').spec.id)"
        done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
        assert done.stdout.strip() == NAME


@pytest.mark.parametrize("name", [NAME, CONTINUOUS, GOAL])
def test_stable_baselines3_learns_by_name(name: str) -> None:
    policy = "MultiInputPolicy" if name == GOAL else "MlpPolicy"
    sb3 = pytest.importorskip("stable_baselines3", reason="needs the extra [sb3]")
    torch = pytest.importorskip("torch")
    with torch.random.fork_rng(devices=[]):
        learner = sb3.PPO(policy, name, n_steps=16, batch_size=16, n_epochs=1, device="cpu")
        learner.learn(16)
        assert learner.num_timesteps == 16
        learner.env.close()


def test_stable_baselines3_learns_in_hindsight() -> None:
    sb3 = pytest.importorskip("stable_baselines3", reason="needs the extra [sb3]")
    torch = pytest.importorskip("torch")
    with torch.random.fork_rng(devices=[]), closing(make(GOAL)) as env:
        learner = sb3.DQN(
            "MultiInputPolicy",
            env,
            replay_buffer_class=sb3.HerReplayBuffer,
            learning_starts=60,
            buffer_size=200,
            batch_size=16,
            device="cpu",
        )
        learner.learn(90)
        assert learner._n_updates > 0
