from math import radians

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import softmax

from nnql_bullet.agents import NnqlOptions, make_agent
from nnql_bullet.agents.nnql import Nnql, boltzmann, encode, nearest_turn
from nnql_bullet.env import Observation, Transition
from nnql_bullet.errors import UserError
from nnql_bullet.geometry import Pose
from nnql_bullet.sensing import scan_from
from nnql_bullet.sim.base import Motion
from nnql_bullet.task import Property

NAMES = ("0.weight", "0.bias", "2.weight", "2.bias")
TOWARD = 5
BEFORE = np.array([3.0, 1.5, 10.0, 7.0, 10.0, 10.0, 4.0, 2.0])
AFTER = np.array([4.5, 2.0, 10.0, 6.0, 9.0, 10.0, 5.0, 2.5])

all_readings = st.lists(st.floats(0, 10), min_size=8, max_size=8).map(np.array)


def observed(readings=BEFORE, state=Property.NON_SAFE, target_bearing=0.3):
    return Observation(np.array(readings), 50.0, target_bearing, 0.0, state)


def transition(action=1, reward=0.4, discount=1.0, before=None, after=None):
    motion = Motion(Pose(0, 0, 0), 2.0, 0.0, (16.0, 16.0), 0.5, 1.0, 1.0, 0.0, False, False)
    return Transition(
        s_tm1=before or observed(),
        a_tm1=action,
        r_t=reward,
        discount_t=discount,
        s_t=after or observed(AFTER),
        terms={},
        ending=None,
        motion=motion,
        scan=scan_from(np.full(72, 10.0)),
    )


def sigmoid(x):
    return 1 / (1 + np.exp(-x))


def inputs(readings, encoding="proximity"):
    """By the letter of the two readings of "if no obstacle is found, then d = 0"."""
    if encoding == "proximity":
        return np.array([(10.0 - d) / 10.0 for d in readings])
    return np.array([d / 10.0 if d < 10.0 else 0.0 for d in readings])


def forward(weights, x):
    w1, b1, w2, b2 = (weights[name] for name in NAMES)
    hidden = sigmoid(w1 @ x + b1)
    return hidden, w2 @ hidden + b2


def stepped(weights, x, action, target, step):
    """The weights after one step of gradient descent on 1/2 (target - Q)^2, derived by hand."""
    w1, b1, w2, b2 = (weights[name] for name in NAMES)
    hidden, q = forward(weights, x)
    error = q[action] - target  # dE/dq of the selected output, whose activation is the identity
    back = error * w2[action] * hidden * (1 - hidden)
    w2_new, b2_new = w2.copy(), b2.copy()
    w2_new[action] -= step * error * hidden
    b2_new[action] -= step * error
    return dict(zip(NAMES, (w1 - step * np.outer(back, x), b1 - step * back, w2_new, b2_new), strict=True))


def same(one, other):
    return one.keys() == other.keys() and all(np.array_equal(one[name], other[name]) for name in one)


def random_agent(seed=1, **options):
    """An agent with biases that are not zero, as after some training."""
    agent = Nnql(NnqlOptions(**options), seed)
    generator = np.random.default_rng(seed)
    agent.load({name: generator.normal(size=value.shape) for name, value in agent.arrays().items()})
    return agent


def test_network_is_8_6_5_with_sigmoid_hidden_units_and_linear_outputs():
    agent = Nnql(NnqlOptions(), 0)
    shapes = {name: value.shape for name, value in agent.arrays().items()}
    assert shapes == {"0.weight": (6, 8), "0.bias": (6,), "2.weight": (5, 6), "2.bias": (5,)}
    assert [type(layer).__name__ for layer in agent.network] == ["Linear", "Sigmoid", "Linear"]
    assert all(value.dtype == np.float64 for value in agent.arrays().values())


@given(all_readings, st.integers(0, 100))
@settings(max_examples=50, deadline=None)
def test_action_values_are_the_networks_outputs(readings, seed):
    agent = random_agent(seed)
    _, expected = forward(agent.arrays(), inputs(readings))
    assert agent.action_values(observed(readings)) == pytest.approx(expected, abs=1e-12)


