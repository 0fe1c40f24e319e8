"""What is around: victims and tags put into the world's axes, alike for one world and for many."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from tests.sensors.people import BOXES, TAGS, VICTIMS, Room, Watch, quick_jit
from usarmjx.base.backend import numpy_backend
from usarmjx.models.compile.tags import tag_table
from usarmjx.models.compile.victims import PADDING_OWNER, pad_table
from usarmjx.models.effecters import MAX_DROPPED_TAGS, DroppedTags, no_dropped_tags
from usarmjx.models.robots.pioneer import P2AT
from usarmjx.models.types.arena import FalseAlarm, HelpSound, SegmentMotion, Tag, Victim
from usarmjx.models.types.robot import Mount, options
from usarmjx.sensors.surroundings import NO_SURROUNDINGS, surroundings_at, tags_at
from usarmjx.sim.ray_geometry import surroundings
from usarmjx.sim.scene import build_scene

WAVE = SegmentMotion(name="RightArm", initial=(-2, 0, 0), final=(-1, 0, 0), rates=(1, 0, 0))
ONE = Victim(name="one", at=(3.0, 0.2, 0.12), segments=(WAVE,), help_sound=HelpSound(loudness=2.0))
TWO = Victim(name="two", at=(2.0, -0.5, 0.9), posture="standing", breathes=False)
ROOMS = (
    Room(victims=(ONE, TWO), tags=(Tag(at=(1.0, 0.0, 0.0), single_shot=True),), floor=-1.5),
    Room(
        victims=(ONE,), alarms=(FalseAlarm(part="Head", at=(1, 1, 1)),), dropped=((1, 0, -1.5),), floor=-1.5
    ),
    Room(floor=-1.5),
)


@pytest.mark.parametrize("room", ROOMS)
def test_tags_are_the_same_where_nobody_looks_for_victims(room):
    everything, floor = room.around(0.4), np.float32(room.floor)
    with numpy_backend():
        dropped = DroppedTags(pos=everything.tag_pos[-MAX_DROPPED_TAGS:], count=np.int32(len(room.dropped)))
        alone = tags_at(tag_table(room.tags, TAGS), dropped, floor)
    for name in ("tag_pos", "tag_id", "tag_single", "tag_there"):
        np.testing.assert_array_equal(getattr(alone, name), getattr(everything, name))
    assert len(alone.box_pos) == len(alone.mouth) == 0


def test_victims_are_looked_for_where_any_robot_senses_them():
    """RFID sensors ask for tags alone, a robot with another sensor beside them for all."""
    seen = []
    seeker = replace(P2AT, name="Seeker", sensors=(Mount(kind="VictSensor", name="Eye"),))
    for robots in ([P2AT], [P2AT, seeker]):
        scene = build_scene("yellow", robots)
        with numpy_backend():
            around = surroundings(scene, None, no_dropped_tags(), np.float32(0.4))
        seen.append((len(around.box_pos), len(around.tag_pos)))
    (nobody, tags), (boxes, same_tags) = seen
    assert nobody == 0 < boxes
    assert tags == same_tags > MAX_DROPPED_TAGS


def test_everything_is_raised_to_the_floor_of_the_arena():
    here = ROOMS[0].around(0.4)
    level = Room(**{**vars(ROOMS[0]), "floor": 0.0}).around(0.4)
    for name in ("box_pos", "mouth", "tag_pos"):
        mine, other = getattr(here, name), getattr(level, name)
        moved = mine - other
        there = np.abs(other).max(-1) < 1e5  # what is not there lies far away
        if name == "tag_pos":
            there = here.tag_there
        np.testing.assert_allclose(moved[there], np.tile((0, 0, -1.5), (there.sum(), 1)), atol=1e-6)


def test_it_says_who_is_there_and_what_they_do():
    around = ROOMS[0].around(0.4)
    assert (around.box_owner >= 0).sum() == 22
    assert (around.box_owner == PADDING_OWNER).sum() == BOXES - 22
    moving = np.flatnonzero(around.speed > 1e-3)
    assert len(moving) == 2  # the right arm and its hand
    np.testing.assert_array_equal(moving, np.flatnonzero(around.swing))
    assert around.loudness.tolist() == [2.0, 0.0, 0.0]
    assert around.breathes.tolist() == [True, False, False]
    np.testing.assert_allclose(around.mouth[0], around.box_pos[2])
    assert around.tag_there.sum() == 1
    assert (around.tag_id[0], around.tag_single[0]) == (1001, True)
    other = ROOMS[1].around()
    assert other.tag_id[other.tag_there].tolist() == [0]  # the first that was dropped
    assert len(other.tag_id) == TAGS + MAX_DROPPED_TAGS


def test_nothing_is_a_world_without_victims_and_tags():
    assert (NO_SURROUNDINGS.box_pos.shape, NO_SURROUNDINGS.mouth.shape) == ((0, 3), (0, 3))
    assert not NO_SURROUNDINGS.tag_there.any()


@pytest.mark.oracle
def test_worlds_side_by_side_are_what_each_is_alone():
    """Sensors too: mapped over worlds with other victims and tags, they read what they read in each."""
    mounts = (
        Mount(kind="VictSensor", name="Eye", options=options(Sigma=0.0)),
        Mount(kind="RFID", name="RFID"),
        Mount(kind="Sound", name="Ear", options=options(Noise=0.0)),
        Mount(kind="HumanMotion", name="Motion", options=options(Noise=0.0)),
        Mount(kind="CO2Sensor", name="CO2"),
    )
    watch = Watch(mounts, "SideBySide")
    tables = [pad_table(room.people, BOXES, VICTIMS) for room in ROOMS]
    people = jax.tree.map(lambda *rows: jnp.stack(rows), *tables)
    lying = jax.tree.map(lambda *rows: jnp.stack(rows), *(tag_table(room.tags, TAGS) for room in ROOMS))
    around = quick_jit(jax.vmap(partial(surroundings_at, floor=-1.5), in_axes=(0, 0, None, None)))(
        people, lying, no_dropped_tags(), jnp.float32(0.4)
    )
    for i, room in enumerate(ROOMS):
        alone = Room(**{**vars(room), "dropped": ()}).around(0.4)
        for one, other in zip(jax.tree.leaves(around), jax.tree.leaves(alone), strict=True):
            np.testing.assert_allclose(one[i], other, atol=1e-4)  # speeds: differences over 0.02 s
    sights = [watch.inputs(room, at=(0.0, 0.0, -1.0), time=0.4) for room in ROOMS]
    stacked = jax.tree.map(lambda *rows: jnp.stack([jnp.asarray(row) for row in rows]), *sights)
    key = jax.random.key(3)
    memory = quick_jit(jax.vmap(watch.suite.init_memory, in_axes=(0, None)))(stacked, jax.random.key(0))
    _, readings = quick_jit(jax.vmap(watch.suite.read, in_axes=(0, 0, None)))(stacked, memory, key)
    assert np.asarray(readings[0].value)[:, :, 0].any(1).tolist() == [True, True, False]
    for i, inputs in enumerate(sights):
        _, alone = watch.read(inputs, watch.start(inputs), 3)
        for one, other in zip(readings, alone.values(), strict=True):
            np.testing.assert_allclose(one.value[i], other, atol=1e-5)
