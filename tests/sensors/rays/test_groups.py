"""Many rays are cast in pieces on a CPU: it changes no hit."""

import jax.numpy as jnp
import mujoco
import numpy as np

from usarmjx.sensors.rays.raycast import RayQuery, brute_force_hits, culled_hits, indexed_blocks
from usarmjx.sensors.rays.raycast_cpu import RAYS_AT_A_TIME
from usarmjx.sensors.rays.targets import make_geoms

BUNDLE = 8
KINDS = mujoco.mjtGeom


def test_rays_of_many_bundles_meet_what_each_of_them_meets_alone():
    rng = np.random.default_rng(0)
    count, bundles = 24, (3 * RAYS_AT_A_TIME) // (2 * BUNDLE) + 3  # the last piece is not full
    kind = np.array([KINDS.mjGEOM_SPHERE, KINDS.mjGEOM_BOX] * (count // 2), int)
    pos = rng.uniform(-1.0, 1.0, (count, 3)).astype(np.float32) * (0.3, 1.0, 1.0) + (3.0, 0.0, 0.0)
    mat = np.tile(np.eye(3, dtype=np.float32), (count, 1, 1))
    size = rng.uniform(0.05, 0.25, (count, 3)).astype(np.float32)
    pos, mat, size, owner = map(jnp.asarray, (pos.astype(np.float32), mat, size, np.full(count, -1)))
    geoms = make_geoms(kind, pos, mat, size, owner)
    aim = np.repeat(rng.uniform(-0.4, 0.4, (bundles, 2)), BUNDLE, 0) + rng.normal(
        0, 0.01, (bundles * BUNDLE, 2)
    )
    along = np.column_stack([np.ones(len(aim)), aim])
    along = (along / np.linalg.norm(along, axis=-1, keepdims=True)).astype(np.float32)
    along = jnp.asarray(along)
    start, query = jnp.zeros_like(along), RayQuery(bundle_size=BUNDLE)
    grouped, each = (
        cast(indexed_blocks(geoms), start, along, query) for cast in (culled_hits, brute_force_hits)
    )
    assert np.array_equal(grouped.geom_index, each.geom_index)
    assert np.allclose(grouped.distance, each.distance, rtol=1e-6)
    met = np.asarray(each.geom_index) >= 0
    assert 0.2 < met.mean() < 1.0
