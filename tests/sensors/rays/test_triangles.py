"""Meshes and terrain as rays see them, against C MuJoCo's own rays."""

from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from tests.lands import Land, hills, land, rays_at, stones
from usarmjx.models.compile.ray_geoms import TRIANGLE_KIND, ray_primitives_of, triangle_frames
from usarmjx.models.types.shapes import HeightField, Mesh, Shape
from usarmjx.sensors.rays.kernels import RAY_KERNELS
from usarmjx.sensors.rays.raycast import RayQuery, cast_rays
from usarmjx.sensors.rays.targets import make_geoms
from usarmjx.sim.scene import build_scene

RAY_ATOL = 1e-4  # m: float32 over a few metres, and what a range sensor may be off
COSINE_ATOL = 1e-4  # a triangle's normal does not depend on where it is met: float32 of a product
FEW = 0.05  # rays that graze an edge, at most
# Without XLA's optimiser, which would take longer than all the rays.
quick_jit = partial(jax.jit, compiler_options={"xla_backend_optimization_level": 0})


@quick_jit
def see(*rays):
    return cast_rays(*rays)


@quick_jit
def see_angle(*rays):
    return cast_rays(*rays, RayQuery(incidence=True))


def seen(place, owner=-1):
    """What rays see of a land; all of it belongs to `owner`."""
    pieces = ray_primitives_of(place.model, np.arange(place.model.ngeom))
    pos, mat = pieces.world_poses(place.data.geom_xpos, place.data.geom_xmat.reshape(-1, 3, 3))
    arrays = (jnp.asarray(part, jnp.float32) for part in (pos, mat, pieces.size))
    return make_geoms(pieces.kind, *arrays, jnp.full(len(pieces.kind), owner))


def meets(place, rays):
    return see_angle(seen(place), *(jnp.asarray(part, jnp.float32) for part in rays))


@pytest.mark.every_run("0")
@pytest.mark.oracle
@pytest.mark.parametrize("seed", range(2))
def test_meshes_and_terrain_are_met_where_c_mujoco_meets_them(seed):
    rng = np.random.default_rng(seed)
    place = Land(land(*stones(rng), hills(rng), hills(rng, tilted=False)))
    rays = rays_at(rng, place, 600)
    # From inside a terrain C also meets the level of its lowest point, which is no surface.
    fields = np.flatnonzero(place.model.geom_type == mujoco.mjtGeom.mjGEOM_HFIELD)
    outside = ~np.any([place.inside(g, rays[0], 2e-4) for g in fields], 0)
    distance, cosine, clear = place.oracle(*rays)
    assert clear.mean() > 1 - FEW
    clear &= outside
    met = clear & np.isfinite(distance)
    assert met.sum() > 200
    assert (clear & ~met).sum() > 50
    hits = meets(place, rays)
    np.testing.assert_allclose(hits.distance[clear], distance[clear], atol=RAY_ATOL)
    np.testing.assert_allclose(hits.cosine[met], cosine[met], atol=COSINE_ATOL)


@pytest.mark.oracle
def test_rays_from_inside_a_mesh_meet_its_far_side():
    rng = np.random.default_rng(8)
    place = Land(land(*stones(rng, 4)))
    geoms = rng.integers(4, size=300)
    origins = place.data.geom_xpos[geoms] + rng.uniform(-0.01, 0.01, (300, 3))
    inside = np.array([place.inside(g, o[None])[0] for g, o in zip(geoms, origins, strict=True)])
    _, directions = rays_at(rng, place, 300)
    distance, cosine, clear = place.oracle(origins, directions)
    clear &= inside
    assert clear.sum() > 150
    assert np.isfinite(distance[clear]).all()
    hits = meets(place, (origins, directions))
    np.testing.assert_allclose(hits.distance[clear], distance[clear], atol=RAY_ATOL)
    np.testing.assert_allclose(hits.cosine[clear], cosine[clear], atol=COSINE_ATOL)