def test_initial_weights_are_uniform_within_their_ranges_and_biases_are_zero():
    agents = [Nnql(NnqlOptions(hidden_weights=0.7, output_weights=0.05), seed).arrays() for seed in range(40)]
    for name, limit in (("0.weight", 0.7), ("2.weight", 0.05)):
        drawn = np.concatenate([arrays[name].ravel() for arrays in agents])
        assert np.abs(drawn).max() <= limit
        assert np.abs(drawn).max() > 0.99 * limit
        assert drawn.mean() == pytest.approx(0, abs=0.05 * limit)
        assert drawn.std() == pytest.approx(limit / np.sqrt(3), rel=0.05)
    assert not any(arrays[name].any() for arrays in agents for name in ("0.bias", "2.bias"))


def test_initial_q_values_are_near_zero():
    assert np.abs(Nnql(NnqlOptions(), 0).action_values(observed())).max() < 0.6  # six hidden units of at most 0.1


def test_weights_are_a_function_of_the_seed():
    one, again, other = (Nnql(NnqlOptions(), seed).arrays() for seed in (4, 4, 5))
    assert same(one, again)
    assert not np.allclose(one["0.weight"], other["0.weight"])


def test_making_an_agent_leaves_the_global_generators_alone():
    torch_state, numpy_state = torch.get_rng_state(), np.random.get_state()[1].copy()  # noqa: NPY002
    Nnql(NnqlOptions(), 4)
    assert torch.equal(torch.get_rng_state(), torch_state)
    assert np.array_equal(np.random.get_state()[1], numpy_state)  # noqa: NPY002


def test_weights_do_not_depend_on_the_global_generators():
    expected = Nnql(NnqlOptions(), 4).arrays()
    torch.rand(3)
    assert same(Nnql(NnqlOptions(), 4).arrays(), expected)


@pytest.mark.parametrize("encoding", ["proximity", "distance"])
@pytest.mark.parametrize("action", range(5))
def test_one_step_of_learning_is_gradient_descent_toward_eq_2(action, encoding):
    agent = random_agent(gradient_step=0.7, learning_rate=0.1, discount=0.15, encoding=encoding)
    before = agent.arrays()
    x_tm1, x_t = inputs(BEFORE, encoding), inputs(AFTER, encoding)
    q = forward(before, x_tm1)[1][action]
    td_error = -0.4 + 0.15 * forward(before, x_t)[1].max() - q
    expected = stepped(before, x_tm1, action, q + 0.1 * td_error, 0.7)
    assert agent.learn(transition(action, reward=-0.4)) == pytest.approx(td_error, abs=1e-12)
    for name, value in agent.arrays().items():
        assert value == pytest.approx(expected[name], abs=1e-12)


def test_learning_matches_numerical_gradients():
    agent = random_agent(gradient_step=0.3)
    before, x = agent.arrays(), inputs(BEFORE)
    q = forward(before, x)[1][2]
    target = q + 0.1 * (1.0 + 0.15 * forward(before, inputs(AFTER))[1].max() - q)
    agent.learn(transition(2, reward=1.0))
    for name, value in agent.arrays().items():
        for index in np.ndindex(value.shape):
            errors = []
            for nudge in (1e-6, -1e-6):
                nudged = {key: array.copy() for key, array in before.items()}
                nudged[name][index] += nudge
                errors.append(0.5 * (target - forward(nudged, x)[1][2]) ** 2)
            gradient = (errors[0] - errors[1]) / 2e-6
            assert value[index] == pytest.approx(before[name][index] - 0.3 * gradient, abs=1e-8)


