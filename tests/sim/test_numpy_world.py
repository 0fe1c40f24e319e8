"""Effecters, radio and mail of a world on NumPy: as on JAX, nothing traced."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from tests.handy import TAGGER, known
from tests.sim.on_numpy import as_numpy, assert_same, nothing_compiled, row
from usarmjx.base import random
from usarmjx.base.backend import numpy_backend
from usarmjx.comms import links
from usarmjx.comms.attenuation import RadioSettings
from usarmjx.comms.mail import MessageSettings, clear_inboxes
from usarmjx.comms.walls import arena_solids, count_walls
from usarmjx.engines.base import PhysicsState
from usarmjx.models.arenas import ARENAS
from usarmjx.models.compile.compose import new_spec
from usarmjx.models.compile.physics import Physics
from usarmjx.models.compile.randomization import DomainRandomization
from usarmjx.models.effecters import EFFECTERS, effecters_of
from usarmjx.models.types.robot import Mount
from usarmjx.sensors.rays.raycast import Hits
from usarmjx.sim.actions import Actions, EffecterAction, JointAction, apply_actions
from usarmjx.sim.batch import Batch
from usarmjx.sim.operate import EffecterCommand, operate
from usarmjx.sim.radio import (
    last_links,
    outgoing_messages,
    radio_obstacles,
    robot_antennas,
    send,
    update_links,
)
from usarmjx.sim.ray_geometry import arena_state_at, moved_geom_poses, start_poses, victims_of
from usarmjx.sim.reset import init_world, reset
from usarmjx.sim.scene import build_scene

YELLOW = ARENAS.get("yellow")
HANDYMAN = replace(
    TAGGER,
    name="Handyman",
    sensors=(),
    effecters=(*TAGGER.effecters, Mount(kind="RollerTable", name="Table", at=(0.0, 0.0, -0.2))),
)
"""A robot with one effecter of every type."""
OPERATIONS = [
    pytest.param(place, opcode, id=f"{effecter.mount.name}-{opcode.name}")
    for place, effecter in enumerate(effecters_of(HANDYMAN))
    for opcode in effecter.opcodes
]
ROBOTS = 6
VALUES = np.array([0.3, np.nan, -1.0, 9.0, 1.0, 0.0], np.float32)
"""Parameters: fine ones, no number, too small, too large."""
WHERE = np.array([True, True, True, True, True, False])
GROUND = 1e-5
"""C MuJoCo's rays in double precision, from points up to 20 m from the origin in single [m]."""
TARGETS = 1e-6
"""Sines of angles up to 1.6 rad."""
POWER = 1e-4
"""Single precision of 100 dB is 8e-6; logarithm and normal numbers differ in their last places too [dB]."""
DRAWN = 1e-6
"""Numbers between bounds are a product and a sum, which XLA fuses."""
PLACES = 1e-5
"""Of antennas up to 20 m from the origin [m]."""


@pytest.fixture(scope="module")
def worlds():
    """A scene in the arena yellow with radio and mail, and one world of it on either library."""
    with known(HANDYMAN):
        radio = RadioSettings(shadowing=4.0, loss_band=40.0, period=0.1)
        scene = build_scene(
            YELLOW, ["Handyman"] * ROBOTS, radio=radio, mail=MessageSettings(numbers=3, capacity=2)
        )
        batch = Batch(scene, 1, engine="c", seed=5)
        state = batch.reset()
        world = row(state.worlds, 0)
        (robots,) = world.groups
        dead = robots.replace(active=robots.active.at[2].set(False), drowned=robots.drowned.at[4].set(True))
        yield scene, as_numpy(world.replace(groups=(dead,)))


def scattered(scene, seed):
    """The physics of robots at random poses in the arena, none of them upright."""
    rng, qpos = np.random.default_rng(seed), scene.model.qpos0.astype(np.float32)
    (group,) = scene.groups
    (x0, x1), (y0, y1) = scene.arena.extent
    low, high = (x0, y0, 0.3 + scene.arena.floor), (x1, y1, 1.0 + scene.arena.floor)
    roots = np.concatenate([rng.uniform(low, high, (ROBOTS, 3)), rng.normal(0, 1, (ROBOTS, 4))], -1)
    qpos[group.root_qposadr] = roots
    return PhysicsState(
        qpos=qpos, qvel=np.zeros(scene.model.nv, np.float32), act=np.zeros(scene.model.na, np.float32)
    )


def on_jax(world):
    """A world on JAX."""
    typed = jax.random.wrap_key_data(jnp.asarray(world.key))
    return jax.tree.map(jnp.asarray, world).replace(key=typed)


