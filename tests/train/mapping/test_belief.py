"""What robots tell each other: against a network in which every word is followed by hand."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from usarmjx.base.clock import Clock
from usarmjx.comms.links import no_links
from usarmjx.comms.mail import MessageSettings, clear_inboxes, deliver, empty_inboxes
from usarmjx.sensors.ranging import ScannerSettings
from usarmjx.train.mapping.belief import (
    HEADER_SIZE,
    VISITED_RADIUS,
    GroupScan,
    compose_messages,
    initial_belief,
    sectors,
    update_base_contact,
    update_from_mail,
    update_from_scan,
    update_pose,
)
from usarmjx.train.mapping.maps import FREE, MARK, UNKNOWN, WALL, MapGrid
from usarmjx.train.mapping.planning import WAYPOINT_SQUARES, PlannerSettings, plan_paths
from usarmjx.train.mapping.wavefront import UNREACHABLE

GRID = MapGrid(low=(0.0, 0.0), cell=0.3, shape=(13, 9))
ROBOTS, BASE, PERIOD = 4, 0, 0.2
SETTINGS = MessageSettings(numbers=HEADER_SIZE + GRID.packed_size, capacity=ROBOTS - 1, bytes_per_step=10_000)
EVERYONE = ~np.eye(ROBOTS, dtype=bool)
read = jax.jit(update_from_mail, static_argnums=(0, 3))


def team(poses=None):
    poses = np.zeros((ROBOTS, 3), np.float32) if poses is None else np.array(poses, np.float32)
    return initial_belief(GRID, jnp.asarray(poses))


@jax.jit
def exchange(belief, linked, time):
    """One step of mail over links that hold."""
    links = no_links(ROBOTS).replace(in_range=linked, delivery_probability=linked.astype(jnp.float32))
    boxes = clear_inboxes(empty_inboxes(SETTINGS, ROBOTS))
    moment = Clock(step=jnp.round(time * 1000).astype(jnp.int32), period=1e-3)
    mail = deliver(SETTINGS, boxes, compose_messages(belief, EVERYONE), links, moment, jax.random.key(0))
    return update_from_mail(GRID, belief, mail, PERIOD)


def drawn(*squares):
    """Own evidence of robots: each (robot, i, j, value)."""
    table = np.zeros((ROBOTS, *GRID.shape), np.int8)
    for robot, i, j, value in squares:
        table[robot, i, j] = value
    return jnp.asarray(table)


def test_news_travel_by_one_link_a_step_and_marks_with_them():
    chain = np.zeros((ROBOTS, ROBOTS), bool)
    for i in range(ROBOTS - 1):
        chain[i, i + 1] = chain[i + 1, i] = True
    belief = team()
    belief = belief.replace(
        evidence=drawn((3, 5, 4, -1), (3, 6, 4, 2)), marks=belief.marks.at[3, 7, 7].set(True)
    )
    for step in range(1, ROBOTS):
        belief = exchange(belief, chain, PERIOD * step)
        squares = np.asarray(belief.squares)
        knows = [squares[robot, 5, 4] == FREE for robot in range(ROBOTS)]
        assert knows == [robot >= ROBOTS - 1 - step for robot in range(ROBOTS)]
    assert (squares[:, 6, 4] == WALL).all()
    assert (squares[:, 7, 7] == MARK).all()
    assert (squares == UNKNOWN).sum() == ROBOTS * (GRID.square_count - 3)


def test_what_a_robot_sees_itself_goes_before_what_it_is_told():
    belief = team().replace(evidence=drawn((0, 2, 2, 3), (1, 2, 2, -3)))
    belief = exchange(belief, EVERYONE, PERIOD)
    assert np.asarray(belief.squares)[:, 2, 2].tolist() == [WALL, FREE, FREE, FREE]


def test_robots_hear_where_the_others_are_and_when_they_said_so():
    poses = [(0.1 * k, 0.2 * k, 0.3 * k) for k in range(ROBOTS)]
    linked = np.zeros((ROBOTS, ROBOTS), bool)
    linked[1, 2] = linked[2, 1] = True
    belief = team(poses)
    belief = belief.replace(pose=belief.pose + 1.0, goal=belief.goal + 2.0)
    belief = exchange(belief, linked, 5.0)
    np.testing.assert_allclose(belief.mate_headers[1, 2], [1.2, 1.4, 1.6, 2.2, 2.4, 0.0], atol=1e-6)
    np.testing.assert_allclose(belief.mate_headers[1, 3, :3], poses[3], atol=1e-6)  # where it started
    assert belief.heard_time[1, 2] == belief.heard_time[2, 1] == 5.0
    assert belief.heard_time[1, 3] == belief.heard_time[0, 1] == 0.0


@pytest.mark.parametrize("seed", range(3))
def test_no_robot_believes_that_the_base_has_what_it_has_not(seed):
    """Each robot's contact is compared with the newest of its words that has really come to the base."""
    draw = np.random.default_rng(seed)
    belief, claims = team(), 0
    newest = np.zeros((ROBOTS, ROBOTS))  # row: who has it, column: whose word; when it was said
    linked = np.zeros((ROBOTS, ROBOTS), bool)
    for step in range(60):
        time = PERIOD * step
        np.fill_diagonal(newest, time)
        for i, j in itertools.combinations(range(ROBOTS), 2):
            if draw.random() < 0.25:
                linked[i, j] = linked[j, i] = ~linked[i, j]
        linked[3, BASE] = linked[BASE, 3] = False  # only over others
        belief = update_base_contact(belief, jnp.asarray(linked), BASE, jnp.float32(time))
        belief = exchange(belief, jnp.asarray(linked), jnp.float32(time))
        told = [newest[[*np.flatnonzero(row), k]].max(0) for k, row in enumerate(linked)]
        newest = np.array(told)
        believed = np.asarray(belief.base_contact_time)
        assert (believed <= newest[BASE] + 1e-4).all()
        claims += believed[3] > 0
    assert claims > 30  # it learned of contact, too


