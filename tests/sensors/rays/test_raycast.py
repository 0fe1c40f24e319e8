"""Every ray kernel and the casts against C MuJoCo, whose normals give the angles too."""

from dataclasses import dataclass
from functools import partial

import jax
import jax.numpy as jnp
import mujoco
import numpy as np
import pytest

from usarmjx.base.errors import UnsupportedGeomError
from usarmjx.sensors.rays.kernels import RAY_KERNELS
from usarmjx.sensors.rays.raycast import RayQuery, cast_rays
from usarmjx.sensors.rays.targets import PADDING_DISTANCE, Geoms, check_ray_kinds, make_geoms
from usarmjx.sim.scene import build_scene

Geom = mujoco.mjtGeom

RAY_ATOL = 1e-4  # m: float32 over a few metres, and what a range sensor may be off
COSINE_ATOL = 2e-3  # the hit point's 1e-4 m on the smallest radius, 0.05 m
GRAZE = 1e-4  # m: rays whose C answer changes when moved by this are left out ...
JUMP = 3e-3  # ... if by more than this: distance [m] or normal
FEW = 0.03  # ... and no more than this share of rays
RAYS = 400
# The size numbers in use: plane's half lengths, half lengths, radius, radius and half length, radii.
KINDS = {
    "plane": Geom.mjGEOM_PLANE,
    "box": Geom.mjGEOM_BOX,
    "sphere": Geom.mjGEOM_SPHERE,
    "capsule": Geom.mjGEOM_CAPSULE,
    "cylinder": Geom.mjGEOM_CYLINDER,
    "ellipsoid": Geom.mjGEOM_ELLIPSOID,
}


@dataclass
class Room:
    """Random geoms, in a C model and as ours; those of `owner` 0 sit on one body, for exclusion."""

    model: mujoco.MjModel
    data: mujoco.MjData
    geoms: Geoms
    body: int

    def c(self, origins, directions, exclude=-1):
        """Distance (infinite for none) and normal of C's first hit for each ray."""
        distance, normal = np.zeros(len(origins)), np.zeros((len(origins), 3))
        for i, (o, d) in enumerate(zip(origins, directions, strict=True)):
            hit = np.zeros(1, np.int32)
            distance[i] = mujoco.mj_ray(self.model, self.data, o, d, None, 1, exclude, hit, normal[i])
        return np.where(distance < 0, np.inf, distance), normal

    def oracle(self, origins, directions, exclude=-1):
        """C's distances and cosines, and which rays graze nothing."""
        distance, normal = self.c(origins, directions, exclude)
        clear = np.ones(len(origins), bool)
        for nudge in np.random.default_rng(3).choice([-GRAZE, GRAZE], (4, 3)):
            moved, turned = self.c(origins + nudge, directions, exclude)
            gone = np.isinf(distance) != np.isinf(moved)
            with np.errstate(invalid="ignore"):
                far = np.abs(moved - distance) > JUMP
            clear &= ~(gone | far | (np.abs(turned - normal).max(-1) > JUMP * 3))
        assert clear.mean() > 1 - FEW
        return distance, np.abs((normal * directions).sum(-1)), clear


