"""The radio in a batch: robots drive apart until their link drops where the formula says, and send mail."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.comms.test_attenuation import DBM_ATOL, manual_power
from tests.handy import known
from usarmjx.base.errors import SpecError, UsageError
from usarmjx.base.transforms import quat_from_angles
from usarmjx.comms.attenuation import RadioSettings, link_range
from usarmjx.comms.links import MIN_ANTENNA_HEIGHT, antenna_offset, antenna_positions, reachable
from usarmjx.comms.mail import MessageSettings
from usarmjx.models.robots import ROBOTS
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.robots.station import COMSTATION
from usarmjx.models.types.arena import ArenaSpec, StartPose
from usarmjx.models.types.shapes import Shape
from usarmjx.sim.batch import Batch
from usarmjx.sim.radio import robot_antennas, update_links
from usarmjx.sim.scene import RosterEntry, build_scene

WALKER = replace(P2AT, name="Walker", sensors=(), cameras=(), packages=())  # quick to compile
MAST = replace(COMSTATION, name="Mast", sensors=())
ROSTER = (
    RosterEntry("Walker"),
    RosterEntry("Mast"),
    RosterEntry("Walker"),
    RosterEntry("Walker", parked=True),
)
N, WORLDS, PERIOD = len(ROSTER), 3, 0.02
WEST, STATION, NORTH, PARKED = range(N)

RADIO = RadioSettings(cutoff=-52.0)
LIMIT = link_range(RADIO, 0)  # 3.27 m
MAIL = MessageSettings(numbers=1, capacity=2, bytes_per_step=64)
LANE = ArenaSpec(
    name="lane",
    starts=(
        StartPose(tag="West", at=(-2.5, 0.0, 0.188), yaw=np.pi),  # faces away from the station
        StartPose(tag="Station", at=(0.0, 0.0, 0.188)),
        StartPose(tag="North", at=(0.0, 2.0, 0.188), yaw=np.pi / 2),
    ),
    shapes=(Shape(kind="box", size=(1.0, 0.05, 0.8), at=(0.0, 1.0, 0.8), surface="wall"),),
    extent=((-4, 4), (-4, 4)),
)


@pytest.fixture(scope="module", autouse=True)
def robots():
    with known(WALKER, MAST):
        yield


@pytest.fixture(scope="module")
def batch(robots):
    return Batch(build_scene(LANE, ROSTER, radio=RADIO, mail=MAIL), WORLDS, engine="c", seed=1)


def true_antennas(batch, state):
    """Antennas in doubles off the physics' state (worlds, robots, 3): up from the origin in robot axes."""
    qpos = np.asarray(batch.physics(state).qpos, float)
    out = np.zeros((batch.worlds, N, 3))
    for team in batch.scene.groups:
        for slot, root in zip(team.slots, team.root_qposadr, strict=True):
            w, i, j, k = qpos[:, root[3:]].T
            up = np.stack([2 * (i * k + w * j), 2 * (j * k - w * i), 1 - 2 * (i * i + j * j)], -1)
            out[:, slot] = qpos[:, root[:3]] + up * team.robot.dimensions[2] / 2
    return out


def drive(batch, state, robot, speeds):
    """Drive one of the walkers straight on, with a speed for each world [rad/s]."""
    place = {WEST: 0, NORTH: 1}[robot]
    told = np.zeros((WORLDS, 3))
    told[:, place] = speeds
    return batch.drive(state, 0, {"Left": told, "Right": told})


@pytest.mark.oracle
def test_a_link_drops_where_the_formula_says(batch):
    """Three worlds: a robot drives off at two speeds, and stays; the station hears it up to 3.27 m."""
    state = drive(batch, batch.reset(), WEST, (5.0, 2.5, 0.0))
    state, links = batch.links(state)
    assert np.asarray(links.in_range)[:, WEST, STATION].all()
    assert not np.asarray(links.went_down | links.came_up).any()
    held, drops, before = np.full(WORLDS, True), {}, np.zeros(WORLDS)
    for step in range(1, 91):
        state, links = batch.links(batch.step(state))
        at = true_antennas(batch, state)
        apart = np.linalg.norm(at[:, WEST] - at[:, STATION], axis=-1)
        power = [manual_power(d, 0) for d in apart]
        np.testing.assert_allclose(np.asarray(links.power)[:, WEST, STATION], power, atol=DBM_ATOL)
        now = np.asarray(links.in_range)[:, WEST, STATION]
        for way in ((WEST, STATION), (STATION, WEST)):
            np.testing.assert_array_equal(np.asarray(links.went_down)[:, *way], held & ~now)
        for world in np.flatnonzero(held & ~now):
            drops[int(world)] = (step, before[world], apart[world])
        held, before = now, apart
    assert held.tolist() == [False, False, True]
    assert drops[0][0] < drops[1][0]  # the faster one first
    for _, last, first in drops.values():
        assert last <= LIMIT < first
        assert first - last < 0.75 * PERIOD  # a P2AT drives 0.7 m/s: within one control step


