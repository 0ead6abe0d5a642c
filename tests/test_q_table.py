"""Tabular Q-learning: held against a dictionary and loops, against numbers by hand, and against value iteration."""

from bisect import bisect_right
from collections.abc import Callable
from contextlib import closing
from itertools import islice, product
from math import exp
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from helpers import learn, observed
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from nnql_bullet import paper
from nnql_bullet.agents import QTableOptions
from nnql_bullet.agents.base import NoTrainingState
from nnql_bullet.agents.learning.q_table import QTable
from nnql_bullet.config import parse
from nnql_bullet.env import Navigation, Observation, Transition
from nnql_bullet.errors import UserError
from nnql_bullet.experiment import Experiment
from nnql_bullet.run_config import RunConfig
from nnql_bullet.sensing import RAYS
from nnql_bullet.sim.base import no_motion
from nnql_bullet.task import NO_ENDING, REWARD_TERMS, StateProperty, TaskOptions
from nnql_bullet.training.base import LearningAgent
from nnql_bullet.training.loop import Training

Cli = Callable[..., tuple[int, str, str]]
Table = dict[tuple[int, ...], list[float]]

TOWARD = 5
EDGES = (2.0, 4.0, 7.0)
SECTORS = (0, 1, 7, 4)


def agent_of(**options: Any) -> QTable:
    return QTable(QTableOptions(**{"edges": EDGES, "sectors": SECTORS, **options}))


def seen(*readings: list[float], state: StateProperty = StateProperty.NON_SAFE) -> Observation:
    """What vehicles see that read so much."""
    return observed(*((r, 50.0, 0.3, 0.0, 2.0, state, np.full(RAYS, 10.0)) for r in readings))


def steps(
    before: Observation, turns: list[int], rewards: list[float], after: Observation, discount: float = 1.0
) -> Transition:
    n = len(turns)
    return Transition(
        s_tm1=before,
        a_tm1=np.array(turns),
        r_t=np.array(rewards),
        discount_t=np.full(n, discount),
        s_t=after,
        terms=np.zeros((n, len(REWARD_TERMS))),
        ending=np.full(n, NO_ENDING),
        heading_command=np.zeros(n),
        speed_command=np.ones(n),
        motion=no_motion(n),
        active=np.ones(n, np.bool_),
    )


def near(front: float) -> list[float]:
    """Eight readings of which only the front one is not 10 m."""
    return [front, *[10.0] * 7]


def q(agent: QTable, readings: list[float]) -> list[float]:
    return [float(value) for value in agent.action_values(seen(readings), None)[0]]


class Dictionary(NoTrainingState):
    """The same learner written anew: a dictionary for the table, one vehicle after the other, Python's floats."""

    def __init__(self, options: QTableOptions) -> None:
        self.options = options
        self.table: Table = {}

    def state(self, readings: NDArray[np.float64]) -> tuple[int, ...]:
        return tuple(bisect_right(self.options.edges, readings[sector]) for sector in self.options.sectors)

    def row(self, readings: NDArray[np.float64]) -> list[float]:
        return self.table.get(self.state(readings), [0.0] * 5)

    def act_exploring(
        self, observations: Observation, state: None, episodes: NDArray[np.int64], uniforms: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], None]:
        actions = []
        for i, uniform in enumerate(uniforms):
            if observations.state_property[i] == StateProperty.SAFE:
                actions.append(TOWARD)
                continue
            temperature = 0.8 - 0.79 * min(int(episodes[i]) / 29, 1.0)
            row = self.row(observations.readings[i])
            weights = [exp((value - max(row)) / temperature) for value in row]
            total = 0.0
            for turn, weight in enumerate(weights):
                total += weight / sum(weights)
                if uniform < total:
                    actions.append(turn)
                    break
        return np.array(actions), None

    def learn(self, transitions: Transition, state: None, episodes: NDArray[np.int64]) -> NDArray[np.float64]:
        t = transitions
        errors, updates = [], []
        for i in range(len(t.r_t)):
            if t.s_tm1.state_property[i] == StateProperty.SAFE or not t.active[i]:
                errors.append(np.nan)
                continue
            target = t.r_t[i] + t.discount_t[i] * 0.15 * max(self.row(t.s_t.readings[i]))
            errors.append(target - self.row(t.s_tm1.readings[i])[t.a_tm1[i]])
            updates.append((self.state(t.s_tm1.readings[i]), t.a_tm1[i], 0.1 * errors[-1]))
        for state, turn, update in updates:
            row = list(self.table.get(state, [0.0] * 5))
            row[turn] += update
            self.table[state] = row
        return np.array(errors)

    def diagnostics(self, episode: int) -> dict[str, float]:
        return {
            "temperature": 0.8 - 0.79 * min(episode / 29, 1.0),
            "states": len(self.table),
            "table_share": len(self.table) / (len(self.options.edges) + 1) ** len(self.options.sectors),
        }


