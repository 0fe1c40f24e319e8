"""Engine `planar`: what holds whatever robots do to walls and to each other."""

import math
from dataclasses import replace

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from tests.arenas import FLAT
from tests.engines.eager import AT_ONCE, EAGER, SINGLE, around, drive, poses
from usarmjx.engines.planar.bodies import footprint_box
from usarmjx.engines.planar.footprints import OVERLAP_TOLERANCE, Footprints, separate_footprints
from usarmjx.engines.planar.neighbor_lists import obstacle_outlines
from usarmjx.engines.planar.overlap import outlines, rectangle_overlap
from usarmjx.engines.planar.responses import override_response
from usarmjx.engines.planar.solids import project_geoms
from usarmjx.models.compile.kinematic_tree import kinematic_tree_of
from usarmjx.models.compile.physics import Physics
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import StartPose
from usarmjx.models.types.shapes import Shape
from usarmjx.sim.batch import Batch
from usarmjx.sim.scene import build_scene

GEOM = mujoco.mjtGeom
PAIR = "AirRobot", "P2AT"
STANDS = 2e-3
"""What stands on another may be so far off [m]: it falls a little in each step, and is put back."""


def rectangles(pos, yaw, half):
    """Corners of rectangles (n, 4, 2)."""
    signs = np.array([(1, 1), (1, -1), (-1, -1), (-1, 1)])
    c, s = np.cos(yaw)[:, None], np.sin(yaw)[:, None]
    own = signs * half[:, None]
    return np.stack([c * own[..., 0] - s * own[..., 1], s * own[..., 0] + c * own[..., 1]], -1) + pos[:, None]


def overlap(a, b):
    """How deep two rectangles are in each other, by the theorem of the separating axis; negative: apart."""
    depths = []
    for corners in (a, b):
        for i in range(2):
            edge = corners[i + 1] - corners[i]
            axis = np.array([-edge[1], edge[0]]) / np.linalg.norm(edge)
            depths.append(min((a @ axis).max(), (b @ axis).max()) - max((a @ axis).min(), (b @ axis).min()))
    return min(depths)


@pytest.mark.oracle
def test_rectangles_are_as_deep_in_each_other_as_their_corners_say():
    """Half of what both take up along a side's normal, less the distance of their middles: the least."""
    rng, count = np.random.default_rng(4), 200
    pos, half = rng.uniform(-1, 1, (2, count, 2)), rng.uniform(0.1, 0.8, (2, count, 2))
    yaw = rng.uniform(-np.pi, np.pi, (2, count))

    def depths(pos):
        ways = []
        corners = [rectangles(*one) for one in zip(pos, yaw, half, strict=True)]
        for angle in (*yaw, *(yaw + np.pi / 2)):
            normal = np.stack([np.cos(angle), np.sin(angle)], -1)
            reach = [np.ptp(one @ normal[..., None], axis=1)[:, 0] / 2 for one in corners]
            ways.append(sum(reach) - np.abs(((pos[0] - pos[1]) * normal).sum(-1)))
        return np.min(ways, 0)

    axis, none = np.stack([np.cos(yaw), np.sin(yaw)], -1), np.zeros(count)
    one, other = (outlines(*map(jnp.asarray, (pos[i], axis[i], half[i], none))) for i in (0, 1))
    depth, x, y = map(np.asarray, rectangle_overlap(one, other))
    assert depth == pytest.approx(depths(pos), abs=1e-5)
    assert 0.2 < (depth > 0).mean() < 0.8, "some are apart"
    out = np.stack([pos[0] + depth[:, None] * np.stack([x, y], -1), pos[1]])
    assert depths(out)[depth > 0] == pytest.approx(0.0, abs=1e-5), "so far and that way they come apart"


WALLS = (
    Shape(kind="box", size=(1.5, 0.05, 0.5), at=(0.0, 1.5, 0.5), surface="wall"),
    Shape(kind="box", size=(1.5, 0.05, 0.5), at=(0.0, -1.5, 0.5), surface="wall"),
    Shape(kind="box", size=(0.05, 1.5, 0.5), at=(1.5, 0.0, 0.5), surface="wall"),
    Shape(kind="box", size=(0.05, 1.5, 0.5), at=(-1.5, 0.0, 0.5), surface="wall"),
    Shape(kind="box", size=(0.4, 0.03, 0.5), at=(0.2, 0.1, 0.5), rotation=(0.0, 0.0, 0.6), surface="wall"),
    Shape(kind="cylinder", size=(0.1, 0.5, 0.0), at=(-0.9, 0.9, 0.5), surface="wall"),
)
PEN = FLAT.__class__(
    name="pen",
    starts=tuple(
        StartPose(tag=f"S{i}", at=(x, y, 0.188), yaw=0.7 * i)
        for i, (x, y) in enumerate(((-0.9, -0.9), (0.9, -0.9), (0.9, 0.9), (-0.3, 0.9)))
    ),
    extent=((-2, 2), (-2, 2)),
    shapes=WALLS,
)


