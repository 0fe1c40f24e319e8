"""Tasks for teams: in a room drawn by hand, with what its robots' sensors would report."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.train.rooms import DEPTH, WIDTH, _machine, begin, play, room, view_of
from usarmjx.models.compile.randomization import RandomizedValues
from usarmjx.models.compile.reachability import footprint_of
from usarmjx.models.robots import ROBOTS
from usarmjx.train.baselines.planners import frontier_action, relay_policy
from usarmjx.train.learning.config import Config
from usarmjx.train.learning.rollout import Rollout
from usarmjx.train.mapping.belief import SECTOR_COUNT
from usarmjx.train.mapping.maps import FREE, MARK, WALL, reachable_squares, to_robot_frame
from usarmjx.train.tasks.buildings import Buildings, sort_starts
from usarmjx.train.tasks.explore import Explore, on_maps
from usarmjx.train.tasks.relay_chain import RelayChain
from usarmjx.train.tasks.team import coverage
from usarmjx.train.tasks.victim_search import VictimSearch

STARTS = ((0.6, 0.9), (0.6, 2.1), (1.8, 0.9), (1.8, 2.1))
STEPS = 6


def paths(*ends, steps=STEPS):
    """Robots on straight lines from their starts to x, y (steps + 1, robots, 3)."""
    share = np.linspace(0.0, 1.0, steps + 1)[:, None, None]
    start = np.array(STARTS[: len(ends)])
    way = start + share * (np.array(ends) - start)
    return np.concatenate([way, np.zeros((steps + 1, len(ends), 1))], -1)


def chain(robots, *pairs):
    """Links at one time."""
    table = np.zeros((robots, robots), bool)
    for i, j in pairs:
        table[i, j] = table[j, i] = True
    return table


def search(linked, base):
    """Who reaches the base, one link after the other."""
    found = {base}
    while more := {int(j) for i in found for j in np.flatnonzero(linked[i])} - found:
        found |= more
    return found


def test_an_episode_that_counts_as_begun_earlier_tells_the_time_that_is_left(explored):
    """Training begins first episodes so; what a critic and the agents see of the time agrees with its end."""
    task, steps = explored
    (_, memory, _), (after, _, plain) = steps[0], steps[1]
    late = STEPS - 2
    memory = jax.tree.map(jnp.asarray, task.started_at(memory, jnp.int32(late)))
    result = _machine(task)[2](after, memory)
    assert float(task.privileged(after, result.memory)[1]) == pytest.approx((late + 1) / STEPS)
    observe = jax.jit(task.observe)
    usual, seen = observe(after, plain.memory)[0], observe(after, result.memory)[0]
    left = np.flatnonzero(np.abs(seen - usual).max(0) > 1e-6)
    assert len(left) == 1, "nothing else of the observation changes"
    np.testing.assert_allclose(usual[:, left], 1 - 1 / STEPS, rtol=1e-6)
    np.testing.assert_allclose(seen[:, left], 1 / STEPS, rtol=1e-5)
    for name, value in plain.metrics.items():
        assert float(result.metrics[name]) == float(value), name
    assert float(plain.score) > float(result.score) > 0, (
        "what the first scans show counts, what is late pays less"
    )


def test_training_tells_tasks_how_late_their_first_episodes_begin():
    class Late(Explore):
        def started_at(self, memory, steps):
            return ("told", steps)

    state = SimpleNamespace(length=jnp.zeros(2, jnp.int32), memory=())
    state.replace = partial(_replaced, state)
    env = SimpleNamespace(task=Late(), reset=lambda seed: state, worlds=2)
    late = jnp.array([3, 5])
    rollout = SimpleNamespace(
        config=Config(),
        env=env,
        teacher=None,
        rivals=None,
        _seeds=lambda: (0, None),
        _begin=lambda key: (jnp.arange(2), late, ()),
    )
    begun = Rollout.start(rollout, 1.0).env_state
    assert begun.memory[0] == "told"
    assert begun.memory[1].tolist() == begun.length.tolist() == [3, 5]


def _replaced(state, **new):
    made = SimpleNamespace(**{**vars(state), **new})
    made.replace = partial(_replaced, made)
    return made


@pytest.fixture(scope="module")
def explored():
    task = Explore(arena=room(STARTS), count=2, episode_steps=STEPS, price=3.0)
    links = [chain(2, (0, 1)) if step >= 3 else chain(2) for step in range(STEPS + 1)]
    return task, list(play(task, paths((4.8, 0.9), (0.6, 2.74)), links))


def test_the_score_of_exploring_is_the_mean_of_what_is_explored_and_known(explored):
    task, steps = explored
    covered = np.array([float(coverage(memory)) for _, memory, _ in steps])
    known = np.array([float(on_maps(memory)) for _, memory, _ in steps])
    contacts = float(steps[-1][2].metrics["contacts"])
    assert contacts == 1  # robot 1 ends 0.235 m from the wall, half as wide as it is
    expected = 50 * covered[1:].mean() + 50 * known[1:].mean() - task.price * contacts
    np.testing.assert_allclose(steps[-1][2].score, expected, rtol=1e-4)
    assert covered[-1] > 0.9
    assert (np.diff(covered) >= 0).all()


def test_rewards_of_exploring_add_up_to_its_score_but_for_the_first_scans(explored):
    _, steps = explored
    rewards = sum(float(group.sum()) for _, _, result in steps[1:] for group in result.reward)
    first = 50 * (float(coverage(steps[0][1])) + float(on_maps(steps[0][1])))
    np.testing.assert_allclose(rewards + first, float(steps[-1][2].score), rtol=1e-4)


def series_of(results):
    """Metrics after each step, by name (steps,)."""
    return {key: np.array([float(result.metrics[key]) for result in results]) for key in results[0].metrics}


def test_the_parts_of_the_score_of_exploring_are_all_of_it(explored):
    task, steps = explored
    results = [result for _, _, result in steps[1:]]
    parts = task.score_parts(series_of(results))
    assert parts.keys() == task.most_points.keys()
    np.testing.assert_allclose(sum(parts.values()), [float(r.score) for r in results], rtol=1e-4)
    assert parts["contacts"][-1] == -task.price


@pytest.mark.thorough
def test_a_find_that_comes_late_pays_more_with_less_haste(explored):
    """The step before is played again: what is new in it is worth 1/2 + 1/2 of the time left, not that."""
    task, steps = explored
    (view, _, hasty), (_, memory, _) = steps[4], steps[3]
    calm = replace(task, haste=0.5, price=0.0).evaluate(view, memory)
    left = (STEPS - 3) / STEPS
    gain = float(hasty.score) - float(memory.score)
    assert gain > 1.0
    np.testing.assert_allclose(float(calm.score) - float(memory.score), gain * (0.5 / left + 0.5), rtol=1e-3)


def test_without_advice_the_planners_numbers_are_hidden_and_no_others(explored):
    task, steps = explored
    view, memory, _ = steps[-1]
    ((shown,), (hidden,)) = (replace(task, advice=on).observe(view, memory) for on in (True, False))
    assert np.abs(np.asarray(shown)[:, :5]).max(0).min() > 0
    assert not np.asarray(hidden)[:, :5].any()
    np.testing.assert_array_equal(hidden[:, 5:], shown[:, 5:])


def test_maps_are_shared_over_links_alone(explored):
    _, steps = explored
    maps = [np.asarray(memory.belief.squares) == FREE for _, memory, _ in steps]
    assert (maps[3][0] & ~maps[3][1]).sum() > 20  # robot 0 has seen what robot 1 has not
    # What was written after step 3 was read in step 4.
    assert not (maps[3][0] & ~maps[4][1]).any()
    gaps = [float(result.metrics["unlinked"]) for _, _, result in steps[1:]]
    np.testing.assert_allclose(gaps[-1], 2 / STEPS, atol=1e-6)  # steps 1 and 2


def test_the_maps_that_robots_build_lie_over_the_room(explored):
    task, steps = explored
    view, memory, _ = steps[-1]
    maps = task.maps(view.scene, memory)
    squares = np.asarray(maps.squares)
    assert len(squares) == 2
    for own in squares:
        free, wall = (np.array(maps.low) + maps.cell * np.argwhere(own == kind) for kind in (FREE, WALL))
        assert len(free) > 100
        assert ((free > 0) & (free < (WIDTH, DEPTH))).all()
        edge = np.minimum(np.abs(wall), np.abs(wall - (WIDTH, DEPTH))).min(-1)
        assert len(wall) > 20
        assert (edge < maps.cell).all()


def test_observations_have_one_size_and_are_finite(explored):
    task, steps = explored
    view, memory, _ = steps[-1]
    (seen,) = task.observe(view, memory)
    assert seen.shape == (2, 6 + SECTOR_COUNT + 2 + 4 + 2 * 121)
    assert np.isfinite(np.asarray(seen)).all()
    assert np.abs(np.asarray(seen)[:, 4:]).max() <= 1.0
    assert np.isfinite(np.asarray(task.privileged(view, memory))).all()


def kinds(memory):
    """What a compiled function asks of its arguments: shapes and types."""
    return [(x.shape, x.dtype, x.weak_type) for x in jax.tree.leaves(memory)]


def test_a_step_leaves_the_types_of_what_is_remembered_as_they_are(explored):
    """Else all would be compiled again in the second step."""
    _, steps = explored
    assert kinds(steps[1][1]) == kinds(steps[0][1])


def test_places_are_seen_in_a_robots_own_axes():
    seen = to_robot_frame(jnp.array([1.0, 2.0, np.pi / 2]), jnp.array([1.0, 5.0]))
    np.testing.assert_allclose(seen, [3.0, 0.0], atol=1e-6)


VICTIM = (5.0, 1.5)
PART = (1.0, 0.0, 1.0, -0.3, 0.1)
"""A part met 1 m ahead of a victim sensor and 0.3 m to its right."""


def searching(linked, path, met_at, **changes):
    """Steps of a base and two robots, the first of which meets something at some steps."""
    task = VictimSearch(
        arena=room(STARTS, (VICTIM,)),
        wheeled=("P2AT",) * 2,
        tracked=(),
        flying=(),
        episode_steps=STEPS,
        **changes,
    )
    boxes = len(task.scene().victims.part)
    met = np.zeros((STEPS + 1, 3, boxes, 5), np.float32)
    for step in met_at:
        met[step, 1, 0] = PART
    return task, list(play(task, path, linked, met))


def test_a_victim_is_reported_when_the_word_reaches_the_base_over_others():
    apart, joined = chain(3), chain(3, (0, 2), (1, 2))
    links = [apart, apart, apart, joined, joined, joined, joined]
    # The sensor is 0.1439 m before the robot's middle, so what it met is where the victim is.
    path = [[(*STARTS[0], 0.0), (3.8561, 1.8, 0.0), (*STARTS[2], 0.0)]] * (STEPS + 1)
    task, steps = searching(links, path, [1])
    # Met in step 1, written after step 3 to robot 2, after step 4 by that to the base, read in step 5.
    reported = [float(result.metrics["reported"]) for _, _, result in steps[1:]]
    assert reported == [0, 0, 0, 0, 1, 1]
    _, memory, result = steps[-1]
    marked = np.argwhere(np.asarray(memory.belief.squares)[0] == MARK)
    np.testing.assert_array_equal(marked, [np.round(np.array(VICTIM) / 0.3)])
    assert result.metrics["wrong"] == 0
    connected = [len(search(links[k], 0)) - 1 for k in range(1, STEPS + 1)]
    np.testing.assert_allclose(result.metrics["connected"], np.mean(connected) / 2, rtol=1e-5)
    mapped = np.array([float(v.metrics["mapped"]) for _, _, v in steps[1:]])
    contacts = float(result.metrics["contacts"])
    expected = 60 * np.mean(reported) + 30 * mapped.mean() + 10 * np.mean(connected) / 2
    np.testing.assert_allclose(result.score, expected - task.price * contacts, rtol=1e-4)
    results = [result for _, _, result in steps[1:]]
    parts = task.score_parts(series_of(results))
    assert parts.keys() == task.most_points.keys()
    np.testing.assert_allclose(sum(parts.values()), [float(r.score) for r in results], rtol=1e-4)


def test_a_wrong_mark_costs_and_an_unheard_one_is_worth_nothing():
    path = paths((0.6, 0.9), (0.6, 2.1), (1.8, 0.9))
    joined, apart = [chain(3, (0, 1))] * (STEPS + 1), [chain(3)] * (STEPS + 1)
    _, steps = searching(joined, path, [1])
    assert float(steps[-1][2].metrics["wrong"]) == 1
    assert float(steps[-1][2].metrics["reported"]) == 0
    _, steps = searching(apart, path, [1])
    assert float(steps[-1][2].metrics["wrong"]) == 0
    assert float(steps[-1][2].score) == pytest.approx(0.0, abs=1e-5)
    # The finder knows that the base does not, and thinks of going home.
    memory = steps[-1][1]
    assert memory.belief.mark_time[1] > memory.belief.base_contact_time[1]
    assert float(jnp.linalg.norm(memory.belief.goal[1] - memory.belief.pose[0, :2])) < 1.6


def test_contacts_cost_those_that_touch_and_the_rest_goes_to_all():
    path = paths((0.6, 0.9), (0.235, 2.1), (1.8, 0.9))  # robot 1 ends as near to the wall as half its width
    task, steps = searching([chain(3, (0, 1))] * (STEPS + 1), path, [], hint=0.0, price=0.25, haste=0.25)
    rewards = np.array([np.asarray(result.reward[0]) for _, _, result in steps[1:]])
    assert float(steps[-1][2].metrics["contacts"]) == 1
    np.testing.assert_allclose(rewards[:, 0].sum() - rewards[:, 1].sum(), -0.25, atol=1e-5)
    np.testing.assert_allclose(rewards.sum(), float(steps[-1][2].score), rtol=1e-4)
    parts = task.score_parts(series_of([result for _, _, result in steps[1:]]))
    np.testing.assert_allclose(sum(parts.values())[-1], float(steps[-1][2].score), rtol=1e-4)


def test_without_messages_to_each_other_robots_still_write_to_the_base():
    task = VictimSearch(arena=room(STARTS), wheeled=("P2AT",) * 2, tracked=(), flying=(), talk="base")
    scene = task.scene()
    assert task.recipients(scene).tolist() == [[False] * 3, [True, False, False], [True, False, False]]
    assert replace(task, talk="all").recipients(scene).sum() == 6
    assert replace(task, talk="none").recipients(scene).sum() == 0


def test_the_chain_is_as_long_as_its_deepest_robot_that_reaches_the_base():
    task = RelayChain(arena=room(STARTS), count=3, episode_steps=STEPS, price=0.0)
    path = paths((0.6, 0.9), (2.4, 2.1), (3.6, 0.9), (5.1, 2.1))
    whole, broken = chain(4, (0, 1), (1, 2), (2, 3)), chain(4, (0, 1), (2, 3))
    links = [whole] * 4 + [broken] * 3
    steps = list(play(task, path, links))
    total = 0.0
    depth = np.asarray(steps[0][1].extra.depth)
    grid = task.arena_grid(steps[0][0].scene)
    for k, (_, _, result) in enumerate(steps[1:], start=1):
        squares = np.asarray(grid.index(path[k, :, :2]))
        deep = [depth[tuple(squares[robot])] for robot in search(links[k], 0)]
        np.testing.assert_allclose(result.metrics["reach"], max(deep), rtol=1e-5)
        total += max(deep)
    np.testing.assert_allclose(steps[-1][2].score, 100 * total / STEPS, rtol=1e-4)
    parts = task.score_parts(series_of([result for _, _, result in steps[1:]]))
    np.testing.assert_allclose(parts["depth"][-1], 100 * total / STEPS, rtol=1e-4)


def test_depths_in_a_room_are_lengths_of_ways_over_squares():
    task = RelayChain(arena=room(STARTS), count=1)
    scene, world, physics = begin(task)
    view = view_of(scene, world, physics, [(*STARTS[0], 0.0), (*STARTS[1], 0.0)])
    memory = jax.jit(task.start)(view, jax.random.key(0))
    depth = np.asarray(memory.extra.depth)
    base = np.round(np.array(STARTS[0]) / 0.3)
    i, j = np.meshgrid(*map(np.arange, depth.shape), indexing="ij")
    low, high = np.sort(np.abs(np.stack([i - base[0], j - base[1]])), 0)
    octile = high - low + np.sqrt(2) * low  # without walls
    inside = np.asarray(memory.reachable)
    np.testing.assert_allclose(depth[inside], (octile / octile[inside].max())[inside], rtol=1e-5)
    # A P2AT, whose circle has a radius of 0.36 m, gets everywhere but along the walls.
    x, y = 0.3 * i, 0.3 * j
    clear = (np.minimum(x, WIDTH - x) > 0.5) & (np.minimum(y, DEPTH - y) > 0.5)
    assert inside[clear].all()
    assert not inside[(np.minimum(x, WIDTH - x) < 0.3) | (np.minimum(y, DEPTH - y) < 0.3)].any()


def test_each_world_knows_which_squares_of_its_own_arena_are_reached():
    library = Buildings(count=2, levels=(0.5, 1.0), size=(4, 3))
    task = Explore(arena=library, count=1)
    scene, world, physics = begin(task)
    view = view_of(scene, world, physics, [(0.6, 0.6, 0.0)])
    assert scene.arenas is not None
    for number, arena in enumerate(scene.arenas.arenas):
        state = jax.tree.map(lambda rows, n=number: jnp.asarray(rows[n]), scene.arenas.states)
        found = task.note(view.replace(world=world.replace(arena_state=state)), "reachable")
        size = footprint_of(ROBOTS.get("P2AT"))
        np.testing.assert_array_equal(found, reachable_squares(arena, task.arena_grid(scene), size))
    tables = scene.arenas.states.notes["reachable"].reshape(len(scene.arenas.arenas), -1)
    assert len(np.unique(tables, axis=0)) > 2  # else the test would say nothing


def test_robots_start_side_by_side():
    away = [np.hypot(s.at[0] - STARTS[2][0], s.at[1] - STARTS[2][1]) for s in room(STARTS).starts]
    mixed = room((STARTS[2], STARTS[1], STARTS[0], STARTS[3]))
    order = [start.at[:2] for start in sort_starts(mixed).starts]
    assert order[0] == STARTS[2]
    assert sorted(away) == [np.hypot(x - STARTS[2][0], y - STARTS[2][1]) for x, y in order]


def seen(**told):
    """An observation: 12 free sectors, on the move, half of the time left; `told` by place."""
    row = np.zeros(40, np.float32)
    row[4:6] = 0.1, 1.0
    row[6 : 6 + SECTOR_COUNT + 1] = [1.0] * SECTOR_COUNT + [0.505]
    for name, value in told.items():
        row[int(name[1:])] = value
    return jnp.asarray(row)


def told(**what):
    """What the frontier baseline does when it sees that, in an episode of 200 steps."""
    return frontier_action(seen(**what), 200)


def test_the_frontier_baseline_drives_where_its_way_leads():
    speed, turn = told(_0=1.0)
    assert speed > 0.8
    assert abs(turn) < 1e-6
    assert told(_1=1.0)[0] < 0.05  # to the left: turn first
    assert told(_1=1.0)[1] > 0.4
    assert told(_1=-1.0)[1] < -0.4
    assert told(_4=1.0).tolist() == [0.0, 0.0]  # no way: the next place is here
    assert told(_0=1.0, _4=1.0)[0] > 0.8  # a long one
    assert told(_0=1.0, _11=0.01)[0] == 0.0  # something right ahead
    left = np.arange(40) / 200  # shares of the time
    backs = [bool(told(_0=1.0, _5=0.0, _18=share)[0] < 0) for share in left]
    assert backs == 2 * [*[True] * 5, *[False] * 15]  # stuck: back for a second, then three to try again


class Fake:
    """What the relay baseline asks of an environment."""

    def __init__(self, robots, talk="all"):
        self.scene, self.episode_steps = type("Scene", (), {"num_robots": robots}), 200
        self.task = type("Task", (), {"talk": talk})


def test_a_relay_sees_powers_above_the_cutoff_of_its_own_world():
    task = RelayChain(arena=room(STARTS), count=1)
    scene, world, physics = begin(task)
    view = view_of(scene, world, physics, [(0.6, 0.9, 0.0), (1.6, 0.9, 0.0)], linked=chain(2, (0, 1)))
    heard = view.links.replace(power=jnp.full((2, 2), task.radio.cutoff + 5.0))
    memory = jax.jit(task.start)(view, jax.random.key(0))
    observe = jax.jit(task.observations)

    def margins(varied):
        own = view.world.replace(links=heard, varied=varied)
        return np.asarray(observe(view.replace(world=own), memory))[:, -1]

    np.testing.assert_allclose(margins(None), 5.0 / 20.0, rtol=1e-6)
    deaf = RandomizedValues(radio_cutoff=jnp.float32(task.radio.cutoff + 3.0))
    np.testing.assert_allclose(margins(deaf), 2.0 / 20.0, rtol=1e-6)


def test_a_relay_stops_where_the_one_before_it_is_hard_to_hear():
    robots, ahead = 3, np.asarray(seen(_0=1.0))
    strong, weak = np.array([[0.5, 0.5]]), np.array([[0.05, 0.5]])

    def told(powers, slot, age=0.0, **kind):
        row = ahead.copy()
        row[7 + SECTOR_COUNT] = slot / robots
        row = np.concatenate([row, [age], powers[0]]).astype(np.float32)
        policy = relay_policy(Fake(robots, **kind))
        return float(policy.act((), (jnp.asarray(row[None]),), jax.random.key(0))[1][0][0, 0])

    assert told(strong, 1) > 0.8
    assert told(weak, 1) == 0.0  # hears the base badly
    assert told(weak, 2) > 0.8  # hears robot 1 well
    assert told(weak, 1, age=0.5) > 0.8  # on its way home
    assert told(weak, 1, talk="none") > 0.8