@pytest.mark.parametrize("vehicles", [1, 4])
def test_training_is_that_of_a_dictionary(vehicles: int, small_world: Path) -> None:
    options = QTableOptions(edges=EDGES, sectors=SECTORS, schedule_episodes=30)
    config = RunConfig(
        seed=3,
        simulator="kinematic",
        vehicles=vehicles,
        world=str(small_world),
        task=TaskOptions(max_steps=60),
        agent=options,
    )
    experiment = Experiment(config)
    agent, oracle = experiment.learning_agent, Dictionary(options)
    found = []
    for learner in (agent, oracle):
        with closing(experiment.new_simulator(1)) as fleet:
            navigation = Navigation(fleet, config.task)
            training = Training(learner, navigation, experiment.training_world, config.seed)  # type: ignore[arg-type]
            found.append(list(islice(training.episodes(), 40)))
    assert isinstance(agent, QTable)
    for one, other in zip(*found, strict=True):
        assert one.summary == other.summary
        assert one.diagnostics == pytest.approx(other.diagnostics, abs=1e-12)
    arrays = agent.state_dict()
    assert len(arrays["states"]) == len(oracle.table) > 10
    for state, row in oracle.table.items():
        readings = np.full(8, 10.0)
        readings[list(SECTORS)] = [(0.0, *EDGES)[level] for level in state]
        assert q(agent, readings.tolist()) == pytest.approx(row, abs=1e-12)


readings_of_eight = st.lists(
    st.one_of(st.floats(0, 10), st.sampled_from([0.0, 2.0, 4.0, 7.0, 10.0])), min_size=8, max_size=8
)


class TestStates:
    @given(st.lists(readings_of_eight, min_size=1, max_size=6))
    @settings(max_examples=100, deadline=None)
    def test_readings_share_a_state_if_and_only_if_they_share_all_levels(self, rows: list[list[float]]) -> None:
        states = agent_of().state(np.array(rows)).tolist()
        levels = [tuple(sum(row[sector] >= edge for edge in EDGES) for sector in SECTORS) for row in rows]
        for one, first in zip(states, levels, strict=True):
            assert [one == other for other in states] == [first == second for second in levels]

    def test_every_row_of_the_table_is_one_combination(self) -> None:
        agent = agent_of()
        rows = []
        for levels in product((1.0, 3.0, 5.0, 9.0), repeat=4):
            readings = np.full(8, 10.0)
            readings[list(SECTORS)] = levels
            rows.append(readings)
        assert sorted(agent.state(np.array(rows)).tolist()) == list(range(4**4)) == list(range(agent.options.states))

    def test_no_edges_make_one_state(self) -> None:
        agent = agent_of(edges=())
        assert agent.options.states == 1
        assert agent.state(np.array([near(1.0), near(9.0)])).tolist() == [0, 0]


class TestLearning:
    def test_by_hand(self) -> None:
        agent = agent_of()
        assert learn(agent, steps(seen(near(3.0)), [2], [0.4], seen(near(5.0)))).tolist() == [0.4]
        assert q(agent, near(3.0)) == pytest.approx([0.0, 0.0, 0.04, 0.0, 0.0])  # 0.1 of it
        # From another state into that one: 1.0 + 0.15 * 0.04
        assert learn(agent, steps(seen(near(5.0)), [0], [1.0], seen(near(3.9)))) == pytest.approx([1.006])
        assert q(agent, near(5.0)) == pytest.approx([0.1006, 0.0, 0.0, 0.0, 0.0])
        # Again, to an end for good: nothing is expected after it.
        assert learn(agent, steps(seen(near(5.0)), [0], [-0.6], seen(near(3.0)), 0.0)) == pytest.approx([-0.7006])
        assert q(agent, near(5.0))[0] == pytest.approx(0.1006 - 0.07006)

    def test_vehicles_that_meet_in_one_entry_add_up(self) -> None:
        agent = agent_of()
        learn(agent, steps(seen(near(3.0)), [1], [1.0], seen(near(9.0))))
        before = q(agent, near(3.0))[1]
        rewards = [0.4, -0.4, 1.0]
        errors = learn(agent, steps(seen(*[near(3.0)] * 3), [1, 1, 1], rewards, seen(*[near(9.0)] * 3)))
        assert errors == pytest.approx([reward - before for reward in rewards])
        assert q(agent, near(3.0))[1] == pytest.approx(before + 0.1 * (sum(rewards) - 3 * before))

    def test_safe_states_teach_nothing(self) -> None:
        agent = agent_of()
        before = seen(near(6.0), state=StateProperty.SAFE)
        assert np.isnan(learn(agent, steps(before, [TOWARD], [-0.2], seen(near(3.0))))).all()
        assert len(agent.state_dict()["states"]) == 0
        assert np.isnan(agent.action_values(before, None)).all()
        assert agent.act(before, None)[0].tolist() == [TOWARD]

    def test_those_that_stand_by_teach_nothing(self) -> None:
        agent = agent_of()
        t = steps(seen(near(3.0), near(1.0)), [1, 1], [1.0, 1.0], seen(near(9.0), near(9.0)))
        t.active[0] = False
        assert np.isnan(learn(agent, t)).tolist() == [True, False]
        assert agent.state_dict()["states"].tolist() == agent.state(np.array([near(1.0)])).tolist()

    def test_it_ends_where_value_iteration_ends(self) -> None:
        """Four states in a ring, five turns that step on by as many, rewards drawn; discount 0.6."""
        places = [near(front) for front in (1.0, 3.0, 5.0, 8.0)]
        rewards = np.random.default_rng(0).normal(size=(4, 5))
        after = (np.arange(4)[:, None] + np.arange(5)) % 4
        expected = np.zeros((4, 5))
        for _ in range(200):
            expected = rewards + 0.6 * expected.max(axis=1)[after]
        agent = agent_of(discount=0.6, learning_rate=0.5)
        state, turn = (grid.ravel().tolist() for grid in np.indices((4, 5)))
        everything = steps(
            seen(*(places[s] for s in state)),
            turn,
            rewards.ravel().tolist(),
            seen(*(places[s] for s in after.ravel())),
        )
        for _ in range(200):
            learn(agent, everything)
        assert np.array([q(agent, place) for place in places]) == pytest.approx(expected, abs=1e-9)
        assert agent.act(seen(*places), None)[0].tolist() == expected.argmax(axis=1).tolist()


