"""Gives the standard learners of others a fair chance, and fills results/learners.

DQN, QR-DQN, PPO and recurrent PPO of stable-baselines3 and sb3-contrib, on the paper's sectors and on rays, with the
paper's reward and the shaped one: each of these 16 combinations is tuned by Optuna on validation worlds, trained anew
from five seeds with the best values, and driven through test worlds. All of it is in the kinematic model at 5 % cover,
with six actions. What is done is kept in --out, so the same command goes on after an interrupt. The table is written
after every combination, and a combination that is in it with the same budget is not made again.

    python scripts/learners.py                       # as in the documentation; some hours on 2 idle cores
    python scripts/learners.py --only ppo --trials 4 --steps 20000
    python scripts/learners.py --why --only ppo dqn  # what the paper's reward pays those that are in the table
"""

import argparse
import json
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import asdict, dataclass, field
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import torch
from sb3_contrib import QRDQN, RecurrentPPO
from stable_baselines3 import DQN, PPO
from stable_baselines3.common.vec_env import VecNormalize

import nnql_bullet as nb
from nnql_bullet.config import options, parse, to_values
from nnql_bullet.evaluation.parts import Parts, part_name, run_kept
from nnql_bullet.evaluation.search import Search
from nnql_bullet.evaluation.space import Trial, best_of, read_space
from nnql_bullet.evaluation.statistics import proportion, success_of_seeds
from nnql_bullet.executors import make_executor
from nnql_bullet.files import write_text
from nnql_bullet.integrations.sb3 import make_vec_env
from nnql_bullet.provenance import made_by
from nnql_bullet.reports.document import Report, Section, table
from nnql_bullet.seeding import TEST_WORLDS
from nnql_bullet.task import ENDINGS
from nnql_bullet.training.selection import seeds

VEHICLES = 32
TRAINED_IN = "paper"
TESTED_IN = {"paper": "5 % cover", "cover_10": "10 % cover"}
SEEDS = 5
TUNING_SEED = 100
RESULTS = Path("results/learners")


@options
class PpoOptions:
    """What is searched of PPO and recurrent PPO."""

    learning_rate: float = 3e-4
    """Of Adam."""
    discount: float = 0.99
    """Of later rewards."""
    horizon: int = 64
    """Steps of each vehicle from one update to the next."""
    epochs: int = 10
    """Passes over the steps of an update."""
    entropy: float = 0.001
    """Weight of the entropy in the loss."""

    def learner(self, algorithm: Any, vehicles: Any, seed: int, steps: int) -> Any:
        """The untrained learner."""
        policy = "MlpLstmPolicy" if algorithm is RecurrentPPO else "MlpPolicy"
        return algorithm(
            policy,
            vehicles,
            learning_rate=self.learning_rate,
            gamma=self.discount,
            n_steps=self.horizon,
            n_epochs=self.epochs,
            ent_coef=self.entropy,
            batch_size=512,
            seed=seed,
            device="cpu",
        )


