"""Messages that robots choose: their sizes, contents and receivers, beside brute force and closed forms."""

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
from usarmjx.train.envs.state import AgentGroup
from usarmjx.train.mapping.belief import ABSENT, HEADER_SIZE, RECENT_AGE
from usarmjx.train.mapping.maps import (
    FREE,
    MARK,
    SQUARES_PER_NUMBER,
    merge_numbers,
    merge_received,
    pack,
    unpack,
)
from usarmjx.train.policies.sources import load_policy
from usarmjx.train.tasks import messages
from usarmjx.train.tasks.goal_features import GOALS, OBSERVATION_SIZE, Mates
from usarmjx.train.tasks.messages import (
    MAP,
    MARKED,
    OPTION_NUMBERS,
    OPTIONS,
    PLAN,
    POSE,
    VICTIMS,
    Choices,
    best_strips,
    choices,
    decode,
    encode,
    given_option,
    heard,
    letters,
    no_messages,
    option,
    posted,
    with_options,
    without_options,
)
from usarmjx.train.tasks.reporting_team import ExploreBase

BASE, NEAR = 1, 2
"""Choices of receivers: the base, and the nearest robot; 0 is all."""
STARTS = ((0.6, 0.9), (0.6, 2.1), (1.8, 0.9))
STEPS = 20
linked = partial(rooms.linked, STEPS + 1)
TASK = ExploreBase(
    arena=room(STARTS), count=2, episode_steps=STEPS, price=0.0, hint=0.0, hold=4, actions="goals+message"
)
"""A base and two robots that choose a message in steps 2, 6, 10, ..., and goals in steps 0, 4, 8, ..."""


def packed(rng, shape=(7, 11)):
    """A random map and its packed form."""
    squares = rng.integers(0, 4, shape).astype(np.uint8)
    return squares, np.asarray(pack(squares)).astype(np.int32)


def test_packed_maps_merge_as_maps_do():
    rng = np.random.default_rng(0)
    for _ in range(5):
        (one, a), (other, b) = packed(rng), packed(rng)
        np.testing.assert_array_equal(unpack(merge_numbers(a, b), (7, 11)), merge_received(one, other))


def test_the_best_strips_are_those_that_a_sort_finds():
    rng = np.random.default_rng(1)
    for most in (0, 1, 3, 10, 40, 100):
        rank = rng.integers(0, MARKED + 1, 60)
        order = np.argsort(-rank, kind="stable")[:most]
        wanted = np.zeros(60, bool)
        wanted[order] = True
        np.testing.assert_array_equal(best_strips(jnp.asarray(rank), jnp.asarray(most)), wanted & (rank > 0))


def test_a_budget_is_divided_among_those_in_range():
    """102.4 bytes: all for one receiver, half for each of two: 51.2; a map needs 29, a pose 16."""
    state = no_messages(4, 5)
    state = state.replace(unknown=jnp.ones((4, 4)))
    allowed = np.zeros((4, 4), bool)
    allowed[1, 0] = allowed[1, 3] = allowed[2, 1] = True
    mates = Mates(jnp.full((4, 2), 3), jnp.array([[False, False]] + [[True, False]] * 3))
    offered = choices(state, jnp.asarray(allowed), 0, mates, 102.4)
    np.testing.assert_allclose(offered.room[1], [51.2, 102.4, 102.4, 0.0], rtol=1e-6)
    np.testing.assert_allclose(offered.room[2], [102.4, 0.0, 0.0, 0.0], rtol=1e-6)
    assert np.asarray(offered.receivers[1, 0]).tolist() == [True, False, False, True]
    valid = np.asarray(offered.valid)
    assert valid[:, 0].all(), "to send nothing is always an option"
    assert not valid[0, 1:].any(), "nobody is in range of the base's own slot"
    assert valid[1, option(0, MAP)]
    assert valid[1, option(BASE, MAP)]
    assert not valid[1, option(BASE, VICTIMS)], "no marks"
    assert not valid[1, option(3, POSE) :].any(), "no second robot"
    poor = np.asarray(choices(state, jnp.asarray(allowed), 0, mates, 40.0).valid)
    assert poor[1, option(0, POSE)]  # 20 bytes each
    assert not poor[1, option(0, PLAN)]
    assert poor[1, option(BASE, MAP)]
    none = np.asarray(choices(state, jnp.asarray(allowed), 0, mates, 0.0).valid)
    assert not none[:, 1:].any()


def sent(own, known, kind, size):
    """The state after robot 0 sends a kind to robot 1, which is believed to know a map; both are packed."""
    state = no_messages(2, len(own))
    state = state.replace(known=state.known.at[0, 1].set(known))
    to = jnp.zeros((2, 4, 2), bool).at[0, :, 1].set(True)
    offered = Choices(to, jnp.full((2, 4), size), jnp.ones((2, OPTIONS), bool))
    both = jnp.stack([unpack(own, (12, 20)), jnp.zeros((12, 20), jnp.uint8)])
    return posted(state, offered, both, jnp.array([option(BASE, kind), 0]))