@pytest.fixture(scope="module")
def crowd():
    """Four robots in each of 64 pens, told anything for 20 s in steps of 50 ms: 100,000 robot steps."""
    batch = Batch(build_scene(PEN, [EAGER] * 4, Physics(timestep=0.05, substeps=1)), 64, engine="planar")
    state, rng, seen = batch.reset(), np.random.default_rng(0), []
    touched = np.zeros((64, 4), int)
    for step in range(400):
        if step % 10 == 0:
            told = rng.uniform(-5.0, 5.0, (2, 64, 4)).astype(np.float32)
            state = batch.drive(state, 0, {"Left": told[0], "Right": told[1]})
        state = batch.step(state)
        touched += np.asarray(state.physics.touched)
        assert not np.asarray(state.physics.omitted).any()
        if step % 8 == 0:
            seen.append(poses(batch, state))
    return batch, np.array(seen), touched


def test_no_robot_is_in_a_wall_or_in_another(crowd):
    batch, seen, touched = crowd
    robots = batch.engine._robots
    walls = [
        rectangles(np.array([w.at[:2]]), np.array([w.rotation[2]]), np.array([w.size[:2]]))[0]
        for w in WALLS
        if w.kind == "box"
    ]
    worst = -1.0
    for moment in seen[:, ::4].reshape(-1, 4, 3):
        corners = rectangles(moment[:, :2], moment[:, 2], robots.half)
        worst = max(worst, *(overlap(robot, wall) for robot in corners for wall in walls))
        worst = max(worst, *(overlap(corners[i], corners[j]) for i in range(4) for j in range(i)))
    assert worst <= OVERLAP_TOLERANCE + 1e-4, "by an independent test of rectangles"
    assert np.median(touched) > 50, "most have met something again and again"
    assert np.abs(seen[..., :2]).max() < 1.5, "nobody has left"


def test_robots_are_not_stuck_for_good(crowd):
    _, seen, _ = crowd
    way = np.linalg.norm(np.diff(seen[..., :2], axis=0), axis=-1).sum(0)
    assert way.min() > 1.0


def test_what_is_around_robots_is_looked_up_seldom_and_forgotten_at_a_reset(crowd):
    batch = crowd[0]
    state, looks = drive(batch, 3.0, 3.0, 1), 1
    for _ in range(20):
        before = np.asarray(state.physics.neighbors.at)
        state = batch.step(state)
        looks += not np.array_equal(before, state.physics.neighbors.at)
    assert 1 <= looks < 5
    mask = jnp.arange(batch.worlds) == 1
    cleared = batch.engine.reset(state.physics, mask, state.physics.qpos).neighbors.obstacle_margin.aside
    assert np.array_equal(np.asarray(cleared == 0).all(-1), mask)


def test_two_that_meet_head_on_stop_in_the_middle():
    """A world that is its own mirror image stays so: what one does to the other comes back."""
    pair = FLAT.__class__(
        name="pair",
        starts=(
            StartPose(tag="A", at=(-1.0, 0.0, 0.188), yaw=0.0),
            StartPose(tag="B", at=(1.0, 0.0, 0.188), yaw=math.pi),
        ),
        extent=((-3, 3), (-3, 3)),
    )
    batch = Batch(build_scene(pair, [EAGER] * 2), 1, engine="planar")
    state = drive(batch, 3.0, 3.0, 150)
    left, right = poses(batch, state)[0]
    robots = batch.engine._robots
    assert left[0] + right[0] == pytest.approx(0.0, abs=SINGLE)
    assert right[0] - left[0] == pytest.approx(
        2 * (robots.half[0, 0] + robots.offset[0, 0]), abs=3 * OVERLAP_TOLERANCE
    )
    assert np.asarray(state.physics.touched).all()


def test_the_heavier_of_two_pushes_the_lighter():
    prints = Footprints(
        pos=jnp.array([[0.0, 0.0], [0.9, 0.0]]),
        yaw=jnp.zeros(2),
        half=jnp.full((2, 2), 0.5),
        low=jnp.zeros(2),
        high=jnp.ones(2),
        step=jnp.zeros(2),
        mass=jnp.array([30.0, 10.0]),
    )
    apart = prints.replace(pos=jnp.array([[0.0, 0.0], [1.2, 0.0]]))
    apart, prints = jax.tree.map(lambda x: x[None], (apart, prints))
    known = jax.jit(around)(prints, no_solids())
    kept, touched = jax.jit(separate_footprints)(
        apart, prints, obstacle_outlines(prints, known.near), jnp.ones((1, 2), bool)
    )
    displacement = np.asarray(kept.pos[0] - prints.pos[0])[:, 0]
    assert displacement.sum() == pytest.approx(displacement[1] + displacement[0])
    assert 30.0 * displacement[0] + 10.0 * displacement[1] == pytest.approx(0.0, abs=1e-3), (
        "their centre of mass stays"
    )
    assert touched.all()
    assert not known.omitted.any()


