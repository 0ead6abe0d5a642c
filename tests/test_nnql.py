from dataclasses import fields, replace
from math import nextafter, radians

import helpers
import numpy as np
import pytest
import torch
from helpers import learn, same
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import softmax

from nnql_bullet.agents import NnqlOptions
from nnql_bullet.agents.learning.nnql import Nnql
from nnql_bullet.agents.learning.q_learning import boltzmann, encode
from nnql_bullet.env import Observation, Transition
from nnql_bullet.errors import UserError
from nnql_bullet.sensing import RAYS
from nnql_bullet.sim.base import no_motion
from nnql_bullet.task import NO_ENDING, REWARD_TERMS, StateProperty

NAMES = ("0.weight", "0.bias", "2.weight", "2.bias")
TOWARD = 5
BEFORE = np.array([3.0, 1.5, 10.0, 7.0, 10.0, 10.0, 4.0, 2.0])
AFTER = np.array([4.5, 2.0, 10.0, 6.0, 9.0, 10.0, 5.0, 2.5])

all_readings = st.lists(st.floats(0, 10), min_size=8, max_size=8).map(np.array)


def observed(readings=BEFORE, state=StateProperty.NON_SAFE, target_bearing=0.3):
    """What one vehicle sees."""
    return helpers.observed((readings, 50.0, target_bearing, 0.0, 2.0, state, np.full(RAYS, 10.0)))


def transition(action=1, reward=0.4, discount=1.0, before=None, after=None):
    """A step of one vehicle."""
    return Transition(
        s_tm1=before or observed(),
        a_tm1=np.array([action]),
        r_t=np.array([reward]),
        discount_t=np.array([discount]),
        s_t=after or observed(AFTER),
        terms=np.zeros((1, len(REWARD_TERMS))),
        ending=np.array([NO_ENDING]),
        heading_command=np.zeros(1),
        speed_command=np.ones(1),
        motion=no_motion(1),
        active=np.ones(1, np.bool_),
    )


def together(*records):
    """Records of single vehicles as one of many."""
    kind = type(records[0])
    if kind is np.ndarray:
        return np.concatenate(records)
    if kind is tuple:  # names
        return records[0]
    return kind(*(together(*(getattr(record, field.name) for record in records)) for field in fields(kind)))


def q_values(agent, observations=None):
    """Of one vehicle."""
    (values,) = agent.action_values(observations or observed(), None)
    return values


def learned(agent, step):
    """The temporal-difference error of a step of one vehicle."""
    (td_error,) = learn(agent, step)
    return float(td_error)


def explored(agent, observations, uniforms, episode=0):
    """The actions of one vehicle for each of several uniforms."""
    rows = (np.repeat(getattr(observations, field.name), len(uniforms), axis=0) for field in fields(Observation))
    many = Observation(*rows)
    return agent.act_exploring(many, None, np.full(len(uniforms), episode), np.array(uniforms))[0].tolist()


def exploited(agent, observations=None):
    """Of one vehicle."""
    (action,) = agent.act(observations or observed(), None)[0].tolist()
    return action


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


def summed(weights, steps, step):
    """The weights after one step of gradient descent on the sum of several errors, each (x, action, target)."""
    moved = [stepped(weights, *one, step) for one in steps]
    return {name: weights[name] + sum(other[name] - weights[name] for other in moved) for name in NAMES}


def close(one, other):
    return one.keys() == other.keys() and all(one[name] == pytest.approx(other[name], abs=1e-12) for name in one)


def random_agent(seed=1, **options):
    """An agent with biases that are not zero, as after some training."""
    agent = Nnql(NnqlOptions(**options), seed)
    generator = np.random.default_rng(seed)
    agent.load_state_dict({name: generator.normal(size=value.shape) for name, value in agent.state_dict().items()})
    return agent