def read_one_by_one(before, box, period):
    """What a robot has after its messages, one after another: header rows, times heard, links, contact."""
    mates, heard, since, contact = (np.array(part) for part in before)
    for sender, time, told in zip(*box, strict=True):
        begun = time if time - heard[sender] > 1.5 * period else since[sender]
        passed_on = min(told[-1] - period, heard[sender])
        contact = max(contact, passed_on) if passed_on >= begun - 1e-3 else contact
        mates[sender], heard[sender], since[sender] = told, time, begun
    return mates, heard, since, contact


@pytest.mark.oracle
@pytest.mark.parametrize("seed", range(20))
def test_a_box_is_read_as_one_message_after_another(seed):
    """Some senders have several messages in it; breaks and contacts are by the times of those before."""
    draw, robots, capacity = np.random.default_rng(seed), 3, 7
    times = np.sort(draw.integers(0, 20, (robots, capacity)), -1) * np.float32(0.1)
    boxes = empty_inboxes(MessageSettings(numbers=SETTINGS.numbers, capacity=capacity), ROBOTS)
    count = draw.integers(0, capacity + 1, ROBOTS)
    payload = draw.integers(0, 4, boxes.payload.shape).astype(np.float32) / 2
    sender = draw.integers(0, robots, (ROBOTS, capacity))
    boxes = boxes.replace(
        count=jnp.asarray(count),
        sender=jnp.asarray(sender),
        time=jnp.asarray(np.concatenate([times, times[:1]])),
        payload=jnp.asarray(payload),
    )
    belief = team().replace(
        heard_time=jnp.asarray(draw.integers(0, 10, (ROBOTS, ROBOTS)) * np.float32(0.1)),
        link_since=jnp.asarray(draw.integers(0, 5, (ROBOTS, ROBOTS)) * np.float32(0.1)),
    )
    found = read(GRID, belief, boxes, PERIOD)
    for k in range(ROBOTS):
        rows = (belief.mate_headers, belief.heard_time, belief.link_since, belief.base_contact_time)
        box = (sender[k], np.asarray(boxes.time[k]), payload[k, :, :HEADER_SIZE])
        expected = read_one_by_one(
            [np.asarray(row[k]) for row in rows], [part[: count[k]] for part in box], np.float32(PERIOD)
        )
        given = (found.mate_headers, found.heard_time, found.link_since, found.base_contact_time)
        for one, other in zip(given, expected, strict=True):
            np.testing.assert_allclose(one[k], other, atol=1e-6)


