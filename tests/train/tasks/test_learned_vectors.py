"""Vectors that robots send: bytes, contents on the wire, and what others observe, by scalar references."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.train import rooms
from tests.train.rooms import play, room
from usarmjx.base.errors import UsageError
from usarmjx.comms.mail import MessageSettings, empty_inboxes
from usarmjx.train.baselines import BASELINES
from usarmjx.train.envs.layout import NO_VECTOR, ActionVector
from usarmjx.train.envs.state import AgentGroup
from usarmjx.train.evaluation.ablation import ablations_of
from usarmjx.train.mapping.belief import ABSENT, HEADER_SIZE
from usarmjx.train.policies.sources import load_policy
from usarmjx.train.tasks.goal_features import GOALS, MATE_NUMBERS, OBSERVATION_SIZE, Mates
from usarmjx.train.tasks.learned_vectors import heard_vectors, no_vectors, quantised, vector_features
from usarmjx.train.tasks.messages import (
    OPTION_NUMBERS,
    OPTIONS,
    VECTOR,
    choices,
    decode,
    encode,
    no_messages,
    option,
    option_count,
    vector_bytes,
    with_options,
    without_options,
)
from usarmjx.train.tasks.reporting_team import ExploreBase

FLOATS = 3
EVERYONE, BASE, NEAR = 0, 1, 2
STARTS = ((0.6, 0.9), (0.6, 2.1), (1.8, 0.9))
STEPS = 8
linked = partial(rooms.linked, STEPS + 1)
TASK = ExploreBase(
    arena=room(STARTS),
    count=2,
    episode_steps=STEPS,
    price=0.0,
    hint=0.0,
    hold=4,
    actions="goals+message",
    message_floats=FLOATS,
)
"""A base and two robots that choose a message in steps 2 and 6, and goals in steps 0 and 4."""
SAID = np.array([0.5, -1.0, 0.123], np.float32)
STEP = 1 / 127
"""Between two numbers of a vector: a signed byte has 127 from 0 to 1."""


def scalar_bytes(floats):
    """Size of a vector's message: pose and a byte for each number; a fill byte if a map has that size."""
    plan_and_strips = {24 + 5 * strips for strips in range(1000)}
    size = 4 * 4 + floats
    return size + 1 if size in plan_and_strips else size


def test_sizes_of_vectors_are_of_no_other_kind():
    for floats in range(1, 100):
        assert vector_bytes(floats) == scalar_bytes(floats)
        assert vector_bytes(floats) not in {16, *range(24, 1000, 5)}
    assert [vector_bytes(floats) for floats in (1, 7, 8, 13, 16)] == [17, 23, 25, 30, 32]


@pytest.mark.parametrize("floats", [1, 8, 16])
def test_vectors_pass_the_wire_to_half_a_step(floats):
    draw = np.random.default_rng(floats)
    numbers = draw.uniform(-1, 1, floats)
    sent = np.asarray(quantised(numbers))
    head = np.array([1.5, -2.0, 0.3, ABSENT, ABSENT, 7.5], np.float32)
    letter = np.concatenate([head, np.zeros(20, np.float32), sent])
    data = encode(letter, floats)
    assert len(data) == scalar_bytes(floats)
    np.testing.assert_array_equal(decode(data, 20, floats), letter)
    np.testing.assert_allclose(decode(data, 20, floats)[-floats:] / 127, numbers, atol=STEP / 2 + 1e-6)
    assert np.abs(np.asarray(quantised(np.array([-7.0, 7.0])))).tolist() == [127, 127]


def test_other_kinds_keep_their_bytes_beside_vectors():
    rng = np.random.default_rng(0)
    strips = rng.integers(1, 2**24, 6).astype(np.float32)
    for plan in ([ABSENT, ABSENT], [4.0, 5.0]):
        plain = np.concatenate([[1.5, -2.0, 0.3, *plan, 7.5], strips * (plan[0] != ABSENT)])
        plain = plain.astype(np.float32)
        letter = np.concatenate([plain, np.full(8, ABSENT, np.float32)])
        assert encode(letter, 8) == encode(plain)
        np.testing.assert_array_equal(decode(encode(plain), 6, 8), letter)
    with pytest.raises(ValueError, match=r"a message of 20 bytes, expected 16, .* for each strip, or 25"):
        decode(bytes(20), 6, 8)


def test_a_byte_below_the_range_counts_as_its_end():
    data = np.array([0, 0, 0, 0], "<f4").tobytes() + np.array([-128], np.int8).tobytes()
    assert decode(data, 6, 1)[-1] == -127