def test_network_is_8_6_5_with_sigmoid_hidden_units_and_linear_outputs():
    agent = Nnql(NnqlOptions(), 0)
    shapes = {name: value.shape for name, value in agent.state_dict().items()}
    assert shapes == {"0.weight": (6, 8), "0.bias": (6,), "2.weight": (5, 6), "2.bias": (5,)}
    assert [type(layer).__name__ for layer in agent.network] == ["Linear", "Sigmoid", "Linear"]
    assert all(value.dtype == np.float64 for value in agent.state_dict().values())


@given(all_readings, st.integers(0, 100))
@settings(max_examples=50, deadline=None)
def test_action_values_are_the_networks_outputs(readings, seed):
    agent = random_agent(seed)
    _, expected = forward(agent.state_dict(), inputs(readings))
    assert q_values(agent, observed(readings)) == pytest.approx(expected, abs=1e-12)


@given(st.lists(st.tuples(all_readings, st.booleans()), min_size=1, max_size=6))
@settings(max_examples=50, deadline=None)
def test_action_values_of_many_vehicles_are_those_of_each(rows):
    agent = random_agent()
    seen = [observed(readings, StateProperty.SAFE if safe else StateProperty.NON_SAFE) for readings, safe in rows]
    values = agent.action_values(together(*seen), None)
    assert values.shape == (len(rows), 5)
    for (readings, safe), got in zip(rows, values, strict=True):
        expected = np.full(5, np.nan) if safe else forward(agent.state_dict(), inputs(readings))[1]
        assert got == pytest.approx(expected, abs=1e-12, nan_ok=True)


def test_initial_weights_are_uniform_within_their_ranges_and_biases_are_zero():
    agents = [Nnql(NnqlOptions(hidden_weights=0.7, output_weights=0.05), seed).state_dict() for seed in range(40)]
    for name, limit in (("0.weight", 0.7), ("2.weight", 0.05)):
        drawn = np.concatenate([arrays[name].ravel() for arrays in agents])
        assert np.abs(drawn).max() <= limit
        assert np.abs(drawn).max() > 0.99 * limit
        assert drawn.mean() == pytest.approx(0, abs=0.05 * limit)
        assert drawn.std() == pytest.approx(limit / np.sqrt(3), rel=0.05)
    assert not any(arrays[name].any() for arrays in agents for name in ("0.bias", "2.bias"))


def test_initial_q_values_are_near_zero():
    assert np.abs(q_values(Nnql(NnqlOptions(), 0))).max() < 0.6  # six hidden units of at most 0.1


def test_weights_are_a_function_of_the_seed():
    one, again, other = (Nnql(NnqlOptions(), seed).state_dict() for seed in (4, 4, 5))
    assert same(one, again)
    assert not np.allclose(one["0.weight"], other["0.weight"])


def test_making_an_agent_leaves_the_global_generators_alone():
    torch_state, numpy_state = torch.get_rng_state(), np.random.get_state()[1].copy()  # noqa: NPY002
    Nnql(NnqlOptions(), 4)
    assert torch.equal(torch.get_rng_state(), torch_state)
    assert np.array_equal(np.random.get_state()[1], numpy_state)  # noqa: NPY002


def test_weights_do_not_depend_on_the_global_generators():
    expected = Nnql(NnqlOptions(), 4).state_dict()
    torch.rand(3)
    assert same(Nnql(NnqlOptions(), 4).state_dict(), expected)


@pytest.mark.parametrize("encoding", ["proximity", "distance"])
@pytest.mark.parametrize("action", range(5))
def test_one_step_of_learning_is_gradient_descent_toward_eq_2(action, encoding):
    agent = random_agent(gradient_step=0.7, learning_rate=0.1, discount=0.15, encoding=encoding)
    before = agent.state_dict()
    x_tm1, x_t = inputs(BEFORE, encoding), inputs(AFTER, encoding)
    q = forward(before, x_tm1)[1][action]
    td_error = -0.4 + 0.15 * forward(before, x_t)[1].max() - q
    expected = stepped(before, x_tm1, action, q + 0.1 * td_error, 0.7)
    assert learned(agent, transition(action, reward=-0.4)) == pytest.approx(td_error, abs=1e-12)
    assert close(agent.state_dict(), expected)