@pytest.fixture(scope="module")
def cast():
    """Rays onto floor and arena of C MuJoCo, one after the other."""
    bare = replace(YELLOW, loose=(), doors=())
    model = new_spec(bare, Physics()).compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)

    def down(origin, direction, query, fans=None):
        assert not query.transparent - {"sky"}
        out, hit = [], np.zeros(1, np.int32)
        for start, along in zip(origin.astype(float), direction.astype(float), strict=True):
            depth = mujoco.mj_ray(model, data, start, along, None, 1, -1, hit)
            out.append(depth if hit[0] >= 0 else np.inf)
        return Hits(distance=np.array(out, np.float32), cosine=np.zeros(len(out), np.float32))

    return down


def test_all_types_of_effecters_are_among_them():
    # A vacuum works in single worlds alone: tests/server/test_vacuum.py.
    assert {effecter.kind for effecter in effecters_of(HANDYMAN)} == set(EFFECTERS.names()) - {"Vacuum"}


@pytest.mark.oracle
@pytest.mark.parametrize(("place", "opcode"), OPERATIONS)
def test_effecters_do_the_same_on_both_libraries(worlds, cast, place, opcode):
    scene, world = worlds
    physics = scattered(scene, 1)
    order = EffecterCommand(group=0, effecter=place, opcode=opcode, value=VALUES, where=WHERE)
    with nothing_compiled():
        ours, mine = operate(scene, world, physics, order, cast)
    theirs, outcome = operate(scene, on_jax(world), physics, order)
    assert mine.done.tolist() == outcome.done.tolist()
    assert not mine.done[[2, 4, 5]].any(), "parked, without power, not asked"
    if opcode.takes_value:
        assert not mine.done[[1, 3]].any(), "no number, too large"
    assert_same(mine, outcome)
    assert_same(ours.groups[0].command, theirs.groups[0].command, atol=TARGETS)
    assert_same(ours.groups[0].releases, theirs.groups[0].releases)
    assert_same(ours.tags, theirs.tags, atol=GROUND)


@pytest.mark.oracle
def test_actions_are_carried_out_the_same_on_both_libraries(worlds):
    scene, world = worlds
    physics = scattered(scene, 1)
    actions = Actions(
        drive={0: {"Left": VALUES, "Right": VALUES}},
        joint_actions=(JointAction(group=0, targets={"CameraPanTilt_Link1": np.ones(ROBOTS, np.float32)}),),
        effecter_actions=(EffecterAction(group=0, name="Lamp", opcode="Activate", where=WHERE),),
    )
    with nothing_compiled():
        ours = apply_actions(scene, world, physics, actions, WHERE)
    theirs = apply_actions(scene, on_jax(world), physics, actions, WHERE)
    assert_same(ours.groups[0].command, theirs.groups[0].command)
    assert ours.groups[0].command.light.tolist() == [True, True, False, True, False, False]


@pytest.mark.oracle
def test_links_and_mail_are_the_same_on_both_libraries(worlds):
    """Solids between robots are the same number: none of the links grazes one by what is rounded."""
    scene, world = worlds
    ours, theirs = world, on_jax(world)
    link, post = jax.jit(update_links, static_argnums=0), jax.jit(send, static_argnums=0)
    jax.clear_caches()  # what JAX has compiled it would not tell of
    events = 0
    for step, seed in ((0, 3), (2, 4), (5, 5), (10, 6)):  # a link is due after five steps
        physics, to = scattered(scene, seed), np.random.default_rng(seed).random((ROBOTS, ROBOTS)) < 0.8
        said = np.random.default_rng(seed).normal(0, 1, (ROBOTS, 3)).astype(np.float32)
        with nothing_compiled():
            ours = ours.replace(step=np.array(step, np.int32))
            ours = ours.replace(links=update_links(scene, ours, physics))
            ours = ours.replace(mail=send(scene, ours, outgoing_messages(scene, (), to, said)))
        theirs = theirs.replace(step=jnp.asarray(step, jnp.int32))
        theirs = theirs.replace(links=link(scene, theirs, physics))
        theirs = theirs.replace(mail=post(scene, theirs, outgoing_messages(scene, (), to, said)))
        assert_same(ours.links, theirs.links, atol=POWER)
        assert_same(ours.mail, theirs.mail, rtol=1e-7)  # time is a product
        events += int(ours.links.went_down.sum() + ours.links.came_up.sum())
    assert ours.links.walls.max() > 1
    assert events, "some links came and went"
    dropped = ours.mail.dropped
    assert all(x.any() for x in (dropped.no_link, dropped.lost, dropped.inbox_full)), "for every cause"
    with numpy_backend():
        assert_same(last_links(ours), last_links(theirs), atol=POWER)
        empty = clear_inboxes(ours.mail, WHERE)
    assert_same(empty, clear_inboxes(theirs.mail, WHERE), rtol=1e-7)