def test_a_world_that_is_reset_starts_without_events(batch):
    state = drive(batch, batch.reset(), WEST, 5.0)
    for _ in range(60):
        state = batch.step(state)
    state, links = batch.links(state)
    assert not np.asarray(links.in_range)[:, WEST, STATION].any()
    state, links = batch.links(batch.reset_where(state, jnp.array([True, False, False])))
    assert np.asarray(links.in_range)[:, WEST, STATION].tolist() == [True, False, False]
    assert not np.asarray(links.came_up).any()
    assert np.asarray(links.step).tolist() == [0, 60, 60]


def test_walls_count_and_robots_do_not(batch):
    _, links = batch.links(batch.reset())
    walls = np.zeros((N, N), int)
    walls[STATION, NORTH] = walls[NORTH, STATION] = 1  # from 1.6 m down to 0.5 m it is 1 m high at the wall
    np.testing.assert_array_equal(links.walls, np.broadcast_to(walls, (WORLDS, N, N)))
    # A robot that stands right between two others weakens nothing.
    row = replace(LANE, starts=tuple(StartPose(tag=f"S{i}", at=(i, 0, 0.188)) for i in range(3)), shapes=())
    one = Batch(build_scene(row, ["Walker"] * 3, radio=RADIO), 1, engine="c")
    assert not np.asarray(one.links(one.reset())[1].walls).any()


def test_parked_robots_are_silent_until_they_are_used(batch):
    state, links = batch.links(batch.reset())
    assert np.asarray(links.paired)[0].sum() == 6
    assert not np.asarray(links.paired)[:, PARKED].any()
    members = state.worlds.groups[0]
    state = batch.step(batch.with_group(state, 0, members.replace(active=members.active.at[1, 2].set(True))))
    _, links = batch.links(state)
    assert np.asarray(links.paired)[:, PARKED].sum(-1).tolist() == [0, 3, 0]


def test_messages_go_over_links_and_are_counted_without(batch):
    state = batch.send(batch.reset(), ~np.eye(N, dtype=bool), np.arange(float(N))[:, None])
    mail, links = state.worlds.mail, state.worlds.links
    held = np.zeros((N, N), bool)
    held[WEST, STATION] = held[STATION, WEST] = True  # the third is behind the wall, and 3.2 m from the first
    held[WEST, NORTH] = held[NORTH, WEST] = True
    np.testing.assert_array_equal(links.in_range, np.broadcast_to(held, (WORLDS, N, N)))
    np.testing.assert_array_equal(mail.count, np.broadcast_to(held.sum(0), (WORLDS, N)))
    assert np.asarray(mail.sender)[0, WEST].tolist() == [STATION, NORTH]
    assert np.asarray(mail.payload)[0, WEST, :, 0].tolist() == [STATION, NORTH]
    assert np.asarray(mail.dropped.no_link)[0].tolist() == [1, 2, 2, 3]
    # The station hears the third robot by way of the first.
    assert np.asarray(reachable(links.in_range, STATION))[0].tolist() == [True, True, True, False]
    assert np.asarray(reachable(links.in_range, STATION, 1))[0].tolist() == [True, True, False, False]
    state = batch.clear_mail(state, np.arange(N) == WEST)
    assert np.asarray(state.worlds.mail.count)[0].tolist() == [0, 1, 1, 0]
    state = batch.send(batch.step(state), held, 0.0, length=65)
    assert np.asarray(state.worlds.mail.dropped.over_budget)[0].tolist() == [2, 1, 1, 0]
    fresh = batch.reset_where(state, jnp.array([True, True, False]))
    assert np.asarray(fresh.worlds.mail.count).sum(-1).tolist() == [0, 0, 2]


def test_links_are_evaluated_as_often_as_asked(batch):
    scene = replace(batch.scene, radio=replace(RADIO, period=5 * PERIOD))
    seldom = Batch(scene, WORLDS, engine="c")
    state = drive(seldom, seldom.reset(), WEST, 5.0)
    seen, powers = [], []
    for _ in range(12):
        state, links = seldom.links(state)
        state, again = seldom.links(state)  # a second look in the same step changes nothing
        jax.tree.map(np.testing.assert_array_equal, links, again)
        seen.append(int(links.step[0]))
        powers.append(float(links.power[0, WEST, STATION]))
        state = batch.step(state)
    assert seen == [0] * 5 + [5] * 5 + [10] * 2
    assert len(set(powers)) == 3


