"""Mail: what arrives, in which order, and where every message that does not is counted."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from usarmjx.base.backend import numpy_backend
from usarmjx.base.clock import Clock
from usarmjx.base.errors import SpecError
from usarmjx.comms.links import Links, no_links
from usarmjx.comms.mail import (
    Inboxes,
    MessageSettings,
    OutgoingMessages,
    clear_inboxes,
    deliver,
    empty_inboxes,
    receive,
)

N = 4
SIZES = MessageSettings(numbers=2, capacity=3, bytes_per_step=1000)
EVERYONE = np.ones((N, N), bool)
CAUSES = ("over_budget", "no_link", "lost", "inbox_full")
KEY = jax.random.key(0)
DELIVER = jax.jit(deliver, static_argnums=0)


def links_of(table, chance=1.0) -> Links:
    table = np.asarray(table) & ~np.eye(N, dtype=bool)
    return no_links(N).replace(
        in_range=jnp.asarray(table), delivery_probability=jnp.asarray(table * np.float32(chance))
    )


def post(mail, to, *, length=8, links=None, sizes=SIZES, step=0, key=KEY) -> Inboxes:
    payload = np.stack([np.arange(N), 10 * np.arange(N)], -1)
    letters = OutgoingMessages(
        receivers=jnp.asarray(to),
        payload=jnp.asarray(payload, jnp.float32),
        size_bytes=jnp.broadcast_to(jnp.asarray(length, jnp.int32), (N,)),
    )
    moment = Clock(step=jnp.int32(step), period=0.02)
    return DELIVER(sizes, mail, letters, links_of(EVERYONE) if links is None else links, moment, key)


def only(*pairs):
    table = np.zeros((N, N), bool)
    for sender, receiver in pairs:
        table[sender, receiver] = True
    return table


def dropped(mail):
    return {cause: np.asarray(getattr(mail.dropped, cause)).tolist() for cause in CAUSES}


NOTHING = dropped(empty_inboxes(SIZES, N))


def test_a_message_arrives_with_all_that_belongs_to_it():
    mail = post(empty_inboxes(SIZES, N), only((2, 1)), step=5, length=77)
    assert mail.count.tolist() == [0, 1, 0, 0]
    assert mail.valid.tolist() == [[False] * 3, [True, False, False], [False] * 3, [False] * 3]
    assert mail.sender[1, 0] == 2
    assert mail.time[1, 0] == pytest.approx(0.1)
    assert mail.size_bytes[1, 0] == 77
    assert mail.payload[1, 0].tolist() == [2.0, 20.0]
    assert mail.sent.tolist() == [0, 0, 1, 0]
    assert dropped(mail) == NOTHING


def test_messages_lie_in_the_order_of_arrival():
    mail = post(empty_inboxes(SIZES, N), only((3, 0)), step=1)
    mail = post(mail, only((2, 0), (1, 0)), step=2)
    assert mail.sender[0].tolist() == [3, 1, 2]
    assert mail.time[0].tolist() == pytest.approx([0.02, 0.04, 0.04])


def test_only_links_that_hold_carry():
    mail = post(empty_inboxes(SIZES, N), EVERYONE, links=links_of(only((0, 1), (1, 0))))
    assert mail.count.tolist() == [1, 1, 0, 0]
    assert dropped(mail) == NOTHING | {"no_link": [3, 3, 4, 4]}  # to oneself there is none either
    assert mail.sent.tolist() == [4] * N


def test_full_boxes_take_nothing_more_until_they_are_emptied():
    mail = empty_inboxes(SIZES, N)
    for step in range(5):
        mail = post(mail, only((0, 1), (2, 1)), step=step)
    assert mail.count.tolist() == [0, 3, 0, 0]
    assert mail.sender[1].tolist() == [0, 2, 0]
    assert dropped(mail) == NOTHING | {"inbox_full": [3, 0, 4, 0]}
    kept = clear_inboxes(mail, jnp.array([True, False, True, True]))
    assert kept.count.tolist() == [0, 3, 0, 0]
    mail = post(clear_inboxes(mail), only((3, 1)), step=9)
    assert mail.count.tolist() == [0, 1, 0, 0]
    assert mail.sender[1, 0] == 3
    assert mail.payload[1, 0].tolist() == [3.0, 30.0]


def test_the_budget_is_for_a_control_step():
    sizes = MessageSettings(numbers=2, capacity=8, bytes_per_step=20)
    mail = post(
        empty_inboxes(sizes, N), EVERYONE & ~np.eye(N, dtype=bool), length=[8, 20, 21, 0], sizes=sizes
    )
    # 8 bytes to two of three receivers, the first ones; 20 to one; 21 to none; 0 to all.
    assert dropped(mail) == NOTHING | {"over_budget": [1, 2, 3, 0]}
    assert mail.spent.tolist() == [16, 20, 0, 0]
    assert mail.count.tolist() == [2, 2, 2, 0]
    same = post(mail, only((0, 1), (1, 0), (2, 0)), length=[4, 1, 20, 9], sizes=sizes)
    assert same.spent.tolist() == [20, 20, 20, 0]
    assert dropped(same)["over_budget"] == [1, 3, 3, 0]
    later = post(same, only((0, 1), (1, 0)), length=5, sizes=sizes, step=1)
    assert later.spent.tolist() == [5, 5, 0, 0]
    assert dropped(later)["over_budget"] == [1, 3, 3, 0]


def test_bytes_of_messages_that_do_not_arrive_are_spent():
    mail = post(empty_inboxes(SIZES, N), EVERYONE, links=links_of(np.zeros((N, N), bool)), length=100)
    assert mail.spent.tolist() == [400] * N


def test_lengths_that_make_no_sense_harm_nobody():
    huge = post(empty_inboxes(SIZES, N), EVERYONE, length=[2**31 - 1, -5, -(2**31), 2**30])
    assert huge.spent.tolist() == [0, 0, 0, 0]
    assert dropped(huge)["over_budget"] == [4, 0, 0, 4]


def test_losses_near_the_cutoff_come_as_often_as_they_should():
    sizes = MessageSettings(numbers=2, capacity=1, bytes_per_step=1000)
    keys = jax.random.split(KEY, 2000)
    links = links_of(EVERYONE, chance=0.25)
    to = EVERYONE & ~np.eye(N, dtype=bool)
    mail = jax.vmap(lambda key: post(empty_inboxes(sizes, N), to, links=links, sizes=sizes, key=key))(keys)
    lost = np.asarray(mail.dropped.lost).sum() / (2000 * 12)
    assert lost == pytest.approx(0.75, abs=0.012)  # 24000 draws: four standard deviations
    sure = jax.vmap(lambda key: post(empty_inboxes(sizes, N), only((0, 1)), sizes=sizes, key=key))(keys)
    assert np.asarray(sure.count)[:, 1].all()


tables = st.lists(st.booleans(), min_size=N * N, max_size=N * N).map(lambda t: np.reshape(t, (N, N)))
rounds = st.lists(st.tuples(tables, tables, st.integers(0, 400), st.booleans()), min_size=1, max_size=6)


@settings(deadline=None)
@given(rounds)
def test_every_message_is_in_a_box_or_counted_as_dropped(calls: list):
    """Against a plain loop over senders and receivers."""
    mail, boxes, spent, asked = empty_inboxes(SIZES, N), [[] for _ in range(N)], [0] * N, 0
    drops, step = {cause: [0] * N for cause in CAUSES}, 0
    for to, linked, length, next_step in calls:
        if next_step:
            step, spent = step + 1, [0] * N
        links = links_of(linked)
        for s in range(N):
            for r in range(N):
                if not to[s, r]:
                    continue
                asked += 1
                if spent[s] + length > SIZES.bytes_per_step:
                    drops["over_budget"][s] += 1
                    continue
                spent[s] += length
                if not linked[s, r] or s == r:
                    drops["no_link"][s] += 1
                elif len(boxes[r]) == SIZES.capacity:
                    drops["inbox_full"][s] += 1
                else:
                    boxes[r].append((s, length))
        mail = post(mail, to, length=length, links=links, step=step)
    assert dropped(mail) == drops
    for r in range(N):
        held = int(mail.count[r])
        assert (
            list(zip(mail.sender[r, :held].tolist(), mail.size_bytes[r, :held].tolist(), strict=True))
            == boxes[r]
        )
    assert int(mail.sent.sum()) == asked == sum(map(len, boxes)) + sum(map(sum, drops.values()))


@pytest.mark.parametrize("name", ["numbers", "capacity", "bytes_per_step"])
def test_sizes_that_make_no_sense_are_refused(name: str):
    with pytest.raises(SpecError, match=f"{name} is 0, expected a whole number from 1"):
        MessageSettings(**{name: 0})


SLOW = MessageSettings(numbers=2, capacity=3, bytes_per_step=1000, latency=0.05, bandwidth=100.0)


def read(mail, step):
    with numpy_backend():
        return receive(mail, Clock(step=np.int32(step), period=0.02))


def senders(mail, receiver):
    return np.asarray(mail.sender)[receiver][: int(mail.count[receiver])].tolist()


@pytest.mark.parametrize("age", [0, 1_800_000_000])
def test_messages_take_the_time_of_their_bytes_and_the_latency(age):
    """8 bytes at 100 bytes/s and 0.05 s are 0.13 s, 6.5 steps of 0.02 s; the next one is 4 steps later."""
    mail = post(empty_inboxes(SLOW, N), only((0, 1), (2, 1)), sizes=SLOW, step=age)
    mail = post(mail, only((0, 1)), sizes=SLOW, step=age)
    assert not np.asarray(mail.count).any()
    mail = jax.device_get(mail)
    counts = [int(read(mail, age + step).count[1]) for step in (0, 6, 7, 10, 11)]
    assert counts == [0, 0, 2, 2, 3], "0.21 s are 10.5 steps"
    assert senders(read(mail, age + 7), 1) == [0, 2]
    later = read(read(mail, age + 7), age + 11)
    assert senders(later, 1) == [0, 2, 0]
    np.testing.assert_array_equal(later.payload[1], [[0, 0], [2, 20], [0, 0]])
    assert dropped(later) == NOTHING
    assert not later.transit.count.any()


def test_a_links_queue_is_as_long_as_a_box_and_is_free_when_it_has_sent_all():
    mail = empty_inboxes(SLOW, N)
    for _ in range(4):
        mail = post(mail, only((0, 1)), sizes=SLOW)
    assert dropped(mail)["inbox_full"] == [1, 0, 0, 0]
    mail = read(jax.device_get(mail), 100)
    assert senders(mail, 1) == [0, 0, 0]
    late = jax.device_get(post(mail, only((0, 1), (0, 2)), sizes=SLOW, step=100))
    assert int(read(late, 107).count[2]) == 1
    assert dropped(read(late, 107))["inbox_full"] == [2, 0, 0, 0], "box 1 is still full"


def test_latency_alone_holds_any_number_of_bytes():
    sizes = MessageSettings(numbers=2, capacity=3, bytes_per_step=1000, latency=0.04)
    mail = jax.device_get(post(empty_inboxes(sizes, N), only((0, 1)), sizes=sizes, length=900))
    assert [int(read(mail, step).count[1]) for step in (0, 1, 2)] == [0, 0, 1]