@pytest.mark.oracle
def test_antennas_and_solids_are_the_same_on_both_libraries(worlds):
    scene, world = worlds
    physics = scattered(scene, 2)
    with nothing_compiled():
        ours = robot_antennas(scene, world, physics), radio_obstacles(scene, world, physics)
    theirs = robot_antennas(scene, on_jax(world), physics), radio_obstacles(scene, on_jax(world), physics)
    assert_same(ours[0], theirs[0], atol=PLACES)
    assert_same(ours[1], theirs[1])


@pytest.mark.every_run("DM-USAR_yellow", "DM-Outdoor")
@pytest.mark.oracle
@pytest.mark.parametrize("name", ARENAS.names())
def test_walls_are_the_same_on_both_libraries(name):
    """Boxes, planes and, outdoors, terrain: links between random points graze none of them."""
    arena = ARENAS.get(name)
    rng, (x, y) = np.random.default_rng(0), arena.extent
    low, high = np.array([x, y, (arena.floor - 0.2, arena.floor + 1.5)]).T
    start, end = rng.uniform(low, high, (2, 200, 3)).astype(np.float32)
    solids = arena_solids(arena)
    with nothing_compiled():
        ours = count_walls(solids, start, end)
    assert_same(ours, count_walls(solids, start, end))
    assert ours.any()


@pytest.mark.oracle
def test_a_world_starts_the_same_on_both_libraries():
    """Robots change places and differ from each other: orders, whole numbers and others are drawn."""
    vary = DomainRandomization(
        mass=(0.8, 1.2), wheel=(0.9, 1.3), torque=(0.5, 1.0), latency=(0, 9), radio_pdo=(-60.0, -40.0)
    )
    scene = build_scene(YELLOW, ["P2AT", "P2DX", "P2AT"], radio=RadioSettings(), vary=vary)
    with nothing_compiled():
        key = random.fold_in(random.key(4), 2)
        ours = init_world(scene, key, np.array(2, np.int32), shuffle=True)
        again = reset(scene, ours[0], shuffle=True)
    start = jax.jit(partial(init_world, scene, shuffle=True))
    theirs = start(jax.random.fold_in(jax.random.key(4), 2), jnp.array(2, jnp.int32))
    assert_same(ours, as_numpy(theirs), rtol=DRAWN, atol=PLACES)
    assert ours[0].varied.latency.any()
    then = jax.jit(partial(reset, scene, shuffle=True))(theirs[0])
    assert_same(again, as_numpy(then), rtol=DRAWN, atol=PLACES)
    assert not np.allclose(again[1], ours[1]), "other places"


@pytest.mark.oracle
@pytest.mark.parametrize("several", [False, True])
def test_the_arena_is_the_same_on_both_libraries(several):
    """Alone, its victims move; of several, it is data altogether."""
    arena = replace(YELLOW, doors=(), loose=YELLOW.loose[:1])
    scene = build_scene([arena, replace(arena, victims=())] if several else arena, ["P2AT"] * 2)
    sets = scene.arenas.states if several else None
    number, episode, now = np.array(0, np.int32), np.array(0, np.int32), np.array(2.3, np.float32)
    with nothing_compiled():
        state = arena_state_at(sets, number, episode)
        ours = moved_geom_poses(scene, state, now), start_poses(scene, state), victims_of(scene, state)
    other = arena_state_at(sets, jnp.asarray(number), jnp.asarray(episode))
    now = jnp.asarray(now)
    theirs = moved_geom_poses(scene, other, now), start_poses(scene, other), victims_of(scene, other)
    assert_same(state, other)
    assert_same(ours, theirs, atol=PLACES)
    assert len(ours[0].pos)


@pytest.mark.parametrize("function", ["transitive_closure", "hops", "reachable", "connected_components"])
def test_who_reaches_whom_is_the_same_on_both_libraries(function):
    linked = np.random.default_rng(1).random((3, 7, 7)) < 0.15
    linked |= linked.swapaxes(-1, -2)
    args = (linked, 2) if function in ("hops", "reachable") else (linked,)
    with nothing_compiled():
        ours = getattr(links, function)(*args)
    assert_same(ours, getattr(links, function)(*args))


def test_the_weakest_links_are_the_same_on_both_libraries():
    power = np.random.default_rng(1).normal(-80, 20, (7, 7)).astype(np.float32)
    power = np.minimum(power, power.T)
    with nothing_compiled():
        ours = links.bottleneck(power)
    assert_same(ours, links.bottleneck(power))