def test_steps_do_not_add_up_old_gradients():
    agent = random_agent(gradient_step=0.5)
    for action, reward in ((0, 0.4), (3, -0.6), (0, -0.2)):
        before = agent.arrays()
        q = forward(before, inputs(BEFORE))[1][action]
        target = q + 0.1 * (reward + 0.15 * forward(before, inputs(AFTER))[1].max() - q)
        agent.learn(transition(action, reward))
        expected = stepped(before, inputs(BEFORE), action, target, 0.5)
        for name, value in agent.arrays().items():
            assert value == pytest.approx(expected[name], abs=1e-12)


def test_repeated_learning_of_an_ending_converges_to_its_reward():
    agent = Nnql(NnqlOptions(gradient_step=1.0), 0)
    for _ in range(1500):
        agent.learn(transition(3, reward=-0.6, discount=0.0))
    assert agent.action_values(observed())[3] == pytest.approx(-0.6, abs=1e-3)


def test_nothing_is_expected_after_an_ending_for_good():
    agent = random_agent()
    q = agent.action_values(observed())[1]
    assert agent.learn(transition(1, reward=-0.6, discount=0.0)) == pytest.approx(-0.6 - q, abs=1e-12)


def test_timeout_still_expects_what_would_come():
    agent = random_agent()
    q, best = agent.action_values(observed())[1], agent.action_values(observed(AFTER)).max()
    assert agent.learn(transition(1, reward=0.4, discount=1.0)) == pytest.approx(0.4 + 0.15 * best - q, abs=1e-12)


def test_next_states_value_is_used_though_it_is_safe():
    agent = random_agent()
    safe = observed(AFTER, Property.SAFE)
    q, best = agent.action_values(observed())[1], agent.action_values(observed(AFTER)).max()
    assert agent.learn(transition(1, after=safe)) == pytest.approx(0.4 + 0.15 * best - q, abs=1e-12)


def test_safe_steps_teach_nothing_by_default():
    agent = random_agent()
    before = agent.arrays()
    assert agent.learn(transition(TOWARD, reward=-0.2, before=observed(state=Property.SAFE))) is None
    assert same(agent.arrays(), before)


@pytest.mark.parametrize(
    ("degrees", "action"),
    [(0, 0), (14, 0), (16, 1), (40, 1), (46, 2), (170, 2), (-14, 0), (-29, 3), (-46, 4), (-179, 4)],
)
def test_safe_steps_teach_the_nearest_turn_when_asked_to(degrees, action):
    agent = random_agent(learn_in_safe_states=True, gradient_step=0.4)
    before = agent.arrays()
    safe = observed(state=Property.SAFE, target_bearing=radians(degrees))
    q = forward(before, inputs(BEFORE))[1][action]
    target = q + 0.1 * (-0.2 + 0.15 * forward(before, inputs(AFTER))[1].max() - q)
    assert agent.learn(transition(TOWARD, reward=-0.2, before=safe)) is not None
    expected = stepped(before, inputs(BEFORE), action, target, 0.4)
    for name, value in agent.arrays().items():
        assert value == pytest.approx(expected[name], abs=1e-12)


def test_non_safe_steps_train_alike_with_safe_steps_on_or_off():
    one, other = random_agent(), random_agent(learn_in_safe_states=True)
    assert one.learn(transition()) == other.learn(transition())
    assert same(one.arrays(), other.arrays())


@pytest.mark.parametrize(
    ("degrees", "turn"), [(0, 0), (30, 1), (60, 2), (-30, 3), (-60, 4), (44, 1), (46, 2), (-44, 3), (-46, 4), (180, 2)]
)
def test_nearest_turn_is_the_papers_turn_closest_by(degrees, turn):
    assert nearest_turn(radians(degrees)) == turn


@given(st.lists(st.floats(-5, 5), min_size=5, max_size=5), st.floats(0.01, 0.8))
@settings(max_examples=100, deadline=None)
def test_boltzmann_is_the_softmax_of_values_over_temperature(values, temperature):
    probabilities = boltzmann(np.array(values), temperature)
    assert probabilities == pytest.approx(softmax(np.array(values) / temperature), abs=1e-12)
    assert probabilities.sum() == pytest.approx(1)


