"""Rays against C MuJoCo's in random scenes of every type of geom: all of them, edges and tangents counted.

A ray whose answer differs by more than the tolerance must be one within 1e-4 m of an edge or a tangent: C's
answers to the ray moved aside by that much have to lie on both sides of ours. Of those there are few.
"""

from dataclasses import dataclass
from functools import cache, partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from tests.lands import Land, hills, land, stones
from usarmjx.models.compile.ray_geoms import TRIANGLE_KIND, ray_primitives_of
from usarmjx.models.types.shapes import Shape
from usarmjx.sensors.rays.raycast import cast_rays
from usarmjx.sensors.rays.targets import make_geoms

Geom = mujoco.mjtGeom
NEAR = 50.0  # m up to which ...
ATOL, RTOL = 1e-4, 1e-5  # ... the first counts [m], and from which the second, of the distance
EDGE = 1e-4  # m from an edge or a tangent; beyond `NEAR` in proportion: float32 is 1e-7 of the distance
FEW = 1e-3  # share of rays that may differ there
RAYS = 3000
ROOM = 400  # geoms of a scene, triangles each for itself
SOLID = ("box", "sphere", "capsule", "cylinder", "ellipsoid")
NUMBERS = {"box": 3, "sphere": 1, "capsule": 2, "cylinder": 2, "ellipsoid": 3}


def scene(seed):
    """Every type of geom, some upright, some turned; planes with and without an end."""
    rng = np.random.default_rng(seed)
    shapes = [
        Shape(
            kind=kind,
            size=tuple(rng.uniform(0.1, 1.0, NUMBERS[kind])),
            at=tuple(rng.uniform(-4, 4, 3)),
            rotation=tuple(rng.uniform(-3, 3, 3)) if i else (0.0, 0.0, 0.0),
        )
        for kind in SOLID
        for i in range(3)
    ]
    place = Land(land(*shapes, *stones(rng, 4), hills(rng), hills(rng, tilted=False)))
    return with_planes_and_faces(place, rng)


def with_planes_and_faces(place, rng):
    """Add what an arena's data cannot say: tilted planes, and a mesh of faces that is not convex."""
    spec = mujoco.MjSpec.from_string(MESHES)
    body = spec.worldbody
    for name in ("star", "sheet"):
        body.add_geom(type=Geom.mjGEOM_MESH, meshname=name, pos=rng.uniform(-3, 3, 3), quat=unit(rng, 4))
    body.add_geom(type=Geom.mjGEOM_PLANE, size=(0, 0, 1), pos=(0, 0, -5))
    body.add_geom(type=Geom.mjGEOM_PLANE, size=(2, 1, 1), pos=rng.uniform(-3, 3, 3), quat=unit(rng, 4))
    return place, Plain(spec.compile())


def unit(rng, n):
    vector = rng.normal(size=n)
    return vector / np.linalg.norm(vector)


# An octahedron with a dent, whose faces are given, and a bent sheet of two triangles that is no solid.
MESHES = """<mujoco><asset>
<mesh name="star" vertex="1 0 0 -1 0 0 0 1 0 0 -1 0 0 0 0.2 0 0 -1" inertia="shell"
  face="0 2 4 2 1 4 1 3 4 3 0 4 2 0 5 1 2 5 3 1 5 0 3 5"/>
<mesh name="sheet" vertex="0 0 0 1.5 0 0 1.5 1 0.5 0 1 0" inertia="shell" face="0 1 2 0 2 3"/>
</asset><worldbody/></mujoco>"""


class Plain:
    """A model with its poses."""

    def __init__(self, model):
        self.model, self.data = model, mujoco.MjData(model)
        mujoco.mj_kinematics(self.model, self.data)


@dataclass
class Both:
    """Two models that are one scene: of C's two answers the nearer counts."""

    parts: tuple

    def c(self, origins, directions):
        return np.min([self._one(part, origins, directions) for part in self.parts], 0)

    def _one(self, part, origins, directions):
        hit = np.zeros(1, np.int32)
        met = np.array(
            [
                mujoco.mj_ray(part.model, part.data, o, d, None, 1, -1, hit)
                for o, d in zip(origins, directions, strict=True)
            ]
        )
        return np.where(met < 0, np.inf, met)

    def geoms(self):
        """The same as our rays see it."""
        blocks = []
        for part in self.parts:
            pieces = ray_primitives_of(part.model, np.arange(part.model.ngeom))
            mats = part.data.geom_xmat.reshape(-1, 3, 3)
            blocks.append((pieces.kind, *pieces.world_poses(part.data.geom_xpos, mats), pieces.size))
        # Triangles without an area, which nothing meets: scenes of one size are one compilation.
        blank = ROOM - sum(len(block[0]) for block in blocks)
        shapes = ((), (3,), (3, 3), (3,))
        blocks.append([np.zeros((blank, *shape)) for shape in shapes])
        blocks[-1][0][:] = TRIANGLE_KIND
        kind, pos, mat, size = (np.concatenate(column) for column in zip(*blocks, strict=True))
        arrays = (jnp.asarray(part, jnp.float32) for part in (pos, mat, size))
        return make_geoms(kind.astype(int), *arrays, jnp.full(len(kind), -1))

    def some(self, rng, count):
        """Places, orientations and radii [m] of geoms at random; unbounded ones count as 2 m."""
        pos = np.concatenate([part.data.geom_xpos for part in self.parts])
        mats = np.concatenate([part.data.geom_xmat for part in self.parts]).reshape(-1, 3, 3)
        radius = np.concatenate([part.model.geom_rbound for part in self.parts])
        geoms = rng.integers(len(pos), size=count)
        return pos[geoms], mats[geoms], np.where(radius > 0, radius, 2.0).clip(0, 2)[geoms, None]

    def inside_terrain(self, origins):
        """Where C also meets the level of a terrain's lowest point, which is no surface."""
        place = self.parts[0]
        fields = np.flatnonzero(place.model.geom_type == Geom.mjGEOM_HFIELD)
        return np.any([place.inside(g, origins, 2e-4) for g in fields], 0)