def test_a_vector_is_offered_where_it_is_paid_for():
    """20 bytes a receiver pay for a vector of 4 numbers, 19 do not; of 3 numbers they do."""
    allowed = np.zeros((3, 3), bool)
    allowed[1, 0] = allowed[1, 2] = True
    mates = Mates(jnp.full((3, 2), 2), jnp.array([[False, False], [True, False], [False, False]]))
    for floats, budget, wanted in ((4, 40.0, True), (4, 39.0, False), (3, 39.0, True)):
        offered = choices(no_messages(3, 5, floats), jnp.asarray(allowed), 0, mates, budget)
        valid = np.asarray(offered.valid)
        assert valid.shape == (3, option_count(floats))
        assert valid[1, option(EVERYONE, VECTOR)] == wanted
        assert valid[1, option(BASE, VECTOR)]
        assert not valid[1, option(3, VECTOR)], "no second robot"
        assert not valid[2, OPTIONS:].any(), "nobody is in range"


def test_the_last_vector_of_each_sender_counts_and_its_age_is_from_sending():
    settings = MessageSettings(numbers=HEADER_SIZE + 5 + 2, capacity=3)
    box = empty_inboxes(settings, 3)
    payload = box.payload.at[0, :, -2:].set(jnp.array([[10.0, 20.0], [-30.0, 40.0], [ABSENT, ABSENT]]))
    box = box.replace(
        count=box.count.at[0].set(3),
        sender=box.sender.at[0].set(jnp.array([1, 1, 1])),
        time=box.time.at[0].set(jnp.array([2.0, 4.0, 6.0])),
        payload=payload,
    )
    state = heard_vectors(no_vectors(3, 2), box)
    assert np.asarray(state.heard[0, 1]).tolist() == [-30, 40]
    mates = Mates(jnp.array([[1, 2, 2, 2]] * 3), jnp.array([[True, True, False, False]] * 3))
    seen = np.asarray(vector_features(state, mates, 10.0))
    np.testing.assert_allclose(seen[0, 0], [1.0, 6.0 / 40.0, -30 / 127, 40 / 127], rtol=1e-6)
    assert not seen[0, 1:].any()
    assert not seen[1:].any(), "nothing came for them"
    assert not np.asarray(vector_features(state, mates, 44.5)).any(), "older than 40 s"


def mission(task, links, chosen):
    """Steps of robots that stand still; the first chooses an option, and says `SAID`."""
    rows = np.zeros((2, task.action_size), np.float32)
    rows[:, 0] = 1.0
    rows[:, GOALS] = 0.5
    rows[0, GOALS + chosen] = 1.0
    rows[0, task.choices :] = SAID
    path = [[(x, y, 0.0) for x, y in STARTS]] * (STEPS + 1)
    return list(play(task, path, links, choose=lambda view, memory: (jnp.asarray(rows),)))


@pytest.fixture(scope="module")
def whispered():
    """Robot 1 sends its vector to robot 2, the nearest; links are there to both others."""
    return mission(TASK, linked((0, 1), (0, 2), (1, 2)), option(NEAR, VECTOR))


def others_of(task, view, memory):
    """Numbers that robots observe of others (robots, others, n)."""
    seen = np.asarray(task.observe(view, memory)[0])
    span = task.layout(view.scene).others_span
    return seen[:, span.first : span.end].reshape(len(seen), span.rows, span.numbers)


def test_who_is_sent_a_vector_observes_it_with_its_age(whispered):
    """Sent after step 2, read in step 3; the pose in it is that of the sender."""
    period = TASK.repeat * whispered[0][0].scene.physics.period
    for step, wanted in ((2, False), (3, True), (5, True)):
        view, memory, _ = whispered[step]
        seen = others_of(TASK, view, memory)
        assert seen.shape[-1] == MATE_NUMBERS + FLOATS + 2
        assert not seen[0, :, MATE_NUMBERS:].any(), "robot 1 was sent none"
        if not wanted:
            assert not seen[1, :, MATE_NUMBERS:].any()
            continue
        there, age, *numbers = seen[1, 0, MATE_NUMBERS:]
        assert there == 1.0
        assert age == pytest.approx((step - 2) * period / 40.0, abs=1e-5)
        np.testing.assert_allclose(numbers, SAID, atol=STEP / 2 + 1e-6)
    heads = np.asarray(whispered[3][1].belief.mate_headers)
    np.testing.assert_allclose(heads[2, 1, :2], STARTS[1], atol=1e-6)
    np.testing.assert_allclose(heads[2, 1, 3:5], STARTS[1], atol=1e-6)  # a vector says nothing of plans


def test_bytes_of_a_vector_count_for_each_receiver(whispered):
    state = whispered[3][1].extra.messaging
    assert int(state.size[1]) == scalar_bytes(FLOATS)
    assert float(state.sent[1]) == scalar_bytes(FLOATS)
    assert float(state.sent[2]) == 0.0
    everyone = mission(TASK, linked((0, 1), (0, 2), (1, 2)), option(EVERYONE, VECTOR))
    assert float(everyone[3][1].extra.messaging.sent[1]) == 2 * scalar_bytes(FLOATS)
    assert not np.asarray(everyone[3][1].extra.messaging.strips[1]).any()