def test_boltzmann_neither_overflows_nor_gives_nothing_at_the_lowest_temperature():
    assert boltzmann(np.array([500.0, -500.0, 490.0, 0.0, 0.0]), 0.01).tolist() == [1, 0, 0, 0, 0]


def test_exploration_follows_the_boltzmann_frequencies():
    agent = random_agent(3)
    agent.temperature = 0.8
    _, q = forward(agent.arrays(), inputs(BEFORE))
    expected = np.exp(q / 0.8) / np.exp(q / 0.8).sum()
    generator = np.random.default_rng(0)
    draws = 20_000
    counts = np.bincount([agent.explore(observed(), generator) for _ in range(draws)], minlength=5)
    spread = np.sqrt(draws * expected * (1 - expected))
    assert np.all(np.abs(counts - draws * expected) < 4.5 * spread)


def test_exploration_is_a_function_of_the_generator():
    agent = random_agent(3)
    one, other = ([agent.explore(observed(), rng) for _ in range(50)] for rng in map(np.random.default_rng, (7, 7)))
    assert one == other


def test_cold_exploration_is_greedy():
    agent = random_agent(3)
    agent.temperature = 1e-4
    generator = np.random.default_rng(0)
    assert {agent.explore(observed(), generator) for _ in range(50)} == {agent.exploit(observed())}


@given(all_readings, st.integers(0, 50))
@settings(max_examples=50, deadline=None)
def test_exploitation_takes_the_largest_q_value(readings, seed):
    agent = random_agent(seed)
    _, q = forward(agent.arrays(), inputs(readings))
    assert q[agent.exploit(observed(readings))] == pytest.approx(q.max(), abs=1e-12)


def test_safe_state_asks_no_network_and_turns_toward_the_target():
    agent, generator = random_agent(), np.random.default_rng(0)
    safe = observed(np.full(8, 10.0), Property.SAFE)
    unused = generator.bit_generator.state
    assert agent.exploit(safe) == TOWARD
    assert agent.explore(safe, generator) == TOWARD
    assert np.isnan(agent.action_values(safe)).tolist() == [True] * 5
    assert generator.bit_generator.state == unused


def test_temperature_falls_linearly_from_0_8_to_0_01_over_1000_episodes():
    agent = Nnql(NnqlOptions(), 0)
    temperatures = []
    for episode in range(1000):
        agent.begin_episode(episode)
        temperatures.append(agent.temperature)
    assert temperatures == pytest.approx(np.linspace(0.8, 0.01, 1000), abs=1e-12)


def test_temperature_stays_at_its_end_and_starts_high_before_the_first_episode():
    agent = Nnql(NnqlOptions(schedule_episodes=11), 0)
    assert agent.temperature == 0.8
    for episode, expected in ((0, 0.8), (5, 0.405), (10, 0.01), (11, 0.01), (5000, 0.01), (0, 0.8)):
        agent.begin_episode(episode)
        assert agent.temperature == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize(
    ("encoding", "reading", "value"),
    [
        ("proximity", 10.0, 0.0),
        ("proximity", 0.0, 1.0),
        ("proximity", 2.5, 0.75),
        ("distance", 10.0, 0.0),  # "if no obstacle is found, then d = 0"
        ("distance", 9.99, 0.999),
        ("distance", 2.5, 0.25),
        ("distance", 0.0, 0.0),
    ],
)
def test_encodings_of_a_reading(encoding, reading, value):
    assert encode(np.full(8, reading), encoding) == pytest.approx(np.full(8, value), abs=1e-12)


@given(all_readings, st.sampled_from(["proximity", "distance"]))
@settings(max_examples=50, deadline=None)
def test_encoding_stays_between_0_and_1_and_leaves_the_readings_alone(readings, encoding):
    before = readings.copy()
    values = encode(readings, encoding)
    assert values == pytest.approx(inputs(readings, encoding), abs=1e-12)
    assert np.all((values >= 0) & (values <= 1))
    assert np.array_equal(readings, before)