@cache
def both(seed):
    return Both(scene(seed))


def aimed(place, rng, count, low, high):
    """From `low` to `high` metres away towards somewhere about a geom."""
    targets = about(place, rng, count, 1.2)
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    return targets - directions * rng.uniform(low, high, (count, 1)), directions


def about(place, rng, count, share):
    """Points within `share` of a geom's own size of its middle."""
    pos, _, radius = place.some(rng, count)
    return pos + rng.uniform(-1, 1, (count, 3)) * radius * share


def from_inside(place, rng, count):
    """From about the middle of solids: nearly all of them are inside."""
    _, directions = aimed(place, rng, count, 0.0, 1.0)
    return about(place, rng, count, 0.2), directions


def along_faces(place, rng, count):
    """Parallel to an axis of a geom: to faces and axes of boxes, cylinders, capsules."""
    pos, mats, radius = place.some(rng, count)
    directions = mats[np.arange(count), :, rng.integers(3, size=count)] * rng.choice([-1, 1], (count, 1))
    targets = pos + rng.uniform(-1, 1, (count, 3)) * radius
    return targets - directions * rng.uniform(0.0, 8.0, (count, 1)), directions


FAMILIES = {
    "aimed": partial(aimed, low=0.1, high=12.0),
    "inside": from_inside,
    "parallel": along_faces,
    "to 50 m": partial(aimed, low=12.0, high=NEAR - 5),
    "beyond 50 m": partial(aimed, low=NEAR, high=900.0),
}
quick_jit = partial(jax.jit, compiler_options={"xla_backend_optimization_level": 0})


@quick_jit
def see(geoms, origins, directions):
    return cast_rays(geoms, origins, directions).distance


def tolerance(distance):
    """What the issue allows: 1e-4 m up to 50 m, beyond that 1e-5 of the distance."""
    met = np.where(np.isfinite(distance), distance, 0.0)
    return np.where(met <= NEAR, ATOL, RTOL * met)


def agree(ours, theirs):
    with np.errstate(invalid="ignore"):
        close = np.abs(ours - theirs) <= tolerance(theirs)
    return close | (np.isinf(ours) & np.isinf(theirs))


def at_an_edge(place, origin, direction, ours, theirs):
    """Whether C's answers to the ray moved aside by up to `EDGE` lie on both sides of ours."""
    width = EDGE * max(1.0, min(ours, theirs) / NEAR)
    side = np.cross(direction, np.eye(3)[np.argmin(np.abs(direction))])
    side /= np.linalg.norm(side)
    other = np.cross(direction, side)
    turn = np.linspace(0, 2 * np.pi, 24, endpoint=False)[:, None]
    ring = np.concatenate(
        [share * width * (np.cos(turn) * side + np.sin(turn) * other) for share in (0.5, 1)]
    )
    moved = place.c(origin + ring, np.tile(direction, (len(ring), 1)))
    slack = tolerance(np.array(ours))
    return moved.min() - slack <= ours <= moved.max() + slack


def compare(place, rays):
    """How many rays there are, how many met something, the worst error, edges and plain mistakes."""
    origins, directions = (np.asarray(part, np.float32) for part in rays)
    ours = np.asarray(see(place.geoms(), jnp.asarray(origins), jnp.asarray(directions)), float)
    origins, directions = origins.astype(float), directions.astype(float)
    theirs = place.c(origins, directions)
    judged = ~place.inside_terrain(origins)
    good = agree(ours, theirs)
    differ = np.flatnonzero(judged & ~good)
    edges = [i for i in differ if at_an_edge(place, origins[i], directions[i], ours[i], theirs[i])]
    wrong = [(origins[i], directions[i], ours[i], theirs[i]) for i in differ if i not in edges]
    met = judged & good & np.isfinite(theirs)
    worst = (np.abs(ours[met] - theirs[met]) / tolerance(theirs[met])).max()
    return int(judged.sum()), int(met.sum()), float(worst), len(edges), wrong


@pytest.mark.oracle
@pytest.mark.parametrize("family", FAMILIES)
def test_rays_meet_what_c_mujocos_do_in_scenes_of_every_type(family):
    rays = met = edges = 0
    for seed in range(2):
        place, rng = both(seed), np.random.default_rng([seed, list(FAMILIES).index(family)])
        some, hits, worst, few, wrong = compare(place, FAMILIES[family](place, rng, count=RAYS))
        assert not wrong, wrong[0]
        assert worst <= 1.0
        rays, met, edges = rays + some, met + hits, edges + few
    assert met > 0.3 * rays  # enough of them meet something
    assert edges <= FEW * rays