def make_room(seed: int, kinds=tuple(KINDS), each: int = 4, padding: int = 2) -> Room:
    rng = np.random.default_rng(seed)
    spec = mujoco.MjSpec()
    robot = spec.worldbody.add_body(name="robot", mocap=True)
    owners = []
    for kind in kinds:
        for i in range(each):
            own = i == 0 and kind != "plane"  # C allows planes only on what does not move
            size = rng.uniform(0.05, 1.0, 3)
            # Every other one stands straight, so that rays along the axes are parallel to its faces.
            quat = rng.normal(size=4) if i % 2 == 0 else np.array([1.0, 0, 0, 0])
            pos = rng.uniform(-3, 3, 3)
            if kind == "plane" and i == 0:
                size[:2], quat, pos = 0, np.array([1.0, 0, 0, 0]), np.array([0, 0, -2.5])  # a floor
            (robot if own else spec.worldbody).add_geom(
                type=KINDS[kind], size=size, pos=pos, quat=quat / np.linalg.norm(quat)
            )
            owners.append((spec.geoms[-1], 0 if own else -1))
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    body = model.body("robot").id
    owner = np.where(model.geom_bodyid == body, 0, -1)
    # Padding: of each type some geoms of a big size, far away, as a batch keeps for other worlds.
    pad = np.repeat([int(KINDS[kind]) for kind in kinds], padding)
    far = np.full((len(pad), 3), PADDING_DISTANCE)
    far[np.repeat([kind == "plane" for kind in kinds], padding)] *= (0, 0, -1)  # below everything
    kind = np.concatenate([model.geom_type, pad])
    pos = np.concatenate([data.geom_xpos, far])
    mat = np.concatenate([data.geom_xmat.reshape(-1, 3, 3), np.tile(np.eye(3), (len(pad), 1, 1))])
    size = np.concatenate([model.geom_size, np.ones((len(pad), 3))])
    owner = np.concatenate([owner, np.full(len(pad), -1)])
    ours = (jnp.asarray(a, jnp.float32) for a in (pos, mat, size))
    return Room(model, data, make_geoms(kind, *ours, jnp.asarray(owner)), body)


def make_rays(room: Room, seed: int, count: int = RAYS):
    """Rays parallel to an axis (a fifth), from inside geoms (a third), the rest aimed at or near geoms."""
    rng = np.random.default_rng(seed)
    model, data = room.model, room.data
    g = rng.integers(model.ngeom, size=count)
    mats = data.geom_xmat.reshape(-1, 3, 3)
    reach = np.where(model.geom_type[:, None] == Geom.mjGEOM_PLANE, (1, 1, 0), 1) * model.geom_size
    near = data.geom_xpos[g] + np.einsum("rij,rj->ri", mats[g], reach[g] * rng.uniform(-1.2, 1.2, (count, 3)))
    origins = rng.uniform(-4, 4, (count, 3))
    solid = model.geom_type[g] != Geom.mjGEOM_PLANE
    inside = solid & (np.arange(count) % 3 == 1)
    origins[inside] = (data.geom_xpos[g] + rng.uniform(-0.02, 0.02, (count, 3)))[inside]
    directions = np.where(inside[:, None], rng.normal(size=(count, 3)), near - origins)
    parallel = np.arange(count) % 5 == 0
    directions[parallel] = rng.permutation([*np.eye(3), *-np.eye(3)] * count)[: parallel.sum()]
    origins[parallel & ~inside] = (near - 3 * directions)[parallel & ~inside]
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    # What ours is given is what C is given.
    return origins.astype(np.float32).astype(float), directions.astype(np.float32).astype(float)


# Without XLA's optimiser, which would take longer than all the rays.
quick_jit = partial(jax.jit, compiler_options={"xla_backend_optimization_level": 0})
see, see_for = (quick_jit(partial(cast_rays)) for _ in range(2))
see_angle = quick_jit(partial(cast_rays, query=RayQuery(incidence=True)))


def ours(function, room, rays, **how):
    return function(room.geoms, *(jnp.asarray(a, jnp.float32) for a in rays), **how)


@pytest.mark.oracle
@pytest.mark.parametrize("kind", KINDS)
def test_each_kernel_matches_c_mujoco(kind):
    kernel = quick_jit(RAY_KERNELS[int(KINDS[kind])])
    met = missed = 0
    for seed in range(4):
        room = make_room(seed, (kind,), each=3, padding=0)
        for g in range(room.model.ngeom):
            # C's rays pass what is fully transparent: one geom at a time.
            room.model.geom_rgba[:, 3] = np.arange(room.model.ngeom) == g
            origins, directions = make_rays(room, seed, 120)
            distance, _, clear = room.oracle(origins, directions)
            mat, pos = room.data.geom_xmat[g].reshape(3, 3), room.data.geom_xpos[g]
            size = np.tile(room.model.geom_size[g], (len(origins), 1))
            local = ((origins - pos) @ mat, directions @ mat, size)
            got = np.asarray(kernel(*(jnp.asarray(a.T, jnp.float32) for a in local)))
            np.testing.assert_allclose(got[clear], distance[clear], atol=RAY_ATOL)
            missed += np.isinf(distance[clear]).sum()
            met += np.isfinite(distance[clear]).sum()
    assert min(met, missed) > 100  # enough of both


