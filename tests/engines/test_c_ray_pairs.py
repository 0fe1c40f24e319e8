"""Rays of several robots at once against `mj_ray`, ray by ray."""

import mujoco
import numpy as np
import pytest

from usarmjx.engines.c.rays import CRayCaster, RayPairs, tree_addresses
from usarmjx.models.types.shapes import FENDER, GLASS, MATERIALS, OPAQUE
from usarmjx.sensors.rays.raycast import RayQuery

ROUNDING = 1e-9
"""Products are summed in another order [m]; 10 m in double precision have 1e-15."""
SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "box": 3}
ROBOTS, ORIGINS, RAYS = 3, 8, 9
REACH = 4.0


def scene(seed, extra=""):
    """Return a model and data with solids of all known kinds, a quarter of glass, and a robot's geoms."""
    rng = np.random.default_rng(seed)
    geoms = [
        '<geom type="plane" size="0 0 1"/>',
        '<geom type="plane" size="2 1 1" pos="0 0 3" euler="150 20 0"/>',
    ]
    for number in range(60):
        kind = list(SIZES)[number % 4]
        size = " ".join(map(str, rng.uniform(0.05, 0.6, SIZES[kind])))
        place = " ".join(map(str, rng.uniform((-4, -4, 0), (4, 4, 2))))
        turn = " ".join(map(str, rng.uniform(-180, 180, 3)))
        group = MATERIALS.index(GLASS if number % 5 == 0 else OPAQUE)
        seen = "0.5 0.5 0.5 0" if number == 7 else "0.5 0.5 0.5 1"
        form = f'type="{kind}" size="{size}" group="{group}" rgba="{seen}"'
        geoms.append(f'<body pos="{place}" euler="{turn}"><geom {form}/></body>')
    model = mujoco.MjModel.from_xml_string(
        f"<mujoco><asset><hfield name='h' nrow='2' ncol='2' size='1 1 1 1'/></asset>"
        f"<worldbody>{''.join(geoms)}{extra}</worldbody></mujoco>"
    )
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    return model, data


def bundles(seed, level=False):
    """Return origins and directions of bundles (robots, rays, 3)."""
    rng = np.random.default_rng(seed)
    point = rng.uniform((-4, -4, 0.05), (4, 4, 2), (ROBOTS, ORIGINS, 3))
    along = rng.normal(size=(ROBOTS, ORIGINS, 1, 3))
    if level:  # parallel to faces of boxes that stand upright
        along = np.eye(3)[rng.integers(2, size=(ROBOTS, ORIGINS, 1))] + 0.0
    along = (
        along + rng.normal(size=(ROBOTS, ORIGINS, RAYS, 3)) * np.linalg.norm(along, axis=-1)[..., None] * 0.1
    )
    along[:, :, 0] = along[:, :, 0].round() if level else along[:, :, 0]
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    return np.repeat(point, RAYS, 1), along.reshape(ROBOTS, -1, 3)


def seen_by_mujoco(model, data, start, along, solid, own):
    """Return distances and cosines by `mj_ray`, within reach (rays,)."""
    groups, out, normal = model.geom_group.copy(), np.zeros(1, np.int32), np.zeros(3)
    model.geom_group[own] = len(MATERIALS)
    found = [
        (mujoco.mj_ray(model, data, *ray, solid, 1, -1, out, normal), normal.copy())
        for ray in zip(start, along, strict=True)
    ]
    model.geom_group[:] = groups
    distance = np.array([met for met, _ in found])
    distance[(distance < 0) | (distance > REACH)] = np.inf
    cosine = np.abs([turned @ way for (_, turned), way in zip(found, along, strict=True)])
    return distance, np.where(np.isfinite(distance), cosine, 0.0)


@pytest.mark.oracle
@pytest.mark.parametrize("level", [False, True])
@pytest.mark.parametrize("seed", range(4))
def test_bundles_meet_what_mj_ray_says(seed, level):
    model, data = scene(seed)
    solid = np.ones(mujoco.mjNGROUP, np.uint8)
    solid[[MATERIALS.index(GLASS), len(MATERIALS)]] = 0
    robots = {0: np.array([5, 6]), 2: np.array([10, 20, 30])}
    start, along = bundles(seed, level)
    distance, cosine, is_right = RayPairs(model, data, robots).nearest(
        start, along, np.arange(ROBOTS), solid, REACH
    )
    assert is_right.all()
    met = 0
    for robot in range(ROBOTS):
        own = robots.get(robot, np.zeros(0, int))
        wanted, faced = seen_by_mujoco(model, data, start[robot], along[robot], solid, own)
        near = distance[robot] <= REACH
        np.testing.assert_array_equal(near, np.isfinite(wanted))
        np.testing.assert_allclose(distance[robot][near], wanted[near], rtol=0, atol=ROUNDING)
        np.testing.assert_allclose(cosine[robot][near], faced[near], rtol=0, atol=1e-6)
        met += near.sum()
    assert met > 50