def test_the_base_is_in_touch_with_itself_and_with_those_it_has_a_link_to():
    linked = np.zeros((ROBOTS, ROBOTS), bool)
    linked[BASE, 2] = linked[2, BASE] = True
    assert update_base_contact(
        team(), jnp.asarray(linked), BASE, jnp.float32(7.0)
    ).base_contact_time.tolist() == [7, 0, 7, 0]


def test_another_robot_is_not_drawn_as_a_wall_if_it_said_where_it_is():
    settings = ScannerSettings(scan_fov=1.0, resolution=0.05, max_range=3.0)
    poses = [(0.6, 1.2, 0.0), (2.1, 1.2, 0.0), (9.0, 9.0, 0.0), (9.0, 9.0, 0.0)]
    ranges = np.full((1, settings.beams), 1.2, np.float32)  # the near side of robot 1
    scan = GroupScan(np.array([0]), settings, jnp.array(poses[:1]), jnp.asarray(ranges), jnp.ones(1, bool))
    heard, silent = team(poses), team(poses).replace(heard_time=jnp.full((ROBOTS, ROBOTS), -9.0))
    at = (0, *GRID.index(np.array([1.8, 1.2])).tolist())
    assert update_from_scan(GRID, heard, scan, jnp.float32(0.2)).squares[at] == UNKNOWN
    assert update_from_scan(GRID, silent, scan, jnp.float32(0.2)).squares[at] == WALL
    # Heard at time 0: after 1.2 s too old for messages of every step, not for those of every 1.6 s.
    late = jnp.float32(1.2)
    assert update_from_scan(GRID, heard, scan, late).squares[at] == WALL
    assert update_from_scan(GRID, heard, scan, late, 1.6).squares[at] == UNKNOWN
    stale = scan.__class__(**{**vars(scan), "fresh": jnp.zeros(1, bool)})
    assert (update_from_scan(GRID, silent, stale, jnp.float32(0.2)).squares == UNKNOWN).all()


def test_sectors_hold_the_shortest_beam():
    ranges = np.arange(24.0)[::-1]
    assert sectors(ranges).tolist() == list(range(22, -1, -2))


def hall(*walls):
    """Own evidence of all robots: a hall of free squares, with what is not known at its right end."""
    table = np.full(GRID.shape, -1, np.int8)
    table[[0, -1], :], table[:, [0, -1]] = 1, 1
    table[9:, :] = 0
    for i, j in walls:
        table[i, j] = 1
    return jnp.broadcast_to(jnp.asarray(table), (ROBOTS, *GRID.shape))


planned = jax.jit(plan_paths, static_argnums=0)


def test_robots_go_to_the_frontier_and_keep_apart():
    poses = [(0.6, 0.6, 0.0), (0.6, 1.8, 0.0), (30.0, 30.0, 0.0), (30.0, 30.0, 0.0)]
    belief = team(poses).replace(evidence=hall())
    belief = plan_paths(GRID, belief, jnp.float32(0.0))
    edge = 8 * GRID.cell
    np.testing.assert_allclose(belief.goal[:2, 0], edge, atol=1e-5)
    assert float(jnp.abs(belief.goal[0, 1] - belief.goal[1, 1])) >= 0.6
    ahead = np.asarray(belief.waypoint[:2, 0]) - 0.6
    np.testing.assert_allclose(ahead, WAYPOINT_SQUARES * GRID.cell, atol=1e-5)