def test_learning_matches_numerical_gradients():
    agent = random_agent(gradient_step=0.3)
    before, x = agent.state_dict(), inputs(BEFORE)
    q = forward(before, x)[1][2]
    target = q + 0.1 * (1.0 + 0.15 * forward(before, inputs(AFTER))[1].max() - q)
    learn(agent, transition(2, reward=1.0))
    for name, value in agent.state_dict().items():
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
        before = agent.state_dict()
        q = forward(before, inputs(BEFORE))[1][action]
        target = q + 0.1 * (reward + 0.15 * forward(before, inputs(AFTER))[1].max() - q)
        learn(agent, transition(action, reward))
        assert close(agent.state_dict(), stepped(before, inputs(BEFORE), action, target, 0.5))


def wanted(weights, readings, action, reward, discount, readings_after):
    """A step's (x, action, target) by eq. (2), and its temporal-difference error, at these weights."""
    q = forward(weights, inputs(readings))[1][action]
    td_error = reward + discount * 0.15 * forward(weights, inputs(readings_after))[1].max() - q
    return (inputs(readings), action, q + 0.1 * td_error), td_error


steps_of_vehicles = st.lists(
    st.tuples(all_readings, st.integers(0, 4), st.floats(-1, 1), st.sampled_from([0.0, 1.0]), all_readings),
    min_size=1,
    max_size=8,
)


def as_transitions(steps):
    return together(
        *(
            transition(action, reward, discount, observed(before), observed(after))
            for before, action, reward, discount, after in steps
        )
    )


@given(steps_of_vehicles)
@settings(max_examples=100, deadline=None)
def test_steps_at_once_are_gradient_descent_on_the_sum_of_their_errors(steps):
    agent = random_agent(gradient_step=0.3)
    before = agent.state_dict()
    wants, td_errors = zip(*(wanted(before, *step) for step in steps), strict=True)
    assert learn(agent, as_transitions(steps)) == pytest.approx(np.array(td_errors), abs=1e-12)
    assert close(agent.state_dict(), summed(before, wants, 0.3))


@pytest.mark.parametrize(("action", "mirror_image"), [(0, 0), (1, 3), (2, 4), (3, 1), (4, 2)])
def test_a_mirrored_step_teaches_as_the_step_and_its_mirror_image_at_once(action, mirror_image):
    def in_a_mirror(readings):
        ahead, left, side_left, back_left, behind, back_right, side_right, right = readings
        return observed([ahead, right, side_right, back_right, behind, back_left, side_left, left])

    step = transition(action, reward=-0.3, discount=0.5)
    image = transition(mirror_image, reward=-0.3, discount=0.5, before=in_a_mirror(BEFORE), after=in_a_mirror(AFTER))
    mirrored, both = Nnql(NnqlOptions(mirrored=True), 3), Nnql(NnqlOptions(), 3)
    (td_error,) = learn(mirrored, step)
    td_errors = learn(both, together(step, image))
    for name in NAMES:
        assert np.allclose(mirrored.state_dict()[name], both.state_dict()[name], rtol=0, atol=1e-14)
    assert td_error == pytest.approx(td_errors[0], abs=1e-14)


def test_one_step_at_once_is_not_several_one_after_another():
    steps = [(BEFORE, 1, 0.4, 1.0, AFTER), (AFTER, 1, -0.6, 0.0, BEFORE), (BEFORE, 4, -0.4, 1.0, AFTER)]
    at_once, one_by_one = random_agent(gradient_step=0.3), random_agent(gradient_step=0.3)
    learn(at_once, as_transitions(steps))
    for step in steps:
        weights = one_by_one.state_dict()
        want, td_error = wanted(weights, *step)
        assert learned(one_by_one, as_transitions([step])) == pytest.approx(td_error, abs=1e-12)
        assert close(
            one_by_one.state_dict(), stepped(weights, *want, 0.3)
        )  # with one vehicle: the paper's online update
    assert not close(at_once.state_dict(), one_by_one.state_dict())