def test_diagnostics_are_temperature_and_root_mean_square_error_of_the_episode():
    agent = random_agent()
    agent.begin_episode(0)
    assert agent.diagnostics() == {"temperature": 0.8, "td_error": 0.0}
    errors = [agent.learn(transition(action)) for action in (0, 1, 2)]
    agent.learn(transition(TOWARD, before=observed(state=Property.SAFE)))
    assert agent.diagnostics()["td_error"] == pytest.approx(np.sqrt(np.mean(np.square(errors))))
    agent.begin_episode(1)
    assert agent.diagnostics()["td_error"] == 0.0


def test_arrays_and_load_are_a_round_trip():
    trained, fresh = random_agent(1), Nnql(NnqlOptions(), 2)
    trained.learn(transition())
    fresh.load(trained.arrays())
    assert same(fresh.arrays(), trained.arrays())
    assert fresh.action_values(observed()).tolist() == trained.action_values(observed()).tolist()
    assert fresh.learn(transition(2)) == trained.learn(transition(2))
    assert same(fresh.arrays(), trained.arrays())


def test_arrays_are_copies_that_learning_does_not_change():
    agent = random_agent()
    arrays = agent.arrays()
    kept = {name: value.copy() for name, value in arrays.items()}
    agent.learn(transition())
    assert same(arrays, kept)
    assert not same(agent.arrays(), kept)


def test_changing_what_arrays_gave_does_not_change_the_agent():
    agent = random_agent()
    values = agent.action_values(observed())
    for array in agent.arrays().values():
        array[:] = 9.0
    assert agent.action_values(observed()).tolist() == values.tolist()


def test_loaded_arrays_stay_the_callers():
    agent, arrays = Nnql(NnqlOptions(), 0), random_agent().arrays()
    kept = {name: value.copy() for name, value in arrays.items()}
    agent.load(arrays)
    agent.learn(transition())
    assert same(arrays, kept)
    for array in arrays.values():
        array[:] = 9.0
    assert not any(np.any(value == 9.0) for value in agent.arrays().values())


@pytest.mark.parametrize(
    "change",
    [
        {"0.weight": np.zeros((6, 7))},
        {"0.weight": np.zeros((8, 6))},
        {"2.bias": np.zeros(6)},
        {"2.bias": np.zeros((5, 1))},
        {"0.bias": np.full(6, np.nan)},
        {"2.weight": np.full((5, 6), np.inf)},
        {"3.weight": np.zeros(3)},
        {"2.bias": None},
    ],
    ids=["narrow", "transposed", "long", "column", "nan", "inf", "extra", "missing"],
)
def test_arrays_of_another_network_are_refused_and_change_nothing(change):
    agent = random_agent()
    before = agent.arrays()
    bad = {name: value for name, value in {**agent.arrays(), **change}.items() if value is not None}
    with pytest.raises(UserError, match="these are not the weights of an NNQL network of 8-6-5 units"):
        agent.load(bad)
    assert same(agent.arrays(), before)


def test_observations_are_not_changed():
    agent, step = random_agent(learn_in_safe_states=True), transition()
    agent.learn(step)
    agent.explore(step.s_tm1, np.random.default_rng(0))
    agent.exploit(step.s_t)
    assert np.array_equal(step.s_tm1.readings, BEFORE)
    assert np.array_equal(step.s_t.readings, AFTER)


def test_learning_is_reproducible():
    agents = [make_agent(NnqlOptions(), 9) for _ in range(2)]
    for agent in agents:
        for action in (0, 4, 2, 2, 1):
            agent.learn(transition(action, reward=0.1 * action))
    assert same(agents[0].arrays(), agents[1].arrays())


def test_defaults_are_the_papers_numbers():
    o = NnqlOptions()
    assert (o.learning_rate, o.discount, o.temperature_max, o.temperature_min) == (0.1, 0.15, 0.8, 0.01)
    assert o.schedule_episodes == 1000
    assert (o.encoding, o.gradient_step, o.learn_in_safe_states) == ("proximity", 0.4, False)