@pytest.fixture
def taught() -> QTable:
    agent = agent_of()
    generator = np.random.default_rng(1)
    for _ in range(20):
        rows = generator.uniform(0, 10, (2, 3, 8)).tolist()
        turns, rewards = generator.integers(0, 5, 3).tolist(), generator.normal(size=3).tolist()
        learn(agent, steps(seen(*rows[0]), turns, rewards, seen(*rows[1])))
    return agent


class TestArrays:
    def test_only_what_was_learned_is_kept(self, taught: QTable) -> None:
        arrays = taught.state_dict()
        assert 10 < len(arrays["states"]) <= 60 < taught.options.states
        other = agent_of()
        other.load_state_dict(arrays)
        rows = np.random.default_rng(2).uniform(0, 10, (200, 8)).tolist()
        assert np.array_equal(other.action_values(seen(*rows), None), taught.action_values(seen(*rows), None))
        assert other.diagnostics(7) == taught.diagnostics(7)
        assert {name: values.tolist() for name, values in other.state_dict().items()} == {
            name: values.tolist() for name, values in arrays.items()
        }

    def test_loading_forgets_what_was_there(self, taught: QTable) -> None:
        taught.load_state_dict(agent_of().state_dict())
        assert taught.diagnostics(0)["states"] == 0
        assert taught.state_dict()["values"].shape == (0, 5)
        assert not taught.action_values(seen(*np.random.default_rng(2).uniform(0, 10, (50, 8)).tolist()), None).any()

    @pytest.mark.parametrize(
        "arrays",
        [
            {},
            {"states": np.array([1, 2])},
            {"states": np.array([1, 2]), "values": np.zeros((3, 5))},
            {"states": np.array([1, 2]), "values": np.zeros((2, 6))},
            {"states": np.array([1, 256]), "values": np.zeros((2, 5))},
            {"states": np.array([-1, 2]), "values": np.zeros((2, 5))},
            {"states": np.array([2, 2]), "values": np.zeros((2, 5))},
            {"states": np.array([1.0, 2.0]), "values": np.zeros((2, 5))},
            {"states": np.array([1, 2]), "values": np.full((2, 5), np.nan)},
            {"0.weight": np.zeros((6, 8))},
        ],
    )
    def test_what_is_no_such_table_is_refused_and_changes_nothing(
        self, taught: QTable, arrays: dict[str, NDArray[Any]]
    ) -> None:
        before = taught.state_dict()
        with pytest.raises(UserError, match="not a table of Q-values of 256 states"):
            taught.load_state_dict(arrays)
        assert all(np.array_equal(values, before[name]) for name, values in taught.state_dict().items())


class TestOptions:
    @pytest.mark.parametrize(
        ("values", "words"),
        [
            ({"edges": [3.0, 2.0]}, "rise"),
            ({"edges": [3.0, 3.0]}, "rise"),
            ({"edges": [11.0]}, "less than or equal to 10"),
            ({"sectors": [0, 8]}, "less than 8"),
            ({"sectors": [0, 0]}, "twice"),
            ({"sectors": list(range(8)), "edges": [float(i) for i in range(1, 10)]}, "100000000 states"),
            ({"temperature_min": 0.9}, "temperature_min"),
            ({"gradient_step": 0.4}, "unknown key"),
        ],
    )
    def test_what_makes_no_sense_is_refused(self, values: dict[str, Any], words: str) -> None:
        with pytest.raises(UserError, match=words):
            parse(RunConfig, {"agent": {"kind": "q_table", **values}}, "x")

    def test_the_papers_numbers_are_the_defaults(self) -> None:
        options = QTableOptions()
        assert (options.learning_rate, options.discount) == (paper.LEARNING_RATE, paper.DISCOUNT)
        assert (options.temperature_max, options.temperature_min) == (paper.TEMPERATURE_MAX, paper.TEMPERATURE_MIN)

    def test_it_learns_step_by_step(self) -> None:
        assert isinstance(agent_of(), LearningAgent)