def test_vehicles_that_stood_by_teach_nothing():
    nobody = observed(np.full(8, np.nan))
    idle = replace(transition(2, np.nan, np.nan, nobody, nobody), active=np.zeros(1, np.bool_))
    one, other = random_agent(), random_agent()
    before = one.state_dict()
    errors = learn(one, together(idle, transition(1), idle, transition(4, -0.6, 0.0), idle))
    assert np.isnan(errors).tolist() == [True, False, True, False, True]
    assert learn(other, together(transition(1), transition(4, -0.6, 0.0))).tolist() == errors[[1, 3]].tolist()
    assert same(one.state_dict(), other.state_dict())
    assert not same(one.state_dict(), before)
    after = one.state_dict()
    assert np.isnan(learn(one, together(idle, idle))).all()
    assert same(one.state_dict(), after)


def test_of_many_vehicles_only_those_in_non_safe_states_teach():
    safe = transition(TOWARD, reward=-0.2, before=observed(state=StateProperty.SAFE))
    one, other = random_agent(), random_agent()
    before = one.state_dict()
    errors = learn(one, together(transition(3), safe, safe))
    assert np.isnan(errors).tolist() == [False, True, True]
    assert errors[0] == learned(other, transition(3))
    assert same(one.state_dict(), other.state_dict())
    assert not same(one.state_dict(), before)


def test_repeated_learning_of_an_ending_converges_to_its_reward():
    agent = Nnql(NnqlOptions(gradient_step=1.0), 0)
    for _ in range(1500):
        learn(agent, transition(3, reward=-0.6, discount=0.0))
    assert q_values(agent)[3] == pytest.approx(-0.6, abs=1e-3)


def test_nothing_is_expected_after_an_ending_for_good():
    agent = random_agent()
    q = q_values(agent)[1]
    assert learned(agent, transition(1, reward=-0.6, discount=0.0)) == pytest.approx(-0.6 - q, abs=1e-12)


def test_timeout_still_expects_what_would_come():
    agent = random_agent()
    q, best = q_values(agent)[1], q_values(agent, observed(AFTER)).max()
    assert learned(agent, transition(1, reward=0.4, discount=1.0)) == pytest.approx(0.4 + 0.15 * best - q, abs=1e-12)


def test_next_states_value_is_used_though_it_is_safe():
    agent = random_agent()
    safe = observed(AFTER, StateProperty.SAFE)
    q, best = q_values(agent)[1], q_values(agent, observed(AFTER)).max()
    assert learned(agent, transition(1, after=safe)) == pytest.approx(0.4 + 0.15 * best - q, abs=1e-12)


def test_safe_steps_teach_nothing_by_default():
    agent = random_agent()
    before = agent.state_dict()
    assert np.isnan(learned(agent, transition(TOWARD, reward=-0.2, before=observed(state=StateProperty.SAFE))))
    assert same(agent.state_dict(), before)


@pytest.mark.parametrize(
    ("degrees", "action"),
    [(0, 0), (14, 0), (16, 1), (40, 1), (46, 2), (170, 2), (-14, 0), (-29, 3), (-46, 4), (-179, 4)],
)
def test_safe_steps_teach_the_nearest_turn_when_asked_to(degrees, action):
    agent = random_agent(learn_in_safe_states=True, gradient_step=0.4)
    before = agent.state_dict()
    safe = observed(state=StateProperty.SAFE, target_bearing=radians(degrees))
    q = forward(before, inputs(BEFORE))[1][action]
    td_error = -0.2 + 0.15 * forward(before, inputs(AFTER))[1].max() - q
    assert learned(agent, transition(TOWARD, reward=-0.2, before=safe)) == pytest.approx(td_error, abs=1e-12)
    assert close(agent.state_dict(), stepped(before, inputs(BEFORE), action, q + 0.1 * td_error, 0.4))