def test_worlds_and_episodes_have_shadows_of_their_own(batch):
    scene = replace(batch.scene, radio=replace(RADIO, shadowing=6.0))
    look = jax.jit(jax.vmap(partial(update_links, scene)))
    start = batch.reset()

    def powers(state):
        return np.asarray(look(state.worlds, batch.physics(state)).power)[:, WEST, STATION]

    first = powers(start)
    assert len(set(first.tolist())) == WORLDS
    second = powers(batch.reset_where(start, jnp.array([True, False, False])))
    assert second[0] != first[0]
    np.testing.assert_array_equal(second[1:], first[1:])
    alone = Batch(batch.scene, 1, engine="c", seed=1, first=2)  # world 2 has its numbers alone too
    np.testing.assert_allclose(powers(alone.reset()), first[2:], atol=DBM_ATOL)


def test_a_scene_without_a_radio_carries_nothing_of_it(batch):
    plain = Batch(replace(batch.scene, radio=None, mail=None), 1, engine="c")
    state = plain.reset()
    assert state.worlds.links is None
    assert state.worlds.mail is None
    with pytest.raises(UsageError, match="no radio"):
        plain.links(state)
    with pytest.raises(UsageError, match="no mail"):
        plain.send(state, True, 0.0)
    with pytest.raises(UsageError, match="no mail"):
        plain.clear_mail(state)
    with pytest.raises(SpecError, match="mail needs a radio"):
        build_scene(LANE, ROSTER, mail=MAIL)


def test_nothing_is_compiled_twice(batch):
    """The state has the same types from a reset on, whatever was done with it."""
    start = batch.reset()
    state = batch.send(start, False, 0.0)
    later = batch.clear_mail(batch.send(batch.step(state), True, 1.0, length=4))
    for name in ("links", "mail"):
        kinds = [
            jax.tree.map(lambda x: (x.shape, x.dtype, x.weak_type), getattr(s.worlds, name))
            for s in (start, state, later)
        ]
        assert kinds[0] == kinds[1] == kinds[2]


@pytest.mark.slow
def test_the_radio_is_part_of_a_compiled_step(batch):
    """On an engine that can be traced, with links evaluated now and then: the same as on C MuJoCo."""
    scene = replace(batch.scene, radio=replace(RADIO, period=2 * PERIOD))
    one, other = (Batch(scene, WORLDS, engine=engine, seed=1) for engine in ("jax", "c"))
    to = ~np.eye(N, dtype=bool)

    def tick(i, state):
        return one.send(one.step(state), to, jnp.ones((N, 1)), length=1)

    traced = jax.jit(lambda state: jax.lax.fori_loop(0, 11, tick, state))(one.reset())
    state = other.reset()
    for _ in range(11):
        state = other.send(other.step(state), to, jnp.ones((N, 1)), length=1)
    mine, theirs = traced.worlds, state.worlds
    assert mine.links.step.tolist() == theirs.links.step.tolist() == [11] * WORLDS
    np.testing.assert_allclose(mine.links.power, theirs.links.power, atol=0.01)  # robots settle on the floor
    np.testing.assert_array_equal(mine.links.walls, theirs.links.walls)
    jax.tree.map(np.testing.assert_array_equal, mine.mail, theirs.mail)


def test_antennas_are_where_the_poses_put_them(batch):
    state = drive(batch, batch.reset(), NORTH, (3.0, -3.0, 0.0))
    for _ in range(20):
        state = batch.step(state)
    find = jax.jit(jax.vmap(partial(robot_antennas, batch.scene)))
    places, in_use = find(state.worlds, batch.physics(state))
    np.testing.assert_allclose(places, true_antennas(batch, state), atol=1e-5)
    assert np.asarray(in_use)[0].tolist() == [True, True, True, False]


def test_antennas_are_above_the_robot_or_where_the_class_has_them():
    p2at, station = ROBOTS.get("P2AT"), ROBOTS.get("ComStation")
    assert antenna_offset(p2at) == (0.0, 0.0, -p2at.dimensions[2] / 2)
    # On top of the mast: 1.6 m above the ground, the origin being at 0.8 m.
    assert station.origin_height - antenna_offset(station)[2] == pytest.approx(1.6)
    moved = replace(p2at, antenna=(0.1, 0.2, -0.3))  # forward, right, up
    quats = jnp.array([quat_from_angles(*angles) for angles in ((0, 0, 0), (0, 0, np.pi / 2), (np.pi, 0, 0))])
    places = antenna_positions(moved, jnp.array([[1.0, 2.0, 0.2]] * 3), quats, 0.0)
    # Turned left, forward is y and right is x; on its back it would be under the floor.
    expected = [(1.1, 1.8, 0.5), (1.2, 2.1, 0.5), (1.1, 2.2, MIN_ANTENNA_HEIGHT)]
    np.testing.assert_allclose(places, expected, atol=1e-6)