def test_no_ray_slips_through_where_triangles_meet():
    """Straight down on every corner of a terrain, and everywhere along the edges of its cells."""
    rng = np.random.default_rng(5)
    place = Land(land(hills(rng, tilted=False, at=(3.0, -7.0, 0.5))))
    x, y = np.linspace(1.001, 4.999, 9), np.linspace(-8.499, -5.501, 6)
    fine = np.linspace(0, 1, 97)
    along_x = np.stack(np.meshgrid(1.001 + 3.998 * fine, np.linspace(-8.5, -5.5, 6)[1:-1]), -1)
    along_y = np.stack(np.meshgrid(np.linspace(1, 5, 9)[1:-1], -8.499 + 2.998 * fine), -1)
    corners = np.stack(np.meshgrid(x, y), -1)
    flat = np.concatenate([part.reshape(-1, 2) for part in (corners, along_x, along_y)])
    origins = np.concatenate([flat, np.full((len(flat), 1), 4.0)], -1)
    down = np.tile([0.0, 0.0, -1.0], (len(origins), 1))
    distance, _ = place.c(origins, down)
    assert (distance < 4.0 - 0.5).all()  # the terrain's lowest point is above 0.5 m
    got = meets(place, (origins, down)).distance
    np.testing.assert_allclose(got, distance, atol=RAY_ATOL)


@pytest.mark.parametrize(
    ("start", "way", "distance"),
    [
        ((0.2, 0.2, 3.0), (0, 0, -1), 3.0),
        ((0.2, 0.2, -2.0), (0, 0, 1), 2.0),  # from behind
        ((0.2, 0.2, -2.0), (0, 0, -1), np.inf),  # away from it
        ((0.9, 0.9, 3.0), (0, 0, -1), np.inf),  # beside it
        ((-0.5, 0.2, 0.0), (1, 0, 0), np.inf),  # within its plane
        ((0.0, 0.2, 1.0), (0.6, 0, -0.8), np.inf),  # past the long edge: x + 2 y = 0.75 + 0.4 > 1
        ((0.0, 0.1, 1.0), (0.6, 0, -0.8), 1.25),
    ],
)
def test_one_triangle(start, way, distance):
    """Corners (0, 0), (1, 0) and (0, 0.5) in the plane z = 0."""
    pos, mat, size = triangle_frames(np.array([[[0, 0, 0], [1, 0, 0], [0, 0.5, 0]]], float))
    np.testing.assert_allclose(mat[0], np.eye(3), atol=1e-12)
    np.testing.assert_allclose((pos[0], size[0]), [(0, 0, 0), (1, 0, 0.5)], atol=1e-12)
    kernel = RAY_KERNELS[TRIANGLE_KIND]
    assert kernel(jnp.array(start, float), jnp.array(way, float), jnp.asarray(size[0])) == pytest.approx(
        distance
    )


def test_triangles_without_an_area_are_left_out():
    line = np.array([[[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[0, 0, 0], [1, 0, 0], [0, 1, 0]]], float)
    pos, _, _ = triangle_frames(line)
    assert len(pos) == 1


def test_padding_is_never_met():
    """Blank rows of a size of zero, as a served world keeps them, where the ray would pass."""
    none = jnp.zeros(3)
    assert RAY_KERNELS[TRIANGLE_KIND](jnp.array([0.0, 0.0, 1.0]), jnp.array([0.0, 0.0, -1.0]), none) == np.inf


def test_the_viewers_own_triangles_are_passed():
    rng = np.random.default_rng(2)
    place = Land(land(*stones(rng, 3)))
    origins, directions = (jnp.asarray(part, jnp.float32) for part in rays_at(rng, place, 100))
    assert np.isfinite(
        see(seen(place, 7), origins, directions, RayQuery(exclude_owner=jnp.int32(3))).distance
    ).any()
    assert np.isinf(
        see(seen(place, 7), origins, directions, RayQuery(exclude_owner=jnp.int32(7))).distance
    ).all()


def test_a_scene_shows_its_meshes_and_terrain():
    """A pyramid of 1 m on a terrain that is level at 0.4 m, above a floor of 0 m and in the arena's place."""
    tip = np.array([(1, 1, 0), (-1, 1, 0), (-1, -1, 0), (1, -1, 0), (0, 0, 1)], float)
    level = np.full((3, 3), 0.4)
    level[0, 0] = 0.0
    shapes = (
        Shape(kind="mesh", mesh=Mesh(vertices=tip), at=(2.0, 1.0, 0.4)),
        Shape(kind="hfield", size=(5.0, 5.0, 0.2), heights=HeightField(heights=level)),
    )
    scene = build_scene(land(*shapes), [])
    look = scene.fixed_geoms
    geoms = make_geoms(
        look.kind, look.pos, look.mat, look.size, np.full(len(look.kind), -1), look.material.tolist()
    )
    down = jnp.tile(jnp.array([0.0, 0.0, -1.0]), (3, 1))
    above = jnp.array([(2.0, 1.0, 3.0), (2.5, 1.0, 3.0), (4.0, 4.0, 3.0)])
    np.testing.assert_allclose(see(geoms, above, down).distance, [1.6, 2.1, 2.6], atol=RAY_ATOL)