def test_messages_hold_as_much_as_their_bytes_pay_for_and_code_to_that_many():
    rng = np.random.default_rng(2)
    (_, own), (_, known) = packed(rng, (12, 20)), packed(rng, (12, 20))
    head = np.array([[1.5, -2.0, 0.3, 4.0, 5.0, 7.5], [0.0] * 6], np.float32)
    for kind, size, most in ((POSE, 60.0, 16), (PLAN, 60.0, 24), (MAP, 60.0, 59), (MAP, 1e9, 24 + 5 * 20)):
        state = sent(own, known, kind, size)
        letter = np.asarray(letters(state, jnp.asarray(head)))[0]
        assert int(state.size[0]) <= most
        assert len(encode(letter)) == int(state.size[0])
        np.testing.assert_array_equal(decode(encode(letter), len(own)), letter)
        assert float(state.sent[0]) == float(state.size[0])
        assert (letter[3] == ABSENT) == (kind == POSE)
    assert int(sent(own, known, MAP, 60.0).size[0]) == 59  # 24 and seven strips of 5
    assert int(state.size[1]) == 0


def test_strips_that_the_receiver_has_stay_at_home_and_marks_go_first():
    rng = np.random.default_rng(3)
    _, own = packed(rng, (12, 20))
    assert int(sent(own, own, MAP, 1e9).size[0]) == messages.PLAN_BYTES
    whole = sent(own, np.zeros_like(own), MAP, 1e9)
    np.testing.assert_array_equal(whole.known[0, 1], own)
    squares = np.full((12, 20), FREE, np.uint8)
    squares[5, 7] = MARK
    own = np.asarray(pack(squares)).astype(np.int32)
    first = sent(own, np.zeros_like(own), MAP, 29.0)
    there = np.flatnonzero(np.asarray(first.strips[0]))
    assert there.tolist() == [(5 * 20 + 7) // SQUARES_PER_NUMBER]
    only = unpack(sent(own, np.zeros_like(own), VICTIMS, 1e9).strips[0], (12, 20))
    assert np.argwhere(np.asarray(only)).tolist() == [[5, 7]]


def test_who_sends_a_map_has_it():
    rng = np.random.default_rng(4)
    _, own = packed(rng)
    settings = MessageSettings(numbers=HEADER_SIZE + len(own), capacity=2)
    box = empty_inboxes(settings, 3)
    payload = box.payload.at[2, 0, HEADER_SIZE:].set(own.astype(np.float32))
    box = box.replace(count=box.count.at[2].set(1), sender=box.sender.at[2, 0].set(1), payload=payload)
    known = np.asarray(heard(no_messages(3, len(own)), box).known)
    np.testing.assert_array_equal(known[2, 1], own)
    assert np.count_nonzero(known.any(-1)) == 1


def test_maps_of_more_strips_than_an_index_names_are_refused():
    with pytest.raises(UsageError, match=r"maps of 65537 strips of 12 squares, .* at most 65536"):
        no_messages(1, 2**16 + 1)


def test_broken_letters_are_refused():
    with pytest.raises(ValueError, match="a message of 20 bytes, expected 16, or 24 and 5 for each strip"):
        decode(bytes(20), 10)
    with pytest.raises(ValueError, match="a strip 10 of a map of 10"):
        decode(bytes(24) + (10).to_bytes(2, "little") + bytes(3), 10)


def test_the_fixed_protocol_sends_maps_to_the_base_then_to_all_then_plans():
    valid = np.zeros((4, OPTIONS))
    valid[:, 0] = 1.0
    valid[0, [option(BASE, MAP), option(0, MAP), option(0, PLAN)]] = 1.0
    valid[1, [option(0, MAP), option(0, PLAN)]] = 1.0
    valid[2, [option(0, PLAN), option(BASE, PLAN)]] = 1.0
    order = [option(BASE, MAP), option(0, MAP), option(0, PLAN), 0]
    assert np.asarray(given_option(valid, base_first=True)).tolist() == order
    assert np.asarray(given_option(valid, base_first=False)).tolist() == [option(0, MAP), *order[1:]]


# In a room.


def actions_of(task, first, second):
    """Actions of two robots that choose options; a goal is always the base."""
    rows = np.zeros((2, GOALS + OPTIONS), np.float32)
    rows[:, 0] = 1.0
    rows[0, GOALS + first] = rows[1, GOALS + second] = 1.0
    return (jnp.asarray(rows) if task.chooses_messages else jnp.asarray(rows[:, :GOALS]),)


def mission(task, links, options=(0, 0)):
    """Steps of robots that stand still and choose options whenever they may."""
    path = [[(x, y, 0.0) for x, y in STARTS]] * (STEPS + 1)
    return list(play(task, path, links, choose=lambda view, memory: actions_of(task, *options)))


@pytest.fixture(scope="module")
def told():
    """Robot 1 sends its map to the base, robot 2 nothing; both have links to it."""
    return mission(TASK, linked((0, 1), (0, 2)), (option(BASE, MAP), 0))


def test_the_base_has_what_was_sent_to_it_and_no_more(told):
    """Sent after step 2, read in step 3: the whole map of robot 1."""
    maps = [np.asarray(memory.belief.squares) for _, memory, _ in told]
    assert not (maps[2][0] == FREE).any()
    np.testing.assert_array_equal(maps[3][0] == FREE, maps[2][1] == FREE)
    size = 24 + 5 * np.count_nonzero(np.asarray(pack(maps[2][1])))
    _, last, result = told[3]
    # The base, which has no map, sends its plan to both.
    np.testing.assert_allclose(last.extra.messaging.sent, [2 * 24, size, 0.0])
    # Of the two robots, after three steps.
    seconds = 3 * TASK.repeat * told[0][0].scene.physics.period
    np.testing.assert_allclose(result.metrics["bytes"], size / 2 / seconds, rtol=1e-5)


def test_a_robot_knows_what_its_base_may_not_have(told):
    news = np.array([np.asarray(m.extra.messaging.untold)[1:, 0] for _, m, _ in told])
    assert (news[2] > 0).all()
    assert news[4, 0] == 0.0  # before the next choice
    assert news[4, 1] > 0.0
    contact = [np.asarray(m.belief.base_contact_time)[1:] for _, m, _ in told]
    view, _, _ = told[4]
    assert contact[4].tolist() == pytest.approx([float(view.time), 0.0])


def test_only_what_is_due_can_be_chosen(told):
    """Goals in steps 0, 4, 8; messages in steps 2, 6, 10."""
    for step in (0, 2, 4, 6):
        view, memory, _ = told[step]
        seen = np.asarray(TASK.observe(view, memory)[0])
        goals, sends = seen[:, -GOALS - OPTIONS : -OPTIONS], seen[:, -OPTIONS:]
        assert (goals.any(-1) == (step % 4 == 0)).all()
        assert (sends[:, 0] == (step % 4 == 2)).all()
    layout = TASK.layout(told[0][0].scene)
    assert layout.misfit(seen.shape[-1], GOALS + OPTIONS) == ""
    assert seen.shape[-1] == OBSERVATION_SIZE + OPTIONS * (OPTION_NUMBERS + 1)


def test_options_are_described_by_what_they_bring(told):
    view, memory, _ = told[2]
    seen = np.asarray(TASK.observe(view, memory)[0])
    span = TASK.layout(view.scene).choices_span
    rows = seen[0, span.first : span.end].reshape(-1, span.numbers)[GOALS:]
    free = int((np.asarray(memory.belief.squares)[1] == FREE).sum())
    there = rows[option(BASE, MAP)]
    assert there[2] == 1.0  # a link
    assert there[3] == pytest.approx(1 / 4)
    assert there[5] == pytest.approx(free / 1000)
    assert there[-4:].tolist() == [0, 0, 1, 0]
    # The base is 1.2 m to the right of robot 1, which looks along x.
    np.testing.assert_allclose(there[:2], [0.0, (STARTS[0][1] - STARTS[1][1]) / 12], atol=1e-6)
    assert not rows[option(BASE, VICTIMS)].any()


def test_observations_lose_and_regain_their_options(told):
    view, memory, _ = told[2]
    seen = TASK.observe(view, memory)[0]
    plain = without_options(seen)
    assert plain.shape[-1] == OBSERVATION_SIZE
    np.testing.assert_array_equal(with_options(plain, seen), seen)


def test_a_policy_of_goals_plays_with_messages_of_the_fixed_protocol(told):
    """Goals are those that it chooses of the same numbers; messages are the protocol's."""
    scene = told[0][0].scene
    plain = replace(TASK, actions="goals")
    group = AgentGroup("P2AT", ("a", "b"), OBSERVATION_SIZE, GOALS, discrete=True, layout=plain.layout(scene))
    both = replace(
        group, obs_size=OBSERVATION_SIZE + OPTIONS * (OPTION_NUMBERS + 1), action_size=GOALS + OPTIONS
    )
    source = load_policy("explore-v3")
    alone = source.policy(SimpleNamespace(name="explore-v3", task=plain, groups=(group,)))
    whole = source.policy(SimpleNamespace(name="explore-v3", task=TASK, groups=(both,)))
    key = jax.random.key(0)
    for step in (2, 4):
        view, memory, _ = told[step]
        seen = TASK.observe(view, memory)[0][None]
        action = np.asarray(whole.act(whole.initial_carry(1), (seen,), key)[1][0][0])
        assert (action.sum(-1) == 1.0).all()
        if step == 4:
            goal = np.asarray(alone.act(alone.initial_carry(1), (without_options(seen),), key)[1][0][0])
            np.testing.assert_array_equal(action[:, :GOALS], goal)
        else:
            assert action[:, GOALS:].argmax(-1).tolist() == [option(0, MAP)] * 2  # no limit: to all


def test_bytes_a_second_limit_what_comes_to_the_base():
    """A message every 4 steps of 0.2 s: 64 bytes/s are 51.2 bytes, so 24 and 5 strips, 49 in all."""
    links = linked((0, 1))
    none = mission(replace(TASK, actions="goals", byte_rate=0.0), links)[-1]
    assert float(none[2].score) == 0.0
    assert float(none[2].metrics["bytes"]) == 0.0
    some = mission(replace(TASK, actions="goals", byte_rate=64.0), links)
    period = 4 * TASK.repeat * some[0][0].scene.physics.period
    strips = int((64.0 * period - 24) // 5)
    for step in range(STEPS):
        sizes = np.asarray(some[step][1].extra.messaging.size)
        assert (sizes <= 24 + 5 * strips).all()
    free = [int((np.asarray(m.belief.squares)[0] == FREE).sum()) for _, m, _ in some]
    assert 0 < free[3] <= strips * SQUARES_PER_NUMBER
    assert free[3] < free[7]
    rate = float(some[-1][2].metrics["bytes"])
    assert 0.0 < rate <= 32.0 + 1e-3  # one of the two robots has a link
    whole = mission(TASK, links, (option(BASE, MAP), 0))[-1]
    assert float(some[-1][2].score) < float(whole[2].score)


def test_bytes_of_whole_maps_are_counted_too():
    """In each step the one robot with a link sends 4 bytes for each number of header and map."""
    task = replace(TASK, actions="goals")
    view, _, last = mission(task, linked((0, 1)))[-1]
    size = 4 * (HEADER_SIZE + task.arena_grid(view.scene).packed_size)
    rate = size / (task.repeat * view.scene.physics.period)
    np.testing.assert_allclose(last.metrics["bytes"], rate / 2, rtol=1e-5)  # of two robots


def test_pictures_show_news_that_the_base_lacks():
    """After a report robot 1 turns around, and its link ends: the base has nothing of what it sees then."""
    task, links = replace(TASK, observed="map"), linked((0, 1))
    links[6:] = False
    path = np.tile([(x, y, 0.0) for x, y in STARTS], (9, 1, 1))
    path[5:, 1, 2] = np.pi
    chosen = actions_of(task, option(BASE, MAP), 0)
    *_, (_, memory, _) = play(task, path, links, choose=lambda view, memory: chosen)
    at_base, seen = (np.asarray(memory.belief.squares[slot]) == FREE for slot in (0, 1))
    np.testing.assert_array_equal(memory.extra.sent[1], at_base)
    assert (seen & ~at_base).any()


def test_a_pose_says_nothing_of_plans():
    """The receiver keeps the plan that it had: where the sender stood at the start."""
    steps = mission(TASK, linked((0, 1), (1, 2)), (option(NEAR, POSE), 0))
    heads = np.asarray(steps[3][1].belief.mate_headers)
    np.testing.assert_allclose(heads[2, 1, :2], STARTS[1], atol=1e-6)
    np.testing.assert_allclose(heads[2, 1, 3:5], STARTS[1], atol=1e-6)
    assert float(steps[3][1].belief.heard_time[2, 1]) > 0.0
    assert float(steps[3][1].belief.heard_time[0, 1]) == 0.0


def test_an_odd_time_between_choices_is_refused():
    with pytest.raises(UsageError, match="hold is 3, but messages are sent half way"):
        replace(TASK, hold=3).scene()


def test_options_are_numbered_by_receivers_and_then_kinds():
    """Silence; pose, plan, map and victims to all, to the base, and to each of two robots: 17."""
    assert OPTIONS == 17
    assert (option(0, POSE), option(0, VICTIMS), option(BASE, POSE), option(3, VICTIMS)) == (1, 4, 5, 16)


def test_reports_count_until_the_next_message_is_due():
    scene = TASK.scene()
    seconds = TASK.hold * TASK.repeat * scene.physics.period
    assert TASK.recent_age(scene) == pytest.approx(seconds)
    assert replace(TASK, actions="goals").recent_age(scene) == RECENT_AGE
