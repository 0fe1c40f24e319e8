"""Rays cast by C MuJoCo in a served world against the raycaster of batches, in every kind of arena."""

from dataclasses import replace

import jax
import numpy as np
import pytest

from tests.lands import hills, land, stones
from usarmjx.base.backend import numpy_backend
from usarmjx.models.compile.kinematic_tree import forward_kinematics
from usarmjx.models.robots import ROBOTS
from usarmjx.models.types.arena import StartPose
from usarmjx.models.types.shapes import FENDER, GLASS, MATERIALS, MIRROR, SKY, Shape
from usarmjx.sensors.rays.raycast import RayQuery, cast_rays
from usarmjx.sim.ray_geometry import moved_geom_poses
from usarmjx.sim.scene import build_scene
from usarmjx.sim.single_world import SingleWorld
from usarmjx.sim.world import caster, clock_of, robot_states

DISTANCE = 1e-4
"""How far apart distances may be [m]: a range scanner's, and single precision of tens of metres."""
FAR = 1e-6
"""Of more than 100 m, as a share of it: single precision."""
COSINE = 1e-5
"""The error of the distance, 1e-6 m nearby, turns the normal of the roundest surface, 0.1 m, by that much."""
EDGES = 0.002
"""Share of rays that may differ by more: they pass an edge or a round surface closer than what is rounded."""
RAYS, PART = 2000, 100
BEAMS = 20
"""Rays from one point, in half of the rays; the others have points of their own."""
QUERIES = {
    "laser": RayQuery(
        exclude_owner=np.int32(0), transparent=frozenset({SKY, GLASS}), incidence=True, max_distance=20.0
    ),
    "sonar": RayQuery(exclude_owner=np.int32(1), transparent=frozenset({SKY}), max_distance=5.0),
    "light": RayQuery(transparent=frozenset({SKY, FENDER, MIRROR}), incidence=True),
}
WHERE = [
    ("everything", "laser"),
    ("everything", "light"),
    ("yellow", "laser"),
    ("orange", "sonar"),
    ("red", "sonar"),
    ("factory", "laser"),
    ("pool", "sonar"),
    ("outdoor", "laser"),
    ("arda", "sonar"),
]
"""Not all of them everywhere: each takes a compilation."""


def everything():
    """An arena of all kinds of solids and all materials, most of them tilted."""
    rng = np.random.default_rng(2)
    boxes = (("box", (0.8, 0.6, 0.4)), ("box", (0.05, 0.9, 0.9)))
    made = [
        Shape(
            kind=kind,
            size=size,
            at=(*rng.uniform(-3, 3, 2), rng.uniform(0.3, 2.0)),
            rotation=tuple(rng.uniform(-3, 3, 3)),
            material=material,
            surface="wall",
        )
        for material in MATERIALS
        for kind, size in (*boxes, *((("cylinder", (0.3, 0.5)), ("sphere", (0.4,))) * (material != FENDER)))
    ]
    solids = (*made, *stones(rng), hills(rng, at=(5.0, 5.0, 0.2)))
    starts = tuple(StartPose(tag=f"S{x}", at=(x, 6.0, 0.3)) for x in (-2.0, 0.0))
    return replace(land(*solids, name="everything"), has_floor=True, starts=starts)


def in_use(arena):
    """A served world in which two robots stand and all that moves has moved."""
    world = SingleWorld(build_scene(everything() if arena == "everything" else arena, ()), seed=1)
    for name, start in zip(("P2AT", "AirRobot"), world.scene.arena.starts, strict=False):
        pos = (*start.at[:2], world.scene.arena.floor + start.at[2] + 0.3)
        world.add(ROBOTS.get(name), name, [(pos, np.array([0.9, 0.1, -0.1, 0.4]))])
    doors = world.scene.door_qpos
    world.engine.data.qpos[doors] = np.linspace(0.4, 1.2, len(doors))
    for _ in range(60):  # until who fell lies, and victims have waved
        world.step()
    return world


def casters(world):
    """Our caster of a world, and what batches cast rays at."""
    indices = {int(s): i for g in world.scene.groups for s, i in zip(g.slots, g.indices, strict=True)}
    with numpy_backend():
        ours = world.engine.caster(
            indices, moved_geom_poses(world.scene, None, clock_of(world.scene, world.world))
        )
        bodies = [forward_kinematics(g.plan, robot_states(g, world.physics)) for g in world.scene.groups]
        return ours, caster(world.scene, world.world, world.physics, bodies).args[0]