def test_a_robot_leaves_a_frontier_where_it_has_been_for_one_farther_off():
    poses = [(1.8, 1.2, 0.0)] * ROBOTS
    table = np.array(hall())
    table[:, :2] = 0  # unknown at both ends: free squares from 0.6 m to 2.4 m
    belief = team(poses).replace(evidence=jnp.asarray(table), heard_time=jnp.full((ROBOTS, ROBOTS), -99.0))
    new = planned(GRID, belief, jnp.float32(0.0))
    np.testing.assert_allclose(new.goal[:, 0], 2.4, atol=1e-5)
    belief = update_pose(GRID, belief, belief.pose)
    near = np.linalg.norm(GRID.centres - np.array([1.8, 1.2]), axis=-1) < VISITED_RADIUS
    np.testing.assert_array_equal(belief.visited, np.broadcast_to(near, belief.visited.shape))
    been = planned(GRID, belief, jnp.float32(0.0))
    assert (np.linalg.norm(been.goal - np.array([1.8, 1.2]), axis=-1) >= VISITED_RADIUS).all()


@pytest.mark.parametrize(
    "planners", [(1, 2), *(pytest.param(few, marks=pytest.mark.thorough) for few in ((0, 3), (2,))), ()]
)
def test_those_that_plan_go_where_they_go_among_all_and_the_others_stay(planners):
    """Of others each heeds some: the more that it does not heed, the fewer columns, and the same way."""
    draw, peers = np.random.default_rng(2), ~np.eye(ROBOTS, dtype=bool)
    peers[1] = [False, False, False, True]
    belief = team(draw.uniform(0.6, 2.4, (ROBOTS, 3))).replace(evidence=hall())
    flyers = np.array([False, False, True, False])
    everyone = plan_paths(GRID, belief, jnp.float32(0.0), PlannerSettings(peers, flyers, np.arange(ROBOTS)))
    some = plan_paths(GRID, belief, jnp.float32(0.0), PlannerSettings(peers, flyers, np.array(planners, int)))
    for k in range(ROBOTS):
        expected = everyone if k in planners else belief
        for name in ("waypoint", "goal", "path_length"):
            np.testing.assert_array_equal(getattr(some, name)[k], getattr(expected, name)[k])


def test_nobody_has_a_way_where_there_is_no_frontier():
    table = hall().at[:, 9:, :].set(1)
    belief = plan_paths(GRID, team([(0.6, 0.6, 0.0)] * ROBOTS).replace(evidence=table), jnp.float32(0.0))
    assert (belief.path_length >= UNREACHABLE).all()
    np.testing.assert_allclose(belief.waypoint, belief.pose[:, :2])


def test_robots_go_where_they_are_wanted_and_those_that_fly_over_walls():
    poses = [(0.6, 1.2, 0.0), (0.6, 1.2, 0.0), (30.0, 30.0, 0.0), (30.0, 30.0, 0.0)]
    shut = [(5, j) for j in range(9)]  # a wall across the hall
    belief = team(poses).replace(evidence=hall(*shut))
    settings = PlannerSettings(
        peers=np.zeros((ROBOTS, ROBOTS), bool),
        flyers=np.array([False, True, False, False]),
        planners=np.arange(ROBOTS),
    )
    wanted = jnp.full((ROBOTS, *GRID.shape), UNREACHABLE).at[:, 8, 4].set(0.0)
    belief = plan_paths(GRID, belief, jnp.float32(0.0), settings, wanted)
    assert belief.path_length[0] >= UNREACHABLE
    np.testing.assert_allclose(belief.path_length[1], 6.0, atol=1e-4)  # six squares ahead
    np.testing.assert_allclose(belief.goal[1], [2.4, 1.2], atol=1e-5)