def test_non_safe_steps_train_alike_with_safe_steps_on_or_off():
    one, other = random_agent(), random_agent(learn_in_safe_states=True)
    assert learned(one, transition()) == learned(other, transition())
    assert same(one.state_dict(), other.state_dict())


five_values = st.lists(st.floats(-5, 5), min_size=5, max_size=5)


@given(st.lists(st.tuples(five_values, st.floats(0.01, 0.8)), min_size=1, max_size=5))
@settings(max_examples=100, deadline=None)
def test_boltzmann_is_the_softmax_of_values_over_temperature(rows):
    values, temperatures = (np.array(column) for column in zip(*rows, strict=True))
    probabilities = boltzmann(values, temperatures)
    expected = np.array([softmax(np.array(one) / temperature) for one, temperature in rows])
    assert probabilities == pytest.approx(expected, abs=1e-12)
    assert probabilities.sum(axis=1) == pytest.approx(np.ones(len(rows)))


def test_boltzmann_neither_overflows_nor_gives_nothing_at_the_lowest_temperature():
    values = np.array([[500.0, -500.0, 490.0, 0.0, 0.0], [-500.0, -500.0, -500.0, -490.0, -500.0]])
    assert boltzmann(values, np.full(2, 0.01)).tolist() == [[1, 0, 0, 0, 0], [0, 0, 0, 1, 0]]


def test_exploration_follows_the_boltzmann_frequencies():
    agent = random_agent(3)
    _, q = forward(agent.state_dict(), inputs(BEFORE))
    expected = np.exp(q / 0.8) / np.exp(q / 0.8).sum()  # 0.8 in the first episode
    draws = 20_000
    actions = explored(agent, observed(), np.random.default_rng(0).random(draws))
    counts = np.bincount(actions, minlength=5)
    spread = np.sqrt(draws * expected * (1 - expected))
    assert np.all(np.abs(counts - draws * expected) < 4.5 * spread)


@given(all_readings, st.integers(0, 50), st.integers(0, 1200), st.floats(0, 1, exclude_max=True))
@settings(max_examples=200, deadline=None)
def test_exploration_is_the_inverse_of_the_cumulated_probabilities(readings, seed, episode, uniform):
    agent = random_agent(seed)
    temperature = np.linspace(0.8, 0.01, 1000)[min(episode, 999)]
    edges = np.cumsum([0.0, *softmax(forward(agent.state_dict(), inputs(readings))[1] / temperature)])
    (action,) = explored(agent, observed(readings), [uniform], episode)
    assert edges[action] - 1e-9 <= uniform <= edges[action + 1] + 1e-9


IMPOSSIBLE = -1e5  # exp(-1e5 / 0.8) is nothing, so the others' probabilities are exact


@pytest.mark.parametrize(
    ("outputs", "edges"),
    [
        ([0.0, 0.0, 0.0, 0.0, IMPOSSIBLE], {0: 0.25, 1: 0.5, 2: 0.75, 3: 1.0}),
        ([IMPOSSIBLE, 0.0, IMPOSSIBLE, 0.0, IMPOSSIBLE], {1: 0.5, 3: 1.0}),
        ([IMPOSSIBLE, IMPOSSIBLE, 2.0, IMPOSSIBLE, IMPOSSIBLE], {2: 1.0}),
        ([7.0, IMPOSSIBLE, IMPOSSIBLE, IMPOSSIBLE, 7.0], {0: 0.5, 4: 1.0}),
    ],
)
def test_exploration_is_exact_at_the_edges(outputs, edges):
    agent = random_agent()
    agent.load_state_dict({**agent.state_dict(), "2.weight": np.zeros((5, 6)), "2.bias": np.array(outputs)})
    below = 0.0
    for action, edge in edges.items():  # an action has the numbers from its lower edge to just below its upper one
        assert explored(agent, observed(), [below, nextafter(edge, 0.0)]) == [action, action]
        below = edge