def some_rays(world, cast):
    """Rays from all over the arena, above its ground, and a quarter from within the robots.

    Of six one is level and one parallel to an axis.
    """
    rng = np.random.default_rng(7)
    (x0, x1), (y0, y1) = world.scene.arena.extent
    origin = rng.uniform((max(x0, -15), max(y0, -15), 0.1), (min(x1, 15), min(y1, 15), 2.5), (RAYS, 3))
    origin = origin.astype(np.float32)
    floor = world.scene.arena.floor
    if any(shape.kind == "hfield" for shape in world.scene.arena.shapes):
        high = origin * (1, 1, 0) + (0, 0, floor + 30.0)
        down = np.tile((0.0, 0.0, -1.0), (RAYS, 1))
        floor = floor + 30.0 - cast(high, down, RayQuery(transparent=frozenset({SKY}))).distance
    origin[:, 2] += floor
    bodies = world.engine.data.xpos[[group.chassis[0] for group in world.scene.groups]]
    here = np.arange(RAYS) % 4 == 0
    origin[here] = bodies[rng.integers(len(bodies), size=here.sum())] + rng.normal(0, 0.02, (here.sum(), 3))
    origin[: RAYS // 2] = origin[: RAYS // 2 : BEAMS].repeat(BEAMS, 0)
    along = rng.normal(size=(RAYS, 3))
    along[1::6, 2] = 0.0
    along[2::6] = np.array([*np.eye(3), *-np.eye(3)])[rng.integers(6, size=len(along[2::6]))]
    return origin, (along / np.linalg.norm(along, axis=-1, keepdims=True)).astype(np.float32)


_see = jax.jit(cast_rays, compiler_options={"xla_backend_optimization_level": 0})


def see(geoms, origin, along, query):
    """What batches see; so few rays at a time take the least time to compile."""
    parts = [_see(geoms, origin[i : i + PART], along[i : i + PART], query) for i in range(0, RAYS, PART)]
    return jax.tree.map(lambda *x: np.concatenate(x), *jax.device_get(parts))


def differ(ours, theirs):
    """Which distances do."""
    return ~np.isclose(ours.distance, theirs.distance, atol=DISTANCE, rtol=FAR)


@pytest.fixture(scope="module")
def worlds():
    made = {}
    return lambda arena: made.get(arena) or made.setdefault(arena, in_use(arena))


@pytest.mark.every_run("everything-laser", "everything-light", "pool-sonar")
@pytest.mark.oracle
@pytest.mark.parametrize(("arena", "name"), WHERE)
def test_rays_meet_what_the_raycaster_of_batches_says(worlds, arena, name):
    world, query = worlds(arena), QUERIES[name]
    cast, geoms = casters(world)
    rays = some_rays(world, cast)
    ours, theirs = cast(*rays, query), see(geoms, *rays, query)
    assert ours.distance.dtype == ours.cosine.dtype == np.float32
    bad = differ(ours, theirs)
    assert bad.mean() <= EDGES
    np.testing.assert_allclose(ours.cosine[~bad], theirs.cosine[~bad], atol=COSINE)
    hits = np.isfinite(ours.distance)
    assert hits.mean() > 0.3
    assert ours.distance[hits].max() <= query.max_distance
    assert (ours.cosine[hits] > 0).mean() > 0.99 if query.incidence else not ours.cosine.any()


def test_each_part_of_a_query_matters_here(worlds):
    """Else the comparisons would show nothing."""
    world = worlds("everything")
    cast, _ = casters(world)
    rays = some_rays(world, cast)
    plain = cast(*rays)
    for query in (
        *(RayQuery(transparent=frozenset({material})) for material in MATERIALS),
        *(RayQuery(exclude_owner=np.int32(slot)) for slot in (0, 1)),
        RayQuery(max_distance=3.0),
    ):
        assert differ(cast(*rays, query), plain).mean() > 2 * EDGES, query
    unwanted = cast(*rays, RayQuery(wanted=np.array(False), incidence=True))
    assert np.isinf(unwanted.distance).all()
    assert not unwanted.cosine.any()
    nobody = cast(*rays, RayQuery(exclude_owner=np.int32(7), wanted=np.array(True)))
    np.testing.assert_array_equal(nobody.distance, plain.distance)


@pytest.mark.parametrize(("arena", "reach"), [("everything", 0.4), ("everything", 5.0), ("yellow", 3.0)])
def test_a_reach_leaves_out_nothing_that_is_within_it(worlds, arena, reach):
    """To the bit, for single rays, narrow cones and rays all round: planes and hills too."""
    cast, _ = casters(worlds(arena))
    origin, along = some_rays(worlds(arena), cast)
    apart = np.repeat([0.0, 0.1, 0.5, 9.0], RAYS // 4)[:, None]
    along = along[::BEAMS].repeat(BEAMS, 0) + apart * np.random.default_rng(4).normal(size=along.shape)
    rays = origin, (along / np.linalg.norm(along, axis=-1, keepdims=True)).astype(np.float32)
    query = RayQuery(exclude_owner=np.int32(0), incidence=True)
    far = cast(*rays, query)
    near = far.distance <= reach
    assert 0.05 < near.mean() < 0.95
    ours = cast(*rays, query.replace(max_distance=reach))
    np.testing.assert_array_equal(ours.distance, np.where(near, far.distance, np.inf))
    np.testing.assert_array_equal(ours.cosine, np.where(near, far.cosine, 0.0))


def test_rays_leave_the_model_as_it_was(worlds):
    world = worlds("everything")
    cast, _ = casters(world)
    before = world.engine.model.geom_group.copy()
    cast(*some_rays(world, cast), QUERIES["laser"])
    np.testing.assert_array_equal(world.engine.model.geom_group, before)
    assert len(cast(np.zeros((0, 3)), np.zeros((0, 3)), QUERIES["laser"]).distance) == 0