@pytest.mark.oracle
@pytest.mark.parametrize("hidden", [False, True])
@pytest.mark.parametrize("other", ["hill", "fender"])
def test_robots_that_see_other_kinds_are_left_to_mujoco(other, hidden):
    group = MATERIALS.index(FENDER)
    y = 0.0 if hidden else -1.4  # a box of the scene is 0.25 m before the robots, and hides it
    extra = {
        "hill": f'<geom type="hfield" hfield="h" pos="0 {y} 0.5"/>',
        "fender": f'<geom type="cylinder" size="0.5 0.5" pos="0 {y} 1" group="{group}"/>',
    }[other]
    model, data = scene(0, extra)
    start, along = bundles(0)
    start += np.array([0.0, 100.0, 100.0])[:, None, None] * (1, 0, 0)  # only the first is near
    start[0] = (0.0, -2.0, 1.0)
    start[0] += np.repeat(np.arange(ORIGINS), RAYS)[:, None] * (0.01, 0, 0)
    along[0] = (0.0, 0.995, -0.0998749)
    solid = np.ones(mujoco.mjNGROUP, np.uint8)
    distance, _, is_right = RayPairs(model, data, {}).nearest(start, along, np.arange(ROBOTS), solid, REACH)
    assert is_right.tolist() == [hidden, True, True]
    wanted, _ = seen_by_mujoco(model, data, start[0], along[0], solid, np.zeros(0, int))
    if hidden:
        np.testing.assert_allclose(distance[0], wanted, rtol=0, atol=ROUNDING)


def test_fans_and_uneven_rays_are_left_to_mujoco():
    model, data = scene(0)
    pairs, solid = RayPairs(model, data, {}), np.ones(mujoco.mjNGROUP, np.uint8)
    angle = np.linspace(-1.6, 1.6, 21)
    fan = np.stack([np.cos(angle), np.sin(angle), 0 * angle], -1)[None]
    assert not pairs.nearest(np.zeros((1, 21, 3)), fan, np.arange(1), solid, REACH)[2].any()
    start, along = bundles(0)
    uneven = np.arange(1, start.shape[1])  # the first origin has a ray less
    assert not pairs.nearest(start[:, uneven], along[:, uneven], np.arange(ROBOTS), solid, REACH)[2].any()


@pytest.mark.oracle
@pytest.mark.parametrize("tilt", [0.0, 0.2, 1.0])
@pytest.mark.parametrize("width", [1.0, np.pi, 6.2])
def test_fans_meet_what_mj_ray_says_and_leave_the_model_as_it_was(tilt, width):
    model, data = scene(1)
    materials = [MATERIALS[group] for group in model.geom_group]
    caster = CRayCaster(model, data, materials, {})
    before = model.geom_group.copy(), model.body_geomnum.copy(), tree_addresses(model).copy()
    angle = np.linspace(-width / 2, width / 2, 181)
    along = np.stack([np.cos(angle), np.sin(angle) * np.cos(tilt), np.sin(angle) * np.sin(tilt)], -1)
    solid, met = np.ones(mujoco.mjNGROUP, np.uint8), 0
    for point in np.random.default_rng(2).uniform((-3, -3, 0.1), (3, 3, 1.5), (5, 3)):
        start = np.tile(point, (len(along), 1))
        hits = caster(start, along, RayQuery(max_distance=REACH, incidence=True))
        wanted, faced = seen_by_mujoco(model, data, start, along, solid, [])
        np.testing.assert_array_equal(hits.distance, wanted.astype(np.float32))
        np.testing.assert_array_equal(hits.cosine, faced.astype(np.float32))
        met += np.isfinite(wanted).sum()
    assert met > 300
    for after, then in zip(
        (model.geom_group, model.body_geomnum, tree_addresses(model)), before, strict=True
    ):
        np.testing.assert_array_equal(after, then)


@pytest.mark.parametrize("incidence", [False, True])
@pytest.mark.parametrize("blind", [False, True])
def test_robots_together_see_what_each_sees(incidence, blind):
    model, data = scene(3)
    caster = CRayCaster(model, data, [MATERIALS[group] for group in model.geom_group], {})
    start, along = bundles(5)
    if blind:  # a sensor that aims at nothing: its robots are cast one by one
        along[1] = along[2, RAYS:] = 0.0
    query = RayQuery(max_distance=REACH, transparent=frozenset({GLASS}), incidence=incidence)
    together = caster.of_robots(start, along, query.replace(exclude_owner=np.arange(ROBOTS)))
    assert together.distance.shape == together.cosine.shape == start.shape[:2]
    for robot in range(ROBOTS):
        aimed = along[robot].any(-1)
        assert np.isinf(together.distance[robot, ~aimed]).all()
        alone = caster(start[robot, aimed], along[robot, aimed], query.replace(exclude_owner=np.int32(robot)))
        np.testing.assert_array_equal(together.distance[robot, aimed], alone.distance)
        np.testing.assert_allclose(together.cosine[robot, aimed], alone.cosine, rtol=0, atol=1e-6)
    assert (together.cosine > 0).any() == incidence


def test_geoms_that_object_sensors_meet_are_kept_at_every_cast():
    """Also where several robots look at once, after a geom has moved."""
    model, data = scene(3)
    caster = CRayCaster(model, data, [MATERIALS[group] for group in model.geom_group], {})
    start, along = bundles(5)
    query = RayQuery(max_distance=REACH, kept_as="Finder")
    kept = []
    for _ in range(2):
        caster.of_robots(start, along, query.replace(exclude_owner=np.arange(ROBOTS)))
        kept.append([caster.met[robot, "Finder"] for robot in range(ROBOTS)])
        for robot, geoms in enumerate(kept[-1]):
            alone = query.replace(exclude_owner=np.int32(robot))
            distance, _, geom = caster.hit_geoms(start[robot], along[robot], alone, np.zeros(0, int))
            np.testing.assert_array_equal(geoms, np.where(distance <= REACH, geom, -1))
        data.geom_xpos[:] += 0.5
    assert (np.concatenate(kept[0]) != np.concatenate(kept[1])).any()