def test_the_largest_number_below_1_still_draws_one_of_the_turns():
    last = nextafter(1.0, 0.0)
    for seed in range(50):
        for episode in (0, 500, 999):
            assert set(explored(random_agent(seed), observed(), [0.0, last], episode)) <= set(range(5))


def test_exploration_of_many_vehicles_is_that_of_each():
    agent, generator = random_agent(1), np.random.default_rng(5)
    seen = [observed(generator.uniform(0, 10, 8), StateProperty(int(generator.integers(2)))) for _ in range(60)]
    episodes, uniforms = generator.integers(0, 1200, 60), generator.random(60)
    actions = agent.act_exploring(together(*seen), None, episodes, uniforms)[0].tolist()
    assert actions == [
        explored(agent, one, [uniform], episode)[0]
        for one, episode, uniform in zip(seen, episodes, uniforms, strict=True)
    ]
    assert set(actions) == set(range(6))


def test_cold_exploration_is_greedy():
    agent = random_agent(3, temperature_max=1e-4, temperature_min=1e-4)
    uniforms = np.random.default_rng(0).random(50)
    assert set(explored(agent, observed(), uniforms)) == {exploited(agent)}


@given(all_readings, st.integers(0, 50))
@settings(max_examples=50, deadline=None)
def test_exploitation_takes_the_largest_q_value(readings, seed):
    agent = random_agent(seed)
    _, q = forward(agent.state_dict(), inputs(readings))
    assert q[exploited(agent, observed(readings))] == pytest.approx(q.max(), abs=1e-12)


def test_exploitation_of_many_vehicles_is_that_of_each():
    agent, generator = random_agent(), np.random.default_rng(6)
    seen = [observed(generator.uniform(0, 10, 8), StateProperty(int(generator.integers(2)))) for _ in range(40)]
    actions = agent.act(together(*seen), None)[0].tolist()
    for one, action in zip(seen, actions, strict=True):
        best = int(forward(agent.state_dict(), inputs(one.readings[0]))[1].argmax())
        assert action == (TOWARD if one.state_property[0] == StateProperty.SAFE else best)
    assert TOWARD in actions
    assert len(set(actions)) > 2


def test_safe_state_asks_no_network_and_turns_toward_the_target():
    agent = random_agent()
    safe = observed(np.full(8, 10.0), StateProperty.SAFE)

    def refuse(x):
        if len(x):
            raise AssertionError("the network was asked")
        return torch.zeros((0, 5), dtype=torch.float64)

    agent.network.forward = refuse
    assert exploited(agent, safe) == TOWARD
    assert explored(agent, safe, [0.0, 0.3, 0.999]) == [TOWARD] * 3
    assert np.isnan(q_values(agent, safe)).tolist() == [True] * 5
    for ask in (exploited, q_values):
        with pytest.raises(AssertionError, match="was asked"):
            ask(agent, observed())


def test_temperature_falls_linearly_from_0_8_to_0_01_over_1000_episodes():
    agent = Nnql(NnqlOptions(), 0)
    assert agent.options.temperature(np.arange(1000)) == pytest.approx(np.linspace(0.8, 0.01, 1000), abs=1e-12)


def test_temperature_stays_at_its_end():
    agent = Nnql(NnqlOptions(schedule_episodes=11), 0)
    episodes = np.array([0, 5, 10, 11, 5000, 0])
    assert agent.options.temperature(episodes) == pytest.approx(
        np.array([0.8, 0.405, 0.01, 0.01, 0.01, 0.8]), abs=1e-12
    )


def test_temperature_may_fall_by_the_same_factor_every_episode():
    agent = Nnql(NnqlOptions(schedule="exponential", schedule_episodes=11), 0)
    temperatures = agent.options.temperature(np.arange(11))
    assert (temperatures[0], temperatures[-1]) == pytest.approx((0.8, 0.01))
    assert temperatures[1:] / temperatures[:-1] == pytest.approx(np.full(10, (0.01 / 0.8) ** 0.1))


