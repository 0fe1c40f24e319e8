"""Meshes that are not convex: rays meet their faces as C MuJoCo's do, robots and radio the hull."""

from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest
import trimesh

from tests.lands import Land
from usarmjx.base.errors import ArenaFileError
from usarmjx.comms.walls import arena_solids, count_walls
from usarmjx.models.compile.compose import new_spec
from usarmjx.models.compile.physics import Physics
from usarmjx.models.files import meshes
from usarmjx.models.files.load import load_arena, save_arena
from usarmjx.sensors.rays.raycast import nearest_hits
from usarmjx.sensors.rays.targets import make_geoms
from usarmjx.sim.scene import build_scene

RAY_ATOL = 1e-4  # m: float32 over a few metres
FEW = 0.1  # rays that graze an edge, at most


def turned(rings, bottom):
    """What rings of corners enclose: one after the other, back to the first or with a bottom at both ends."""
    n, count = len(rings[0]), len(rings)
    faces = []
    for ring in range(count - 1 if bottom else count):
        for i in range(n):
            a, b = n * ring + i, n * ring + (i + 1) % n
            c, d = (a + n) % (n * count), (b + n) % (n * count)
            faces += [(a, b, d), (a, d, c)]
    if bottom:
        last = n * (count - 1)
        faces += [(0, k + 1, k) for k in range(1, n - 1)]
        faces += [(last, last + k, last + k + 1) for k in range(1, n - 1)]
    return trimesh.Trimesh(np.concatenate(rings), faces, process=False)


def cup():
    """A round cup, open at the top, whose walls and bottom are 0.1 m thick."""
    around = np.linspace(0, 2 * np.pi, 10, endpoint=False)
    rings = [(1.0, 0.0), (1.0, 1.5), (0.9, 1.5), (0.9, 0.1)]
    return turned([np.c_[r * np.cos(around), r * np.sin(around), np.full(10, z)] for r, z in rings], True)


def room():
    """The walls of an L-shaped room, 5 cm thick."""
    outside = np.array([(0, 0), (4, 0), (4, 2), (2, 2), (2, 4), (0, 4)], float)
    inside = outside + 0.05 * np.array([(1, 1), (-1, 1), (-1, -1), (-1, -1), (-1, -1), (1, -1)])
    rings = [(outside, 0.0), (outside, 1.0), (inside, 1.0), (inside, 0.0)]
    return turned([np.c_[flat, np.full(6, z)] for flat, z in rings], False)


def torus():
    return trimesh.creation.torus(1.0, 0.3, 14, 8)


def loaded(folder, solid, more=""):
    solid.export(folder / "solid.obj")
    path = folder / "a.yaml"
    path.write_text(
        f"has_floor: false\nmeshes: [{{file: solid.obj, hull: true, surface: ground{more}}}]\n"
        "starts: [{tag: A, at: [9, 9, 0.188]}]\n"
    )
    return load_arena(path)


@partial(jax.jit, compiler_options={"xla_backend_optimization_level": 0})
def distances(geoms, origins, ways):
    return nearest_hits(geoms, origins, ways).distance


def seen(arena, origins, ways):
    look = build_scene(arena, []).fixed_geoms
    places = (jnp.asarray(part) for part in (look.pos, look.mat, look.size))
    geoms = make_geoms(look.kind, *places, np.full(len(look.kind), -1))
    return np.asarray(distances(geoms, jnp.asarray(origins, jnp.float32), jnp.asarray(ways, jnp.float32)))


@pytest.mark.every_run("room")
@pytest.mark.oracle
@pytest.mark.parametrize("make", [torus, cup, room])
def test_rays_meet_faces_where_c_mujoco_meets_them(make, tmp_path):
    """C MuJoCo gets the file's corners and faces without a line of ours."""
    solid = make()
    assert solid.is_watertight
    assert solid.volume > 0
    spec = mujoco.MjSpec()
    spec.add_mesh(name="it", uservert=solid.vertices.ravel(), userface=solid.faces.ravel())
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="it")
    arena = loaded(tmp_path, solid)
    rng, middle = np.random.default_rng(4), solid.bounds.mean(0)
    origins = (middle + rng.uniform(-2.5, 2.5, (600, 3))).astype(np.float32).astype(float)
    ways = middle + rng.uniform(-1.2, 1.2, (600, 3)) - origins
    ways = (ways / np.linalg.norm(ways, axis=-1, keepdims=True)).astype(np.float32).astype(float)
    distance, _, clear = Land(arena, spec.compile()).oracle(origins, ways)
    assert clear.mean() > 1 - FEW
    met = clear & np.isfinite(distance)
    assert met.sum() > 200
    np.testing.assert_allclose(seen(arena, origins, ways)[clear], distance[clear], atol=RAY_ATOL)
    filled = seen(loaded(tmp_path, solid, ", rays: hull"), origins, ways)
    assert (np.abs(filled[met] - distance[met]) > 0.1).sum() > 30


def test_the_radio_and_robots_meet_the_hull(tmp_path):
    arena = loaded(tmp_path, room())
    # Across the cut corner of the L, outside its walls: within the hull.
    ends = np.array([(2.5, 3.2, 0.5)]), np.array([(3.2, 2.5, 0.5)])
    assert int(np.squeeze(count_walls(arena_solids(arena), *ends))) == 1
    spec = new_spec(arena, Physics())
    ball = spec.worldbody.add_body(pos=(2.6, 2.6, 0.5))
    ball.add_freejoint()
    ball.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=(0.1, 0, 0), contype=7, conaffinity=7)
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    assert data.ncon == 1


def test_a_saved_arena_has_the_faces(tmp_path):
    arena = loaded(tmp_path, torus())
    again = load_arena(save_arena(arena, tmp_path / "saved.yaml"))
    assert again.shapes == arena.shapes
    assert again.shapes[0].mesh.faces is not None
    assert again.shapes != loaded(tmp_path, torus(), ", rays: hull").shapes


def test_too_many_faces_are_refused_with_what_helps(tmp_path, monkeypatch):
    monkeypatch.setattr(meshes, "MAX_FACES", 20)
    with pytest.raises(ArenaFileError, match=r"not convex and has 224 faces, at most 20 .*`rays: hull`"):
        loaded(tmp_path, torus())
    assert loaded(tmp_path, torus(), ", rays: hull").shapes[0].mesh.faces is None
