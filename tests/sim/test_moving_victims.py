"""Victims that move inside a batch, on every engine."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from usarmjx.models.compile.victims import box_names, segment_poses, victim_table
from usarmjx.models.types.arena import ArenaSpec, FalseAlarm, LooseObject, SegmentMotion, StartPose, Victim
from usarmjx.models.types.shapes import Shape
from usarmjx.sensors.rays.raycast import RayQuery, cast_rays
from usarmjx.sim.batch import Batch
from usarmjx.sim.ray_geometry import ray_geoms, visible_arena
from usarmjx.sim.scene import build_scene

SWEEP = SegmentMotion(name="LeftArm", final=(0.0, 0.0, 1.2), initial=(0.0, 0.0, 0.01), rates=(0.0, 0.0, 1.0))
"""Lying on its back the victim sweeps the ground beside it, out to 0.9 m and back."""
BOX = LooseObject(
    name="box",
    at=(0.1, 0.62, 0.1),
    shapes=(Shape(kind="box", size=(0.1, 0.1, 0.1), mass=0.5, surface="loose"),),
)
ARENA = ArenaSpec(
    name="ward",
    floor=-1.0,
    starts=(StartPose(tag="S", at=(3.0, 3.0, 0.188)),),
    extent=((-4, 4), (-4, 4)),
    loose=(BOX,),
    victims=(
        Victim(name="Ada", at=(0.0, 0.0, 0.12), segments=(SWEEP,)),
        Victim(name="Bob", at=(-3.0, -3.0, 0.12), posture="sitting"),
    ),
    false_alarms=(FalseAlarm(part="RightLeg", at=(-2.0, 2.0, 0.1)),),
)
STEPS = 60
"""Control steps of 20 ms: the arm is all the way out."""


def test_only_what_moves_is_data():
    moved = build_scene(ARENA, ["ComStation"]).moved_geoms
    names = box_names(ARENA.victims, ARENA.false_alarms)
    assert moved is not None
    assert {names[int(name.split("/")[1])] for name in moved.names} == {"Ada/LeftArm", "Ada/LeftHand"}
    still = ArenaSpec(**{**vars(ARENA), "victims": ARENA.victims[1:]})
    assert build_scene(still, ["ComStation"]).moved_geoms is None


@pytest.fixture(scope="module")
def pushed():
    """Where the box is pushed, by engine."""
    return {}


@pytest.mark.every_run("c")
@pytest.mark.parametrize("engine", ["c", pytest.param("jax", marks=pytest.mark.slow), "warp"])
def test_an_arm_sweeps_a_box_aside(engine, pushed):
    """Limbs are where the closed form has them; the box slides half a metre, on all engines within 10 %."""
    scene = build_scene(ARENA, ["ComStation"])
    batch = Batch(scene, 2, engine=engine)
    start = state = batch.reset()
    for _ in range(STEPS):
        state = batch.step(state)
    batch.check_overflow(state)
    ids = [batch.engine.model.geom(name).id for name in scene.moved_geoms.names]
    physics = state.physics
    seen = batch.engine._datas[1].geom_xpos[ids] if engine == "c" else np.asarray(physics.geom_xpos)[1, ids]
    told = (STEPS - 1) * scene.physics.period  # the last step began then
    pos, _ = segment_poses(victim_table(ARENA.victims), np.float32(told))
    expected = pos[scene.moving_victim_boxes] + (0.0, 0.0, ARENA.floor)
    np.testing.assert_allclose(seen, expected, atol=1e-5)

    root = scene.loose_geoms.root_qposadr[0, :2]
    way = np.asarray(batch.physics(state).qpos - batch.physics(start).qpos)[:, root]
    assert np.linalg.norm(way[0]) > 0.4
    pushed[engine] = way
    np.testing.assert_allclose(way, pushed.get("c", way)[:1].repeat(2, 0), atol=0.05)


def test_rays_and_victims_meet_where_the_arm_is_now():
    """A ray straight down onto the hand meets its upper side, and the floor when the hand is gone."""
    scene = build_scene(ARENA, ["ComStation"])
    names = box_names(ARENA.victims, ARENA.false_alarms)
    hand = names.index("Ada/LeftHand")
    table = victim_table(ARENA.victims, ARENA.false_alarms)

    def height(point, time):
        geoms = ray_geoms(visible_arena(scene, None, jnp.float32(time)))
        start = jnp.array([[*point, 1.0]])
        hits = cast_rays(geoms, start, jnp.array([[0.0, 0.0, -1.0]]), RayQuery(exclude_owner=jnp.int32(0)))
        return 1.0 - float(hits.distance[0])

    for time in (0.0, 0.4, 1.0):
        place = segment_poses(table, np.float32(time))[0][hand]
        top = height(place[:2], time) - ARENA.floor
        assert 0.05 < top - place[2] + 0.1 < 0.3, "somewhere on the hand"
        assert height(place[:2], time + 0.8) == pytest.approx(ARENA.floor, abs=1e-5)


def test_time_starts_again_with_the_episode():
    batch = Batch(build_scene(ARENA, ["ComStation"]), 1, engine="c")
    state = batch.reset()
    for _ in range(5):
        state = batch.step(state)
    again = batch.step(batch.reset_where(state, jnp.ones(1, bool)))
    ids = batch.engine.moved_ids
    first = batch.engine._datas[0].geom_xpos[ids].copy()
    fresh = Batch(build_scene(ARENA, ["ComStation"]), 1, engine="c")
    fresh.step(fresh.reset())
    np.testing.assert_array_equal(first, fresh.engine._datas[0].geom_xpos[ids])
    assert int(jax.device_get(again.worlds.episode[0])) == 1