def test_the_network_may_have_other_hidden_units():
    agent = Nnql(NnqlOptions(hidden_units=3), 0)
    assert sum(values.size for values in agent.state_dict().values()) == 8 * 3 + 3 + 3 * 5 + 5
    with pytest.raises(UserError, match="not the weights of an NNQL network of 8-3-5 units"):
        agent.load_state_dict(Nnql(NnqlOptions(), 0).state_dict())


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


def test_diagnostics_are_the_temperature_of_the_episode():
    agent = Nnql(NnqlOptions(schedule_episodes=11), 0)
    for episode, expected in ((0, 0.8), (5, 0.405), (5000, 0.01)):
        assert agent.diagnostics(episode) == {"temperature": pytest.approx(expected, abs=1e-12)}


def test_arrays_and_load_are_a_round_trip():
    trained, fresh = random_agent(1), Nnql(NnqlOptions(), 2)
    learn(trained, transition())
    fresh.load_state_dict(trained.state_dict())
    assert same(fresh.state_dict(), trained.state_dict())
    assert q_values(fresh).tolist() == q_values(trained).tolist()
    assert learned(fresh, transition(2)) == learned(trained, transition(2))
    assert same(fresh.state_dict(), trained.state_dict())


def test_arrays_are_copies_that_learning_does_not_change():
    agent = random_agent()
    arrays = agent.state_dict()
    kept = {name: value.copy() for name, value in arrays.items()}
    learn(agent, transition())
    assert same(arrays, kept)
    assert not same(agent.state_dict(), kept)


def test_changing_what_arrays_gave_does_not_change_the_agent():
    agent = random_agent()
    values = q_values(agent)
    for array in agent.state_dict().values():
        array[:] = 9.0
    assert q_values(agent).tolist() == values.tolist()


def test_loaded_arrays_stay_the_callers():
    agent, arrays = Nnql(NnqlOptions(), 0), random_agent().state_dict()
    kept = {name: value.copy() for name, value in arrays.items()}
    agent.load_state_dict(arrays)
    learn(agent, transition())
    assert same(arrays, kept)
    for array in arrays.values():
        array[:] = 9.0
    assert not any(np.any(value == 9.0) for value in agent.state_dict().values())


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
    before = agent.state_dict()
    bad = {name: value for name, value in {**agent.state_dict(), **change}.items() if value is not None}
    finite = all(np.isfinite(value).all() for value in bad.values())
    said = "these are not the weights of an NNQL network of 8-6-5 units" if finite else "an NNQL network is not finite"
    with pytest.raises(UserError, match=said):
        agent.load_state_dict(bad)
    assert same(agent.state_dict(), before)


def test_observations_are_not_changed():
    agent, step = random_agent(learn_in_safe_states=True), transition()
    learn(agent, step)
    agent.act_exploring(step.s_tm1, None, np.zeros(1, np.int64), np.full(1, 0.5))[0]
    agent.act(step.s_t, None)[0]
    agent.action_values(step.s_t, None)
    assert np.array_equal(step.s_tm1.readings, [BEFORE])
    assert np.array_equal(step.s_t.readings, [AFTER])
    assert (step.a_tm1.tolist(), step.r_t.tolist(), step.active.tolist()) == ([1], [0.4], [True])


def test_learning_is_reproducible():
    agents = [Nnql(NnqlOptions(), 9) for _ in range(2)]
    for agent in agents:
        for action in (0, 4, 2, 2, 1):
            learn(agent, transition(action, reward=0.1 * action))
    assert same(agents[0].state_dict(), agents[1].state_dict())


def test_defaults_are_the_papers_numbers():
    o = NnqlOptions()
    assert (o.learning_rate, o.discount, o.temperature_max, o.temperature_min) == (0.1, 0.15, 0.8, 0.01)
    assert o.schedule_episodes == 1000
    assert (o.encoding, o.gradient_step, o.learn_in_safe_states) == ("proximity", 0.4, False)