def test_nobody_hears_over_a_link_that_does_not_hold():
    alone = mission(TASK, linked((0, 1)), option(EVERYONE, VECTOR))
    view, memory, _ = alone[3]
    assert float(memory.extra.messaging.sent[1]) == scalar_bytes(FLOATS)  # to the base
    assert not others_of(TASK, view, memory)[..., MATE_NUMBERS:].any()


def test_other_messages_carry_no_vector():
    """Numbers of an action count with the options of vectors alone."""
    view, memory, _ = mission(TASK, linked((1, 2)), option(EVERYONE, 0))[3]
    assert float(memory.extra.messaging.sent[1]) == 16
    assert not others_of(TASK, view, memory)[..., MATE_NUMBERS:].any()


def test_layout_and_sizes_fit_what_robots_observe(whispered):
    view, memory, _ = whispered[3]
    seen, layout = TASK.observe(view, memory)[0], TASK.layout(view.scene)
    options = OPTIONS + 4
    assert TASK.action_sizes(view.scene) == (GOALS + options + FLOATS,)
    assert layout.misfit(seen.shape[-1], GOALS + options) == ""
    assert seen.shape[-1] == OBSERVATION_SIZE + options * (OPTION_NUMBERS + 1) + 4 * (FLOATS + 2)
    assert TASK.sizes_of_messages == (seen.shape[-1] - OBSERVATION_SIZE, options + FLOATS)
    assert TASK.vector == ActionVector(FLOATS, 4)
    assert replace(TASK, message_floats=0).vector == NO_VECTOR
    assert len(set(layout.kinds[-4:])) == 1
    assert layout.kinds[-1] not in layout.kinds[:-4]


def test_observations_lose_and_regain_their_vectors(whispered):
    view, memory, _ = whispered[3]
    seen = TASK.observe(view, memory)[0]
    plain = without_options(seen, FLOATS)
    without = replace(TASK, message_floats=0)
    there = play(without, [[(x, y, 0.0) for x, y in STARTS]] * 2, linked()[:2])
    assert plain.shape[-1] == without_options(without.observe(*next(iter(there))[:2])[0]).shape[-1]
    np.testing.assert_array_equal(with_options(plain, seen, FLOATS), seen)


def test_ablations_hide_vectors_alone_and_with_their_senders(whispered):
    view, memory, _ = whispered[3]
    seen = TASK.observe(view, memory)[0]
    span = TASK.layout(view.scene).others_span

    def rows(obs):
        return np.asarray(obs[:, span.first : span.end]).reshape(2, span.rows, span.numbers)

    hidden = ablations_of(TASK)
    vectors, mates = (rows(hidden[name][1](seen, 2)) for name in ("vectors", "mates"))
    assert rows(seen)[1, 0, MATE_NUMBERS:].any()
    assert not vectors[..., MATE_NUMBERS:].any()
    np.testing.assert_array_equal(vectors[..., :MATE_NUMBERS], rows(seen)[..., :MATE_NUMBERS])
    assert not mates.any()
    assert "vectors" not in ablations_of(replace(TASK, message_floats=0))


def test_policies_of_goals_play_beside_vectors(whispered):
    """Their messages are the fixed protocol's, and numbers of a vector are 0."""
    view, memory, _ = whispered[3]
    seen, size = TASK.observe(view, memory)[0], TASK.action_size
    group = AgentGroup("P2AT", ("a", "b"), seen.shape[-1], size, True, TASK.layout(view.scene), TASK.vector)
    env = SimpleNamespace(name="explore-v3", task=TASK, groups=(group,))
    task = replace(TASK, actions="goals", message_floats=0)
    of_goals = AgentGroup("P2AT", ("a", "b"), OBSERVATION_SIZE, GOALS, True, task.layout(view.scene))
    plain = SimpleNamespace(name="explore-v3", task=task, groups=(of_goals,))

    def act(policy, obs):
        return np.asarray(policy.act(policy.initial_carry(1), (obs[None],), jax.random.key(0))[1][0][0])

    for make_policy in (load_policy("explore-v3").policy, BASELINES.get("explore-v3")):
        for step, due in ((2, False), (4, True)):
            seen = TASK.observe(*whispered[step][:2])[0]
            action = act(make_policy(env), seen)
            assert action.shape == (2, size)
            assert (action[:, : GOALS + OPTIONS].sum(-1) == 1.0).all()
            assert not action[:, GOALS + OPTIONS :].any()
            goals = act(make_policy(plain), without_options(seen, FLOATS))
            assert (action[:, :GOALS] == goals).all() if due else not action[:, :GOALS].any()


def test_vectors_without_choices_of_messages_are_refused():
    with pytest.raises(UsageError, match="message_floats is 3, but robots choose no messages"):
        replace(TASK, actions="goals").scene()