BODY = EAGER.chassis[0]
BURDENED = replace(EAGER, name="Burdened", chassis=(replace(BODY, mass=40.0), *EAGER.chassis[1:]))
override_response(BURDENED, AT_ONCE)


@pytest.mark.parametrize("speeds", [(4.0, 4.0), (4.0, 0.0), (0.0, 4.0)], ids=["both", "light", "heavy"])
def test_robots_that_push_have_the_speed_that_their_momentum_leaves_them(speeds):
    """(m1 v1 + m2 v2) / (m1 + m2), as of a plastic impact, of speeds that each would have without the other.

    Step after step: wheels do as they are told, those that are told to stand, too.
    """
    starts = tuple(
        StartPose(tag=f"S{x}", at=(x, 0.0, 0.188), yaw=yaw) for x, yaw in ((-0.5, 0.0), (0.5, math.pi))
    )
    batch = Batch(build_scene(replace(FLAT, starts=starts), [EAGER, BURDENED]), 1, engine="planar")
    scene, state = batch.scene, batch.reset()
    for number, speed in enumerate(speeds):
        state = batch.drive(state, number, {"Left": speed, "Right": speed})
    for _ in range(70):
        state = batch.step(state)
    free = [way * speed * EAGER.wheel_radius for way, speed in zip((1.0, -1.0), speeds, strict=True)]
    mass = [scene.model.body_subtreemass[group.indices[0].body_ids[0]] for group in scene.groups]
    assert mass[1] > 2.5 * mass[0]
    common = np.dot(mass, free) / np.sum(mass)
    qvel = np.asarray(batch.physics(state).qvel)[0]
    assert np.asarray(state.physics.touched).all()
    assert [qvel[group.root_dofadr[0, 0]] for group in scene.groups] == pytest.approx([common] * 2, abs=2e-3)
    assert [abs(qvel[group.root_dofadr[0, 5]]) for group in scene.groups] == pytest.approx(
        [0.0] * 2, abs=1e-3
    )


def no_solids():
    return project_geoms(np.zeros(0, int), jnp.zeros((0, 3)), jnp.zeros((0, 3, 3)), jnp.zeros((0, 3)))


def test_a_world_alone_does_bit_for_bit_what_it_does_among_others(crowd):
    scene = crowd[0].scene
    together = Batch(scene, 3, engine="planar", seed=5)
    alone = Batch(scene, 1, engine="planar", seed=5, first=2)
    states = [drive(batch, 3.0, 2.0, 80, drive(batch, 3.0, -1.0, 40)) for batch in (together, alone)]
    first, second = (
        np.asarray(batch.physics(state).qpos) for batch, state in zip((together, alone), states, strict=True)
    )
    assert np.asarray(states[1].physics.touched).any(), "it has met something"
    assert np.array_equal(first[2:], second)


def test_what_flies_stands_on_what_is_below_it():
    """An AirRobot comes down on a P2AT and on another AirRobot: on their tops, and carried up by the one."""
    air, ground = (replace(ROBOTS.get(name), sensors=(), cameras=(), battery_life=1e6) for name in PAIR)
    heights = [float(np.diff(footprint_box(robot)[:, 2])[0]) for robot in (air, ground)]
    places = ((0.0, 0.0, 2.0), (0.0, 0.0, 0.188), (3.0, 0.0, 2.0), (3.1, 0.2, 0.188))
    starts = tuple(StartPose(tag=f"S{i}", at=at) for i, at in enumerate(places))
    scene = build_scene(replace(FLAT, starts=starts), [air, ground, air, air])
    batch = Batch(scene, 1, engine="planar")
    number = {slot: group for group, one in enumerate(scene.groups) for slot in one.slots.tolist()}
    down = np.where(scene.groups[number[0]].slots == 3, 0.0, -1.0).astype(np.float32)
    state = batch.drive(batch.reset(), number[0], {"AltitudeVelocity": down[None]})

    def lowest(state):
        """Heights of their lowest points, by slot."""
        qpos, found = np.asarray(batch.physics(state).qpos)[0], np.zeros(4)
        for group in scene.groups:
            found[group.slots] = qpos[group.root_qposadr[:, 2]] - kinematic_tree_of(group.robot).clearance
        return found

    begun = lowest(state)
    for _ in range(300):
        state = batch.step(state)
    low = lowest(state)
    assert begun[0] > 1.5, "it has come down"
    np.testing.assert_allclose(low[[0, 2]] - low[[1, 3]], [heights[1], heights[0]], atol=STANDS)
    up = (scene.groups[number[0]].slots == 3).astype(np.float32)
    state = batch.drive(state, number[0], {"AltitudeVelocity": up[None] + down[None]})
    for _ in range(100):
        state = batch.step(state)
    carried = lowest(state)
    assert carried[3] > low[3] + 0.3, "the lower one has risen"
    assert carried[2] >= carried[3] + heights[0] - STANDS, "and the other one with it"