@options
class DqnOptions:
    """What is searched of DQN and QR-DQN."""

    learning_rate: float = 5e-4
    """Of Adam."""
    discount: float = 0.9
    """Of later rewards."""
    steps_per_update: int = 4
    """Steps, of all vehicles together, from one gradient step to the next."""
    target_update_steps: int = 1000
    """Steps after which the target network is renewed."""
    exploration: float = 0.3
    """Share of the training over which the probability of a random action falls to 5 %."""

    def learner(self, algorithm: Any, vehicles: Any, seed: int, steps: int) -> Any:
        """The untrained learner."""
        return algorithm(
            "MlpPolicy",
            vehicles,
            learning_rate=self.learning_rate,
            gamma=self.discount,
            train_freq=1,
            gradient_steps=max(VEHICLES // self.steps_per_update, 1),
            target_update_interval=self.target_update_steps,
            exploration_fraction=self.exploration,
            exploration_final_eps=0.05,
            learning_starts=1000,
            buffer_size=steps,
            batch_size=64,
            seed=seed,
            device="cpu",
        )


RATE = {"low": 1e-4, "high": 3e-3, "log": True}
PPO_SPACE: dict[str, Any] = {
    "learning_rate": RATE,
    "discount": [0.9, 0.97, 0.99],
    "horizon": [32, 64, 128],
    "epochs": {"low": 4, "high": 12},
    "entropy": {"low": 1e-4, "high": 0.03, "log": True},
}
DQN_SPACE: dict[str, Any] = {
    "learning_rate": RATE,
    "discount": [0.8, 0.9, 0.97, 0.99],
    "steps_per_update": [2, 4, 8],
    "target_update_steps": {"low": 250, "high": 8000, "log": True},
    "exploration": {"low": 0.1, "high": 0.6},
}
LEARNERS: dict[str, tuple[Any, Any, dict[str, Any]]] = {
    "ppo": (PPO, PpoOptions, PPO_SPACE),
    "dqn": (DQN, DqnOptions, DQN_SPACE),
    "qr_dqn": (QRDQN, DqnOptions, DQN_SPACE),
    "recurrent_ppo": (RecurrentPPO, PpoOptions, PPO_SPACE),
}
"""Algorithm, options and space of each learner."""


@dataclass(frozen=True)
class Training:
    """One training and its test."""

    learner: str
    observation: str
    reward: str
    options: str
    """As JSON."""
    seed: int
    steps: int
    tested_in: tuple[str, ...]
    world_seeds: range

    @property
    def size(self) -> int:
        """Number of trainings."""
        return 1

    @property
    def part(self) -> str:
        """See `parts.Piece`."""
        return part_name(*asdict(self).values())


@dataclass(frozen=True)
class Drives:
    """Drives of a trained learner in one kind of world."""

    world: str
    endings: list[str]
    """How each world's drive ended."""
    returns: list[float] = field(default_factory=list)
    """Discounted sum of each drive's rewards, from its start."""


def environment(t: Training, world: str) -> dict[str, Any]:
    """The options of `make_env`."""
    rays = {"rays": 24} if t.observation == "rays" else {}
    return {"simulator": "kinematic", "world": world, "observation": t.observation, "reward": t.reward, **rays}


def train_and_test(t: Training, on_step: Callable[..., bool] | None = None) -> list[Drives]:
    """Trains a learner, and drives it greedily through worlds of each kind; `on_step` is a callback of the learner."""
    torch.set_num_threads(1)
    algorithm, kind, _ = LEARNERS[t.learner]
    with closing(VecNormalize(make_vec_env(VEHICLES, **environment(t, TRAINED_IN), workers=1))) as vehicles:
        vehicles.seed(1_000 * t.seed)
        learner = parse(kind, json.loads(t.options), "options").learner(algorithm, vehicles, t.seed, t.steps)
        learner.learn(t.steps, callback=on_step)
        return [driven(t, learner, vehicles, world) for world in t.tested_in]


def driven(t: Training, learner: Any, vehicles: VecNormalize, world: str) -> Drives:
    """Drives once through the world of each seed."""
    n, discount = len(t.world_seeds), float(json.loads(t.options)["discount"])
    endings: list[str | None] = [None] * n
    returns, weights = np.zeros(n), np.ones(n)
    with closing(nb.make_env(n_envs=n, **environment(t, world))) as envs:
        seen, _ = envs.reset(options={"world_seed": np.array(t.world_seeds)})
        memory, first = None, np.ones(n, np.bool_)
        while None in endings:
            told = vehicles.normalize_obs(seen)
            actions, memory = learner.predict(told, state=memory, episode_start=first, deterministic=True)
            seen, r_t, terminated, truncated, infos = envs.step(actions)
            first = terminated | truncated
            returns += weights * r_t
            weights = np.where(first, 0.0, discount * weights)
            for i in np.flatnonzero(first).tolist():
                endings[i] = endings[i] or infos["ending"][i]
    return Drives(world, [ending or "" for ending in endings], returns.tolist())


@dataclass(frozen=True)
class Cell:
    """A learner with an observation and a reward."""

    learner: str
    observation: str
    reward: str

    @property
    def name(self) -> str:
        """Of its folder."""
        return f"{self.learner}-{self.observation}-{self.reward}"


def training(cell: Cell, text: str, seed: int, steps: int, tested_in: tuple[str, ...], worlds: range) -> Training:
    """A training of a combination with options as JSON."""
    return Training(**asdict(cell), options=text, seed=seed, steps=steps, tested_in=tested_in, world_seeds=worlds)


def tuned(cell: Cell, a: argparse.Namespace) -> Trial:
    """The best values of a search on validation worlds."""
    _, kind, values = LEARNERS[cell.learner]
    space = read_space(values, kind(), cell.name)
    folder = a.out / cell.name
    folder.mkdir(parents=True, exist_ok=True)
    identity = f"{nb.__version__} {a.search_steps} {a.worlds} {values}"
    search = Search(folder / "study.db", space, identity, 0, a.trials // 2)
    while len(search.trials) < a.trials:
        number = len(search.trials)
        drawn = search.draw(number, number)
        text = json.dumps(to_values(space.options(drawn)), sort_keys=True)
        task = training(cell, text, TUNING_SEED, a.search_steps, (TRAINED_IN,), seeds(a.worlds))
        (found,) = train_and_test(task)
        arrived = found.endings.count("goal")
        search.add([Trial(number, drawn, (arrived / a.worlds,), "trained")])
        print(f"{cell.name}: trial {number + 1} of {a.trials}: {arrived} of {a.worlds} arrive", flush=True)
    best = best_of(search.trials)
    if best is None:
        raise SystemExit(f"{cell.name}: no trial")
    return Trial(best.number, to_values(space.options(best.values)), best.history, best.state)


def tested(cell: Cell, best: Trial, a: argparse.Namespace) -> list[list[Drives]]:
    """What trainings with these values come to in test worlds, seed by seed."""
    text = json.dumps(dict(best.values), sort_keys=True)
    worlds = TEST_WORLDS[: a.worlds]
    tasks = [training(cell, text, seed, a.steps, tuple(TESTED_IN), worlds) for seed in range(SEEDS)]
    executor = make_executor(None, a.workers)
    return run_kept(executor, cell.name, train_and_test, tasks, Parts(a.out / cell.name / "parts"), Drives)


def record(cell: Cell, best: Trial, found: Sequence[Sequence[Drives]]) -> dict[str, Any]:
    """All numbers of a combination: of each seed's drives, world by world, the first letters of their endings."""
    return {
        "made_by": made_by(),
        **asdict(cell),
        "options": dict(best.values),
        "validation": best.score,
        "endings": {
            world: ["".join(name[0] for name in its.endings) for one in found for its in one if its.world == world]
            for world in TESTED_IN
        },
    }


def row(one: dict[str, Any]) -> tuple[str, ...]:
    """The line of a combination in the table."""
    endings = {world: np.array([list(letters) for letters in one["endings"][world]]) for world in TESTED_IN}
    cells = [str(success_of_seeds([its == "g"], [np.ones(its.shape)])) for its in endings.values()]
    failures = {name: int((endings[TRAINED_IN] == name[0]).sum()) for name in ENDINGS if name != "goal"}
    share = 100 / endings[TRAINED_IN].size
    why = ", ".join(f"{name} {count * share:.0f}" for name, count in failures.items() if count)
    values = ", ".join(f"{name} {value:.3g}" for name, value in one["options"].items())
    return one["learner"], one["observation"], one["reward"], *cells, why or "none", values


def write(done: Sequence[dict[str, Any]], straight: dict[str, int], a: argparse.Namespace) -> None:
    """Writes the table of what is done so far."""
    RESULTS.mkdir(parents=True, exist_ok=True)
    header = ("learner", "observation", "reward", *TESTED_IN.values(), "failures at 5 % cover [%]", "tuned values")
    rule = ("straight", "", "", *(str(proportion(count, a.worlds)) for count in straight.values()), "", "")
    about = (
        f"Success in %, inter-quartile mean over {SEEDS} training seeds with its 95 % interval over seeds and worlds; "
        f"{a.worlds} test worlds of each kind, kinematic model, six actions, {a.steps} steps of training at 5 % cover "
        f"with {VEHICLES} vehicles. Tuned by {a.trials} trials of {a.search_steps} steps on {a.worlds} validation "
        "worlds (one training each, so the best may be a lucky one); "
        "observations and rewards are normalised by what was seen so far. nnql-bullet " + nb.__version__ + "."
    )
    missing, makers = len(CELLS) - len(done), {one["made_by"]["code"] for one in done}
    more = f"{missing} of the {len(CELLS)} combinations are not trained yet. " if missing else ""
    more += f"The combinations were made by {len(makers)} states of the code." if len(makers) > 1 else ""
    body = table(header, [*(row(one) for one in done), rule], note=more)
    sections = [Section("", (about, "`python scripts/learners.py`", body))]
    if any("why" in one for one in done):
        sections.append(explanation(done, a))
    write_text(RESULTS / "learners.md", Report("Learners of others", tuple(sections)).markdown())
    values = {"budget": budget(a), "straight": straight, "rows": done}
    write_text(RESULTS / "learners.json", json.dumps(values, indent=1) + "\n")


def explained(cell: Cell, options: dict[str, Any], a: argparse.Namespace) -> dict[str, Any]:
    """What the reward pays: how a training's episodes ended, and what its drives are worth that arrive and that do not.

    The training is that of seed 0 of the table, and drives through validation worlds.
    """
    ended: Counter[str] = Counter()

    def count(local: dict[str, Any], _: dict[str, Any]) -> bool:
        ended.update(info["ending"] for info in local["infos"] if info.get("ending"))
        return True

    task = training(cell, json.dumps(options, sort_keys=True), 0, a.steps, (TRAINED_IN,), seeds(a.worlds))
    (found,) = train_and_test(task, count)
    returns = {
        ending: [worth for name, worth in zip(found.endings, found.returns, strict=True) if name == ending]
        for ending in ("goal", "timeout")
    }
    return {
        "made_by": made_by(),
        "trained": {name: ended[name] for name in ENDINGS if ended[name]},
        "returns": {ending: [round(float(np.mean(its)), 3), len(its)] for ending, its in returns.items() if its},
    }


def explanation(done: Sequence[dict[str, Any]], a: argparse.Namespace) -> Section:
    """What the paper's reward pays those that it is known of."""
    about = (
        f"Trainings of {a.steps} steps with the tuned values and seed 0, and their greedy drives through {a.worlds} "
        "validation worlds at 5 % cover: the discounted sum of rewards from the start, mean over drives that end so "
        "and (their number). One training each, so without intervals."
    )
    header = ("learner", "observation", "discount", "training episodes", "return: arrives", "return: runs out of time")
    rows = [
        (
            *(one["learner"], one["observation"], f"{one['options']['discount']:g}"),
            ", ".join(f"{name} {count}" for name, count in one["why"]["trained"].items()),
            *("{} ({})".format(*one["why"]["returns"].get(name, ("none", 0))) for name in ("goal", "timeout")),
        )
        for one in done
        if "why" in one
    ]
    learners = " ".join(dict.fromkeys(name for name, *_ in rows))
    command = f"`python scripts/learners.py --why --only {learners}`"
    return Section("What the paper's reward pays", (about, command, table(header, rows)))


def budget(a: argparse.Namespace) -> dict[str, int]:
    """What each combination is given."""
    return {"steps": a.steps, "search_steps": a.search_steps, "trials": a.trials, "worlds": a.worlds}


def made_before(a: argparse.Namespace) -> dict[Cell, dict[str, Any]]:
    """Combinations in the table that had the same budget."""
    file = RESULTS / "learners.json"
    values = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    rows = values["rows"] if values.get("budget") == budget(a) else []
    return {Cell(its["learner"], its["observation"], its["reward"]): its for its in rows}


CELLS = [
    Cell(learner, observation, reward)
    for learner, reward, observation in product(LEARNERS, ("progress", "paper"), ("rays", "sectors"))
]


def main() -> None:
    """Does all of it, one combination after the other."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", nargs="*", choices=list(LEARNERS), default=list(LEARNERS), help="some learners")
    parser.add_argument("--why", action="store_true", help="say what the paper's reward pays, from the table")
    parser.add_argument("--trials", type=int, default=6, help="of the search for each combination")
    parser.add_argument("--search-steps", type=int, default=30_000, help="of a trial, of all vehicles together")
    parser.add_argument("--steps", type=int, default=60_000, help="of a training")
    parser.add_argument("--worlds", type=int, default=100, help="validation worlds, and test worlds of each kind")
    parser.add_argument("--workers", type=int, default=1, help="trainings at a time")
    parser.add_argument("--out", type=Path, default=Path("runs/learners"), help="what is kept")
    a = parser.parse_args()
    rule = nb.evaluate(
        "straight", worlds=list(TESTED_IN), seeds=TEST_WORLDS[: a.worlds], simulator="kinematic", workers=1
    )
    straight = {its["world"]: round(its["goal"] * a.worlds) for its in rule.rows if its["world"] in TESTED_IN}
    done = made_before(a)
    for cell in CELLS:
        if a.why and cell in done and cell.reward == "paper" and cell.learner in a.only:
            done[cell]["why"] = explained(cell, done[cell]["options"], a)
        elif not a.why and cell not in done and cell.learner in a.only:
            best = tuned(cell, a)
            done[cell] = record(cell, best, tested(cell, best, a))
        else:
            continue
        write([done[its] for its in CELLS if its in done], straight, a)
        print("  ".join(row(done[cell])), flush=True)


if __name__ == "__main__":
    main()