@pytest.mark.oracle
@pytest.mark.parametrize("seed", range(4))
def test_casts_match_c_mujoco_in_random_rooms(seed):
    room = make_room(seed)
    rays = make_rays(room, 100 + seed)
    distance, cosine, clear = room.oracle(*rays)
    met = clear & np.isfinite(distance)
    assert met.sum() > RAYS / 3
    np.testing.assert_allclose(ours(see, room, rays).distance[clear], distance[clear], atol=RAY_ATOL)
    hits = ours(see_angle, room, rays)
    np.testing.assert_allclose(hits.distance[clear], distance[clear], atol=RAY_ATOL)
    np.testing.assert_allclose(hits.cosine[met], cosine[met], atol=COSINE_ATOL)
    assert not np.asarray(hits.cosine)[np.isinf(hits.distance)].any()


@pytest.mark.oracle
def test_rays_pass_the_viewers_own_geoms():
    room = make_room(21, ("box", "cylinder"))
    rays = make_rays(room, 22)
    distance, cosine, clear = room.oracle(*rays, exclude=room.body)
    others, _, _ = room.oracle(*rays)
    assert (distance[clear] != others[clear]).sum() > 10  # it makes a difference
    query = RayQuery(exclude_owner=jnp.int32(0))
    plain = ours(see_for, room, rays, query=query)
    np.testing.assert_allclose(plain.distance[clear], distance[clear], atol=RAY_ATOL)
    hits = ours(see_for, room, rays, query=query.replace(incidence=True))
    met = clear & np.isfinite(distance)
    np.testing.assert_allclose(hits.distance[clear], distance[clear], atol=RAY_ATOL)
    np.testing.assert_allclose(hits.cosine[met], cosine[met], atol=COSINE_ATOL)


def test_many_rooms_are_one_compilation():
    for seed in (31, 32, 33):
        room = make_room(seed)
        ours(see, room, make_rays(room, seed))
    assert see._cache_size() == 1


@pytest.mark.parametrize(
    ("origin", "direction", "distance"),
    [
        ((0, 0, 0), (1, 0, 0), 0.5),  # from the centre
        ((-2, 0, 0), (1, 0, 0), 1.5),
        ((-2, 0, 0), (-1, 0, 0), np.inf),  # behind
        ((-2, 0.49, 0), (1, 0, 0), 1.5),  # parallel to two faces, just inside
        ((-2, 0.51, 0), (1, 0, 0), np.inf),  # just outside
    ],
)
def test_rays_along_the_faces_of_a_box(origin, direction, distance):
    size = jnp.full(3, 0.5)
    kernel = RAY_KERNELS[int(Geom.mjGEOM_BOX)]
    assert kernel(jnp.array(origin, float), jnp.array(direction, float), size) == pytest.approx(distance)


def test_unknown_type_is_refused_by_type_and_name():
    types = [Geom.mjGEOM_BOX, Geom.mjGEOM_SDF, Geom.mjGEOM_ARROW, Geom.mjGEOM_SDF]
    with pytest.raises(UnsupportedGeomError) as caught:
        check_ray_kinds(types, ["crate", "statue", "hill", "bust"])
    message = str(caught.value)
    for word in ("mjGEOM_SDF", "mjGEOM_ARROW", "statue", "hill", "bust"):
        assert word in message
    assert "crate" not in message
    check_ray_kinds([*KINDS.values(), Geom.mjGEOM_MESH, Geom.mjGEOM_HFIELD], [*KINDS, "stone", "hill"])


def test_a_scene_with_such_a_geom_is_refused(monkeypatch):
    monkeypatch.delitem(RAY_KERNELS, int(Geom.mjGEOM_SPHERE))
    with pytest.raises(UnsupportedGeomError, match=r"mjGEOM_SPHERE.*r0/CameraPanTilt_Link1"):
        build_scene("yellow", ["P2AT"])
